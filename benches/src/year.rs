//! `geu-bench year`: a year of one unit, simulated, decoded to an archive, calibrated by fortnight and diagnosed by day.
//!
//! Each fortnight begins with a checkout. A day has a drift step in its second half, another one a loose float; every other day has no
//! effect. Finished steps are kept in `year.jsonl`, so a stopped run continues.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::Args;
use serde_json::{Value, json};

use crate::Result;
use crate::diagnose::{Injected, found};
use crate::process::{Finished, finish, geu};
use crate::table::Table;

/// Arguments of `geu-bench year`.
#[derive(Args)]
pub struct Arguments {
    #[arg(long, value_name = "N", default_value_t = 365)]
    days: u64,
    /// Directory of the recording and the results; a year takes up to 30 GB
    #[arg(long, value_name = "DIRECTORY")]
    directory: PathBuf,
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Midnight.
const START_S: u64 = 1_790_035_200;
const DAY_S: u64 = 86_400;
const FORTNIGHT: u64 = 14;
/// Scans of a survey, with which checkout and survey take some minutes more than a fortnight.
const SCANS: u64 = 2268;
/// The reference unit. Its scenario is a checkout and a survey for ever.
const UNIT: &str = include_str!("../../configs/reference.toml");

/// Days with an effect, from 0, of the whole year and of a trial of a few days.
const DRIFT_DAYS: [u64; 2] = [200, 1];
const PIVOT_DAYS: [u64; 2] = [300, 2];
const DRIFT: Injected = Injected { assignment: "", name: "GYRY drift-step", term: None };
const PIVOT: Injected = Injected { assignment: "", name: "GYRX pivot-clearance", term: None };

/// A step of a stage: wall clock and CPU time, s, largest memory, MB, and the result in words.
struct Step {
    stage: String,
    number: u64,
    figures: [f64; 3],
    result: String,
}

/// Measures what is not done yet, and prints.
///
/// # Errors
/// The directory cannot be written, a command fails.
pub fn run(arguments: &Arguments) -> Result {
    let year = Year { directory: &arguments.directory, days: arguments.days, is_whole: arguments.days > DRIFT_DAYS[0] };
    fs::create_dir_all(year.directory)?;
    let mut steps = year.steps()?;
    let mut work = vec![("simulate", 0), ("decode", 0)];
    let fortnights = arguments.days.div_ceil(FORTNIGHT).min((arguments.days / FORTNIGHT).max(1));
    work.extend((0..fortnights).map(|number| ("calibrate", number)));
    work.extend((0..arguments.days).map(|number| ("diagnose", number)));
    for (stage, number) in work {
        if steps.iter().any(|done| done.stage == stage && done.number == number) {
            continue;
        }
        let (finished, result) = match stage {
            "simulate" => year.simulate(arguments.seed)?,
            "decode" => year.decode()?,
            "calibrate" => year.calibrate(number)?,
            _ => year.diagnose(number)?,
        };
        let figures = [finished.time_s, finished.cpu_s, finished.peak_mb];
        eprintln!("{stage} {number}: {:.1} s, {result}", finished.time_s);
        let step = Step { stage: stage.to_owned(), number, figures, result };
        year.keep(&step)?;
        steps.push(step);
    }
    println!("{} days, seed {}; {}", arguments.days, arguments.seed, geu()?.get_program().display());
    println!("{}", table(&steps));
    Ok(())
}

/// The recording and its results.
struct Year<'a> {
    directory: &'a Path,
    days: u64,
    is_whole: bool,
}

