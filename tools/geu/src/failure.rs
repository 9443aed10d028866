//! How a command ends when it does not end well: one message on standard error and an exit code others rely on.

use std::fmt::{Arguments, Display};
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

/// An unsuccessful end.
#[derive(Debug)]
pub struct Failure {
    code: u8,
    message: String,
}

impl Failure {
    /// It was tried and did not work, or `--strict` found defects: exit 1.
    pub fn failed(message: impl Display) -> Failure {
        Failure { code: 1, message: message.to_string() }
    }

    /// Bad usage or bad input: exit 2. The message says file, line or offset, field, expected, got.
    pub fn input(message: impl Display) -> Failure {
        Failure { code: 2, message: message.to_string() }
    }

    /// A diagnosis that left something unexplained: exit 3. Its report has said so.
    pub fn unexplained() -> Failure {
        Failure { code: 3, message: String::new() }
    }

    /// Results could not be written: exit 1; but whoever closed the pipe has seen enough, a quiet end.
    pub fn writing(error: io::Error) -> Failure {
        match error.kind() {
            ErrorKind::BrokenPipe => Failure { code: 0, message: String::new() },
            _ => Failure::failed(format!("writing failed: {error}")),
        }
    }

    /// The same with another reason behind it.
    #[must_use]
    pub fn and(mut self, message: impl Display) -> Failure {
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

/// Writes results to standard output.
///
/// # Errors
/// When they cannot be written.
pub fn print(text: Arguments) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    out.write_fmt(text).and_then(|()| out.flush()).map_err(Failure::writing)
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
