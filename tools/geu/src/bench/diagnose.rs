//! `geu bench diagnose`: the whole `geu diagnose` as a user has it, from files to names, beside what a Python user would assemble
//! on the same residual.

use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use clap::Args;
use geu_calibration::CountsReader;
use geu_daemon::recorder::{Destination, Recorder};
use geu_daemon::simulate::simulate;
use geu_diagnosis::MeasuredData;
use geu_diagnosis::measured::{Shifts, TIMING};
use geu_model::configuration::LinkLogFormat;
use geu_model::temperature::SENSOR_NOMINAL_C;
use geu_model::units::{RAD_PER_DEG, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Truth};
use geu_recording::{ReferenceAttitude, Sink};
use nix::sys::resource::{Usage, UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use serde_json::Value;

use super::rounds::{Contender, Rounds, Spread};
use crate::diagnose::DecodedRecording;
use crate::failure::{CommandError, say};
use crate::outputs::write;

/// Sequential selection with statsmodels, sparse regression with pysindy: what a Python user would write.
const PYTHON: &str = include_str!("diagnose.py");
/// How often a child's memory is looked at.
const LOOK: Duration = Duration::from_millis(5);

/// Terms of a regression that are printed.
const SHOWN: usize = 4;

/// Arguments of `geu bench diagnose`.
#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    rounds: Rounds,
    /// Lengths of the recordings: of the first one with one effect hidden, one with nothing and one with two, of the others one
    /// with one effect
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

/// What is hidden, as an assignment, as our name, and as the term of a regression that is the same function, where there is one.
struct Hidden {
    assignment: &'static str,
    name: &'static str,
    term: Option<&'static str>,
}

const PIVOT: Hidden =
    Hidden { assignment: "gyro.GYRX.pivot-clearance.clearance_arcsec=11.5", name: "GYRX pivot-clearance", term: None };
const CUBIC: Hidden = Hidden {
    assignment: "gyro.GYRY.scale-factor-nonlinearity.cubic_ppm=180",
    name: "GYRY scale-factor-nonlinearity",
    term: Some("GYRY rate_y^3"),
};
const RAMP: Hidden = Hidden {
    assignment: "gyro.GYRX.drift-ramp.arcsec_per_h_per_day=420",
    name: "GYRX drift-ramp",
    term: Some("GYRX time"),
};

/// Recordings with this hidden.
const CASES: [(&str, &[Hidden]); 3] =
    [("one effect", &[PIVOT]), ("nothing hidden", &[]), ("two effects", &[CUBIC, RAMP])];

/// What a child took and said.
struct Took {
    time_s: f64,
    cpu_s: f64,
    peak_mb: f64,
    output: Output,
}

/// Measures and prints.
///
/// # Errors
/// A temporary directory that cannot be written, a diagnosis that fails.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    say!("{cores} cores; cold: thresholds set anew, warm: known; {}", arguments.rounds)?;
    say!("targets, warm: 3 h under 5 s, 24 h under 40 s; under 500 MB")?;
    say!("{:<14} {:>22} {:>22} {:>9}   found", "", "time_s", "CPU_s", "peak_MB")?;
    for (index, &hours) in arguments.hours.iter().enumerate() {
        for (name, hidden) in &CASES[..if index == 0 { CASES.len() } else { 1 }] {
            let assignments: Vec<&str> = hidden.iter().map(|hidden| hidden.assignment).collect();
            say!("{hours} h, {name} {}", assignments.join(" "))?;
            let directory = tempfile::tempdir().map_err(CommandError::failed)?;
            case(arguments, directory.path(), hours, hidden)?;
        }
    }
    Ok(())
}

/// Makes a recording, and measures everyone on it.
fn case(arguments: &Arguments, directory: &Path, hours: f64, hidden: &[Hidden]) -> Result<(), CommandError> {
    record(directory, hours, hidden)?;
    // Thresholds for those that know them.
    let warm = directory.join("cache");
    diagnose(directory, &warm, hidden).map_err(CommandError::failed)?;
    let mut contenders = vec![
        Contender::ours("geu, cold", || {
            let cold = tempfile::tempdir().map_err(|error| error.to_string())?;
            diagnose(directory, cold.path(), hidden)
        }),
        Contender::ours("geu, warm", || diagnose(directory, &warm, hidden)),
    ];
    if !arguments.alone {
        let (script, residual) = (directory.join("bench.py"), directory.join("residual.csv"));
        write(&script, PYTHON)?;
        write(&residual, residual_csv(directory)?)?;
        for tool in ["statsmodels", "pysindy"] {
            let mut command = Command::new("python3");
            command.arg(&script).arg(tool).arg(&residual);
            contenders.push(Contender::other(tool, move || {
                let took = measure(&mut command).map_err(|error| format!("python3: {error}"))?;
                let terms = terms(&took)?;
                Ok((took, judged(&terms, hidden)))
            }));
        }
    }
    for result in arguments.rounds.measure(contenders)? {
        match &result.runs {
            Ok(runs) => show(&result.name, runs)?,
            Err(reason) => say!("  {:<12} skipped: {reason}", result.name)?,
        }
    }
    Ok(())
}

