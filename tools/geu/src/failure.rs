//! How a command ends when it does not end well: one message on standard error and an exit code others rely on.

use std::fmt::{Arguments, Display};
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

use geu_daemon::recorder::RecordError;
use geu_files::ClaimError;
use geu_recording::InputError;

/// What the help of every command says of them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  failed: an output that cannot be written, a link that breaks, an expectation that was not met, defects under --strict
  2  bad usage or bad input: an option, a configuration or a file that is missing or wrong
  3  a diagnosis that ended unexplained
  130, 143  SIGINT, SIGTERM; run, replay, monitor, and decode and track of a live input end well by them";

/// An unsuccessful end.
#[derive(Debug)]
pub struct CommandError {
    code: u8,
    message: String,
}

impl CommandError {
    /// It was tried and did not work, an output cannot be written, or `--strict` found defects: exit 1.
    pub fn failed(message: impl Display) -> CommandError {
        CommandError { code: 1, message: message.to_string() }
    }

    /// Bad usage or bad input: exit 2. The message says file, line or offset, field, expected, got.
    pub fn input(message: impl Display) -> CommandError {
        CommandError { code: 2, message: message.to_string() }
    }

    /// A diagnosis that left something unexplained: exit 3. Its report has said so.
    pub fn unexplained() -> CommandError {
        CommandError { code: 3, message: String::new() }
    }

    /// Results could not be written: exit 1; but whoever closed the pipe has seen enough, a quiet end.
    pub fn writing(error: io::Error) -> CommandError {
        match error.kind() {
            ErrorKind::BrokenPipe => CommandError { code: 0, message: String::new() },
            _ => CommandError::failed(format!("writing failed: {error}")),
        }
    }

    /// The same with another reason behind it.
    #[must_use]
    pub fn and(mut self, message: impl Display) -> CommandError {
        self.message += &format!("; {message}");
        self
    }

    /// Prints the message and gives the exit code.
    pub fn report(&self) -> ExitCode {
        if !self.message.is_empty() {
            note(format_args!("geu: {}\n", self.message.trim_end()));
        }
        ExitCode::from(self.code)
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

/// A link that breaks is no bad input.
impl From<InputError> for CommandError {
    fn from(error: InputError) -> CommandError {
        match error {
            InputError::Read { .. } => CommandError::failed(error),
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
/// When they cannot be written.
pub fn print(text: Arguments) -> Result<(), CommandError> {
    let mut out = io::stdout().lock();
    out.write_fmt(text).and_then(|()| out.flush()).map_err(CommandError::writing)
}

/// Writes to standard error; there is nobody to tell that it failed.
pub fn note(text: Arguments) {
    let _ = io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// A line of results on standard output, as [`print()`].
macro_rules! say {
    () => { $crate::failure::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::failure::print(format_args!("{}\n", format_args!($($text)*))) };
}
pub(crate) use say;
