//! `geu blind`: blind trials of the diagnosis with randomly injected effects.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use geu_blind::{
    AnswerKey, BlindCampaign, CampaignPlan, InjectedEffect, MergeError, ReportedDiagnosis, SURVEY_S, Shard, ShardFile,
    TrialMotion, campaign, generate_trial, merged, score,
};
use geu_diagnosis::Verdict;
use geu_diagnosis::report::labelled;
use indicatif::ProgressBar;
use serde_json::json;

use crate::command_error::{CommandError, say};
use crate::output_guard::Force;
use crate::outputs::{OutputDirectory, OutputFile, create_directory, write};
use crate::settings::{ConfigArgs, NamedConfigArgs, duration, number, read_text, seed};

/// Blind trials: injects random effects, scores a diagnosis, and runs campaigns of both.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    Hide(HideArguments),
    Score(ScoreArguments),
    Campaign(CampaignArguments),
    Merge(MergeArguments),
}

/// Writes a recording with zero to three injected effects, and the answer key.
///
/// DIR/recording has link.log, reference.csv and nominal.toml, DIR/key has key.toml. With --count the directories are DIR/1,
/// DIR/2 …, for seed N, N + 1 ….
#[derive(Args, Debug)]
struct HideArguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Seed of the random numbers
    #[arg(long, value_parser = seed)]
    seed: u64,
    /// Directory to write into; created if necessary
    #[arg(long, value_name = "DIR")]
    out: OutputDirectory,
    #[command(flatten)]
    force: Force,
    /// Number of recordings
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    count: Option<u16>,
    /// On-board time of each recording
    #[arg(long, value_name = "DURATION", default_value_t = SURVEY_S, allow_negative_numbers = true, value_parser = duration(900.0, 1e6))]
    duration: f64,
}

/// Compares the JSON of `geu diagnose` with the key; exit 1 if they differ.
#[derive(Args, Debug)]
struct ScoreArguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Key of `geu blind hide`
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// JSON of `geu diagnose`
    #[arg(long, value_name = "FILE")]
    json: PathBuf,
}

/// Injects one effect into each of many recordings, diagnoses them, and prints power, isolation and false alarms.
///
/// There are N runs of each signal-to-noise ratio with one amplitude of the catalogue, N runs without an effect, and N/4 with a
/// term outside the catalogue at 12 times the bound. The thresholds come from one recording without an effect.
///
/// --shard I/N runs part I of N, and `geu blind merge` joins all parts to the whole campaign.
#[derive(Args, Debug)]
struct CampaignArguments {
    #[command(flatten)]
    unit: NamedConfigArgs,
    /// Runs of each signal-to-noise ratio
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    runs: u16,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1, value_parser = seed)]
    seed: u64,
    /// Signal-to-noise ratios: amplitude over its Cramér–Rao bound, with calibration parameters, lag and random walks as nuisances
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_value = "6,12", value_parser = number(0.1, 1e4, ""))]
    sizes: Vec<f64>,
    /// Write every run as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<OutputFile>,
    /// Print only the tables
    #[arg(long)]
    markdown: bool,
    /// On-board time of each recording
    #[arg(long, value_name = "DURATION", default_value_t = SURVEY_S, allow_negative_numbers = true, value_parser = duration(900.0, 1e6))]
    duration: f64,
    /// Threads [default: one for each core]; the result is the same
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Run part I of N, and write it to the file of --json for `geu blind merge`
    #[arg(long, value_name = "I/N", value_parser = shard, requires = "json", conflicts_with = "markdown")]
    shard: Option<Shard>,
}

/// Joins all parts of a campaign to the whole one, with its tables and JSON.
#[derive(Args, Debug)]
struct MergeArguments {
    /// Files of `geu blind campaign --shard`, in any order
    #[arg(value_name = "FILE", required = true)]
    shards: Vec<PathBuf>,
    /// Write every run as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<OutputFile>,
}

/// Largest number of shards.
const MAX_SHARDS: usize = 10_000;

fn shard(text: &str) -> Result<Shard, String> {
    let is_number = |own: &str| own.bytes().all(|byte| byte.is_ascii_digit());
    let parts = text.split_once('/').filter(|(index, count)| is_number(index) && is_number(count));
    let parts = parts.and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
    match parts {
        Some((index, count)) if (1..=count).contains(&index) && count <= MAX_SHARDS => {
            Ok(Shard { index: index - 1, count })
        }
        _ => Err(format!("expected a part from 1 to N, and N up to {MAX_SHARDS}, such as 2/8")),
    }
}

/// Runs `geu blind`.
///
/// # Errors
/// A configuration, key or result cannot be read, a file cannot be written; exit 1 if a score is not right.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    match &arguments.command {
        Command::Hide(arguments) => write_trials(arguments),
        Command::Score(arguments) => print_score(arguments),
        Command::Campaign(arguments) => run_campaign(arguments),
        Command::Merge(arguments) => merge(arguments),
    }
}

fn survey(unit: &NamedConfigArgs, duration_s: f64) -> Result<TrialMotion, CommandError> {
    TrialMotion::new(ConfigArgs::from(unit).read()?, duration_s).map_err(CommandError::input)
}

/// The files of a trial.
const FILES: [&str; 4] = ["recording/link.log", "recording/reference.csv", "recording/nominal.toml", "key/key.toml"];

