//! Where a configuration comes from: a file or the built-in one, with overrides. Every command that reads one takes these.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use geu_daemon::recorder;
use geu_daemon::truth::{ExternalTruth, TruthAddress, received};
use geu_model::configuration::{LinkLogFormat, unix_ns};
use geu_model::fault::unsatisfiable_condition;
use geu_model::units::{duration_s, on_board_s};
use geu_model::{Configuration, GyroUnit, Truth};
use geu_protocol::CanIdMap;
use geu_recording::{REFERENCE, ReferenceAttitude, TableError, open_rows};
use geu_report::Provenance;

use crate::failure::CommandError;

/// Configuration and overrides.
#[derive(Args, Debug, Clone, Default)]
pub struct ConfigArgs {
    /// Configuration file (TOML, may be .gz or .zst); without it the reference unit on its default scenario
    pub config: Option<PathBuf>,
    /// Overrides a value of the configuration: gyro.GYRX.drift.arcsec_per_h=10, manoeuvre.0.duration_s=60
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub overrides: Vec<String>,
}

/// The same by name, for commands that take other files too.
#[derive(Args, Debug, Clone)]
pub struct NamedSettings {
    /// What is believed of the unit [default: the reference unit]
    #[arg(long, value_name = "CONFIG")]
    pub config: Option<PathBuf>,
    /// Overrides a value of the configuration
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub overrides: Vec<String>,
}

impl From<&NamedSettings> for ConfigArgs {
    fn from(named: &NamedSettings) -> ConfigArgs {
        ConfigArgs { config: named.config.clone(), overrides: named.overrides.clone() }
    }
}

/// A seed that a configuration can hold: its integers end at 2^63.
pub fn seed(text: &str) -> Result<u64, String> {
    let seed = text.parse().ok().filter(|&seed| seed <= i64::MAX as u64);
    seed.ok_or_else(|| format!("expected an integer 0…{}, got {text}", i64::MAX))
}

/// The longest run, s.
pub const LONGEST_S: f64 = 1e10;

/// Reads a duration within limits: the value parser of every option that is one.
pub fn duration(least_s: f64, greatest_s: f64) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    move |text| duration_s(text, least_s, greatest_s)
}

pub fn can_base(text: &str) -> Result<CanIdMap, String> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    let max = CanIdMap::MAX_BASE;
    u16::from_str_radix(digits, 16)
        .ok()
        .and_then(CanIdMap::with_base)
        .ok_or_else(|| format!("expected a hexadecimal identifier from 0 to {max:X}, got {text}"))
}

/// A Unix time, s.
pub fn start(text: &str) -> Result<f64, String> {
    let start = text.parse().ok().filter(|start| (0.0..=4e9).contains(start));
    start.ok_or_else(|| format!("expected 0…4e9 seconds, got {text}"))
}

/// What a run takes beside its configuration.
#[derive(Args, Debug, Clone, Default)]
pub struct RunArgs {
    #[command(flatten)]
    pub settings: ConfigArgs,
    /// Seed of every random stream, in place of the configuration's
    #[arg(long, allow_negative_numbers = true, value_parser = seed)]
    pub seed: Option<u64>,
    /// Unix time of the start of the first sample interval, in place of the configuration's
    #[arg(long, value_name = "UNIX_SECONDS", allow_negative_numbers = true, value_parser = start)]
    pub start: Option<f64>,
    /// What moves the unit: `scenario` (the configuration's); a file, reference.csv or a CCSDS attitude ephemeris, whose
    /// first instant is the start; or, for `geu run`, a simulator: udp://HOST:PORT listens for JSON lines, tcp://HOST:PORT
    /// fetches them, 42://HOST:PORT speaks with 42 [default: the recorded one, else scenario]
    #[arg(long, value_name = "SOURCE")]
    pub truth: Option<String>,
    /// Plan of faults and expectations (TOML, as configs/faults.toml); added to the configuration's
    #[arg(long, value_name = "PLAN")]
    pub faults: Vec<PathBuf>,
}

/// A run that is ready to begin.
pub struct PreparedRun {
    /// Its configuration, with seed, start and truth put in.
    pub configuration: Configuration,
    /// What moves the unit.
    pub truth: Truth,
    /// Who tells it, where that is a simulator.
    pub live: Option<LiveTruth>,
}