/// A contender's runs: times, the most memory of any, and what it found; every run finds the same.
fn show(name: &str, runs: &[(Took, String)]) -> Result<(), CommandError> {
    let of = |value: fn(&Took) -> f64| Spread::of(runs.iter().map(|(took, _)| value(took)));
    let (time_s, cpu_s, peak_mb) = (of(|took| took.time_s), of(|took| took.cpu_s), of(|took| took.peak_mb));
    let mut found: Vec<&str> = runs.iter().map(|(_, found)| found.as_str()).collect();
    found.dedup();
    say!("  {name:<12} {time_s:>22.2} {cpu_s:>22.2} {:>9.0}   {}", peak_mb.largest, found.join("; in another run: "))
}

/// Flies the reference unit with that hidden, and writes what it is believed to be.
fn record(directory: &Path, hours: f64, hidden: &[Hidden]) -> Result<(), CommandError> {
    let overrides: Vec<String> = hidden.iter().map(|hidden| hidden.assignment.to_owned()).collect();
    let unit = Configuration::reference_with(&overrides).map_err(CommandError::failed)?;
    let samples = (hours * 3600.0 / SAMPLE_INTERVAL_S) as u64;
    let mut recorder =
        Recorder::create(&Destination::new(directory, true), &unit, &Truth::Scenario, LinkLogFormat::Can, &[])
            .map_err(CommandError::failed)?;
    simulate(&unit, &Truth::Scenario, samples, &mut recorder, |_| true).map_err(CommandError::failed)?;
    recorder.finish().map_err(CommandError::failed)?;
    write(&directory.join("believed.toml"), Configuration::reference().to_toml(false))
}

/// A diagnosis as a process of its own, with its thresholds in this cache; and whether it names what is hidden.
fn diagnose(directory: &Path, cache: &Path, hidden: &[Hidden]) -> Result<(Took, String), String> {
    let mut command = Command::new(std::env::current_exe().map_err(|error| error.to_string())?);
    command.arg("diagnose").env("XDG_CACHE_HOME", cache);
    for (option, file) in [
        ("--config", "believed.toml"),
        ("--link", "link.log"),
        ("--reference", "reference.csv"),
        ("--json", "found.json"),
    ] {
        command.arg(option).arg(directory.join(file));
    }
    let took = measure(&mut command).map_err(|error| error.to_string())?;
    match took.output.status.code() {
        // 3: something is left unexplained, which the result tells.
        Some(0 | 3) => {
            let found = found(directory, hidden)?;
            Ok((took, found))
        }
        _ => Err(String::from_utf8_lossy(&took.output.stderr).into_owned()),
    }
}

/// Runs a command to its end; its output is short.
fn measure(command: &mut Command) -> std::io::Result<Took> {
    let cpu_before_s = children_cpu_s()?;
    let start = Instant::now();
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let status = format!("/proc/{}/status", child.id());
    let mut peak_kb = 0.0f64;
    while child.try_wait()?.is_none() {
        let status = std::fs::read_to_string(&status).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        peak_kb = peak_kb.max(line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(0.0));
        std::thread::sleep(LOOK);
    }
    let time_s = start.elapsed().as_secs_f64();
    let cpu_s = children_cpu_s()? - cpu_before_s;
    Ok(Took { time_s, cpu_s, peak_mb: peak_kb / 1024.0, output: child.wait_with_output()? })
}

/// CPU time of all children that have ended.
fn children_cpu_s() -> std::io::Result<f64> {
    let usage: Usage = getrusage(UsageWho::RUSAGE_CHILDREN)?;
    Ok((usage.user_time() + usage.system_time()).num_microseconds() as f64 * 1e-6)
}

