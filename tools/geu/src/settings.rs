//! Configuration arguments: a file or the built-in configuration, with overrides; values that several commands parse.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use geu_daemon::truth::{ExternalTruth, TruthAddress};
use geu_model::configuration::{LinkLogFormat, unix_ns};
use geu_model::device::Device;
use geu_model::fault::unsatisfiable_condition;
use geu_model::units::duration_s;
use geu_model::{Configuration, GyroUnit, Truth};
use geu_protocol::CanIdMap;
use geu_recorder::{self as recorder, received};
use geu_recording::{REFERENCE, ReferenceAttitude, TableError, open_rows};
use geu_report::Provenance;

use crate::command_error::CommandError;
use crate::device::unit;

/// Configuration and overrides.
#[derive(Args, Debug, Clone, Default)]
pub struct ConfigArgs {
    /// Configuration file (TOML, may be .gz or .zst) [default: the reference unit on its default scenario]
    pub config: Option<PathBuf>,
    /// Override a value of the configuration: gyro.GYRX.drift.arcsec_per_h=10, manoeuvre.0.duration_s=60
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub overrides: Vec<String>,
    /// Name or description of another unit than the default one (`geu device list`); without a configuration it has no errors
    /// and rests
    #[arg(long, value_name = "NAME|FILE")]
    pub device: Option<String>,
}

/// Configuration as an option, for commands that take other files too.
#[derive(Args, Debug, Clone)]
pub struct NamedConfigArgs {
    /// Prior configuration of the unit [default: the reference unit]
    #[arg(long, value_name = "CONFIG")]
    pub config: Option<PathBuf>,
    /// Override a value of the configuration
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub overrides: Vec<String>,
}

impl From<&NamedConfigArgs> for ConfigArgs {
    fn from(named: &NamedConfigArgs) -> ConfigArgs {
        ConfigArgs { config: named.config.clone(), overrides: named.overrides.clone(), device: None }
    }
}

/// A seed that a configuration can hold: its integers end at 2^63.
pub fn seed(text: &str) -> Result<u64, String> {
    let seed = text.parse().ok().filter(|&seed| seed <= i64::MAX as u64);
    seed.ok_or_else(|| format!("expected an integer 0…{}, got {text}", i64::MAX))
}

/// The longest run, s.
pub const LONGEST_S: f64 = 1e10;

/// Value parser of a duration within limits.
pub fn duration(min_s: f64, max_s: f64) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    move |text| duration_s(text, min_s, max_s)
}

/// Value parser of a number within limits; `unit` with a leading space, or empty.
pub fn number(min: f64, max: f64, unit: &'static str) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    move |text| {
        let number = text.parse().ok().filter(|number| (min..=max).contains(number));
        number.ok_or_else(|| format!("expected {min}…{max}{unit}, got {text}"))
    }
}

/// Value parser of an option with named values: name, value, help.
pub fn choice<T: Copy + Send + Sync>(
    choices: &'static [(&'static str, T, &'static str)],
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(choices.iter().map(|(name, _, help)| PossibleValue::new(*name).help(*help)))
        .map(|name| choices.iter().find(|choice| choice.0 == name).expect("a possible value").1)
}

pub fn can_base(text: &str) -> Result<CanIdMap, String> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    let max = CanIdMap::MAX_BASE;
    u16::from_str_radix(digits, 16)
        .ok()
        .and_then(CanIdMap::with_base)
        .ok_or_else(|| format!("expected a hexadecimal identifier from 0 to {max:X}, got {text}"))
}

/// Unix time, s.
pub fn start(text: &str) -> Result<f64, String> {
    number(0.0, 4e9, "")(text).map_err(|_| format!("expected 0…4e9 seconds, got {text}"))
}

/// Reads a text file; `expected` describes it in the error message.
pub fn read_text(path: &Path, expected: &str) -> Result<String, CommandError> {
    geu_recording::read_text(path).map_err(|error| {
        CommandError::input(format!("{}: cannot be read: {error}; expected {expected}", path.display()))
    })
}

