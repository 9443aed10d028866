//! The command `geu`: one thin file per subcommand, nothing but arguments and printing.
//!
//! Results go to standard output or the file named, everything else to standard error.

mod bench;
mod blind;
mod calibrate;
mod calibrate_compare;
mod checkout;
mod config;
mod control;
mod decode;
mod describe;
mod diagnose;
mod diagnose_rates;
mod expectations;
mod failure;
mod faults;
mod gyro_csv;
mod inject;
mod links;
mod monitor;
mod outputs;
mod overwriting;
mod reconstruct;
mod replay;
mod run;
mod running;
mod selftest;
mod send;
mod settings;
mod simulate;
mod token;
mod track;
mod update;

use std::process::ExitCode;
use std::sync::LazyLock;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use failure::{CommandError, EXIT_CODES};

/// Emulator, decoder and evaluation of a spacecraft gyro electronics unit.
///
/// Without a command the emulator runs: the reference unit on its default scenario, on a pty.
#[derive(Parser)]
#[command(name = "geu", version = VERSION.as_str())]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    Run(run::Arguments),
    Replay(replay::Arguments),
    Send(send::Arguments),
    Selftest(selftest::Arguments),
    Simulate(simulate::Arguments),
    Calibrate(calibrate::Arguments),
    Checkout(checkout::Arguments),
    Reconstruct(reconstruct::Arguments),
    Diagnose(diagnose::Arguments),
    Blind(blind::Arguments),
    Faults(faults::Arguments),
    Inject(inject::Arguments),
    Monitor(monitor::Arguments),
    Config(config::Arguments),
    Describe(describe::Arguments),
    /// Decode recordings or live links to CSV, JSON lines or a summary.
    Decode(decode::Arguments),
    Track(track::Arguments),
    /// Measure what users rely on.
    Bench(bench::Arguments),
}

static VERSION: LazyLock<String> = LazyLock::new(|| {
    let (major, minor) = geu_protocol::LINK_VERSION;
    format!("{} (link version {major}.{minor})", env!("CARGO_PKG_VERSION"))
});

/// The command and all below it, each with the exit codes at the end of its help.
fn with_exit_codes(command: clap::Command) -> clap::Command {
    let own = command.get_after_help().map(|text| format!("{text}\n\n")).unwrap_or_default();
    command.after_help(own + EXIT_CODES).mut_subcommands(with_exit_codes)
}

fn main() -> ExitCode {
    geu_files::interruption::ignore_file_size_signal();
    let mut command = with_exit_codes(Arguments::command());
    let matches = command.get_matches_mut();
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    match outputs::claim(&command, &matches).and_then(|()| carried_out(arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

fn carried_out(arguments: Arguments) -> Result<(), CommandError> {
    match arguments.command {
        Some(Command::Simulate(arguments)) => simulate::run(&arguments),
        Some(Command::Calibrate(arguments)) => calibrate::run(&arguments),
        Some(Command::Checkout(arguments)) => checkout::run(&arguments),
        Some(Command::Reconstruct(arguments)) => reconstruct::run(&arguments),
        Some(Command::Diagnose(arguments)) => diagnose::run(&arguments),
        Some(Command::Blind(arguments)) => blind::run(&arguments),
        Some(Command::Faults(arguments)) => faults::run(&arguments),
        Some(Command::Inject(arguments)) => inject::run(&arguments),
        Some(Command::Monitor(arguments)) => monitor::run(&arguments),
        Some(Command::Config(arguments)) => config::run(&arguments),
        Some(Command::Describe(arguments)) => describe::run(&arguments),
        Some(Command::Decode(arguments)) => decode::run(arguments),
        Some(Command::Track(arguments)) => track::run(&arguments),
        Some(Command::Bench(arguments)) => bench::run(arguments),
        Some(Command::Run(arguments)) => run::run(&arguments),
        Some(Command::Replay(arguments)) => replay::run(arguments),
        Some(Command::Send(arguments)) => send::run(&arguments),
        Some(Command::Selftest(arguments)) => selftest::run(&arguments),
        None => run::run(&run::Arguments::default()),
    }
}
