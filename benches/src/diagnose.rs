//! `geu-bench diagnose`: the whole `geu diagnose`, from files to names of effects, beside Python regressions of the same residual.

use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Stdio;

use clap::Args;
use geu_calibration::CountsReader;
use geu_diagnosis::MeasuredData;
use geu_diagnosis::measured::Shifts;
use geu_model::temperature::SENSOR_NOMINAL_C;
use geu_model::units::{RAD_PER_DEG, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Truth};
use geu_recorder::{Destination, record};
use geu_recording::{DecoderOptions, InputReader, ReferenceAttitude, Stop};
use serde_json::Value;

use crate::Result;
use crate::process::{Finished, finish, geu, python};
use crate::rounds::{Contender, Rounds, Spread};
use crate::table::Table;

/// Sequential selection with statsmodels, sparse regression with pysindy.
const PYTHON: &str = include_str!("diagnose.py");
/// Terms of a regression that are printed.
const SHOWN: usize = 4;

/// Arguments of `geu-bench diagnose`.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    rounds: Rounds,
    /// Lengths of the recordings: of the first length with one effect, without and with two effects, of the others with one
    /// effect
    #[arg(long, value_name = "H,…", value_delimiter = ',', default_value = "3,24", value_parser = hours)]
    hours: Vec<f64>,
    /// Leave out statsmodels and pysindy
    #[arg(long)]
    alone: bool,
}

fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse().ok().filter(|hours| (0.5..=240.0).contains(hours));
    hours.ok_or_else(|| format!("expected 0.5…240 hours, got {text}"))
}

/// An injected effect: assignment, name of the diagnosis, and the equal term of a regression, if there is one.
struct Injected {
    assignment: &'static str,
    name: &'static str,
    term: Option<&'static str>,
}

const PIVOT: Injected = Injected {
    assignment: "gyro.GYRX.pivot-clearance.clearance_arcsec=11.5",
    name: "GYRX pivot-clearance",
    term: None,
};
const CUBIC: Injected = Injected {
    assignment: "gyro.GYRY.scale-factor-nonlinearity.cubic_ppm=180",
    name: "GYRY scale-factor-nonlinearity",
    term: Some("GYRY rate_y^3"),
};
const RAMP: Injected = Injected {
    assignment: "gyro.GYRX.drift-ramp.arcsec_per_h_per_day=420",
    name: "GYRX drift-ramp",
    term: Some("GYRX time"),
};

/// Recordings and their injected effects.
const CASES: [(&str, &[Injected]); 3] = [("one effect", &[PIVOT]), ("no effect", &[]), ("two effects", &[CUBIC, RAMP])];

/// Measures and prints.
///
/// # Errors
/// The temporary directory cannot be written, a diagnosis fails.
pub fn run(arguments: &Arguments) -> Result {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    println!("{cores} cores; cold: thresholds computed, warm: thresholds stored; {}", arguments.rounds);
    println!("targets: three hours in 1 s warm, a day in 8 s warm and 15 s cold");
    let columns = ["case", "", "time, s: median (min…max)", "CPU time, s", "peak memory, MB", "found"];
    let mut table = Table::new("diagnose", &columns);
    for (index, &hours) in arguments.hours.iter().enumerate() {
        for (name, injected) in &CASES[..if index == 0 { CASES.len() } else { 1 }] {
            let assignments: Vec<&str> = injected.iter().map(|effect| effect.assignment).collect();
            eprintln!("{hours} h, {name} {}", assignments.join(" "));
            let directory = tempfile::tempdir()?;
            let case = format!("{hours} h, {name}");
            measure(&mut table, &case, arguments, directory.path(), hours, injected)?;
        }
    }
    println!("{table}");
    Ok(())
}

