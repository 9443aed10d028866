//! Small motions that contain the noise of the gyros.
//!
//! A controller that uses the counts turns the unit back by the noise of the gyros, and the motion between the rows of a slow
//! reference is taken from the counts. An effect that withholds such a motion explains any noise.

use crate::courses::is_switch;
use crate::measured::{CHANNELS, MeasuredData, ModelRun, TIMING, nodes};
use crate::signature_bank::{ConstantSignature, SignatureBank};
use crate::significance::MEDIAN_OF_NORMAL;
use crate::whitening::NoiseModel;
use geu_checks::median;
use geu_hypothesis::Hypothesis;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::device::Device;
use geu_model::parameter_spec::MISALIGNMENTS;
use geu_protocol::Gyros;

/// Largest turn within a block of a motion that answers the counts: several roundings.
pub const SMALL_COUNTS: f64 = 10.0;
/// Largest turn of a motion that contains the noise of described gyros or of the reference, in standard deviations of that over a block.
const SMALL_SIGMAS: f64 = 10.0;

/// Turn of each gyro within a block up to which a motion is small, arcsec.
pub fn small_arcsec(measured: &MeasuredData, device: &Device, noise: &[NoiseModel; CHANNELS]) -> [f64; TIMING] {
    let of_gyro = |own: &NoiseModel| match device.is_iras() {
        true => SMALL_COUNTS,
        false => SMALL_SIGMAS * (own.white + own.angle_walk.powi(2) * measured.block_s()).sqrt(),
    };
    std::array::from_fn(|gyro| of_gyro(&noise[gyro]))
}

impl SignatureBank {
    /// The signatures of effects that withhold small motions, and of formulas of them, without those along a path.
    #[must_use]
    pub fn without_small_motions(
        mut self,
        measured: &MeasuredData,
        path: &ModelRun,
        small_arcsec: &[f64; TIMING],
    ) -> SignatureBank {
        let moves: [Vec<bool>; TIMING] = std::array::from_fn(|gyro| {
            let blocks = self.bases.first().map_or(0, |base| base.series[gyro].len());
            (0..blocks).map(|block| turned(&path[gyro][nodes(block)]) >= small_arcsec[gyro]).collect()
        });
        let is_described = self.gyros().unit() != Gyros::ALL;
        let largest = small_arcsec.iter().take(self.gyros().heads()).copied().fold(0.0, f64::max);
        let about_axes = blocks_of_axes(measured, path, largest);
        for base in &mut self.bases {
            let formula = base.amplitude.formula();
            let projection = MISALIGNMENTS.iter().position(|name| *name == base.amplitude.number().name);
            // What is in proportion to the motion explains the noise of a reference where the unit rests.
            let unit = base.amplitude.number().unit;
            let follows_noise = is_described && (projection.is_some() || unit.starts_with("ppm") || unit == "s");
            if formula.is_none() && !base.amplitude.filters_motion() && !follows_noise {
                continue;
            }
            for (gyro, series) in base.series.iter_mut().enumerate().take(TIMING) {
                let is_evidence = |block: usize| match (formula, projection.filter(|_| is_described)) {
                    (Some(formula), _) => formula.axes().all(|axis| about_axes[axis][block]),
                    (None, Some(axis)) => about_axes[axis][block],
                    (None, None) => moves[gyro][block],
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

    /// The signatures without effects that withhold motions.
    #[must_use]
    pub fn without_filters_of_motion(mut self) -> SignatureBank {
        self.bases.retain(|base| !base.amplitude.filters_motion());
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

/// Blocks in which the unit turns about each control axis by this or more.
pub fn blocks_of_axes(measured: &MeasuredData, path: &ModelRun, small_arcsec: f64) -> [Vec<bool>; 3] {
    let mut near = 0;
    let mut angles: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(measured.samples + 1));
    for node in 0..=measured.samples {
        let (angle, _) = measured.reference.at(node as f64 * measured.interval_s(), &mut near);
        angles.iter_mut().zip(angle).for_each(|(own, angle)| own.push(angle));
    }
    std::array::from_fn(|axis| {
        // The first three gyros of the default unit sense the control axes.
        let own = if measured.gyros().unit() == Gyros::ALL { &path[axis] } else { &angles[axis] };
        (0..measured.block_count()).map(|block| turned(&own[nodes(block)]) >= small_arcsec).collect()
    })
}

/// Difference of the largest and the smallest of accumulated counts.
fn turned(counts: &[f64]) -> f64 {
    let limits = |(min, max): (f64, f64), angle: &f64| (angle.min(min), angle.max(max));
    let (min, max) = counts.iter().fold((f64::MAX, f64::MIN), limits);
    max - min
}

/// True for a described unit beside a reference of noise, even or uneven: an effect that withholds motions withholds the errors of the reference as well, which may
/// be as large as any motion.
pub fn has_noisy_motion(measured: &MeasuredData, nominal: &Configuration) -> bool {
    (measured.smoothed.is_some() || measured.noise_scale.is_some()) && !nominal.device.is_iras()
}

/// Noise of the rates from row to row of a reference, arcsec/s, of the axis with the largest: by the median of their second differences, of
/// white noise √10 times as large, in which smooth motion has little part.
fn rate_noise(reference: &RecordedAttitude) -> f64 {
    let (times_s, angles): (Vec<f64>, Vec<[f64; 3]>) = reference.rows().unzip();
    let of_axis = |axis: usize| {
        let rate = |row: usize| (angles[row + 1][axis] - angles[row][axis]) / (times_s[row + 1] - times_s[row]);
        let difference = |row: usize| (rate(row) - 2.0 * rate(row + 1) + rate(row + 2)).abs();
        let mut differences: Vec<f64> = (0..times_s.len().saturating_sub(3)).map(difference).collect();
        median(&mut differences) / (MEDIAN_OF_NORMAL * 10f64.sqrt())
    };
    (0..3).map(of_axis).fold(0.0, f64::max)
}

/// Rate up to which a dead zone is not searched, arcsec/s: that of small motions if these answer the counts or are taken from them. Such a zone
/// withholds the noise of the gyros, and explains it.
pub fn unknown_rate_arcsec_per_s(
    measured: &MeasuredData,
    nominal: &Configuration,
    answers_counts: bool,
    small_arcsec: &[f64; TIMING],
) -> f64 {
    let scale_factors = nominal.gyros.iter().map(|gyro| gyro.calibration.scale_factor);
    let largest = scale_factors.fold(0.0, f64::max);
    if has_noisy_motion(measured, nominal) {
        f64::INFINITY
    } else if answers_counts || measured.smoothed.is_some() {
        let of_blocks = small_arcsec.iter().take(measured.gyros().heads()).copied().fold(0.0, f64::max);
        let of_rows = if nominal.device.is_iras() { 0.0 } else { SMALL_SIGMAS * rate_noise(&measured.reference) };
        (of_blocks / measured.block_s()).max(of_rows) * largest
    } else {
        0.0
    }
}
