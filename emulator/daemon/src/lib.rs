//! The unit as a process: cadence, links, commands, recording.
