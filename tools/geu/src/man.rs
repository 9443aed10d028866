//! `geu man`: man pages.

use clap::{Args, Command};
use clap_mangen::Man;

use crate::command_error::CommandError;
use crate::output_guard::Force;
use crate::outputs::{OutputDirectory, create_directory, write};
use crate::whole_command;

/// Writes the man pages of this command: geu.1, and one for each subcommand, such as geu-run.1.
#[derive(Debug, Args)]
pub struct Arguments {
    /// New or empty directory for the pages
    #[arg(long, value_name = "DIRECTORY")]
    out: OutputDirectory,
    #[command(flatten)]
    force: Force,
}

/// Runs `geu man`.
///
/// # Errors
/// A page cannot be written.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let mut command = whole_command().disable_help_subcommand(true);
    // Gives each subcommand its whole name.
    command.build();
    let mut pages = Vec::new();
    add_pages(command, &mut pages);
    let directory = arguments.out.prepare(arguments.force, pages.iter().map(|page| page.get_filename()))?;
    create_directory(directory)?;
    for page in &pages {
        let mut text = Vec::new();
        page.render(&mut text).map_err(CommandError::writing)?;
        write(&directory.join(page.get_filename()), text)?;
    }
    Ok(())
}

/// Appends the pages of a command and its subcommands.
fn add_pages(command: Command, pages: &mut Vec<Man>) {
    command.get_subcommands().cloned().for_each(|within| add_pages(within, pages));
    pages.push(Man::new(command.version(env!("CARGO_PKG_VERSION"))));
}
