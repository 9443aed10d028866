//! Files of an archive: one file, or all of a directory by unit and day.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use geu_protocol::excerpt::excerpt;

use super::{ARROW, PARQUET};
use crate::input::InputError;

/// The files of a directory in the order of their days and names; `None` if it is no directory.
///
/// # Errors
/// The directory cannot be read, or is no archive of one unit.
pub fn archive_files(name: &str) -> Result<Option<Vec<PathBuf>>, InputError> {
    let path = Path::new(name);
    if !path.is_dir() {
        return Ok(None);
    }
    let failed = |source| InputError::Open { name: name.to_owned(), source };
    let refused = |message: String| InputError::Archive { name: name.to_owned(), message };
    let entries = entries(path).map_err(failed)?;
    let units: Vec<&PathBuf> = entries.iter().filter(|entry| is_named(entry, "device=")).collect();
    let directory = match &units[..] {
        [] => path.to_owned(),
        [unit] => (*unit).clone(),
        [first, ..] => {
            let name =
                |unit: &PathBuf| unit.file_name().map_or(String::new(), |name| name.to_string_lossy()[7..].to_owned());
            let names: Vec<String> = units.iter().map(|unit| name(unit)).collect();
            let (names, first) = (names.join(", "), first.display().to_string());
            let (names, first) = (excerpt(&names), excerpt(&first));
            return Err(refused(format!("expected an archive of one unit, got {names}; give {first}")));
        }
    };
    let (mut files, mut has_arrow) = (Vec::new(), false);
    let days = if units.is_empty() { entries } else { self::entries(&directory).map_err(failed)? };
    for entry in days {
        let within = if is_named(&entry, "day=") { self::entries(&entry).map_err(failed)? } else { vec![entry] };
        for file in within {
            let ends = |name: &str| file.extension().is_some_and(|end| end == name);
            has_arrow |= ends(ARROW);
            if ends(PARQUET) {
                files.push(file);
            }
        }
    }
    match (files.is_empty(), has_arrow) {
        (false, false) => Ok(Some(files)),
        (_, true) => {
            let message = "expected Parquet files, got Arrow files; decode the recordings with --format parquet";
            Err(refused(message.to_owned()))
        }
        (true, false) => Err(InputError::Directory { name: name.to_owned() }),
    }
}

/// The entries of a directory, sorted.
fn entries(directory: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(directory)?.map(|entry| entry.map(|entry| entry.path()));
    let mut entries: Vec<PathBuf> = entries.collect::<io::Result<_>>()?;
    entries.sort_unstable();
    Ok(entries)
}

/// True for a directory with this prefix of its name.
fn is_named(path: &Path, prefix: &str) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)) && path.is_dir()
}
