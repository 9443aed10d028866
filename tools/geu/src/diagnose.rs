//! `geu diagnose`: model against measurement.

use clap::Args;

use crate::diagnose_rates::{self, RatesArguments};
use crate::failure::Failure;

/// Finds which effects explain a measurement, and how far they can be told apart.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    rates: RatesArguments,
}

/// Carries it out.
///
/// # Errors
/// As [`diagnose_rates::run`].
pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    diagnose_rates::run(&arguments.rates)
}