impl Year<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    fn steps(&self) -> Result<Vec<Step>> {
        let Ok(text) = fs::read_to_string(self.path("year.jsonl")) else { return Ok(Vec::new()) };
        let step = |line: &str| -> Result<Step> {
            let value: Value = serde_json::from_str(line)?;
            let text = |key: &str| value[key].as_str().unwrap_or_default().to_owned();
            let number = |key: &str| value[key].as_f64().unwrap_or_default();
            let figures = [number("time_s"), number("cpu_s"), number("peak_mb")];
            Ok(Step { stage: text("stage"), number: number("number") as u64, figures, result: text("result") })
        };
        text.lines().map(step).collect()
    }

    fn keep(&self, step: &Step) -> Result {
        let [time_s, cpu_s, peak_mb] = step.figures;
        let line = json!({ "stage": step.stage, "number": step.number, "time_s": time_s, "cpu_s": cpu_s, "peak_mb": peak_mb,
                           "result": step.result });
        writeln!(OpenOptions::new().create(true).append(true).open(self.path("year.jsonl"))?, "{line}")?;
        Ok(())
    }

    /// Days with a drift step and with a loose float.
    fn days_with_effects(&self) -> [u64; 2] {
        [DRIFT_DAYS, PIVOT_DAYS].map(|[whole, trial]| if self.is_whole { whole } else { trial })
    }

    /// Writes link and reference of the whole time, and the reference of each day.
    fn simulate(&self, seed: u64) -> Result<(Finished, String)> {
        let (before, rest) = UNIT.split_once("[[manoeuvre]]").ok_or("expected manoeuvres of the reference unit")?;
        let (scenario, after) =
            rest.split_once("[temperature]").ok_or("expected a temperature of the reference unit")?;
        let scenario = scenario.replace("kind = \"survey\"", &format!("kind = \"survey\"\nscans = {SCANS}"));
        let scenarios = format!("[[manoeuvre]]{scenario}").repeat(self.days.div_ceil(FORTNIGHT) as usize);
        fs::write(self.path("year.toml"), format!("{before}{scenarios}[temperature]{after}"))?;
        let [drift_s, pivot_s] = self.days_with_effects().map(|day| day * DAY_S);
        fs::write(
            self.path("faults.toml"),
            format!(
                "[[fault]]\nid = \"drift\"\nat_s = {}\ngyro = \"GYRY\"\nparameter = \"drift.arcsec_per_h\"\n\
                 course = {{ step = 30.0 }}\nfor_s = {}\n\n[[fault]]\nid = \"pivot\"\nat_s = {pivot_s}\ngyro = \"GYRX\"\n\
                 parameter = \"pivot-clearance.clearance_arcsec\"\ncourse = {{ step = 11.5 }}\nfor_s = {DAY_S}\n",
                drift_s + DAY_S / 2,
                DAY_S / 2
            ),
        )?;
        let mut command = geu()?;
        command.arg("simulate").arg(self.path("year.toml")).arg("--faults").arg(self.path("faults.toml"));
        command.args(["--force", "--format", "parquet", "--start", &START_S.to_string(), "--seed", &seed.to_string()]);
        command.args(["--duration", &format!("{}d", self.days)]).arg("--out").arg(self.path("recording"));
        let finished = completed(&mut command)?;
        for unused in ["truth.parquet", "fss.csv", "sse.csv"] {
            fs::remove_file(self.path("recording").join(unused))?;
        }
        let reference = self.path("recording").join("reference.csv");
        self.divide(&reference)?;
        fs::remove_file(reference)?;
        let link_gb = fs::metadata(self.path("recording").join("link.log"))?.len() as f64 * 1e-9;
        Ok((finished, format!("candump log of {link_gb:.1} GB")))
    }

    /// Writes the rows of each day to a reference of its own.
    fn divide(&self, reference: &Path) -> Result {
        let mut lines = BufReader::new(File::open(reference)?).lines();
        let header = lines.next().ok_or("expected a reference with rows")??;
        let mut open: Option<(u64, BufWriter<File>)> = None;
        for line in lines {
            let line = line?;
            let seconds = line.split_once(',').and_then(|(t_s, _)| t_s.parse::<f64>().ok()).ok_or("expected a time")?;
            // A row is of the time before it.
            let day = (((seconds - START_S as f64) / DAY_S as f64).ceil() as u64).saturating_sub(1);
            if open.as_ref().is_none_or(|own| own.0 != day) {
                let mut file = BufWriter::new(File::create(self.reference(day))?);
                writeln!(file, "{header}")?;
                open = Some((day, file));
            }
            if let Some((_, file)) = &mut open {
                writeln!(file, "{line}")?;
            }
        }
        Ok(())
    }

    fn reference(&self, day: u64) -> PathBuf {
        self.path(&format!("reference-{day:03}.csv"))
    }

    fn decode(&self) -> Result<(Finished, String)> {
        let (link, archive) = (self.path("recording").join("link.log"), self.path("archive"));
        let mut command = geu()?;
        command
            .arg("decode")
            .arg(&link)
            .args(["--quiet", "--force", "--format", "parquet", "--partition"])
            .arg(&archive);
        let finished = completed(&mut command)?;
        fs::remove_file(link)?;
        Ok((finished, format!("archive of {:.1} GB", bytes_of(&archive)? as f64 * 1e-9)))
    }

    /// A command on the archive from a day to another one.
    fn on_archive(&self, command: &str, config: &Path, days: [u64; 2]) -> Result<Command> {
        let [from_s, to_s] = days.map(|day| (START_S + day * DAY_S).to_string());
        let mut own = geu()?;
        own.arg(command).arg("--config").arg(config).arg("--link").arg(self.path("archive"));
        own.args(["--from", &from_s, "--to", &to_s]).env("XDG_CACHE_HOME", self.path("cache"));
        Ok(own)
    }

    fn config(&self, fortnight: u64) -> PathBuf {
        self.path(&format!("calibrated-{fortnight:02}.toml"))
    }

    /// Calibrates a fortnight. Without an explanation of its data the calibration before stays.
    fn calibrate(&self, fortnight: u64) -> Result<(Finished, String)> {
        let (first, end) = (fortnight * FORTNIGHT, ((fortnight + 1) * FORTNIGHT).min(self.days));
        let reference = self.path("fortnight.csv");
        let mut all = BufWriter::new(File::create(&reference)?);
        for day in first..end {
            let text = fs::read(self.reference(day))?;
            let header = text.iter().position(|&byte| byte == b'\n').map_or(0, |end| end + 1);
            all.write_all(&text[if day == first { 0 } else { header }..])?;
        }
        all.flush()?;
        let prior = self.path("unit.toml");
        fs::write(&prior, UNIT)?;
        let (result, out) = (self.path("calibrated.json"), self.config(fortnight));
        let mut command = self.on_archive("calibrate", &prior, [first, end])?;
        command.arg("--reference").arg(&reference).arg("--json").arg(&result).arg("--out").arg(&out);
        let finished = finish(&mut command, Stdio::null())?;
        fs::remove_file(&reference)?;
        if out.exists() {
            return Ok((finished, "explained".to_owned()));
        }
        if !result.exists() {
            return Err(finished.text().err().unwrap_or_default().into());
        }
        fs::copy(if fortnight == 0 { prior } else { self.config(fortnight - 1) }, out)?;
        Ok((finished, "not explained".to_owned()))
    }

    fn diagnose(&self, day: u64) -> Result<(Finished, String)> {
        let [drift, pivot] = self.days_with_effects();
        let injected: &[Injected] = match day {
            _ if day == drift => &[DRIFT],
            _ if day == pivot => &[PIVOT],
            _ => &[],
        };
        let config = self.config((day / FORTNIGHT).min((self.days / FORTNIGHT).max(1) - 1));
        let mut command = self.on_archive("diagnose", &config, [day, day + 1])?;
        command.arg("--reference").arg(self.reference(day)).arg("--json").arg(self.path("found.json"));
        let finished = finish(&mut command, Stdio::null())?;
        fs::remove_dir_all(self.path("cache"))?;
        match finished.output.status.code() {
            // 3: not explained, as the result states.
            Some(0 | 3) => Ok((finished, found(self.directory, injected)?)),
            _ => Err(finished.text().err().unwrap_or_default().into()),
        }
    }
}

