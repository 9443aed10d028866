//! Files that this process reads and writes.
//!
//! Every input claims its file when it is opened, every output when its option is read; the second claim of a file is refused.

use std::fs::Metadata;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::place::{FileId, Target, duplicate, file_id};

#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// An input is the same file.
    #[error("{output}: expected a file that is not an input, got the same file as the input {input}; name another")]
    Input { output: String, input: String },
    /// Another output is the same file.
    #[error("{output}: expected another file than {other}, got the same; name another")]
    Output { output: String, other: String },
    /// It cannot be written.
    #[error(
        "{output}: expected a file that may be written, in a directory that exists and may be written, got: {source}"
    )]
    Unwritable { output: String, source: io::Error },
}

/// Identity of a file: of an existing one, or the path of a new one.
#[derive(Debug, PartialEq, Eq)]
enum Claimed {
    Existing(FileId),
    New(PathBuf),
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
        if let Claimed::Existing(id) = claimed
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

/// Claims an input. Only regular files are claimed: writing does not destroy others.
///
/// # Errors
/// The file is an output.
pub fn claim_input(name: &str, metadata: &Metadata) -> Result<(), ClaimError> {
    if !metadata.is_file() {
        return Ok(());
    }
    let (mut claims, id) = (claims(), file_id(metadata));
    if let Some((_, output)) = claims.outputs.iter().find(|(claimed, _)| *claimed == Claimed::Existing(id)) {
        return Err(ClaimError::Input { output: output.clone(), input: name.to_owned() });
    }
    if claims.inputs.iter().all(|(other, _)| *other != id) {
        claims.inputs.push((id, name.to_owned()));
    }
    Ok(())
}

/// Claims the output file of an option, and checks that it may be written.
///
/// # Errors
/// The file is an input or another output, or cannot be written.
pub fn claim_output(option: &str, path: &Path) -> Result<(), ClaimError> {
    let output = format!("{option} {}", path.display());
    let unwritable = |source| ClaimError::Unwritable { output: output.clone(), source };
    let target = Target::new(path).map_err(unwritable)?;
    target.check().map_err(unwritable)?;
    match target {
        Target::Descriptor(_) | Target::Direct(_) => Ok(()),
        Target::Regular { before: Some(metadata), .. } => {
            claims().output(output, Claimed::Existing(file_id(&metadata)))
        }
        Target::Regular { path, before: None } => claims().output(output, Claimed::New(path)),
    }
}

/// Claims the files of standard output and standard error: `geu decode x.log >> x.log` would never end. Both may be the same
/// file.
///
/// # Errors
/// A file is an input.
pub fn claim_standard_output() -> Result<(), ClaimError> {
    use std::os::fd::AsFd;
    let streams =
        [("standard output", duplicate(io::stdout().as_fd())), ("standard error", duplicate(io::stderr().as_fd()))];
    let mut claimed = Vec::new();
    for (name, stream) in streams {
        let metadata = stream.and_then(|stream| stream.metadata());
        let id = metadata.ok().filter(Metadata::is_file).map(|metadata| file_id(&metadata));
        if let Some(id) = id.filter(|id| !claimed.contains(id)) {
            claims().output(name.to_owned(), Claimed::Existing(id))?;
            claimed.push(id);
        }
    }
    Ok(())
}