fn write_trials(arguments: &HideArguments) -> Result<(), CommandError> {
    let trials: Vec<PathBuf> = match arguments.count {
        Some(count) => (1..=count).map(|number| number.to_string().into()).collect(),
        None => vec![PathBuf::new()],
    };
    let files = trials.iter().flat_map(|trial| FILES.map(|file| trial.join(file)));
    let out = arguments.out.prepare(arguments.force, files)?;
    let survey = survey(&arguments.unit, arguments.duration)?;
    let bar = ProgressBar::new(trials.len() as u64);
    for (seed, trial) in (arguments.seed..).zip(&trials) {
        let (key, recording) = generate_trial(&survey, seed & i64::MAX as u64);
        let trial = out.join(trial);
        for directory in ["recording", "key"].map(|name| trial.join(name)) {
            create_directory(&directory)?;
        }
        let contents = [recording.link_log(), recording.reference_csv(), survey.nominal.to_toml(false), key.to_toml()];
        FILES.iter().zip(contents).try_for_each(|(file, content)| write(&trial.join(file), content))?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

fn print_score(arguments: &ScoreArguments) -> Result<(), CommandError> {
    let key = read_text(&arguments.key, "a key of `geu blind hide`")?;
    let key =
        AnswerKey::parse(&key).map_err(|error| CommandError::input(format!("{}: {error}", arguments.key.display())))?;
    let at = |error: &dyn std::fmt::Display| CommandError::input(format!("{}: {error}", arguments.json.display()));
    let expected = "JSON as `geu diagnose --json` writes it";
    let result = serde_json::from_str(&read_text(&arguments.json, expected)?)
        .map_err(|error| at(&format!("expected {expected}: {error}")))?;
    let reported = ReportedDiagnosis::from_json(&result).map_err(|error| at(&error))?;
    let survey = survey(&arguments.unit, key.duration_s)?;
    let score = score(&key.injected, &reported, &|injected: &InjectedEffect, found| {
        survey.signature_cosine(injected, found, reported.temperature_late_s)
    });
    let mut facts = Vec::new();
    for (injected, outcome) in key.injected.iter().zip(&score.outcomes) {
        facts.extend(injected.facts());
        facts.push(("outcome".to_owned(), outcome.isolation.name().to_owned()));
        facts.extend(outcome.size.map(|size| ("error".to_owned(), size.to_string())));
    }
    if key.injected.is_empty() {
        facts.push(("injected".to_owned(), "nothing".to_owned()));
    }
    facts.push(("verdict".to_owned(), reported.verdict.name().to_owned()));
    let false_alarms = score.false_alarms.iter();
    facts.extend(false_alarms.map(|&index| ("false alarm".to_owned(), reported.missing[index].to_string())));
    say!("{}", labelled(0, &facts).trim_end())?;
    match score.is_right(&key.injected, &reported)
        && (reported.verdict == Verdict::Consistent || !key.injected.is_empty())
    {
        true => Ok(()),
        false => Err(CommandError::failed("the result differs from the key")),
    }
}

fn run_campaign(arguments: &CampaignArguments) -> Result<(), CommandError> {
    let survey = survey(&arguments.unit, arguments.duration)?;
    let threads = arguments.threads.map_or_else(rayon::current_num_threads, usize::from);
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let (runs, strengths) = (arguments.runs, arguments.sizes.clone());
    let plan = CampaignPlan { seed: arguments.seed, runs, strengths, threads, shard };
    let bar = ProgressBar::new(plan.count() as u64);
    let campaign = campaign(&survey, &plan, &|| bar.inc(1)).map_err(CommandError::failed)?;
    bar.finish_and_clear();
    if let (Some(_), Some(path)) = (arguments.shard, &arguments.json) {
        let file = ShardFile::new(&plan, survey.nominal.to_toml(false), arguments.duration, campaign);
        return path.write(format!("{:#}\n", json!(file)));
    }
    write_campaign(&campaign, arguments.json.as_ref())?;
    if arguments.markdown {
        return Ok(());
    }
    let misses = campaign.misses();
    say!("\nmissed or wrongly isolated: {}", misses.len())?;
    misses.iter().try_for_each(|(run, facts)| say!("- {run}\n{}", labelled(4, facts).trim_end()))?;
    say!("\nmedian time of a diagnosis on one core with stored thresholds: {:.1} s", campaign.median_s())
}

fn write_campaign(campaign: &BlindCampaign, json: Option<&OutputFile>) -> Result<(), CommandError> {
    if let Some(path) = json {
        path.write(format!("{:#}\n", campaign.json()))?;
    }
    say!("{}", campaign.tables().trim_end())
}

fn merge(arguments: &MergeArguments) -> Result<(), CommandError> {
    const EXPECTED: &str = "a file of `geu blind campaign --shard`";
    let at = |path: &PathBuf, error: String| CommandError::input(format!("{}: {error}", path.display()));
    let read = |path: &PathBuf| -> Result<ShardFile, CommandError> {
        let read = serde_json::from_str(&read_text(path, EXPECTED)?);
        read.map_err(|error| at(path, format!("expected {EXPECTED}: {error}")))
    };
    let shards = arguments.shards.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let campaign = merged(&shards).map_err(|error| match error {
        MergeError::Differs { file, .. } | MergeError::Damaged { file, .. } => {
            at(&arguments.shards[file], error.to_string())
        }
        MergeError::Times { .. } => CommandError::input(error),
    })?;
    write_campaign(&campaign, arguments.json.as_ref())
}
