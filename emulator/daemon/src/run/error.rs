//! Errors that prevent a run.

use std::io;

use crate::control::ControlError;
use crate::descriptors::TooFew;
use crate::link::LinkError;
use crate::truth::TruthError;
use geu_recorder::RecordError;

/// A run that could not begin.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A link cannot be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Too few descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFew),
    /// No client can attach to any of the links.
    #[error(
        "--wait: no client attaches to a CAN interface or a serial port; expected a link with clients as well: --pty or --tcp"
    )]
    NoClientLink,
    /// The control interface cannot be served.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The address of the external truth cannot be opened.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// A condition has a variable that the external truth does not provide.
    #[error("{0}; a simulator provides them by the direction to the sun in its first sample, \"sun\": [x, y, z]")]
    Unavailable(String),
    /// The recording cannot begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The runtime or a thread cannot be started.
    #[error("cannot start: {0}")]
    System(#[from] io::Error),
}