/// Makes a recording, and measures all contenders on it.
fn measure(
    table: &mut Table,
    case: &str,
    arguments: &Arguments,
    directory: &Path,
    hours: f64,
    injected: &[Injected],
) -> Result {
    let overrides: Vec<String> = injected.iter().map(|effect| effect.assignment.to_owned()).collect();
    let unit = Configuration::reference_with(&overrides)?;
    record(&Destination::new(directory, true), &unit, (hours * 3600.0 / SAMPLE_INTERVAL_S) as u64)?;
    fs::write(directory.join("nominal.toml"), Configuration::reference().to_toml(false))?;
    // Stores the thresholds for the warm runs.
    let warm = directory.join("cache");
    diagnose(directory, &warm, injected)?;
    let mut contenders = vec![
        Contender::ours("geu, cold", || {
            let cold = tempfile::tempdir().map_err(|error| error.to_string())?;
            diagnose(directory, cold.path(), injected)
        }),
        Contender::ours("geu, warm", || diagnose(directory, &warm, injected)),
    ];
    if !arguments.alone {
        let residual = directory.join("residual.csv");
        fs::write(&residual, residual_csv(directory)?)?;
        for tool in ["statsmodels", "pysindy"] {
            let residual = residual.display().to_string();
            contenders.push(Contender::other(tool, move || {
                let finished = python(directory, PYTHON, &[tool, &residual])?;
                let terms: Vec<String> = finished.text()?.lines().map(str::to_owned).collect();
                Ok((finished, judge(&terms, injected)))
            }));
        }
    }
    for result in arguments.rounds.measure(contenders)? {
        match &result.runs {
            Ok(runs) => row(table, case, &result.name, runs),
            Err(reason) => table.row([case.to_owned(), result.name.clone(), format!("skipped: {reason}")]),
        }
    }
    Ok(())
}

/// Adds the times of a contender's runs, the largest memory, and the results, which are the same in every run.
fn row(table: &mut Table, case: &str, name: &str, runs: &[(Finished, String)]) {
    let spread = |value: fn(&Finished) -> f64| Spread::new(runs.iter().map(|(finished, _)| value(finished)));
    let (time_s, cpu_s, peak_mb) = (spread(|run| run.time_s), spread(|run| run.cpu_s), spread(|run| run.peak_mb));
    let mut found: Vec<&str> = runs.iter().map(|(_, found)| found.as_str()).collect();
    found.dedup();
    let figures = [format!("{time_s:.2}"), format!("{cpu_s:.2}"), format!("{:.0}", peak_mb.max)];
    let found = found.join("; in another run: ");
    table.row([case.to_owned(), name.to_owned()].into_iter().chain(figures).chain([found]));
}

/// Runs a diagnosis with a cache of thresholds, and compares its result with the injected effects.
fn diagnose(directory: &Path, cache: &Path, injected: &[Injected]) -> Result<(Finished, String), String> {
    let mut command = geu().map_err(|error| error.to_string())?;
    command.arg("diagnose").env("XDG_CACHE_HOME", cache);
    for (option, file) in [
        ("--config", "nominal.toml"),
        ("--link", "link.log"),
        ("--reference", "reference.csv"),
        ("--json", "found.json"),
    ] {
        command.arg(option).arg(directory.join(file));
    }
    let finished = finish(&mut command, Stdio::null())?;
    match finished.output.status.code() {
        // 3: the residual is not explained, as the result states.
        Some(0 | 3) => {
            let names: Vec<&str> = injected.iter().map(|effect| effect.name).collect();
            let found = found(directory, &names)?;
            Ok((finished, found))
        }
        _ => Err(String::from_utf8_lossy(&finished.output.stderr).into_owned()),
    }
}

