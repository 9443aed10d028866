//! `geu completions`: completion scripts of shells.

use clap::Args;
use clap_complete::{Shell, generate};

use crate::command_error::{CommandError, print};
use crate::whole_command;

/// Prints the script that completes this command in a shell.
///
/// bash: `eval "$(geu completions bash)"` in ~/.bashrc; fish: `geu completions fish > ~/.config/fish/completions/geu.fish`;
/// zsh: `geu completions zsh > _geu` in a directory of $fpath. docs/install.md has the others.
#[derive(Debug, Args)]
pub struct Arguments {
    shell: Shell,
}

/// Runs `geu completions`.
///
/// # Errors
/// The script cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let mut script = Vec::new();
    generate(arguments.shell, &mut whole_command(), "geu", &mut script);
    print(format_args!("{}", String::from_utf8_lossy(&script)))
}
