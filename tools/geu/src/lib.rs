//! The command `geu`: one file per subcommand, with its arguments and output.
//!
//! Results go to standard output or the named file, everything else to standard error. [`command()`] is the whole command,
//! [`decode_table`] `geu decode` to Arrow batches in memory, [`StreamDecoder`] that of bytes as they arrive.

/// Declares the subcommands of a command: the enum for clap, and `run`.
macro_rules! subcommands {
    ($($(#[$about:meta])* $name:ident => $module:ident,)*) => {
        #[derive(clap::Subcommand)]
        enum Command {
            $($(#[$about])* $name($module::Arguments),)*
        }

        impl Command {
            fn run(&self) -> Result<(), crate::command_error::CommandError> {
                match self {
                    $(Command::$name(arguments) => $module::run(arguments),)*
                }
            }
        }
    };
}

mod blind;
mod calibrate;
mod calibrate_compare;
mod calibrate_parts;
mod checkout;
mod command_error;
mod completions;
mod config;
mod control_client;
mod decode;
mod describe;
mod device;
mod diagnose;
mod diagnose_magnitudes;
mod evaluation_args;
mod expectations;
mod faults;
mod inject;
mod input_args;
mod links;
mod man;
mod monitor;
mod output_guard;
mod output_writer;
mod outputs;
mod reconstruct;
mod replay;
mod run;
mod running;
mod selftest;
mod send;
mod settings;
mod simulate;
mod time_range;
mod token;
mod track;
mod update;
mod watch;

use std::ffi::OsString;
use std::sync::LazyLock;

use clap::{CommandFactory, FromArgMatches, Parser};
pub use command_error::CommandError;
use command_error::EXIT_CODES;
pub use decode::stream::StreamDecoder;
pub use decode::table::{DecodedTable, decode_table};
pub use geu_archive::UNIT;

/// Emulator, decoder and evaluation of a spacecraft gyro electronics unit.
///
/// Without a command the emulator runs: the reference unit on its default scenario, on a pty.
#[derive(Parser)]
#[command(name = "geu", version = VERSION.as_str())]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

subcommands! {
    Run => run,
    Replay => replay,
    Send => send,
    Selftest => selftest,
    Simulate => simulate,
    Calibrate => calibrate,
    Checkout => checkout,
    Reconstruct => reconstruct,
    Diagnose => diagnose,
    Blind => blind,
    Faults => faults,
    Inject => inject,
    Monitor => monitor,
    Config => config,
    Device => device,
    Describe => describe,
    Decode => decode,
    Track => track,
    Watch => watch,
    Completions => completions,
    Man => man,
}

static VERSION: LazyLock<String> = LazyLock::new(|| {
    let (major, minor) = geu_protocol::LINK_VERSION;
    format!("{} (link version {major}.{minor})", env!("CARGO_PKG_VERSION"))
});

/// Adds the exit codes to the help of the command and of all its subcommands.
fn with_exit_codes(command: clap::Command) -> clap::Command {
    let own = command.get_after_help().map(|text| format!("{text}\n\n")).unwrap_or_default();
    command.after_help(own + EXIT_CODES).mut_subcommands(with_exit_codes)
}

/// The command as its help shows it.
fn whole_command() -> clap::Command {
    with_exit_codes(Arguments::command())
}

/// Runs the command with these arguments, the program's name first; returns its exit code.
pub fn command(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    geu_files::interruption::ignore_file_size_signal();
    let mut command = whole_command();
    let matches = match command.try_get_matches_from_mut(arguments) {
        Ok(matches) => matches,
        Err(error) => error.exit(),
    };
    let arguments = Arguments::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    let result = outputs::claim(&command, &matches).and_then(|()| match arguments.command {
        Some(command) => command.run(),
        None => run::run(&run::Arguments::default()),
    });
    match result {
        Ok(()) => 0,
        Err(error) => error.report(),
    }
}
