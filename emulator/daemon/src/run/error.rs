//! Why a run cannot begin.

use std::io;

use crate::control::ControlError;
use crate::descriptors::TooFew;
use crate::link::LinkError;
use crate::recorder::RecordError;
use crate::truth::TruthError;

/// A run that could not begin.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A link cannot be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Too few descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFew),
    /// Nobody can attach to any of the links.
    #[error(
        "--wait: nobody attaches to a CAN interface or a serial port; expected a link with clients too: --pty or --tcp"
    )]
    NobodyToWaitFor,
    /// The control interface cannot be served.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The truth from outside cannot be listened for.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// A condition asks about what the truth from outside does not tell.
    #[error("{0}; a simulator tells them by the direction to the sun in its first sample, \"sun\": [x, y, z]")]
    Untold(String),
    /// The recording cannot begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// No runtime, no thread.
    #[error("cannot start: {0}")]
    System(#[from] io::Error),
}