/// Arguments of a run beside its configuration.
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
    /// Motion of the unit: `scenario` (the configuration's); a file, reference.csv or a CCSDS attitude ephemeris, with
    /// its first instant as the start; or, for `geu run`, a simulator: udp://HOST:PORT listens for JSON lines, tcp://HOST:PORT
    /// fetches them, 42://HOST:PORT connects to 42 [default: the recorded one, else scenario]
    #[arg(long, value_name = "SOURCE")]
    pub truth: Option<String>,
    /// Plan of faults and expectations (TOML, as configs/faults.toml); added to the configuration's
    #[arg(long, value_name = "PLAN")]
    pub faults: Vec<PathBuf>,
}

/// Inputs of a run.
pub struct PreparedRun {
    /// With seed, start and truth set.
    pub configuration: Configuration,
    pub truth: Truth,
    /// The simulator that sends the truth, if any.
    pub live: Option<LiveTruth>,
}

/// External truth, before its first sample.
pub struct LiveTruth {
    pub address: TruthAddress,
    pub source: Arc<ExternalTruth>,
}

impl PreparedRun {
    /// Samples to run: of this duration, else the length of a truth from a file. `None` if neither sets an end.
    ///
    /// # Errors
    /// The file is shorter than `asked`.
    pub fn samples(&self, duration_s: Option<f64>) -> Result<Option<u64>, CommandError> {
        let device = &self.configuration.device;
        // Sums have rounding errors.
        let of_duration = |duration_s: f64| (duration_s / device.interval_s - 1e-6).ceil().max(1.0) as u64;
        let asked = duration_s.map(|duration_s| within(duration_s).map(of_duration)).transpose()?;
        let end_s = match &self.truth {
            Truth::Recorded(rows) => rows.end_s(),
            Truth::Stepped(motion) if self.live.is_none() => motion.end_s(),
            Truth::Scenario | Truth::Stepped(_) => return Ok(asked),
        };
        let covered = GyroUnit::samples_within(&self.configuration, &self.truth, asked.unwrap_or(u64::MAX));
        match asked {
            Some(asked) if covered < asked => Err(CommandError::input(format!(
                "{}: expected a truth that covers the run of {} s, got {} s, enough for {} s",
                self.configuration.run.truth.as_deref().unwrap_or_default(),
                device.on_board_s(asked),
                (end_s * 1e6).round() / 1e6,
                device.on_board_s(covered),
            ))),
            _ => Ok(Some(covered)),
        }
    }
}

/// Formats of the link on disk.
pub const LINK_FORMATS: &[(&str, LinkLogFormat, &str)] = &[
    ("can", LinkLogFormat::Can, "link.log, as `candump -l` writes"),
    ("serial", LinkLogFormat::Serial, "link.bin, the serial bytes"),
];

impl ConfigArgs {
    /// Reads the configuration of the default unit.
    ///
    /// # Errors
    /// The file cannot be read, is not valid, or is of another unit.
    pub fn read(&self) -> Result<Configuration, CommandError> {
        let mut configuration = self.read_for(Some(&Device::iras()))?;
        // Prescribed rates are of a run, and replace the scenario there; here the unit alone counts.
        configuration.motion.clear();
        Ok(configuration)
    }

    /// Reads the configuration of any unit.
    ///
    /// # Errors
    /// The file cannot be read, is not valid, or is not of the unit that `--device` names.
    pub fn read_of_any(&self) -> Result<Configuration, CommandError> {
        let device = self.device.as_deref().map(unit).transpose()?;
        self.read_for(device.as_ref())
    }

    fn read_for(&self, device: Option<&Arc<Device>>) -> Result<Configuration, CommandError> {
        match (&self.config, device) {
            (Some(_), _) => {
                let (name, text) = self.text()?;
                Configuration::parse_for(device, &name, &text, &self.overrides)
            }
            (None, Some(device)) if !device.is_iras() => Configuration::of_device(device, &self.overrides),
            (None, _) => Configuration::reference_with(&self.overrides),
        }
        .map_err(CommandError::input)
    }

