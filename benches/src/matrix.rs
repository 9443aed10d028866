//! `geu-bench matrix`: the diagnosis of recordings of the independent model, over motions and references, by number of injected effects.
//!
//! Effects have twelve times their sigma on the motion and against the reference of their recording. Each recording has a motion,
//! temperatures, calibration errors and noise of its own, and thresholds of its own. With `--out` each result is written when it is
//! there; a run with a file that has results continues it.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use clap::{Args, value_parser};
use geu_blind::{InjectedEffect, TrialGenerator, TrialMotion, TrialRun, on_threads};
use geu_diagnosis::{DiagnosisOptions, Verdict, diagnose_rows};
use geu_model::Configuration;
use geu_plant::{GYROS, Gyro, IndependentModel, MotionKind, PlantedEffect, Recording, ReferenceKind};
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop};
use serde::{Deserialize, Serialize};

use crate::Result;

/// Strength of the effects, sigmas.
const STRENGTH: f64 = 12.0;
/// Parts of a cell's recordings: nothing, one, two, three effects, outside the catalogue.
const PARTS: [(Content, usize); 5] = [
    (Content::Effects(0), 20),
    (Content::Effects(1), 20),
    (Content::Effects(2), 8),
    (Content::Effects(3), 4),
    (Content::Outside, 8),
];
const MOTIONS: [(&str, MotionKind); 4] = [
    ("survey with limit cycle", MotionKind::Survey),
    ("quiet survey", MotionKind::QuietSurvey),
    ("rate table", MotionKind::RateTable),
    ("closed-loop slews", MotionKind::ClosedLoop),
];
const REFERENCES: [(&str, ReferenceKind); 4] = [
    ("exact rates", ReferenceKind::Rates),
    ("4 Hz, 1″", ReferenceKind::Quaternions { steps: 10, sigma_arcsec: 1.0 }),
    ("1 Hz, 5″", ReferenceKind::Quaternions { steps: 40, sigma_arcsec: 5.0 }),
    ("0.1 Hz, 3″", ReferenceKind::Quaternions { steps: 400, sigma_arcsec: 3.0 }),
];

/// Arguments of `geu-bench matrix`.
#[derive(Args)]
pub struct Arguments {
    /// Random seed
    #[arg(long, value_name = "N", value_parser = value_parser!(u64).range(..1 << 40))]
    seed: u64,
    /// Recordings of each cell: a third with nothing, a third with one effect, the rest with two, three, and outside the catalogue
    #[arg(long, value_name = "N", default_value_t = 60)]
    runs: usize,
    /// Only this cell, motion 0…3 and reference 0…3
    #[arg(long, value_name = "M,R")]
    cell: Option<String>,
    /// Only recordings with this content: nothing, 1, 2, 3, outside
    #[arg(long, value_name = "CONTENT")]
    only: Option<String>,
    /// Print every recording that is not right
    #[arg(long)]
    misses: bool,
    /// Append each result to this file, as JSON lines; results of the same seed in it are taken from there
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write these recordings to this directory: SEED.log, and SEED.csv, the reference
    #[arg(long, value_name = "DIRECTORY")]
    keep: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Content {
    Effects(usize),
    Outside,
}

impl Content {
    fn name(self) -> String {
        match self {
            Content::Effects(0) => "nothing".to_owned(),
            Content::Effects(count) => count.to_string(),
            Content::Outside => "outside".to_owned(),
        }
    }
}

/// One recording of the matrix.
struct Trial {
    motion: usize,
    reference: usize,
    content: Content,
    /// Seed of its scenario, also of the recording that sizes the effects.
    seed: u64,
}

/// Result of one recording, a line of `--out`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct TrialResult {
    seed: u64,
    name: String,
    is_right: bool,
    diagnosis_s: f64,
    facts: Vec<(String, String)>,
}