/// A truth from outside, before anything of it was told.
pub struct LiveTruth {
    /// As it was asked for.
    pub address: TruthAddress,
    /// To run on.
    pub source: Arc<ExternalTruth>,
}

impl PreparedRun {
    /// Samples to run: as many as `asked`, and all that a truth from a file covers where nothing is asked. Nothing
    /// where neither sets an end.
    ///
    /// # Errors
    /// A file that does not cover what is asked.
    pub fn samples(&self, asked: Option<u64>) -> Result<Option<u64>, CommandError> {
        let end_s = match &self.truth {
            Truth::Recorded(rows) => rows.end_s(),
            Truth::Stepped(pieces) if self.live.is_none() => pieces.end_s(),
            Truth::Scenario | Truth::Stepped(_) => return Ok(asked),
        };
        let covered = GyroUnit::samples_within(&self.configuration, &self.truth, asked.unwrap_or(u64::MAX));
        match asked {
            Some(asked) if covered < asked => Err(CommandError::input(format!(
                "{}: expected a truth that covers the run of {} s, got one of {} s, enough for {} s",
                self.configuration.run.truth.as_deref().unwrap_or_default(),
                on_board_s(asked),
                // Of sums that are rounded.
                (end_s * 1e6).round() / 1e6,
                on_board_s(covered),
            ))),
            _ => Ok(Some(covered)),
        }
    }
}

/// Form of the link on disk.
#[derive(ValueEnum, Debug, Clone, Copy)]
pub enum LinkFile {
    /// link.log, as `candump -l` writes
    Can,
    /// link.bin, the serial bytes
    Serial,
}

impl From<LinkFile> for LinkLogFormat {
    fn from(wire: LinkFile) -> LinkLogFormat {
        match wire {
            LinkFile::Can => LinkLogFormat::Can,
            LinkFile::Serial => LinkLogFormat::Serial,
        }
    }
}

impl LinkFile {
    /// The form that a simulated run has: the one asked for, else the form recorded, else `link.log`.
    pub fn form(asked: Option<LinkFile>, configuration: &Configuration) -> LinkLogFormat {
        asked.map(LinkLogFormat::from).or(configuration.run.wire).unwrap_or_default()
    }
}

impl ConfigArgs {
    /// Reads it.
    ///
    /// # Errors
    /// A file that cannot be read, or whatever is wrong in it.
    pub fn read(&self) -> Result<Configuration, CommandError> {
        match &self.config {
            None => Configuration::reference_with(&self.overrides),
            Some(_) => {
                let (name, text) = self.text()?;
                Configuration::parse(&name, &text, &self.overrides)
            }
        }
        .map_err(CommandError::input)
    }