/// The result of the diagnosis in `found.json`, and whether it is the injected effects.
pub fn found(directory: &Path, injected: &[&str]) -> Result<String, String> {
    let text = fs::read_to_string(directory.join("found.json")).map_err(|error| error.to_string())?;
    let result: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let effects = result["effects"].as_array().into_iter().flatten();
    let (mut names, mut texts) = (Vec::new(), vec![result["verdict"].as_str().unwrap_or_default().to_owned()]);
    for effect in effects.filter(|effect| effect["class"] == "missing-effect") {
        let gyros: Vec<&str> = effect["gyros"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let name = format!("{} {}", gyros.join("+"), effect["code"].as_str().unwrap_or_default());
        let values = effect["parameters"].as_object().into_iter().flatten();
        let values = values.filter_map(|(key, value)| {
            let (value, sigma) = (value["value"].as_f64()?, value["sigma"].as_f64()?);
            // Sigma has two digits.
            let decimals = (1.0 - sigma.log10().floor()).clamp(0.0, 9.0) as usize;
            Some(format!("{key} {value:.decimals$} ± {sigma:.decimals$}"))
        });
        texts.push(format!("{name}, {}", values.collect::<Vec<_>>().join(", ")));
        names.push(name);
    }
    let is_verdict_right = result["verdict"] == if injected.is_empty() { "consistent" } else { "explained" };
    let is_right = is_verdict_right && is_same(&names, injected.iter().copied());
    Ok(format!("{}: {}", if is_right { "right" } else { "wrong" }, texts.join("; ")))
}

/// Compares terms of a regression (gyro, term, coefficient) with the injected effects.
fn judge(terms: &[String], injected: &[Injected]) -> String {
    let names: Vec<&str> =
        terms.iter().map(|term| term.rsplit_once(' ').map_or(term.as_str(), |(name, _)| name)).collect();
    let none: Vec<&str> = injected.iter().filter(|effect| effect.term.is_none()).map(|effect| effect.name).collect();
    let is_right = none.is_empty() && is_same(&names, injected.iter().filter_map(|effect| effect.term));
    let mut text = if is_right { "right: " } else { "wrong: " }.to_owned();
    text += &if terms.is_empty() { "no term".to_owned() } else { terms[..terms.len().min(SHOWN)].join("; ") };
    if terms.len() > SHOWN {
        text += &format!(" and {} more", terms.len() - SHOWN);
    }
    if !none.is_empty() {
        text += &format!("; has no term for {}", none.join(", "));
    }
    text
}

/// True if two lists have the same names, in any order.
fn is_same<'a, T: AsRef<str>>(names: &[T], expected: impl Iterator<Item = &'a str>) -> bool {
    let (mut names, mut expected): (Vec<&str>, Vec<&str>) =
        (names.iter().map(AsRef::as_ref).collect(), expected.collect());
    names.sort_unstable();
    expected.sort_unstable();
    names == expected
}

/// For each sample the accumulated residual of each gyro, measured less modelled, as in the diagnosis before averaging, and
/// the candidate regressors.
fn residual_csv(directory: &Path) -> Result<String> {
    let name = |file: &str| directory.join(file).display().to_string();
    let nominal = Configuration::reference();
    let reference = ReferenceAttitude::read(&name("reference.csv"))?;
    let mut reader = CountsReader::default();
    let mut input = InputReader::new(DecoderOptions::default(), Stop::default());
    input.read(&name("link.log"), &mut reader)?;
    input.finish(&mut reader).1?;
    let counts = reader.finish(reference.start_ns).ok_or("expected samples, got none")?;
    let measured = MeasuredData::new(counts, &reference, &nominal)?;
    let (counted, model) = (measured.series(), measured.run(&nominal, Shifts::default()));
    let mut motion = Truth::Recorded(measured.reference.clone()).motion(&nominal, 0.0);
    let mut text =
        "time,gyrx,gyry,gyrza,gyrzb,rate_x,rate_y,rate_z,acceleration_x,acceleration_y,acceleration_z,temperature,\
                    sensor_temperature,theta\n"
            .to_owned();
    for node in 1..=measured.samples {
        let t_s = node as f64 * SAMPLE_INTERVAL_S;
        let step = motion.advance(t_s);
        let (start, end) = (step.start.rate_control_arcsec_s, step.end.rate_control_arcsec_s);
        let row = [t_s]
            .into_iter()
            .chain((0..nominal.device.heads.len()).map(|gyro| counted[gyro][node] - model[gyro][node]))
            .chain(step.angle_control_arcsec.map(|angle| angle / SAMPLE_INTERVAL_S))
            .chain((0..3).map(|axis| (end[axis] - start[axis]) / SAMPLE_INTERVAL_S))
            .chain([
                measured.counts.electronics_c[node] - nominal.electronics.numbers.reference_c,
                measured.counts.sensor_c[node] - SENSOR_NOMINAL_C,
                step.end.theta_rad / RAD_PER_DEG - 90.0,
            ]);
        let row: Vec<String> = row.map(|value| value.to_string()).collect();
        let _ = writeln!(text, "{}", row.join(","));
    }
    Ok(text)
}
