//! Failure of a command: one message on standard error and a fixed exit code.

use std::fmt::{self, Arguments, Display, Formatter};
use std::io::{self, ErrorKind, Write};

use geu_files::ClaimError;
use geu_recorder::RecordError;
use geu_recording::InputError;

/// Exit codes, as the help of every command lists them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed: output not writable, link broken, expectation not met, defects with --strict
  2  bad usage or bad input: an option, a configuration or a file is missing or wrong
  3  a diagnosis ended unexplained
  130, 143  SIGINT, SIGTERM; run, replay, and decode, track and watch of a live input exit with 0 instead";

/// Failure of a command.
#[derive(Debug)]
pub struct CommandError {
    code: u8,
    message: String,
}

impl CommandError {
    /// Exit 1: an operation failed, an output cannot be written, or `--strict` found defects.
    pub fn failed(message: impl Display) -> CommandError {
        CommandError { code: 1, message: message.to_string() }
    }

    /// Exit 2: bad usage or bad input. The message states file, line or offset, field, expected, got.
    pub fn input(message: impl Display) -> CommandError {
        CommandError { code: 2, message: message.to_string() }
    }

    /// Exit 3: a diagnosis ended unexplained. Its report states this.
    pub fn unexplained() -> CommandError {
        CommandError { code: 3, message: String::new() }
    }

    /// Exit 1: results cannot be written. A closed pipe is a quiet end.
    pub fn writing(error: io::Error) -> CommandError {
        match error.kind() {
            ErrorKind::BrokenPipe => CommandError { code: 0, message: String::new() },
            _ => CommandError::failed(format!("writing failed: {error}")),
        }
    }

    /// Appends another reason.
    #[must_use]
    pub fn and(mut self, message: impl Display) -> CommandError {
        self.message += &format!("; {message}");
        self
    }

    /// Exit code of the command.
    pub fn code(&self) -> u8 {
        self.code
    }

    /// Prints the message and returns the exit code.
    pub fn report(&self) -> u8 {
        if !self.message.is_empty() {
            // Names and contents of inputs may have characters that command a terminal.
            let is_harmless = |letter: char| !letter.is_control() || matches!(letter, '\n' | '\t');
            let shown = |letter: char| if is_harmless(letter) { letter } else { char::REPLACEMENT_CHARACTER };
            let message: String = self.message.trim_end().chars().map(shown).collect();
            note(format_args!("geu: {message}\n"));
        }
        self.code
    }
}

impl Display for CommandError {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<RecordError> for CommandError {
    fn from(error: RecordError) -> CommandError {
        match error {
            RecordError::Occupied { .. } | RecordError::NotAFile(_) => CommandError::input(error),
            RecordError::Write { .. } | RecordError::InUse(_) | RecordError::Thread { .. } => {
                CommandError::failed(error)
            }
        }
    }
}

/// A broken link is not bad input.
impl From<InputError> for CommandError {
    fn from(error: InputError) -> CommandError {
        match error {
            InputError::Read { .. } | InputError::EndedEarly { .. } => CommandError::failed(error),
            error => CommandError::input(error),
        }
    }
}

impl From<ClaimError> for CommandError {
    fn from(error: ClaimError) -> CommandError {
        match error {
            ClaimError::Input { .. } | ClaimError::Output { .. } => CommandError::input(error),
            ClaimError::Unwritable { .. } => CommandError::failed(error),
        }
    }
}

/// Writes results to standard output.
///
/// # Errors
/// They cannot be written.
pub fn print(text: Arguments) -> Result<(), CommandError> {
    let mut out = io::stdout().lock();
    out.write_fmt(text).and_then(|()| out.flush()).map_err(CommandError::writing)
}

/// Writes to standard error; a failure is ignored.
pub fn note(text: Arguments) {
    let _ = io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Writes a line of results to standard output, as [`print()`].
macro_rules! say {
    () => { $crate::command_error::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::command_error::print(format_args!("{}\n", format_args!($($text)*))) };
}
pub(crate) use say;
