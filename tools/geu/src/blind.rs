//! `geu blind`: effects hidden at random, what a diagnosis makes of them, and how often it is right.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use geu_diagnosis::Verdict;
use geu_diagnosis::blind::{
    AnswerKey, CampaignPlan, InjectedEffect, ReportedDiagnosis, SURVEY_S, TrialMotion, campaign, generate_trial, score,
};
use geu_diagnosis::report::labelled;
use geu_recording::read_text;
use indicatif::ProgressBar;

use crate::failure::{CommandError, say};
use crate::outputs::{OutputDirectory, OutputFile, write};
use crate::overwriting::Force;
use crate::settings::{ConfigArgs, NamedSettings, duration, seed};

/// Hides effects at random, scores what a diagnosis says of them, and does both many times.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    Hide(Hide),
    Score(ScoreArguments),
    Campaign(CampaignArguments),
}

/// Writes a recording with from none to three things hidden, and the key that tells them.
///
/// DIR/recording has link.log, reference.csv and believed.toml, DIR/key has key.toml: what is given the one sees nothing of the
/// other. With --count the directories are DIR/1, DIR/2 …, for seed N, N + 1 ….
#[derive(Args, Debug)]
struct Hide {
    #[command(flatten)]
    unit: NamedSettings,
    /// Seed of all that is drawn
    #[arg(long, value_parser = seed)]
    seed: u64,
    /// Directory to write into; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: OutputDirectory,
    #[command(flatten)]
    force: Force,
    /// Recordings to make
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    count: Option<u16>,
    /// On-board time of each
    #[arg(long, value_name = "DURATION", default_value_t = SURVEY_S, allow_negative_numbers = true, value_parser = duration(900.0, 1e6))]
    duration: f64,
}

/// Compares what `geu diagnose --json` wrote with the key; exit 1 where they differ.
#[derive(Args, Debug)]
struct ScoreArguments {
    #[command(flatten)]
    unit: NamedSettings,
    /// The key that `geu blind hide` wrote
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// The JSON that `geu diagnose` wrote
    #[arg(long, value_name = "FILE")]
    json: PathBuf,
}

/// Hides one effect in each of many recordings, diagnoses them, and prints power, naming and false names.
///
/// Runs of each strength with one amplitude of the catalogue, as many with nothing hidden, and a quarter as many with a term
/// outside the catalogue at 12 times the bound. The thresholds are those of one recording with nothing hidden.
#[derive(Args, Debug)]
struct CampaignArguments {
    #[command(flatten)]
    unit: NamedSettings,
    /// Runs of each strength
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    runs: u16,
    /// Seed of all that is drawn
    #[arg(long, default_value_t = 1, value_parser = seed)]
    seed: u64,
    /// Strengths: size over its Cramér–Rao bound, with the sixteen, the lag and the walks as nuisances
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_value = "6,12", value_parser = strength)]
    sizes: Vec<f64>,
    /// Write every run as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<OutputFile>,
    /// Print the tables alone
    #[arg(long)]
    markdown: bool,
    /// On-board time of each recording
    #[arg(long, value_name = "DURATION", default_value_t = SURVEY_S, allow_negative_numbers = true, value_parser = duration(900.0, 1e6))]
    duration: f64,
    /// Threads [default: one for each core]; the result is the same
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

fn strength(text: &str) -> Result<f64, String> {
    let strength = text.parse().ok().filter(|strength| (0.1..=1e4).contains(strength));
    strength.ok_or_else(|| format!("expected 0.1…1e4, got {text}"))
}

/// Carries it out.
///
/// # Errors
/// A configuration, key or result that cannot be read, files that cannot be written; exit 1 where a score is not right.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    match &arguments.command {
        Command::Hide(arguments) => hidden(arguments),
        Command::Score(arguments) => scored(arguments),
        Command::Campaign(arguments) => many(arguments),
    }
}

fn survey(unit: &NamedSettings, duration_s: f64) -> Result<TrialMotion, CommandError> {
    TrialMotion::new(ConfigArgs::from(unit).read()?, duration_s).map_err(CommandError::input)
}

/// The files that a trial has.
const FILES: [&str; 4] = ["recording/link.log", "recording/reference.csv", "recording/believed.toml", "key/key.toml"];