/// What a diagnosis wrote, and whether it is what was hidden.
fn found(directory: &Path, hidden: &[Hidden]) -> Result<String, String> {
    let text = std::fs::read_to_string(directory.join("found.json")).map_err(|error| error.to_string())?;
    let result: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let effects = result["effects"].as_array().into_iter().flatten();
    let (mut names, mut told) = (Vec::new(), vec![result["verdict"].as_str().unwrap_or_default().to_owned()]);
    for effect in effects.filter(|effect| effect["class"] == "missing-effect") {
        let gyros: Vec<&str> = effect["gyros"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let name = format!("{} {}", gyros.join("+"), effect["code"].as_str().unwrap_or_default());
        let sizes = effect["parameters"].as_object().into_iter().flatten();
        let sizes =
            sizes.filter_map(|(key, size)| Some(told_size(key, size["value"].as_f64()?, size["sigma"].as_f64()?)));
        told.push(format!("{name}, {}", sizes.collect::<Vec<_>>().join(", ")));
        names.push(name);
    }
    let is_told = result["verdict"] == if hidden.is_empty() { "consistent" } else { "explained" };
    let is_right = is_told && same(&names, hidden.iter().map(|hidden| hidden.name));
    Ok(format!("{}: {}", if is_right { "right" } else { "wrong" }, told.join("; ")))
}

/// A size with its sigma in two digits.
fn told_size(name: &str, value: f64, sigma: f64) -> String {
    let decimals = (1.0 - sigma.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{name} {value:.decimals$} ± {sigma:.decimals$}")
}

/// The terms that a script printed, one a line: gyro, term, coefficient.
fn terms(took: &Took) -> Result<Vec<String>, String> {
    let [said, wrong] =
        [&took.output.stdout, &took.output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    match took.output.status.success() {
        true => Ok(said.lines().map(str::to_owned).collect()),
        false => Err(wrong.lines().last().unwrap_or("no output").to_owned()),
    }
}

/// Whether these terms are what was hidden.
fn judged(terms: &[String], hidden: &[Hidden]) -> String {
    let names: Vec<&str> =
        terms.iter().map(|term| term.rsplit_once(' ').map_or(term.as_str(), |(name, _)| name)).collect();
    let none: Vec<&str> = hidden.iter().filter(|hidden| hidden.term.is_none()).map(|hidden| hidden.name).collect();
    let is_right = none.is_empty() && same(&names, hidden.iter().filter_map(|hidden| hidden.term));
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

/// Whether two lists have the same names, in any order.
fn same<'a, T: AsRef<str>>(names: &[T], expected: impl Iterator<Item = &'a str>) -> bool {
    let (mut names, mut expected): (Vec<&str>, Vec<&str>) =
        (names.iter().map(AsRef::as_ref).collect(), expected.collect());
    names.sort_unstable();
    expected.sort_unstable();
    names == expected
}

/// For each sample the accumulated residual of each gyro, measured less believed, as the diagnosis has it before it averages,
/// and what a term of it may follow.
fn residual_csv(directory: &Path) -> Result<String, CommandError> {
    let name = |file: &str| directory.join(file).display().to_string();
    let reference = ReferenceAttitude::read(&name("reference.csv")).map_err(CommandError::input)?;
    let mut reader = CountsReader::default();
    DecodedRecording::read(&[name("link.log")], None)?.rows.iter().for_each(|row| reader.row(row));
    let counts = reader.finish(reference.start_ns).ok_or_else(|| CommandError::failed("expected samples, got none"))?;
    let measured = MeasuredData::new(counts, &reference).map_err(CommandError::failed)?;
    let believed = Configuration::reference();
    let (counted, model) = (measured.series(), measured.run(&believed, Shifts::default()));
    let mut motion = Truth::Recorded(measured.reference.clone()).motion(&believed, 0.0);
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
            .chain((0..TIMING).map(|gyro| counted[gyro][node] - model[gyro][node]))
            .chain(step.angle_control_arcsec.map(|angle| angle / SAMPLE_INTERVAL_S))
            .chain((0..3).map(|axis| (end[axis] - start[axis]) / SAMPLE_INTERVAL_S))
            .chain([
                measured.counts.electronics_c[node] - believed.electronics.numbers.reference_c,
                measured.counts.sensor_c[node] - SENSOR_NOMINAL_C,
                step.end.theta_rad / RAD_PER_DEG - 90.0,
            ]);
        let row: Vec<String> = row.map(|value| value.to_string()).collect();
        let _ = writeln!(text, "{}", row.join(","));
    }
    Ok(text)
}