/// Runs the campaign and prints its table.
///
/// # Errors
/// A recording cannot be written or diagnosed; `--out` cannot be read or written.
pub fn run(arguments: &Arguments) -> Result {
    let trials: Vec<Trial> = trials(arguments);
    arguments.keep.as_ref().map(fs::create_dir_all).transpose()?;
    let known = arguments.out.as_deref().map_or(Ok(BTreeMap::new()), read_results)?;
    let append = |path: &PathBuf| OpenOptions::new().create(true).append(true).open(path);
    let out = Mutex::new(arguments.out.as_ref().map(append).transpose()?);
    let (start, done) = (Instant::now(), AtomicUsize::new(0));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let results = on_threads(threads, trials.len(), &|index| {
        let trial = &trials[index];
        let result = known.get(&trial.seed).map_or_else(|| trial.result(arguments, &out), |result| Ok(result.clone()));
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        eprint!("\r{done} of {}, {:.0} s", trials.len(), start.elapsed().as_secs_f64());
        result.map_err(|error| format!("{}: {error}", trial.name()))
    });
    eprintln!();
    let mut cells: BTreeMap<(usize, usize, Content), [usize; 2]> = BTreeMap::new();
    for (trial, result) in trials.iter().zip(results) {
        let result = result?;
        let counts = cells.entry((trial.motion, trial.reference, trial.content)).or_default();
        counts[0] += usize::from(result.is_right);
        counts[1] += 1;
        if arguments.misses && !result.is_right {
            println!("{}, {:.1} s", result.name, result.diagnosis_s);
            result.facts.iter().for_each(|(label, value)| println!("    {label:20} {value}"));
        }
    }
    print(&cells);
    Ok(())
}

/// Results of an earlier run, by seed; none if there is no file.
fn read_results(path: &Path) -> Result<BTreeMap<u64, TrialResult>> {
    let text = match fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
        text => text?,
    };
    let result = |line: &str| serde_json::from_str(line).map(|result: TrialResult| (result.seed, result));
    let results: Result<_, _> = text.lines().map(result).collect();
    Ok(results.map_err(|error| format!("{}: {error}", path.display()))?)
}

fn trials(arguments: &Arguments) -> Vec<Trial> {
    let whole: usize = PARTS.iter().map(|(_, count)| count).sum();
    let mut trials = Vec::new();
    for motion in 0..MOTIONS.len() {
        for reference in 0..REFERENCES.len() {
            for (content, part) in PARTS {
                let count = (part * arguments.runs).div_ceil(whole);
                let is_asked = arguments.cell.as_ref().is_none_or(|cell| *cell == format!("{motion},{reference}"))
                    && arguments.only.as_ref().is_none_or(|only| *only == content.name());
                for index in (0..count).filter(|_| is_asked) {
                    let of_content = PARTS.iter().position(|(other, _)| *other == content).unwrap_or(0);
                    let place = ((motion * 4 + reference) * PARTS.len() + of_content) * 1000 + index;
                    trials.push(Trial { motion, reference, content, seed: (arguments.seed << 20) + place as u64 });
                }
            }
        }
    }
    trials
}

/// True for `consistent` without effects; each effect right or in its group, and no other; no name of the catalogue outside it.
fn is_right(run: &TrialRun, content: Content) -> bool {
    match content {
        Content::Effects(0) => run.result.verdict == Verdict::Consistent && run.result.missing.is_empty(),
        Content::Effects(count) => run.injected.len() == count && run.score.is_right(&run.injected, &run.result),
        Content::Outside => !run.is_wrong(),
    }
}

impl Trial {
    fn name(&self) -> String {
        let Trial { motion, reference, content, seed } = self;
        format!("{}, {}, {}, seed {seed}", MOTIONS[*motion].0, REFERENCES[*reference].0, content.name())
    }