    /// Its name and text, without the overrides.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn text(&self) -> Result<(String, String), CommandError> {
        let Some(path) = &self.config else {
            return Ok(("the reference unit".to_owned(), Configuration::reference_text().to_owned()));
        };
        let name = path.display().to_string();
        match geu_recording::read_text(path) {
            Ok(text) => Ok((name, text)),
            Err(error) => Err(CommandError::input(format!(
                "{name}: cannot be read: {error}; expected a configuration, as `geu config show` prints"
            ))),
        }
    }

    /// What a page of results rests on.
    ///
    /// # Errors
    /// A configuration that cannot be read.
    pub fn provenance(&self, inputs: Vec<(&'static str, String)>) -> Result<Provenance<'_>, CommandError> {
        let (name, text) = self.text()?;
        let configuration = (name, text, &self.overrides[..]);
        Ok(Provenance { command: command_line(), version: crate::VERSION.as_str(), inputs, configuration })
    }
}

/// The command line, so that a shell takes it again.
fn command_line() -> String {
    let quoted = std::env::args().map(|argument| {
        let is_plain = |character: char| character.is_ascii_alphanumeric() || "-_./=,:+@%".contains(character);
        match !argument.is_empty() && argument.chars().all(is_plain) {
            true => argument,
            false => format!("'{}'", argument.replace('\'', r"'\''")),
        }
    });
    quoted.collect::<Vec<_>>().join(" ")
}

impl RunArgs {
    /// Reads the configuration, puts seed, start and truth in, and reads the truth.
    ///
    /// # Errors
    /// As [`ConfigArgs::read`], a start that is no time, a truth that cannot be read.
    pub fn read(&self) -> Result<PreparedRun, CommandError> {
        let mut configuration = self.settings.read()?;
        let is_unfinished = configuration.run.is_unfinished;
        if let (true, Some(path)) = (is_unfinished, &self.settings.config) {
            let directory = path.parent().unwrap_or(Path::new(""));
            recorder::complete(&mut configuration, directory).map_err(CommandError::input)?;
        }
        if let Some(seed) = self.seed {
            configuration.seed = seed;
        }
        if let Some(start_unix_s) = self.start {
            configuration.start_unix_ns = unix_ns(start_unix_s);
        }
        if let Some(source) = &self.truth {
            configuration.run.truth = Some(source.clone()).filter(|source| source != "scenario");
        }
        for path in &self.faults {
            add_plan(&mut configuration, path)?;
        }
        let name = match (&configuration.run.truth, &self.truth, &self.settings.config) {
            (Some(name), None, Some(config)) => Some(beside(config, name)),
            (name, ..) => name.clone(),
        };
        configuration.run.truth.clone_from(&name);
        let (truth, live) = match name {
            None => (Truth::Scenario, None),
            Some(name) if TruthAddress::is_meant(&name) => {
                let address: TruthAddress = name.parse().map_err(CommandError::input)?;
                let source = ExternalTruth::new(address.clone(), configuration.truth);
                (source.truth(), Some(LiveTruth { address, source }))
            }
            Some(name) => (truth_of_file(&name, is_unfinished)?, None),
        };
        let (faults, expectations) = (&configuration.faults, &configuration.expectations);
        // Of a simulator its first sample says what it tells.
        let untold = if live.is_some() { &[] } else { truth.motion(&configuration, 0.0).untold() };
        match unsatisfiable_condition(faults, expectations, "the truth of this run", untold) {
            Some(why) => Err(CommandError::input(why)),
            None => Ok(PreparedRun { configuration, truth, live }),
        }
    }
}

/// Adds the faults and expectations of a plan.
///
/// # Errors
/// A file that cannot be read, that is no plan, or has neither.
pub fn add_plan(configuration: &mut Configuration, path: &Path) -> Result<(), CommandError> {
    let name = path.display().to_string();
    let expected = "expected a plan with [[fault]] or [[expect]], as in configs/faults.toml";
    let text = geu_recording::read_text(path)
        .map_err(|error| CommandError::input(format!("{name}: cannot be read: {error}; {expected}")))?;
    let count = |all: &Configuration| all.faults.len() + all.expectations.len();
    let before = count(configuration);
    configuration.add_plan(&name, &text).map_err(CommandError::input)?;
    match count(configuration) > before {
        true => Ok(()),
        false => Err(CommandError::input(format!("{name}: {expected}, got neither"))),
    }
}

/// The file that a configuration names: beside it, where it is there, else as it stands.
fn beside(config: &Path, name: &str) -> String {
    let path = config.parent().unwrap_or(Path::new("")).join(name);
    path.to_str().filter(|_| path.exists()).unwrap_or(name).to_owned()
}

/// A truth from a file, whichever kind it is; that of an unfinished run may end within a row.
fn truth_of_file(name: &str, is_unfinished: bool) -> Result<Truth, CommandError> {
    let failed = |error| CommandError::input(TableError::read(name, REFERENCE)(error));
    let mut rows = open_rows(Path::new(name)).map_err(failed)?;
    let head = rows.first_lines().map_err(failed)?;
    if head.first().is_some_and(|line| received::is_received(line)) {
        let lines = if is_unfinished { rows.lines().of_unfinished() } else { rows.lines() };
        return Ok(Truth::Stepped(Arc::new(received::parse(name, lines).map_err(CommandError::input)?)));
    }
    Ok(Truth::Recorded(ReferenceAttitude::of_rows(name, rows).map_err(CommandError::input)?.truth))
}

/// Samples of on-board time in `duration_s`.
///
/// # Errors
/// A duration that is none.
pub fn samples(duration_s: f64) -> Result<u64, CommandError> {
    if duration_s > 0.0 && duration_s <= LONGEST_S {
        Ok((duration_s * 2.0).ceil() as u64)
    } else {
        Err(CommandError::input(format!("--duration: expected more than 0 seconds and at most 1e10, got {duration_s}")))
    }
}
