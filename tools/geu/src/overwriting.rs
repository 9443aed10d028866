//! Directories to write into that hold something already.

use std::fmt::Display;
use std::fs;
use std::io;
use std::path::Path;

use clap::Args;

use crate::failure::CommandError;

/// Of every command that writes into a directory.
#[derive(Args, Debug, Clone, Copy, Default)]
pub struct Force {
    /// Writes into a directory that holds something already, over files of the same names
    #[arg(long)]
    pub force: bool,
}

impl Force {
    /// Refuses a directory that holds anything, unless it was forced. One that is not there is free.
    ///
    /// # Errors
    /// The directory; something that is no directory, or cannot be looked into.
    pub fn refuse_filled(self, directory: &Path) -> Result<(), CommandError> {
        let refused = |got: &dyn Display| {
            let path = directory.display();
            format!("{path}: expected a directory that is empty or not there, got {got}")
        };
        match fs::read_dir(directory).map(|mut entries| entries.next().is_none()) {
            Ok(is_empty) if self.force || is_empty => Ok(()),
            Ok(_) => Err(CommandError::input(refused(&"one that holds files; --force writes into it all the same"))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::NotADirectory => Err(CommandError::failed(refused(&"a file"))),
            Err(error) => Err(CommandError::failed(refused(&error))),
        }
    }
}
