//! Scores of a filter against the signatures of changes (Willsky and Jones 1976).
//!
//! A change of a state at some instant moves the filter's error by a signature that does not depend on its size. For onsets back to
//! four hours the product of scores and signature is kept; its square over that of the signature is chi-square of one degree of
//! freedom without a change.

use nalgebra::SMatrix;

use crate::filter::{ANGLE, CHANGES, Filter, STATES, Step, Update, carried};

/// Samples between two looks at the statistics: five seconds.
pub const LOOK_SAMPLES: u64 = 10;
/// Samples between onsets: a minute.
const ONSET_SAMPLES: u64 = 120;
/// Onsets older than this, in samples, are dropped: four hours.
pub const OLDEST_SAMPLES: u64 = 28_800;
/// Distance of neighbouring onsets as a share of their age: a signature that starts that much off loses about a tenth.
const SPACING: u64 = 8;

/// Signatures of changes at one instant, and what matches them.
#[derive(Debug, Clone)]
pub struct Onset {
    pub sample: u64,
    /// The filter before the onset.
    pub before: Filter,
    /// Error of the filter's states per unit of each change.
    error: SMatrix<f64, STATES, CHANGES>,
    energy: [f64; CHANGES],
    product: [f64; CHANGES],
}

/// The best match of a change over all onsets.
#[derive(Debug, Clone, Copy, Default)]
pub struct Match {
    /// Chi-square of one degree of freedom.
    pub statistic: f64,
    pub onset: usize,
}

/// The onsets of one filter, the oldest first.
#[derive(Debug, Clone, Default)]
pub struct Bank {
    pub onsets: Vec<Onset>,
}

impl Bank {
    /// Starts an onset before this sample if one is due.
    pub fn begin(&mut self, sample: u64, filter: &Filter) {
        if self.onsets.last().is_none_or(|last| sample >= last.sample + ONSET_SAMPLES) {
            self.thin(sample);
            let (energy, product) = ([0.0; CHANGES], [0.0; CHANGES]);
            self.onsets.push(Onset { sample, before: filter.clone(), error: SMatrix::identity(), energy, product });
        }
    }

    /// Drops onsets that are too old, or close to a kept one for their age.
    fn thin(&mut self, now: u64) {
        let mut kept = None;
        self.onsets.retain(|onset| {
            let is_kept = now.saturating_sub(onset.sample) <= OLDEST_SAMPLES
                && kept.is_none_or(|before| onset.sample - before >= (now - before) / SPACING);
            if is_kept {
                kept = Some(onset.sample);
            }
            is_kept
        });
    }

    /// Adds a step of the filter.
    pub fn push(&mut self, step: &Step, update: Option<&Update>) {
        let coefficients = carried(step);
        for onset in &mut self.onsets {
            for change in 0..CHANGES {
                let mut error = onset.error.column_mut(change);
                let turned: f64 = coefficients.iter().map(|&(from, coefficient)| coefficient * error[from]).sum();
                error[ANGLE] += turned;
                let Some(update) = update else { continue };
                if step.is_new {
                    error[ANGLE] = 0.0;
                }
                if update.information > 0.0 {
                    let signature = update.observed.dot(&error);
                    onset.energy[change] += signature * signature * update.information;
                    onset.product[change] += signature * update.score;
                    error.axpy(-signature * update.information, &update.seen, 1.0);
                }
            }
        }
    }

    /// The best match of each change.
    pub fn matches(&self) -> [Match; CHANGES] {
        let mut matches = [Match::default(); CHANGES];
        for (index, onset) in self.onsets.iter().enumerate() {
            for (change, best) in matches.iter_mut().enumerate() {
                let (energy, product) = (onset.energy[change], onset.product[change]);
                let statistic = if energy > 0.0 { product * product / energy } else { 0.0 };
                if statistic > best.statistic {
                    *best = Match { statistic, onset: index };
                }
            }
        }
        matches
    }

    /// The largest statistic.
    pub fn largest(&self) -> f64 {
        self.matches().iter().map(|best| best.statistic).fold(0.0, f64::max)
    }
}
