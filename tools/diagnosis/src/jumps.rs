//! Jumps of an angle in the samples of a gyro.
//!
//! Counts are lost in one sample, which differs from those beside it. A reference by cameras jumps too, where other markers come into view:
//! the residual shows the same jump, the samples of the gyro do not.

use geu_checks::median;
use geu_hypothesis::Hypothesis;
use geu_model::parameter_spec::Role;

use crate::measured::{BLOCK, MeasuredData};
use crate::significance::{MEDIAN_OF_NORMAL, THREE_SIGMAS};

/// Nodes to either side of an onset: it is known to a block.
const REACH: usize = 2 * BLOCK;

impl MeasuredData {
    /// True if counts of that value at that time would change a sample of a gyro by more than motion and noise do, and none is changed.
    pub fn contradicts(&self, lost: &Hypothesis) -> bool {
        let onset = lost.parameters().iter().find(|own| own.role == Role::Onset).map(|own| own.value);
        let Some(onset_s) = onset.filter(|_| lost.amplitude.is_count()) else { return false };
        let node = (onset_s / self.interval_s()) as usize;
        let changes = |gyro: usize| -> Vec<f64> {
            let sums = &self.counts.accumulated[gyro];
            let own = &sums[node.saturating_sub(REACH).min(sums.len())..(node + REACH).min(sums.len())];
            own.windows(4).map(|sums| sums[2] - sums[1] - 0.5 * (sums[1] - sums[0] + sums[3] - sums[2])).collect()
        };
        (0..self.gyros().heads()).filter(|&gyro| lost.gyros[gyro]).any(|gyro| {
            let mut sizes: Vec<f64> = changes(gyro).into_iter().map(f64::abs).collect();
            let largest = sizes.iter().copied().fold(0.0, f64::max);
            let sigma = median(&mut sizes) / MEDIAN_OF_NORMAL;
            // Three sigma from none to half of it, and from there to the whole.
            let half = 0.5 * lost.value.abs();
            !sizes.is_empty() && largest < half && THREE_SIGMAS * sigma < half
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use geu_calibration::AccumulatedCounts;
    use geu_hypothesis::amplitude::AmplitudeRef;
    use geu_model::Configuration;
    use geu_model::attitude::{AttitudeRow, RecordedAttitude};
    use geu_recording::ReferenceAttitude;

    #[test]
    fn lost_counts_need_a_sample_that_differs_from_those_beside_it() {
        let row = |node: usize| AttitudeRow {
            t_s: node as f64 * 0.5,
            angle_control_arcsec: [0.0; 3],
            theta_psi_rad: Some((1.5, 0.0)),
        };
        let truth = RecordedAttitude::new((0..=3000).map(row).collect()).expect("a truth");
        let mut counts = AccumulatedCounts::starting_at(0);
        // Half a count of rounding, and 40 counts in the sample that ends at 500 s on the first gyro alone.
        for node in 1..=2400 {
            let rounding = f64::from(u8::from(node % 3 == 0));
            let lost = if node == 1000 { 40.0 } else { 0.0 };
            counts.push(node as f64 * 0.5, &[rounding + lost, rounding, 0.0, 0.0], 20.0);
        }
        let reference = ReferenceAttitude::of_truth(0, truth);
        let measured = MeasuredData::new(counts, &reference, &Configuration::reference()).expect("long enough");
        let all = AmplitudeRef::all(&Configuration::reference().device);
        let amplitude = all.into_iter().find(|own| own.is_count() && own.kind.is_none()).expect("lost counts");
        let lost = |gyro: usize, counts: f64| {
            let constant = Hypothesis::constant(amplitude, counts, measured.gyros().only(gyro));
            let lost = Hypothesis { own_shapes: vec![499.8], ..constant };
            measured.contradicts(&lost)
        };
        assert!(!lost(0, 40.0) && lost(1, 40.0) && !lost(1, 2.0));
    }
}
