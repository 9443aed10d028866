//! The token of a control interface: from a file or the environment, where nobody who lists processes sees it.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::failure::CommandError;

/// Longest token, byte.
const LONGEST: u64 = 1024;

/// Where the token comes from. No message quotes it.
#[derive(Args, Debug, Clone, Default)]
pub struct Token {
    /// Token of the control interface, which lists of processes show; better the environment or --control-token-file
    #[arg(long, value_name = "TOKEN", env = "GEU_CONTROL_TOKEN", hide_env_values = true)]
    control_token: Option<String>,
    /// File with the token on its only line, in place of --control-token and GEU_CONTROL_TOKEN
    #[arg(long, value_name = "FILE")]
    control_token_file: Option<PathBuf>,
}

impl Token {
    /// The token, where one is given.
    ///
    /// # Errors
    /// A file that cannot be read, a token that no header can carry.
    pub fn read(&self) -> Result<Option<String>, CommandError> {
        let (place, token) = match &self.control_token_file {
            Some(path) => {
                let place = format!("--control-token-file {}", path.display());
                let token = first(path).map_err(|error| {
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

/// What a file begins with: as much as a token may be, and some more.
fn first(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(2 * LONGEST).read_to_string(&mut text)?;
    Ok(text)
}
