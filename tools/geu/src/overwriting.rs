//! Outputs that are one of the inputs, or one another: writing them would destroy what is to be read, or what was written.

use std::ffi::OsStr;
use std::fs::{self, File, Metadata};
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use geu_daemon::record::FILES;

use crate::failure::Failure;

/// Refuses outputs, each with its option, of which one is an input or another output.
///
/// # Errors
/// The option and the file.
pub fn refuse_overwriting(outputs: &[(&str, Option<&PathBuf>)], inputs: &[&str]) -> Result<(), Failure> {
    let given = || outputs.iter().filter_map(|(option, path)| Some((option, (*path)?)));
    for (index, (option, path)) in given().enumerate() {
        let id = file_id(fs::metadata(path));
        if let Some(input) = inputs.iter().find(|input| id.is_some() && of_input(input) == id) {
            return Err(Failure::input(format!(
                "{option}: expected a file that is none of the inputs, got {}, the same file as the input {input}",
                path.display()
            )));
        }
        if let Some((other, _)) = given().take(index).find(|(_, other)| are_same(other, path)) {
            return Err(Failure::input(format!(
                "{option}: expected another file than {other}, got {}, the same file",
                path.display()
            )));
        }
    }
    Ok(())
}

/// Refuses a recording in whose directory one of its files is an input: replacing it would destroy that.
///
/// # Errors
/// The option and the file.
pub fn refuse_recording_over(option: &str, directory: &Path, inputs: &[&str]) -> Result<(), Failure> {
    FILES.iter().try_for_each(|name| refuse_overwriting(&[(option, Some(&directory.join(name)))], inputs))
}

/// A regular file, by device and inode.
type FileId = (u64, u64);

fn file_id(metadata: io::Result<Metadata>) -> Option<FileId> {
    let metadata = metadata.ok().filter(Metadata::is_file)?;
    Some((metadata.dev(), metadata.ino()))
}

fn of_input(name: &str) -> Option<FileId> {
    match name {
        "-" => file_id(io::stdin().as_fd().try_clone_to_owned().and_then(|stdin| File::from(stdin).metadata())),
        name => file_id(fs::metadata(name)),
    }
}

fn are_same(one: &Path, other: &Path) -> bool {
    match (fs::metadata(one), fs::metadata(other)) {
        (Err(_), Err(_)) => place(one) == place(other),
        (one, other) => file_id(one).is_some_and(|id| file_id(other) == Some(id)),
    }
}

/// Where a file that is not there yet will be.
fn place(path: &Path) -> (PathBuf, Option<&OsStr>) {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    (fs::canonicalize(parent).unwrap_or_else(|_| parent.to_owned()), path.file_name())
}
