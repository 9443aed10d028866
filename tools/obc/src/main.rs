//! `geu-obc`: a small on-board computer that closes the loop around the emulator, without any other software.
//!
//! It starts `geu run`, reads the link as on-board software does ([`computer`]), moves a simulated spacecraft
//! ([`spacecraft`]), and tells the emulator where that points (`--truth udp://…`).

mod computer;
mod emulator;
mod flight;
mod spacecraft;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use emulator::Emulator;
use flight::{SETTLED_S, say};
use geu_calibration::{GyroSelection, PriorCalibration};
use geu_model::Configuration;
use geu_model::units::duration_s;

const EXIT_CODES: &str = "\
Exit codes:
  0  pointing was held
  1  it was not, a plan's expectation was not met, or the flight broke off
  2  it could not begin: bad usage, or a configuration, a plan or a link that is missing or wrong";

/// Holds a simulated spacecraft still by the gyros of an emulated unit, and prints a line a second.
///
/// The spacecraft starts with the rest of a slew and must come back and stay. What the computer believes of the unit is the
/// configuration; what --set and --faults change is in the unit alone, so that one sees what it does to a pointing.
#[derive(Parser)]
#[command(name = "geu-obc", version, after_help = EXIT_CODES)]
struct Arguments {
    /// Configuration of the unit, believed on board [default: the reference unit]
    config: Option<PathBuf>,
    /// Length of the flight, on-board time
    #[arg(long, value_name = "DURATION", default_value = "60", allow_negative_numbers = true, value_parser = duration)]
    duration: u32,
    /// On-board time against the wall clock: a factor, or max, where unit and computer wait for each other [default: 1]
    #[arg(long, value_name = "X|max", conflicts_with = "link")]
    speed: Option<String>,
    /// Changes a value in the unit, unknown on board: gyro.GYRY.drift.arcsec_per_h=720
    #[arg(long = "set", value_name = "PATH=VALUE", conflicts_with = "link")]
    overrides: Vec<String>,
    /// Fault plan for geu run
    #[arg(long, value_name = "PLAN", conflicts_with = "link")]
    faults: Option<PathBuf>,
    /// Where geu run writes what became of the plan's expectations, as JUnit XML
    #[arg(long, value_name = "FILE", conflicts_with = "link")]
    junit: Option<PathBuf>,
    /// Writes what geu run records
    #[arg(long, value_name = "DIRECTORY", conflicts_with = "link")]
    record: Option<PathBuf>,
    /// Replaces a recording in that directory
    #[arg(long, requires = "record")]
    force: bool,
    /// Gyros in use
    #[arg(long, value_enum, default_value_t = Gyros::Za)]
    gyros: Gyros,
    /// Seed of what disturbs the spacecraft
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The program geu [default: the one beside this program]
    #[arg(long, value_name = "PROGRAM")]
    geu: Option<PathBuf>,
    /// Goes to an emulator that runs already: HOST:PORT or a pty
    #[arg(long, value_name = "LINK", requires = "truth")]
    link: Option<String>,
    /// Where that one listens for its truth: HOST:PORT, as in its --truth udp://HOST:PORT
    #[arg(long, value_name = "ADDRESS", requires = "link")]
    truth: Option<String>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Gyros {
    /// GYRX, GYRY, GYRZA
    Za,
    /// GYRX, GYRY, GYRZB
    Zb,
    /// All four, by least squares
    All,
    /// As za; samples without GYRZA by GYRZB
    Auto,
}

impl From<Gyros> for GyroSelection {
    fn from(gyros: Gyros) -> GyroSelection {
        match gyros {
            Gyros::Za => GyroSelection::Za,
            Gyros::Zb => GyroSelection::Zb,
            Gyros::All => GyroSelection::All,
            Gyros::Auto => GyroSelection::Auto,
        }
    }
}

/// The longest flight: a week.
const LONGEST_S: f64 = 604_800.0;

/// A flight long enough to settle, in whole seconds.
fn duration(text: &str) -> Result<u32, String> {
    Ok(duration_s(text, f64::from(SETTLED_S + 1), LONGEST_S)?.ceil() as u32)
}

impl Arguments {
    /// What the child is started with.
    fn for_geu(&self) -> Vec<String> {
        let mut all = Vec::new();
        let mut add = |name: &str, value: String| all.extend([name.to_owned(), value]);
        self.speed.iter().for_each(|speed| add("--speed", speed.clone()));
        self.overrides.iter().for_each(|path| add("--set", path.clone()));
        self.faults.iter().for_each(|plan| add("--faults", plan.display().to_string()));
        self.junit.iter().for_each(|file| add("--junit", file.display().to_string()));
        self.record.iter().for_each(|directory| add("--record", directory.display().to_string()));
        // Should this program go without ending it.
        add("--duration", (self.duration + 30).to_string());
        all.extend(self.force.then(|| "--force".to_owned()));
        all.extend(self.config.iter().map(|config| config.display().to_string()));
        all
    }

    fn believed(&self) -> Result<PriorCalibration, String> {
        let Some(path) = &self.config else { return Ok(PriorCalibration::from(&Configuration::reference())) };
        let name = path.display().to_string();
        let text = geu_recording::read_text(path).map_err(|error| format!("{name}: cannot be read: {error}"))?;
        Ok(PriorCalibration::from(&Configuration::parse(&name, &text, &[]).map_err(|error| error.to_string())?))
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let begun = begin(&arguments).map_err(|message| (2, message));
    match begun.and_then(|(believed, emulator)| fly(&arguments, &believed, emulator).map_err(|message| (1, message))) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err((code, message)) => {
            let _ = writeln!(std::io::stderr(), "geu-obc: {message}");
            ExitCode::from(code)
        }
    }
}

/// What is believed of the unit, and the unit.
fn begin(arguments: &Arguments) -> Result<(PriorCalibration, Emulator), String> {
    let believed = arguments.believed()?;
    let emulator = match (&arguments.link, &arguments.truth) {
        (Some(link), Some(truth)) => Emulator::attach(link, truth)?,
        _ => Emulator::start(&emulator::program(arguments.geu.as_deref())?, &arguments.for_geu())?,
    };
    Ok((believed, emulator))
}

/// Flies, and tells whether pointing was held.
fn fly(arguments: &Arguments, believed: &PriorCalibration, mut emulator: Emulator) -> Result<bool, String> {
    let flown = flight::fly(&mut emulator, believed, arguments.gyros.into(), arguments.duration, arguments.seed);
    let flown = match flown {
        Ok(flown) => flown,
        Err(message) => {
            // Why it is so, the emulator may know better.
            return Err(emulator.end().err().map_or_else(|| message.clone(), |more| format!("{message}; {more}")));
        }
    };
    let is_content = emulator.end()?;
    let bound_arcsec = flight::bound_arcsec(believed, arguments.duration);
    let is_held = flown.worst_arcsec <= bound_arcsec;
    say(&format!(
        "pointing {}: after {SETTLED_S} s the true error was {:.2}″ at most, at {:.1} s; the bound is {bound_arcsec:.2}″",
        if is_held { "held" } else { "not held" },
        flown.worst_arcsec,
        flown.worst_s
    ));
    if !is_content {
        say("the emulator is not content: what it said stands above");
    }
    Ok(is_held && is_content)
}
