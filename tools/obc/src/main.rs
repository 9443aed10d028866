//! `geu-obc`: a small on-board computer that closes the loop around the emulator, without any other software.
//!
//! It starts `geu run`, reads the link as on-board software does ([`controller`]), moves a simulated spacecraft
//! ([`spacecraft`]), and sends its attitude to the emulator (`--truth udp://…`).

mod closed_loop;
mod controller;
mod emulator;
mod spacecraft;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use closed_loop::{SETTLED_S, print};
use emulator::Emulator;
use geu_calibration::{GyroSelection, PriorCalibration};
use geu_model::Configuration;
use geu_model::device::Device;
use geu_model::units::duration_s;

const EXIT_CODES: &str = "\
Exit codes:
  0  pointing was held
  1  it was not held, a plan's expectation was not met, or the run was interrupted
  2  the run could not start: bad usage, or a configuration, a plan or a link is missing or wrong";

/// Controls the attitude of a simulated spacecraft by the gyros of an emulated unit, and prints a line a second.
///
/// The spacecraft starts with the residual rate of a slew and must return and stay. The configuration is the prior knowledge of
/// the computer; --set and --faults change only the unit, to show their effect on the pointing.
#[derive(Parser)]
#[command(name = "geu-obc", version, after_help = EXIT_CODES)]
struct Arguments {
    /// Configuration of the unit, known on board [default: the reference unit]
    config: Option<PathBuf>,
    /// On-board time to run
    #[arg(long, value_name = "DURATION", default_value = "60", allow_negative_numbers = true, value_parser = duration)]
    duration: u32,
    /// On-board time against the wall clock: a factor, or max, with which unit and computer wait for each other [default: 1]
    #[arg(long, value_name = "X|max", conflicts_with = "link")]
    speed: Option<String>,
    /// Change a value in the unit, unknown on board: gyro.GYRY.drift.arcsec_per_h=720
    #[arg(long = "set", value_name = "PATH=VALUE", conflicts_with = "link")]
    overrides: Vec<String>,
    /// Fault plan for geu run
    #[arg(long, value_name = "PLAN", conflicts_with = "link")]
    faults: Option<PathBuf>,
    /// Results of the plan's expectations as JUnit XML, written by geu run
    #[arg(long, value_name = "FILE", conflicts_with = "link")]
    junit: Option<PathBuf>,
    /// Directory for the recording of geu run
    #[arg(long, value_name = "DIRECTORY", conflicts_with = "link")]
    record: Option<PathBuf>,
    /// Replace a recording in that directory
    #[arg(long, requires = "record")]
    force: bool,
    /// Gyros in use
    #[arg(long, value_enum, default_value_t = GyroSelection::Za)]
    gyros: GyroSelection,
    /// Seed of the disturbances of the spacecraft
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The program geu [default: geu in the directory of this program]
    #[arg(long, value_name = "PROGRAM")]
    geu: Option<PathBuf>,
    /// Connect to a running emulator: HOST:PORT or a pty
    #[arg(long, value_name = "LINK", requires = "truth")]
    link: Option<String>,
    /// Address at which the running emulator receives its truth: HOST:PORT, as in its --truth udp://HOST:PORT
    #[arg(long, value_name = "ADDRESS", requires = "link")]
    truth: Option<String>,
}

/// The longest run: a week.
const LONGEST_S: f64 = 604_800.0;

/// A run long enough to settle, in whole seconds.
fn duration(text: &str) -> Result<u32, String> {
    Ok(duration_s(text, f64::from(SETTLED_S + 1), LONGEST_S)?.ceil() as u32)
}

impl Arguments {
    /// Arguments of `geu run`.
    fn for_geu(&self) -> Vec<String> {
        let mut all = Vec::new();
        let mut add = |name: &str, value: String| all.extend([name.to_owned(), value]);
        self.speed.iter().for_each(|speed| add("--speed", speed.clone()));
        self.overrides.iter().for_each(|path| add("--set", path.clone()));
        self.faults.iter().for_each(|plan| add("--faults", plan.display().to_string()));
        self.junit.iter().for_each(|file| add("--junit", file.display().to_string()));
        self.record.iter().for_each(|directory| add("--record", directory.display().to_string()));
        // Ends the child if this program cannot.
        add("--duration", (self.duration + 30).to_string());
        all.extend(self.force.then(|| "--force".to_owned()));
        all.extend(self.config.iter().map(|config| config.display().to_string()));
        all
    }

    fn prior(&self) -> Result<PriorCalibration, String> {
        let Some(path) = &self.config else { return Ok(PriorCalibration::from(&Configuration::reference())) };
        let name = path.display().to_string();
        let text = geu_recording::read_text(path).map_err(|error| format!("{name}: cannot be read: {error}"))?;
        Ok(PriorCalibration::from(
            &Configuration::parse_for(Some(&Device::iras()), &name, &text, &[]).map_err(|error| error.to_string())?,
        ))
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let started = start(&arguments).map_err(|message| (2, message));
    match started.and_then(|(prior, emulator)| run(&arguments, &prior, emulator).map_err(|message| (1, message))) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err((code, message)) => {
            let _ = writeln!(std::io::stderr(), "geu-obc: {message}");
            ExitCode::from(code)
        }
    }
}

/// The prior knowledge of the unit, and the unit.
fn start(arguments: &Arguments) -> Result<(PriorCalibration, Emulator), String> {
    let prior = arguments.prior()?;
    let emulator = match (&arguments.link, &arguments.truth) {
        (Some(link), Some(truth)) => Emulator::attach(link, truth)?,
        _ => Emulator::start(&emulator::program(arguments.geu.as_deref())?, &arguments.for_geu())?,
    };
    Ok((prior, emulator))
}

/// Runs the closed loop; true if the pointing was held and the emulator ended well.
fn run(arguments: &Arguments, prior: &PriorCalibration, mut emulator: Emulator) -> Result<bool, String> {
    let result = closed_loop::run(&mut emulator, prior, arguments.gyros, arguments.duration, arguments.seed);
    let is_emulator_ok = match (emulator.end(), &result) {
        (Ok(is_ok), _) => is_ok,
        // The emulator may know the cause.
        (Err(cause), Err(message)) => return Err(format!("{message}; {cause}")),
        (Err(cause), Ok(_)) => return Err(cause),
    };
    let result = result?;
    let bound_arcsec = closed_loop::bound_arcsec(prior, arguments.duration);
    let is_held = result.worst_arcsec <= bound_arcsec;
    print(&format!(
        "pointing {}: after {SETTLED_S} s the true error was {:.2}″ at most, at {:.1} s; the bound is {bound_arcsec:.2}″",
        if is_held { "held" } else { "not held" },
        result.worst_arcsec,
        result.worst_s
    ));
    if !is_emulator_ok {
        print("geu run ended with exit code 1; its messages are above");
    }
    Ok(is_held && is_emulator_ok)
}
