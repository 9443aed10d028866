//! What this process reads and what it writes.
//!
//! Every input claims its file when it is opened, every output when its option is read; whichever comes second is refused.
//! So a command that opens its inputs as all do cannot forget the check.

use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::place::{FileId, Place, duplicate, file_id};

#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// An input is the same file.
    #[error(
        "{output}: expected a file that is none of the inputs, got the same file as the input {input}; name another"
    )]
    Input { output: String, input: String },
    /// Another output is the same file.
    #[error("{output}: expected another file than {other}, got the same; name another")]
    Output { output: String, other: String },
    /// It cannot be written.
    #[error(
        "{output}: expected a file that may be written, in a directory that is there and may be written, got: {source}"
    )]
    Unwritable { output: String, source: io::Error },
}

/// Files by what tells them apart: those that are there, and the places of those that are not.
#[derive(Debug, PartialEq, Eq)]
enum Claimed {
    There(FileId),
    NotYet(PathBuf),
}

#[derive(Default)]
struct Claims {
    inputs: Vec<(FileId, String)>,
    outputs: Vec<(Claimed, String)>,
}

fn claims() -> MutexGuard<'static, Claims> {
    static CLAIMS: Mutex<Claims> = Mutex::new(Claims { inputs: Vec::new(), outputs: Vec::new() });
    CLAIMS.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Claims {
    fn output(&mut self, output: String, claimed: Claimed) -> Result<(), ClaimError> {
        if let Claimed::There(id) = claimed
            && let Some((_, input)) = self.inputs.iter().find(|(other, _)| *other == id)
        {
            return Err(ClaimError::Input { output, input: input.clone() });
        }
        if let Some((_, other)) = self.outputs.iter().find(|(other, _)| *other == claimed) {
            return Err(ClaimError::Output { output, other: other.clone() });
        }
        self.outputs.push((claimed, output));
        Ok(())
    }
}

/// Claims a file that is read under this name. Only regular files can be destroyed by writing; others are not claimed.
///
/// # Errors
/// A file that is an output.
pub fn claim_input(name: &str, metadata: &Metadata) -> Result<(), ClaimError> {
    if !metadata.is_file() {
        return Ok(());
    }
    let (mut claims, id) = (claims(), file_id(metadata));
    if let Some((_, output)) = claims.outputs.iter().find(|(claimed, _)| *claimed == Claimed::There(id)) {
        return Err(ClaimError::Input { output: output.clone(), input: name.to_owned() });
    }
    if claims.inputs.iter().all(|(other, _)| *other != id) {
        claims.inputs.push((id, name.to_owned()));
    }
    Ok(())
}

/// Claims the file that this option names for writing, and looks whether it may be written.
///
/// # Errors
/// A file that is an input or another output, or that cannot be written.
pub fn claim_output(option: &str, path: &Path) -> Result<(), ClaimError> {
    let output = format!("{option} {}", path.display());
    let unwritable = |source| ClaimError::Unwritable { output: output.clone(), source };
    let place = Place::of(path).map_err(unwritable)?;
    place.check().map_err(unwritable)?;
    match place {
        Place::Descriptor(_) | Place::AsItStands(_) => Ok(()),
        Place::Regular { before: Some(metadata), .. } => claims().output(output, Claimed::There(file_id(&metadata))),
        Place::Regular { path, before: None } => claims().output(output, Claimed::NotYet(path)),
    }
}

/// Claims the files into which standard output and standard error go, where they are some: `geu decode x.log >> x.log` would
/// never end. Both may go into one.
///
/// # Errors
/// A file that is an input.
pub fn claim_standard_output() -> Result<(), ClaimError> {
    use std::os::fd::AsFd;
    let streams =
        [("standard output", duplicate(io::stdout().as_fd())), ("standard error", duplicate(io::stderr().as_fd()))];
    let mut claimed = Vec::new();
    for (name, stream) in streams {
        let metadata = stream.and_then(|stream| stream.metadata());
        let id = metadata.ok().filter(Metadata::is_file).map(|metadata| file_id(&metadata));
        if let Some(id) = id.filter(|id| !claimed.contains(id)) {
            claims().output(name.to_owned(), Claimed::There(id))?;
            claimed.push(id);
        }
    }
    Ok(())
}