    /// Name and text of the configuration, without the overrides.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn text(&self) -> Result<(String, String), CommandError> {
        let Some(path) = &self.config else {
            let device = self.device.as_deref().map(unit).transpose()?.filter(|device| !device.is_iras());
            let Some(device) = device else {
                return Ok(("the reference unit".to_owned(), Configuration::reference_text().to_owned()));
            };
            let configuration = Configuration::of_device(&device, &[]).map_err(CommandError::input)?;
            return Ok((format!("configuration of {}", device.name), configuration.to_toml(false)));
        };
        Ok((path.display().to_string(), read_text(path, "a configuration, as `geu config show` prints")?))
    }

    /// Text of the configuration with its overrides and further `values`, each PATH=VALUE; comments are kept.
    ///
    /// # Errors
    /// The file cannot be read; a value is not valid.
    pub fn edited(&self, values: impl IntoIterator<Item = String>) -> Result<String, CommandError> {
        let (name, text) = self.text()?;
        let values: Vec<String> = self.overrides.iter().cloned().chain(values).collect();
        Configuration::edited(&name, &text, &values).map_err(CommandError::input)
    }

    /// Provenance of a result page.
    ///
    /// # Errors
    /// The configuration cannot be read.
    pub fn provenance(&self, inputs: Vec<(&'static str, String)>) -> Result<Provenance<'_>, CommandError> {
        let (name, text) = self.text()?;
        let configuration = (name, text, &self.overrides[..]);
        Ok(Provenance { command: command_line(), version: crate::VERSION.as_str(), inputs, configuration })
    }
}

/// The command line, quoted for a shell.
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
    /// Reads the configuration and the truth, and sets seed and start.
    ///
    /// # Errors
    /// The configuration cannot be read or is not valid; the truth or a fault plan cannot be read.
    pub fn read(&self) -> Result<PreparedRun, CommandError> {
        let mut configuration = self.settings.read_of_any()?;
        let is_unfinished = configuration.run.is_unfinished;
        if let (true, Some(path)) = (is_unfinished, &self.settings.config) {
            let directory = path.parent().unwrap_or(Path::new(""));
            recorder::complete(&mut configuration, directory).map_err(CommandError::input)?;
        }
        configuration.seed = self.seed.unwrap_or(configuration.seed);
        configuration.start_unix_ns = self.start.map_or(configuration.start_unix_ns, unix_ns);
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
        // The quantities of a simulator are known from its first sample.
        let unavailable = if live.is_some() { &[] } else { truth.motion(&configuration, 0.0).unavailable() };
        match unsatisfiable_condition(faults, expectations, "the truth of this run", unavailable) {
            Some(why) => Err(CommandError::input(why)),
            None => Ok(PreparedRun { configuration, truth, live }),
        }
    }
}

/// Adds the faults and expectations of a plan.
///
/// # Errors
/// The file cannot be read, is not a plan, or has no fault and no expectation.
pub fn add_plan(configuration: &mut Configuration, path: &Path) -> Result<(), CommandError> {
    let (name, expected) = (path.display(), "a plan with [[fault]] or [[expect]], as in configs/faults.toml");
    let text = read_text(path, expected)?;
    let count = |all: &Configuration| all.faults.len() + all.expectations.len();
    let before = count(configuration);
    configuration.add_plan(&name.to_string(), &text).map_err(CommandError::input)?;
    match count(configuration) > before {
        true => Ok(()),
        false => Err(CommandError::input(format!("{name}: expected {expected}, got neither"))),
    }
}

/// Path of a file that a configuration names: beside the configuration if it exists there, else as written.
fn beside(config: &Path, name: &str) -> String {
    let path = config.parent().unwrap_or(Path::new("")).join(name);
    path.to_str().filter(|_| path.exists()).unwrap_or(name).to_owned()
}

/// A truth from a file of any kind; that of an unfinished run may end within a row.
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

/// A duration of a run.
///
/// # Errors
/// The duration is not within 0…1e10 s.
pub fn within(duration_s: f64) -> Result<f64, CommandError> {
    if duration_s > 0.0 && duration_s <= LONGEST_S {
        Ok(duration_s)
    } else {
        Err(CommandError::input(format!("--duration: expected more than 0 seconds and at most 1e10, got {duration_s}")))
    }
}
