//! `geu selftest`: verifies the model against the published values.

use clap::Args;
use geu_selftest::{ClaimCheck, Expected, LIMIT_SIGMA, PublishedValue, experiments, measure};

use crate::command_error::{CommandError, say};

/// Simulates and measures every number that the paper prints; fails if one is off.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Seed of every random stream
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = crate::settings::seed)]
    seed: u64,
    /// Number of seeds, from --seed on; with further seeds only random experiments are repeated
    #[arg(long, value_name = "COUNT", default_value_t = 1)]
    seeds: u64,
}

/// Runs `geu selftest`.
///
/// # Errors
/// A number is off.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let (mut measured, mut off) = (0, 0);
    for index in 0..arguments.seeds {
        let seed = arguments.seed.wrapping_add(index);
        let again = if index > 0 { ", random experiments" } else { "" };
        say!("seed {seed}{again}")?;
        say!(
            "{:<16} {:<50} {:>17} {:>14} {:>10}  {:<13} verdict",
            "source",
            "what",
            "paper or model",
            "measured",
            "sigma",
            "unit"
        )?;
        for experiment in experiments().filter(|experiment| experiment.noise || index == 0) {
            for result in measure(experiment, seed, &[]).map_err(CommandError::failed)? {
                print_row(&result)?;
                measured += 1;
                off += u32::from(!result.holds());
            }
        }
        say!()?;
    }
    if off > 0 {
        return Err(CommandError::failed(format!("{off} of {measured} numbers off by more than {LIMIT_SIGMA} sigma")));
    }
    say!("{measured} numbers, all within {LIMIT_SIGMA} sigma")?;
    Ok(())
}

fn print_row(result: &ClaimCheck) -> Result<(), CommandError> {
    let ClaimCheck { claim: PublishedValue { what, source, expected, unit }, measured } = result;
    // Two digits of sigma; a measurement without sigma is exact.
    let decimals =
        if measured.sigma > 0.0 { (1.0 - measured.sigma.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 };
    let value = format!("{:.decimals$}", measured.value);
    let sigma = if measured.sigma > 0.0 { format!("{:.1e}", measured.sigma) } else { "exact".to_owned() };
    let expected = match expected {
        Expected::Value(value, 0.0) => value.to_string(),
        Expected::Value(value, rounding) => format!("{value} ± {rounding}"),
        Expected::AtMost(limit) => format!("≤ {limit}"),
        Expected::Between(min, max) => format!("{min}…{max}"),
    };
    let verdict = match result.off_sigma() {
        0.0 => "ok".to_owned(),
        off if result.holds() => format!("ok, {off:.1} sigma"),
        off => format!("OFF, {off:.1} sigma"),
    };
    say!("{source:<16} {what:<50} {expected:>17} {value:>14} {sigma:>10}  {unit:<13} {verdict}")
}