    fn result(&self, arguments: &Arguments, out: &Mutex<Option<fs::File>>) -> Result<TrialResult> {
        let run = self.run()?;
        let is_right = is_right(&run, self.content);
        if let Some(directory) = arguments.keep.as_ref().filter(|_| !is_right) {
            let recording = self.recording(&run.injected.iter().map(planted).collect::<Vec<_>>());
            fs::write(directory.join(format!("{}.log", self.seed)), recording.link)?;
            fs::write(directory.join(format!("{}.csv", self.seed)), recording.reference)?;
        }
        let (name, facts) = (self.name(), run.facts());
        let result = TrialResult { seed: self.seed, name, is_right, diagnosis_s: run.seconds, facts };
        if let Some(file) = out.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
            writeln!(file, "{}", serde_json::to_string(&result)?)?;
        }
        Ok(result)
    }

    fn run(&self) -> Result<TrialRun> {
        let nominal = Configuration::reference();
        let (rows, reference) = self.recorded(&[])?;
        let motion = TrialMotion::of_recording(nominal.clone(), &rows, &reference)?;
        let mut generator = TrialGenerator::new(&motion, self.seed, 0);
        // The independent model does not have every time course of every effect.
        let mut draw = || match self.content {
            Content::Effects(count) => generator.amplitudes(count, STRENGTH),
            Content::Outside => generator.unknown(STRENGTH).into_iter().collect(),
        };
        let injected = std::iter::repeat_with(&mut draw)
            .find(|injected| injected.iter().all(|own| planted(own).is_known()))
            .unwrap_or_default();
        let effects: Vec<PlantedEffect> = injected.iter().map(planted).collect();
        let (rows, reference) = self.recorded(&effects)?;
        let options = DiagnosisOptions::new(reference.start_ns);
        let start = Instant::now();
        let diagnosis = diagnose_rows(&rows, &[], &nominal, &reference, &options)?;
        Ok(TrialRun::new(&motion, injected, &diagnosis, start.elapsed().as_secs_f64()))
    }

    fn recording(&self, effects: &[PlantedEffect]) -> Recording {
        let model = IndependentModel {
            motion: MOTIONS[self.motion].1,
            reference: REFERENCES[self.reference].1,
            ..IndependentModel::new(self.seed, effects.to_vec())
        };
        model.record()
    }

    fn recorded(&self, effects: &[PlantedEffect]) -> Result<(Vec<ReceivedSample>, ReferenceAttitude)> {
        let recording = self.recording(effects);
        let link = tempfile::NamedTempFile::new()?;
        fs::write(link.path(), recording.link)?;
        let (mut reader, mut rows) = (InputReader::new(DecoderOptions::default(), Stop::default()), Rows::default());
        reader.read(&link.path().to_string_lossy(), &mut rows)?;
        reader.finish(&mut rows).1?;
        Ok((rows.0, ReferenceAttitude::parse("reference.csv", &recording.reference)?))
    }
}

/// The effect of the independent model.
fn planted(injected: &InjectedEffect) -> PlantedEffect {
    let gyros: Vec<Gyro> = injected.gyros().gyros().map(|gyro| GYROS[gyro.index()]).collect();
    let numbers = injected.hypothesis.parameters();
    let code = match injected.formula() {
        Some(formula) => format!("product {formula}"),
        None => injected.code(),
    };
    let numbers: Vec<(&str, f64)> = numbers.iter().map(|number| (number.name.as_str(), number.value)).collect();
    PlantedEffect::new(&code, &gyros, &numbers)
}

#[derive(Default)]
struct Rows(Vec<ReceivedSample>);

impl Sink for Rows {
    fn row(&mut self, row: &ReceivedSample) {
        self.0.push(*row);
    }
    fn defect(&mut self, _: &Defect) {}
}

/// Right of all, by cell and content, in Markdown.
fn print(cells: &BTreeMap<(usize, usize, Content), [usize; 2]>) {
    let contents = PARTS.map(|(content, _)| content);
    println!("| motion | reference | {} |", contents.map(Content::name).join(" | "));
    println!("|---|---|{}", "---|".repeat(contents.len()));
    let share = |is: &dyn Fn(&(usize, usize, Content)) -> bool| {
        let of_cells = cells.iter().filter(|(cell, _)| is(cell));
        let [right, all] = of_cells.fold([0, 0], |sum, (_, counts)| [sum[0] + counts[0], sum[1] + counts[1]]);
        format!("{right}/{all}")
    };
    for (motion, (motion_name, _)) in MOTIONS.iter().enumerate() {
        for (reference, (reference_name, _)) in REFERENCES.iter().enumerate() {
            let of_content = |content| share(&|cell| *cell == (motion, reference, content));
            println!("| {motion_name} | {reference_name} | {} |", contents.map(of_content).join(" | "));
        }
    }
    println!("| all | all | {} |", contents.map(|content| share(&|cell| cell.2 == content)).join(" | "));
}
