//! What is left when everything found is taken off: whether it is noise, and if not, what it looks like.

use std::collections::BTreeSet;

use crate::bank::Bank;
use crate::explain::Explained;
use crate::gyros::Gyros;
use crate::measured::{BLOCK_S, CHANNELS, Series, TIMING};
use crate::outcome::{FollowedTerm, Unexplained};
use crate::search::search;
use crate::state::Case;

/// Terms told that the rest follows.
const FOLLOWED: usize = 5;

/// How far a whitened residual is from noise.
///
/// For averages over half a minute up to half an hour, on each gyro: their χ² against their number, in sigmas; the largest. What no
/// hypothesis matches is still slow.
pub fn unlikeness(left: &Series) -> (f64, [f64; CHANNELS]) {
    const SCALES: [usize; 4] = [6, 24, 96, 384];
    let of_channel = |channel: usize| {
        let of_scale = |scale: &usize| {
            // Blocks that tell nothing are exactly 0; a window that is half of these is none.
            let of_window = |window: &[f64]| {
                let known = window.iter().filter(|value| **value != 0.0).count();
                (2 * known >= *scale).then(|| window.iter().sum::<f64>().powi(2) / known as f64)
            };
            let windows: Vec<f64> = left[channel].chunks_exact(*scale).filter_map(of_window).collect();
            let count = windows.len() as f64;
            // With few windows the law leans: the cube root of χ² is closer to a normal variable (Wilson and Hilferty).
            let mean = windows.iter().sum::<f64>() / count.max(1.0);
            if windows.len() < 4 {
                return 0.0;
            }
            let spread = 2.0 / (9.0 * count);
            (mean.cbrt() - (1.0 - spread)) / spread.sqrt()
        };
        SCALES.iter().map(of_scale).fold(f64::NEG_INFINITY, f64::max)
    };
    let channels: [f64; CHANNELS] = std::array::from_fn(of_channel);
    (channels[..TIMING].iter().copied().fold(f64::NEG_INFINITY, f64::max), channels)
}
/// Fourth moment over the square of the second; 3 of normal values. Blocks that tell nothing, exactly 0, are left out.
pub fn kurtosis(values: &[f64]) -> f64 {
    let known = || values.iter().filter(|value| **value != 0.0);
    let count = known().count().max(1) as f64;
    let moment = |power: i32| known().map(|value| value.powi(power)).sum::<f64>() / count;
    if moment(2) > 0.0 { moment(4) / moment(2).powi(2) } else { 0.0 }
}

/// What is left: which gyros, when, what it follows.
pub fn unexplained(case: &Case, bank: &Bank, explained: &Explained, left: &Series, gyros: Gyros) -> Unexplained {
    const WINDOW: usize = 24;
    // Of two minutes each: how much more than noise.
    let blocks = case.measured.block_count();
    let excess: Vec<f64> = (0..blocks / WINDOW)
        .map(|window| {
            let of_gyro = |gyro: usize| {
                let sum: f64 = left[gyro][window * WINDOW..(window + 1) * WINDOW].iter().sum();
                (sum * sum / WINDOW as f64 - 1.0).max(0.0)
            };
            (0..TIMING).filter(|&gyro| gyros[gyro]).map(of_gyro).sum()
        })
        .collect();
    let whole: f64 = excess.iter().sum();
    let reached = |share: f64| {
        let mut sum = 0.0;
        excess.iter().position(|excess| {
            sum += excess;
            sum >= share * whole
        })
    };
    let at_s = |window: usize| (window * WINDOW) as f64 * BLOCK_S;
    let (from, to) = (reached(0.05).unwrap_or(0), reached(0.95).unwrap_or(excess.len()));
    let held: usize = excess.iter().filter(|excess| **excess > 4.0).count();
    let share = 100.0 * held as f64 / excess.len().max(1) as f64;
    let shape = match share {
        share if share < 5.0 => "a few short departures",
        share if share < 40.0 => "departures in some manoeuvres",
        _ => "departures through most of it",
    };
    let formulas = search(bank, &explained.normal, &explained.state, &|_| 0.0);
    let mut follows: Vec<FollowedTerm> = formulas
        .iter()
        .filter(|candidate| candidate.hypothesis.gyros.iter().zip(gyros).all(|(one, other)| !one || other))
        .filter_map(|candidate| {
            let term = candidate.hypothesis.amplitude.formula()?.to_string();
            Some(FollowedTerm { term, score: candidate.gain.chi2 })
        })
        .collect();
    follows.sort_by(|one, other| other.score.total_cmp(&one.score));
    let mut seen = BTreeSet::new();
    follows.retain(|followed| seen.insert(followed.term.clone()));
    follows.truncate(FOLLOWED);
    let shape = format!("{shape}: {share:.0} % of the two-minute averages stand out");
    Unexplained { gyros, interval_s: [at_s(from), at_s((to + 1).min(excess.len()))], shape, follows }
}
