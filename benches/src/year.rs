//! `geu-bench year`: a year of one unit, simulated, decoded to an archive, calibrated by fortnight and diagnosed by day.
//!
//! A checkout comes every thirteen and a half days, so each fortnight has one. One day has a drift step in its second half, another one a
//! loose float, all others have no effect. `year.jsonl` keeps the finished steps, so a stopped run continues.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::Args;
use serde_json::{Value, json};

use crate::Result;
use crate::diagnose::found;
use crate::process::{Finished, finish, geu};
use crate::table::Table;

/// Arguments of `geu-bench year`.
#[derive(Args)]
pub struct Arguments {
    /// A part of a fortnight at the end is diagnosed with the calibration before it
    #[arg(long, value_name = "N", default_value_t = 365, value_parser = clap::value_parser!(u64).range(3..=366))]
    days: u64,
    /// Directory of the recording and the results; a year takes up to 30 GB
    #[arg(long, value_name = "DIRECTORY")]
    directory: PathBuf,
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Finished steps.
const RESULTS: &str = "year.jsonl";
/// Midnight.
const START_S: u64 = 1_790_035_200;
const DAY_S: u64 = 86_400;
const FORTNIGHT: u64 = 14;
/// Scans of a survey, with which checkout and survey take a little more than [`CYCLE_DAYS`].
const SCANS: u64 = 2268;
const CYCLE_DAYS: f64 = 13.5;
/// The reference unit. Its scenario is a checkout and a survey for ever.
const UNIT: &str = include_str!("../../configs/reference.toml");

/// Days with a drift step and with a loose float, from 0, of a year and of a shorter time.
const DAYS_OF_YEAR: [u64; 2] = [200, 300];
const DAYS_OF_TRIAL: [u64; 2] = [1, 2];
const DRIFT: &str = "GYRY drift-step";
const PIVOT: &str = "GYRX pivot-clearance";

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
    let year = Year { directory: &arguments.directory, days: arguments.days };
    fs::create_dir_all(year.directory)?;
    let version = completed(geu()?.arg("--version"))?.text()?;
    let head = format!("{} days, seed {}, {}", arguments.days, arguments.seed, version.trim());
    let mut steps = year.steps(&head)?;
    let mut work = vec![("simulate", 0), ("decode", 0)];
    work.extend((0..year.fortnights()).map(|number| ("calibrate", number)));
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
    println!("{head}\n{}", table(&steps));
    Ok(())
}

/// The recording and its results.
struct Year<'a> {
    directory: &'a Path,
    days: u64,
}

