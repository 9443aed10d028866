//! How a command ends when it does not end well: one message on standard error and an exit code others rely on.

use std::fmt::Display;
use std::process::ExitCode;

/// An unsuccessful end.
#[derive(Debug)]
#[allow(dead_code)]
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

    /// Prints the message and gives the exit code.
    pub fn report(&self) -> ExitCode {
        eprintln!("geu: {}", self.message.trim_end());
        ExitCode::from(self.code)
    }
}
