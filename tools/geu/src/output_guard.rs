//! Output directories that are not empty.

use std::fmt::Display;
use std::fs;
use std::io;
use std::path::Path;

use clap::Args;

use crate::command_error::CommandError;

/// Option of each command that writes into a directory.
#[derive(Args, Debug, Clone, Copy, Default)]
pub struct Force {
    /// Write into a directory that is not empty, and replace files of the same names
    #[arg(long)]
    pub force: bool,
}

impl Force {
    /// Refuses a directory that is not empty, unless `--force` is given. A directory that does not exist is accepted.
    ///
    /// # Errors
    /// The directory is not empty, is not a directory, or cannot be read.
    pub fn check_empty(self, directory: &Path) -> Result<(), CommandError> {
        let refused = |got: &dyn Display| {
            let path = directory.display();
            format!("{path}: expected a directory that is empty or does not exist, got {got}")
        };
        match fs::read_dir(directory).map(|mut entries| entries.next().is_none()) {
            Ok(is_empty) if self.force || is_empty => Ok(()),
            Ok(_) => Err(CommandError::input(refused(&"a directory with files; --force writes into it anyway"))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::NotADirectory => Err(CommandError::failed(refused(&"a file"))),
            Err(error) => Err(CommandError::failed(refused(&error))),
        }
    }
}