impl Year<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    /// Fortnights to calibrate.
    fn fortnights(&self) -> u64 {
        (self.days / FORTNIGHT).max(1)
    }

    /// The finished steps of a year of this description, which is the first line.
    fn steps(&self, head: &str) -> Result<Vec<Step>> {
        let (path, head) = (self.path(RESULTS), json!({ "year": head }).to_string());
        let text = match fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            text => text.map_err(|error| format!("{}: {error}", path.display()))?,
        };
        // A kill can leave the last line without its end.
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        if whole.is_empty() {
            fs::write(&path, format!("{head}\n"))?;
        } else if whole.len() < text.len() {
            OpenOptions::new().write(true).open(&path)?.set_len(whole.len() as u64)?;
        }
        let mut lines = whole.lines().enumerate();
        if let Some((_, own)) = lines.next().filter(|(_, own)| *own != head) {
            return Err(format!("{}: expected {head}, got {own}; give another directory", path.display()).into());
        }
        let step = |(number, line): (usize, &str)| -> Result<Step> {
            let failed = |error| format!("{}: line {}: {error}", path.display(), number + 1);
            let value: Value = serde_json::from_str(line).map_err(failed)?;
            let text = |key: &str| value[key].as_str().unwrap_or_default().to_owned();
            let number = |key: &str| value[key].as_f64().unwrap_or_default();
            let figures = [number("time_s"), number("cpu_s"), number("peak_mb")];
            Ok(Step { stage: text("stage"), number: number("number") as u64, figures, result: text("result") })
        };
        lines.map(step).collect()
    }

    fn keep(&self, step: &Step) -> Result {
        let [time_s, cpu_s, peak_mb] = step.figures;
        let line = json!({ "stage": step.stage, "number": step.number, "time_s": time_s, "cpu_s": cpu_s, "peak_mb": peak_mb,
                           "result": step.result });
        OpenOptions::new().append(true).open(self.path(RESULTS))?.write_all(format!("{line}\n").as_bytes())?;
        Ok(())
    }

    /// Days with a drift step and with a loose float.
    fn days_with_effects(&self) -> [u64; 2] {
        if self.days > DAYS_OF_YEAR[1] { DAYS_OF_YEAR } else { DAYS_OF_TRIAL }
    }

    /// Writes link and reference of the whole time, and the reference of each day.
    fn simulate(&self, seed: u64) -> Result<(Finished, String)> {
        let (before, rest) = UNIT.split_once("[[manoeuvre]]").ok_or("expected manoeuvres of the reference unit")?;
        let (scenario, after) =
            rest.split_once("[temperature]").ok_or("expected a temperature of the reference unit")?;
        let scenario = scenario.replace("kind = \"survey\"", &format!("kind = \"survey\"\nscans = {SCANS}"));
        let scenarios = format!("[[manoeuvre]]{scenario}").repeat((self.days as f64 / CYCLE_DAYS).ceil() as usize);
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
            // A row has the motion up to its time.
            let day = (((seconds - START_S as f64) / DAY_S as f64).ceil() as u64).saturating_sub(1);
            if open.as_ref().is_none_or(|own| own.0 != day) {
                let mut file = BufWriter::new(File::create(self.reference(day))?);
                writeln!(file, "{header}")?;
                if let Some((_, mut before)) = open.replace((day, file)) {
                    before.flush()?;
                }
            }
            if let Some((_, file)) = &mut open {
                writeln!(file, "{line}")?;
            }
        }
        if let Some((_, mut last)) = open {
            last.flush()?;
        }
        Ok(())
    }

    fn reference(&self, day: u64) -> PathBuf {
        self.path(&format!("reference-{day:03}.csv"))
    }

    fn decode(&self) -> Result<(Finished, String)> {
        let (link, archive) = (self.path("recording").join("link.log"), self.path("archive"));
        remove(&archive, fs::remove_dir_all)?;
        let mut command = geu()?;
        command
            .arg("decode")
            .arg(&link)
            .args(["--quiet", "--force", "--format", "parquet", "--partition"])
            .arg(&archive);
        let finished = completed(&mut command)?;
        Ok((finished, format!("archive of {:.1} GB", bytes_of(&archive)? as f64 * 1e-9)))
    }

    /// A command on the archive from a day to another one.
    fn on_archive(&self, command: &str, config: &Path, days: [u64; 2]) -> Result<Command> {
        let [from_s, to_s] = days.map(|day| (START_S + day * DAY_S).to_string());
        let mut own = geu()?;
        own.arg(command).arg("--config").arg(config).arg("--link").arg(self.path("archive"));
        own.args(["--from", &from_s, "--to", &to_s]);
        Ok(own)
    }

    fn config(&self, fortnight: u64) -> PathBuf {
        self.path(&format!("calibrated-{fortnight:02}.toml"))
    }

    /// Calibrates a fortnight. If its data are not explained, the calibration before is used.
    fn calibrate(&self, fortnight: u64) -> Result<(Finished, String)> {
        remove(&self.path("recording").join("link.log"), fs::remove_file)?;
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
        let out = self.config(fortnight);
        remove(&out, fs::remove_file)?;
        let mut command = self.on_archive("calibrate", &prior, [first, end])?;
        command.arg("--reference").arg(&reference).arg("--out").arg(&out);
        let finished = finish(&mut command, Stdio::null())?;
        fs::remove_file(&reference)?;
        match finished.output.status.code() {
            Some(0) => Ok((finished, "explained".to_owned())),
            Some(1) if String::from_utf8_lossy(&finished.output.stderr).contains("--anyway") => {
                fs::copy(if fortnight == 0 { prior } else { self.config(fortnight - 1) }, out)?;
                Ok((finished, "not explained".to_owned()))
            }
            _ => Err(finished.text().err().unwrap_or_default().into()),
        }
    }

    fn diagnose(&self, day: u64) -> Result<(Finished, String)> {
        let [drift, pivot] = self.days_with_effects();
        let injected: &[&str] = match day {
            _ if day == drift => &[DRIFT],
            _ if day == pivot => &[PIVOT],
            _ => &[],
        };
        let config = self.config((day / FORTNIGHT).min(self.fortnights() - 1));
        let mut command = self.on_archive("diagnose", &config, [day, day + 1])?;
        command
            .arg("--reference")
            .arg(self.reference(day))
            .arg("--no-cache")
            .arg("--json")
            .arg(self.path("found.json"));
        let finished = finish(&mut command, Stdio::null())?;
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
    let finished = finish(command, Stdio::piped())?;
    finished.text()?;
    Ok(finished)
}

/// Removes what may be absent.
fn remove<'a>(path: &'a Path, remove: impl FnOnce(&'a Path) -> io::Result<()>) -> Result {
    match remove(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(format!("{}: {error}", path.display()).into()),
        _ => Ok(()),
    }
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
