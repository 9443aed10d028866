//! Description of a residual that is not noise.

use std::collections::BTreeSet;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::Series;
use crate::model_selection::SelectedModel;
use crate::outcome::{FollowedTerm, Unexplained};
use crate::search::search;
use crate::signature_bank::SignatureBank;
use geu_protocol::Gyros;

/// Maximum number of reported terms.
const FOLLOWED: usize = 5;

/// Describes the residual: gyros, interval, correlated terms.
pub fn unexplained(
    case: &DiagnosisCase,
    bank: &SignatureBank,
    explained: &SelectedModel,
    left: &Series,
    gyros: Gyros,
) -> Unexplained {
    const WINDOW: usize = 24;
    // Excess over noise in windows, of the default unit of two minutes.
    let blocks = case.measured.block_count();
    let excess: Vec<f64> = (0..blocks / WINDOW)
        .map(|window| {
            let of_gyro = |gyro: usize| {
                let sum: f64 = left[gyro][window * WINDOW..(window + 1) * WINDOW].iter().sum();
                (sum * sum / WINDOW as f64 - 1.0).max(0.0)
            };
            gyros.gyros().map(|gyro| of_gyro(gyro.index())).sum()
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
    let at_s = |window: usize| (window * WINDOW) as f64 * case.measured.block_s();
    let (from, to) = (reached(0.05).unwrap_or(0), reached(0.95).unwrap_or(excess.len()));
    let held: usize = excess.iter().filter(|excess| **excess > 4.0).count();
    let share = 100.0 * held as f64 / excess.len().max(1) as f64;
    let shape = match share {
        share if share < 5.0 => "a few short departures",
        share if share < 40.0 => "departures in some manoeuvres",
        _ => "departures through most of it",
    };
    let formulas = search(bank, &explained.normal, &explained.state, None);
    let mut follows: Vec<FollowedTerm> = formulas
        .iter()
        .filter(|candidate| candidate.hypothesis.gyros.is_within(&gyros))
        .filter_map(|candidate| {
            let term = candidate.hypothesis.amplitude.formula()?.to_string();
            Some(FollowedTerm { term, score: candidate.gain.chi2 })
        })
        .collect();
    follows.sort_by(|one, other| other.score.total_cmp(&one.score));
    let mut seen = BTreeSet::new();
    follows.retain(|followed| seen.insert(followed.term.clone()));
    follows.truncate(FOLLOWED);
    let window_s = at_s(1);
    let shape = format!("{shape}: {share:.0} % of the averages over {window_s:.0} s stand out");
    Unexplained { gyros, interval_s: [at_s(from), at_s((to + 1).min(excess.len()))], shape, follows }
}
