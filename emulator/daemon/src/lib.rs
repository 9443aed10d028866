//! The unit as a process: cadence, links, commands, recording.

pub mod record;
pub mod simulate;