/// The steps of each stage together.
fn table(steps: &[Step]) -> Table {
    let columns = ["stage", "steps", "time, s", "CPU time, s", "CPU time of a step, s", "peak memory, MB", "result"];
    let mut table = Table::new("year", &columns);
    for stage in ["simulate", "decode", "calibrate", "diagnose"] {
        let own: Vec<&Step> = steps.iter().filter(|step| step.stage == stage).collect();
        if own.is_empty() {
            continue;
        }
        let sum = |figure: usize| own.iter().map(|step| step.figures[figure]).sum::<f64>();
        let largest = |figure: usize| own.iter().map(|step| step.figures[figure]).fold(0.0, f64::max);
        let mut results = BTreeMap::<&str, Vec<String>>::new();
        for step in &own {
            results.entry(&step.result).or_default().push(step.number.to_string());
        }
        let result = |(result, numbers): (&str, Vec<String>)| match numbers.len() {
            1 if own.len() > 1 => format!("{}: {result}", numbers[0]),
            count if count < own.len() => format!("{count} times {result}"),
            _ => result.to_owned(),
        };
        table.row([
            stage.to_owned(),
            own.len().to_string(),
            format!("{:.0}", sum(0)),
            format!("{:.0}", sum(1)),
            format!("{:.1} (at most {:.1})", sum(1) / own.len() as f64, largest(1)),
            format!("{:.0}", largest(2)),
            results.into_iter().map(result).collect::<Vec<_>>().join("; "),
        ]);
    }
    table
}

fn completed(command: &mut Command) -> Result<Finished> {
    let finished = finish(command, Stdio::null())?;
    finished.text()?;
    Ok(finished)
}

/// Bytes of the files under a directory.
fn bytes_of(directory: &Path) -> Result<u64> {
    let mut sum = 0;
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        sum += if entry.file_type()?.is_dir() { bytes_of(&entry.path())? } else { entry.metadata()?.len() };
    }
    Ok(sum)
}
