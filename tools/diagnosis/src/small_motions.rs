//! Small motions that contain the noise of the gyros.
//!
//! A controller that uses the counts turns the unit back by the noise of the gyros, and the motion between the rows of a slow
//! reference is taken from the counts. An effect that withholds such a motion explains any noise.

use crate::courses::is_switch;
use crate::measured::{MeasuredData, ModelRun, TIMING, nodes};
use crate::signature_bank::{ConstantSignature, SignatureBank};
use geu_hypothesis::Hypothesis;
use geu_model::Configuration;

/// Largest turn within a block of a motion that answers the counts: several roundings.
const SMALL_COUNTS: f64 = 10.0;

impl SignatureBank {
    /// The signatures of effects that withhold small motions, and of formulas of them, without those along a path.
    #[must_use]
    pub fn without_small_motions(mut self, path: &ModelRun) -> SignatureBank {
        let moves: [Vec<bool>; TIMING] = std::array::from_fn(|gyro| {
            let blocks = self.bases.first().map_or(0, |base| base.series[gyro].len());
            (0..blocks).map(|block| turned(&path[gyro][nodes(block)]) >= SMALL_COUNTS).collect()
        });
        for base in &mut self.bases {
            let formula = base.amplitude.formula();
            if formula.is_none() && !base.amplitude.filters_motion() {
                continue;
            }
            for (gyro, series) in base.series.iter_mut().enumerate().take(TIMING) {
                let is_evidence = |block: usize| match formula {
                    // The first three gyros sense the control axes.
                    Some(formula) => formula.axes().all(|axis| moves[axis][block]),
                    None => moves[gyro][block],
                };
                let (mut sum, mut before) = (0.0, 0.0);
                let of_block = |(block, value): (usize, &f64)| {
                    let change = value - std::mem::replace(&mut before, *value);
                    sum += if is_evidence(block) { change } else { 0.0 };
                    sum
                };
                *series = series.iter().enumerate().map(of_block).collect();
            }
            base.products = Default::default();
        }
        self
    }

    /// The signatures without dead zones up to a rate, and with time courses of others that switch them only: other courses pass through
    /// values of which each has another signature.
    #[must_use]
    pub fn without_zones_up_to(mut self, arcsec_per_s: f64) -> SignatureBank {
        self.unknown_rate_arcsec_per_s = Some(arcsec_per_s);
        self.bases.retain(|base| !base.is_zone() || base.size > arcsec_per_s);
        // Other courses have other products.
        self.bases.iter_mut().filter(|base| base.is_zone()).for_each(|base| base.products = Default::default());
        self
    }

    /// Value up to which an amplitude is not searched.
    pub fn unsearched(&self, base: &ConstantSignature) -> f64 {
        self.unknown_rate_arcsec_per_s.filter(|_| base.is_zone()).unwrap_or(f64::NEG_INFINITY)
    }

    /// False for a dead zone that is not searched, with zones up to a rate left out.
    pub fn searches(&self, hypothesis: &Hypothesis, arcsec_per_s: f64) -> bool {
        let is_zone = |base: &ConstantSignature| base.amplitude == hypothesis.amplitude.constant() && base.is_zone();
        let is_searched = hypothesis.amplitude.kind.is_none_or(is_switch) && hypothesis.value > arcsec_per_s;
        is_searched || !self.bases.iter().any(is_zone)
    }
}

/// Difference of the largest and the smallest of accumulated counts.
fn turned(counts: &[f64]) -> f64 {
    let limits = |(min, max): (f64, f64), angle: &f64| (angle.min(min), angle.max(max));
    let (min, max) = counts.iter().fold((f64::MAX, f64::MIN), limits);
    max - min
}

/// Rate up to which a dead zone is not searched, arcsec/s: that of small motions if these answer the counts or are taken from them. Such a zone
/// withholds the noise of the gyros, and explains it.
pub fn unknown_rate_arcsec_per_s(measured: &MeasuredData, nominal: &Configuration, answers_counts: bool) -> f64 {
    let scale_factors = nominal.gyros.iter().map(|gyro| gyro.calibration.scale_factor);
    let largest = scale_factors.fold(0.0, f64::max);
    if answers_counts || measured.smoothed.is_some() { SMALL_COUNTS / measured.block_s() * largest } else { 0.0 }
}
