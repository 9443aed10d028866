//! The token of a control interface: from a file or the environment, where process lists do not show it.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::command_error::CommandError;

/// Longest token, bytes.
const LONGEST: u64 = 1024;

/// Sources of the token. No message quotes it.
#[derive(Args, Debug, Clone, Default)]
pub struct Token {
    /// Token of the control interface; process lists show it, so prefer the environment or --control-token-file
    #[arg(long, value_name = "TOKEN", env = "GEU_CONTROL_TOKEN", hide_env_values = true)]
    control_token: Option<String>,
    /// File with the token on its only line, in place of --control-token and GEU_CONTROL_TOKEN
    #[arg(long, value_name = "FILE")]
    control_token_file: Option<PathBuf>,
}

impl Token {
    /// The token, if one is given.
    ///
    /// # Errors
    /// The file cannot be read; the token does not fit into a header.
    pub fn read(&self) -> Result<Option<String>, CommandError> {
        let (place, token) = match &self.control_token_file {
            Some(path) => {
                let place = format!("--control-token-file {}", path.display());
                let token = start_of(path).map_err(|error| {
                    CommandError::input(format!(
                        "{place}: cannot be read: {error}; expected a file with a token on one line"
                    ))
                })?;
                (place, token.trim().to_owned())
            }
            None => match self.control_token.as_deref() {
                None | Some("") => return Ok(None),
                Some(token) => ("--control-token or GEU_CONTROL_TOKEN".to_owned(), token.to_owned()),
            },
        };
        let is_plain =
            !token.is_empty() && token.len() as u64 <= LONGEST && token.bytes().all(|c| c.is_ascii_graphic());
        if is_plain {
            return Ok(Some(token));
        }
        Err(CommandError::input(format!(
            "{place}: expected a token of 1 to {LONGEST} visible ASCII characters without blanks, got {} bytes of another kind",
            token.len()
        )))
    }
}

/// Start of a file, longer than the longest token.
fn start_of(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(2 * LONGEST).read_to_string(&mut text)?;
    Ok(text)
}
