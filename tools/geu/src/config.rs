//! `geu config`: shows, checks and describes configurations.

use clap::{Args, Subcommand};
use geu_model::Configuration;

use crate::command_error::{CommandError, print, say};
use crate::device::{DEFAULT_DEVICE, unit};
use crate::settings::ConfigArgs;

/// Shows, checks and describes configurations.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand, Debug)]
enum Action {
    /// Print a complete configuration with comments: every value with its limits and source
    Show(ConfigArgs),
    /// Check a configuration; exit 2 with the place of the first error
    Check(ConfigArgs),
    /// Print the JSON schema of configurations; in geu.schema.json beside a configuration of `geu config show`, an editor finds it
    Schema {
        /// Name or description of another unit than the default one (`geu device list`)
        #[arg(long, value_name = "NAME|FILE")]
        device: Option<String>,
    },
}

/// File that editors with Taplo read, beside the configuration.
const SCHEMA_FILE: &str = "geu.schema.json";

/// Runs `geu config`.
///
/// # Errors
/// The configuration is not valid.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    match &arguments.action {
        Action::Show(settings) => {
            print(format_args!("#:schema ./{SCHEMA_FILE}\n\n{}", settings.read_of_any()?.to_toml(true)))
        }
        Action::Check(settings) => {
            settings.read_of_any()?;
            let name = settings
                .config
                .as_ref()
                .map_or("the built-in configuration".to_owned(), |path| path.display().to_string());
            say!("{name}: valid")
        }
        Action::Schema { device } => {
            let device = unit(device.as_deref().unwrap_or(DEFAULT_DEVICE))?;
            say!("{:#}", Configuration::schema(device))
        }
    }
}
