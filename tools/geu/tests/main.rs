//! The command `geu` as a process.

mod blind;
mod directories;
mod outputs;
mod version;
