//! Files that this process reads and writes.
//!
//! Every input claims its file when it is opened, every output when its option is read; the second claim of a file is refused.

use std::fs::Metadata;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use nix::sys::stat::major;

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

/// Major number of /dev/null and the like, which any number of inputs and outputs share.
const MEMORY_DEVICES: u64 = 1;

/// True for a file, pipe or device of which an input and an output cannot be the same.
fn is_claimed(metadata: &Metadata) -> bool {
    let kind = metadata.file_type();
    kind.is_file() || kind.is_fifo() || kind.is_char_device() && major(metadata.rdev()) != MEMORY_DEVICES
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
    /// Several outputs may go to the same device or pipe.
    fn output(&mut self, output: String, claimed: Claimed, is_file: bool) -> Result<(), ClaimError> {
        if let Claimed::Existing(id) = claimed
            && let Some((_, input)) = self.inputs.iter().find(|(other, _)| *other == id)
        {
            return Err(ClaimError::Input { output, input: input.clone() });
        }
        if let Some((_, other)) = self.outputs.iter().find(|(other, _)| is_file && *other == claimed) {
            return Err(ClaimError::Output { output, other: other.clone() });
        }
        self.outputs.push((claimed, output));
        Ok(())
    }
}

/// Claims an input: a file, which an output would destroy, or a pipe or device, to which it would be sent.
///
/// # Errors
/// The file is an output.
pub fn claim_input(name: &str, metadata: &Metadata) -> Result<(), ClaimError> {
    if !is_claimed(metadata) {
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
        Target::Descriptor(_) => Ok(()),
        Target::Direct(path) => match std::fs::metadata(path).map_err(unwritable)? {
            metadata if is_claimed(&metadata) => claims().output(output, Claimed::Existing(file_id(&metadata)), false),
            _ => Ok(()),
        },
        Target::Regular { before: Some(metadata), .. } => {
            claims().output(output, Claimed::Existing(file_id(&metadata)), true)
        }
        Target::Regular { path, before: None } => claims().output(output, Claimed::New(path), true),
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
            claims().output(name.to_owned(), Claimed::Existing(id), true)?;
            claimed.push(id);
        }
    }
    Ok(())
}
