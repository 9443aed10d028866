//! `geu config`: shows, checks and describes configurations.

use clap::{Args, Subcommand};
use geu_model::Configuration;

use crate::failure::{CommandError, print, say};
use crate::settings::ConfigArgs;

/// Shows, checks and describes configurations.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand, Debug)]
enum Action {
    /// Prints a configuration, complete and commented: everything that can be set, with limits and sources
    Show(ConfigArgs),
    /// Checks a configuration; exit 2 and the place of the first thing wrong
    Check(ConfigArgs),
    /// Prints the JSON schema of configurations
    Schema,
}

/// Carries it out.
///
/// # Errors
/// A configuration that cannot be run.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    match &arguments.action {
        Action::Show(settings) => print(format_args!("{}", settings.read()?.to_toml(true))),
        Action::Check(settings) => {
            settings.read()?;
            let name = settings
                .config
                .as_ref()
                .map_or("the built-in configuration".to_owned(), |path| path.display().to_string());
            say!("{name}: valid")
        }
        Action::Schema => say!("{:#}", Configuration::schema()),
    }
}
