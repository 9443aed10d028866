//! From files to windows: mean rates of the table, or of the samples in each interval of the reference.

use geu_rates::{Gyro, Reference, Windows};
use geu_recording::{GyroCsv, GyroCsvDefectKind as Kind, GyroCsvSpec, RateRow, RateTable};

use crate::command_error::CommandError;
use crate::diagnose_rates::RatesArguments;

/// Smallest share of the expected samples in a window.
const MIN_SHARE: f64 = 0.5;

/// The windows with rates of gyros and reference.
///
/// # Errors
/// There is no such window.
pub fn windows(
    arguments: &RatesArguments,
    description: &GyroCsvSpec,
    links: &[GyroCsv],
    table: &RateTable,
) -> Result<Windows, CommandError> {
    let gyros = description.gyros.iter().map(|gyro| Gyro { name: gyro.name.clone(), axis: gyro.axis }).collect();
    let of_samples = table.rows.iter().any(|row| row.t_s.is_some());
    let failed = |error| CommandError::input(format!("{}: {error}", arguments.reference));
    let reference = |row: &RateRow| match row.rates_arcsec_s[..] {
        [x, y, z] => Reference::Vector([x, y, z]),
        _ => Reference::Magnitude(row.rates_arcsec_s.first().copied().unwrap_or(f64::NAN)),
    };
    if !of_samples {
        let mut groups: Vec<String> = Vec::new();
        let group = |row: &RateRow| row.group.clone().unwrap_or_else(|| arguments.reference.clone());
        for name in table.rows.iter().map(group) {
            if !groups.contains(&name) {
                groups.push(name);
            }
        }
        let mut windows = Windows::new(gyros, groups.clone());
        for row in &table.rows {
            let index = groups.iter().position(|name| *name == group(row)).unwrap_or(0);
            windows.push(index, &row.gyros_arcsec_s, reference(row)).map_err(failed)?;
        }
        return Ok(windows);
    }
    if links.is_empty() {
        return Err(CommandError::input("--link: expected CSV of gyros, because the reference has no rates of gyros"));
    }
    let (mut filled, mut found) = (Vec::new(), Vec::new());
    let spacing_s = table.spacing_s().unwrap_or(description.interval_s);
    for (link, read) in arguments.link.iter().zip(links) {
        let samples = well_stamped(read);
        let own: Vec<(Vec<f64>, &RateRow)> = table
            .rows
            .iter()
            .filter_map(|row| Some((mean(&samples, row.t_s?, spacing_s, description)?, row)))
            .collect();
        if !own.is_empty() {
            filled.push(link.clone());
            found.push(own);
        }
    }
    if found.is_empty() {
        return Err(CommandError::input(format!(
            "{}: expected times within {}, got other times",
            arguments.reference,
            arguments.link.join(", ")
        )));
    }
    let mut windows = Windows::new(gyros, filled);
    for (group, own) in found.iter().enumerate() {
        for (rates, row) in own {
            windows.push(group, rates, reference(row)).map_err(failed)?;
        }
    }
    Ok(windows)
}

/// Times and rates of the samples with valid time stamps, in the order of time.
fn well_stamped(read: &GyroCsv) -> Vec<(f64, &[f64])> {
    let mut is_good = vec![true; read.samples.len()];
    for defect in &read.defects {
        let rows = match defect.kind {
            Kind::Repeat => 1,
            Kind::Glitch { rows, .. } => rows,
            _ => 0,
        };
        let from = read.samples.partition_point(|sample| sample.line < defect.line);
        is_good.iter_mut().skip(from).take(rows).for_each(|is_good| *is_good = false);
    }
    let samples = read.samples.iter().zip(is_good).filter(|(_, is_good)| *is_good);
    let mut samples: Vec<(f64, &[f64])> = samples.map(|(sample, _)| (sample.t_s, &sample.rates_arcsec_s[..])).collect();
    samples.sort_by(|one, other| one.0.total_cmp(&other.0));
    samples
}

/// Mean rates in the interval that ends at `t_s`; `None` if it has too few samples.
fn mean(samples: &[(f64, &[f64])], t_s: f64, spacing_s: f64, description: &GyroCsvSpec) -> Option<Vec<f64>> {
    let from = samples.partition_point(|sample| sample.0 <= t_s - spacing_s);
    let to = samples.partition_point(|sample| sample.0 <= t_s);
    let inside = &samples[from..to.max(from)];
    if inside.is_empty() || (inside.len() as f64) < MIN_SHARE * spacing_s / description.interval_s {
        return None;
    }
    let sum = |gyro: usize| inside.iter().map(|(_, rates)| rates[gyro]).sum::<f64>();
    Some((0..description.gyros.len()).map(|gyro| sum(gyro) / inside.len() as f64).collect())
}
