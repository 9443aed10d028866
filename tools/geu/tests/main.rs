//! The command `geu` as a process.

mod archives;
mod blind;
mod directories;
mod outputs;
mod shells;
mod version;
