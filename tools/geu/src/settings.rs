//! Where a configuration comes from: a file or the built-in one, with overrides. Every command that reads one takes these.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use geu_model::Configuration;
use geu_model::configuration::{WireForm, unix_ns};

use crate::failure::Failure;

/// Configuration and overrides.
#[derive(Args, Debug, Clone, Default)]
pub struct Settings {
    /// Configuration file (TOML, may be .gz or .zst); without it the reference unit on its default scenario
    pub config: Option<PathBuf>,
    /// Overrides a value of the configuration: gyro.GYRX.drift.arcsec_per_h=10, manoeuvre.0.duration_s=60
    #[arg(long = "set", value_name = "PATH=VALUE")]
    pub overrides: Vec<String>,
}

/// What a run takes beside its configuration.
#[derive(Args, Debug, Clone, Default)]
pub struct RunSettings {
    #[command(flatten)]
    pub settings: Settings,
    /// Seed of every random stream, in place of the configuration's
    #[arg(long)]
    pub seed: Option<u64>,
    /// Unix time of the start of the first half second, in place of the configuration's
    #[arg(long, value_name = "UNIX_SECONDS")]
    pub start: Option<f64>,
}

/// Form of the link on disk.
#[derive(ValueEnum, Debug, Clone, Copy)]
pub enum Wire {
    /// link.log, as `candump -l` writes
    Can,
    /// link.bin, the serial bytes
    Serial,
}

impl From<Wire> for WireForm {
    fn from(wire: Wire) -> WireForm {
        match wire {
            Wire::Can => WireForm::Can,
            Wire::Serial => WireForm::Serial,
        }
    }
}

impl Wire {
    /// The form asked for, else the form recorded, else `link.log`.
    pub fn form(asked: Option<Wire>, configuration: &Configuration) -> WireForm {
        asked.map(WireForm::from).or(configuration.run.wire).unwrap_or_default()
    }
}

impl Settings {
    /// Reads it.
    ///
    /// # Errors
    /// A file that cannot be read, or whatever is wrong in it.
    pub fn read(&self) -> Result<Configuration, Failure> {
        match &self.config {
            None => Configuration::reference_with(&self.overrides),
            Some(path) => {
                let name = path.display().to_string();
                let text = geu_recording::read_text(path).map_err(|error| {
                    Failure::input(format!(
                        "{name}: cannot be read: {error}; expected a configuration, as `geu config show` prints"
                    ))
                })?;
                Configuration::parse(&name, &text, &self.overrides)
            }
        }
        .map_err(Failure::input)
    }
}

impl RunSettings {
    /// Reads the configuration and puts seed and start in.
    ///
    /// # Errors
    /// As [`Settings::read`], and a start that is no time.
    pub fn read(&self) -> Result<Configuration, Failure> {
        let mut configuration = self.settings.read()?;
        if let Some(seed) = self.seed {
            configuration.seed = seed;
        }
        if let Some(start_unix_s) = self.start {
            if !(0.0..=4e9).contains(&start_unix_s) {
                return Err(Failure::input(format!("--start: expected 0…4e9 seconds, got {start_unix_s}")));
            }
            configuration.start_unix_ns = unix_ns(start_unix_s);
        }
        Ok(configuration)
    }
}

/// Half seconds of on-board time in `duration_s`.
///
/// # Errors
/// A duration that is none.
pub fn half_seconds(duration_s: f64) -> Result<u64, Failure> {
    if duration_s > 0.0 && duration_s <= 1e10 {
        Ok((duration_s * 2.0).ceil() as u64)
    } else {
        Err(Failure::input(format!("--duration: expected more than 0 seconds and at most 1e10, got {duration_s}")))
    }
}