fn hidden(arguments: &Hide) -> Result<(), CommandError> {
    // Of one trial, or of each by its number.
    let trials: Vec<PathBuf> = match arguments.count {
        Some(count) => (1..=count).map(|number| number.to_string().into()).collect(),
        None => vec![PathBuf::new()],
    };
    let files = trials.iter().flat_map(|trial| FILES.map(|file| trial.join(file)));
    let out = arguments.out.prepare(arguments.force, files)?;
    let survey = survey(&arguments.unit, arguments.duration)?;
    let bar = ProgressBar::new(trials.len() as u64);
    for (seed, trial) in (arguments.seed..).zip(&trials) {
        let (key, flight) = generate_trial(&survey, seed & i64::MAX as u64);
        let own = out.join(trial);
        for directory in ["recording", "key"].map(|name| own.join(name)) {
            fs::create_dir_all(&directory)
                .map_err(|error| CommandError::failed(format!("{}: cannot be made: {error}", directory.display())))?;
        }
        let contents = [flight.link_log(), flight.reference_csv(), survey.believed.to_toml(false), key.to_toml()];
        FILES.iter().zip(contents).try_for_each(|(file, content)| write(&own.join(file), content))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

fn text(path: &Path) -> Result<String, CommandError> {
    read_text(path).map_err(|error| CommandError::input(format!("{}: cannot be read: {error}", path.display())))
}

fn scored(arguments: &ScoreArguments) -> Result<(), CommandError> {
    let key =
        AnswerKey::parse(&arguments.key.display().to_string(), &text(&arguments.key)?).map_err(CommandError::input)?;
    let at = |error: &dyn std::fmt::Display| CommandError::input(format!("{}: {error}", arguments.json.display()));
    let expected = |error: serde_json::Error| at(&format!("expected JSON as `geu diagnose --json` writes it: {error}"));
    let result = serde_json::from_str(&text(&arguments.json)?).map_err(expected)?;
    let told = ReportedDiagnosis::from_json(&result).map_err(|error| at(&error))?;
    let survey = survey(&arguments.unit, key.duration_s)?;
    let score = score(&key.hidden, &told, &|hidden: &InjectedEffect, found| {
        survey.signature_cosine(hidden, found, told.temperature_late_s)
    });
    let mut facts = Vec::new();
    for (hidden, outcome) in key.hidden.iter().zip(&score.outcomes) {
        facts.extend(hidden.facts());
        facts.push(("outcome".to_owned(), outcome.naming.name().to_owned()));
        facts.extend(outcome.size.map(|size| ("error".to_owned(), size.to_string())));
    }
    if key.hidden.is_empty() {
        facts.push(("injected".to_owned(), "nothing".to_owned()));
    }
    facts.push(("verdict".to_owned(), told.verdict.name().to_owned()));
    let false_names = score.false_names.iter();
    facts.extend(false_names.map(|&index| ("false alarm".to_owned(), told.missing[index].to_string())));
    say!("{}", labelled(0, &facts).trim_end())?;
    match score.is_right(&key.hidden, &told) && (told.verdict == Verdict::Consistent || !key.hidden.is_empty()) {
        true => Ok(()),
        false => Err(CommandError::failed("expected what the key tells, got something else")),
    }
}

fn many(arguments: &CampaignArguments) -> Result<(), CommandError> {
    let survey = survey(&arguments.unit, arguments.duration)?;
    let threads = arguments.threads.map_or_else(rayon::current_num_threads, usize::from);
    let plan =
        CampaignPlan { seed: arguments.seed, runs: arguments.runs.into(), strengths: arguments.sizes.clone(), threads };
    let bar = ProgressBar::new(plan.count() as u64);
    let campaign = campaign(&survey, &plan, &|| bar.inc(1)).map_err(CommandError::failed)?;
    bar.finish_and_clear();
    if let Some(path) = &arguments.json {
        path.write(format!("{:#}\n", campaign.json()))?;
    }
    say!("{}", campaign.tables().trim_end())?;
    if arguments.markdown {
        return Ok(());
    }
    let misses = campaign.misses();
    say!("\nmissed or wrongly named: {}", misses.len())?;
    misses.iter().try_for_each(|(run, facts)| say!("- {run}\n{}", labelled(4, facts).trim_end()))?;
    say!("\nmedian time of a diagnosis, on one core, thresholds known: {:.1} s", campaign.median_s())
}
