//! A slow rate is not sensed: lock-in of a laser gyro (IEEE Std 647), dead band of any other (IEEE Std 528).
//!
//! The rate is linear over a sub-step: a limit cycle enters and leaves the zone within sub-steps.

use super::{EffectInputs, GyroEffect, GyroSubStep};

effect! {
    /// A band about zero in which no rate is sensed.
    pub struct DeadZone ("dead-zone", "dead zone") {
        /// A smaller rate about the input axis is not sensed, a larger one whole.
        arcsec_per_s: 0.0, 0.0..=1000.0, "arcsec/s";
    }
    amplitudes: [{ per_day: 1000.0, per_k: 1000.0 }],
    paper: "0",
    source: "IEEE Std 528, 647",
    {
        const FILTERS_MOTION: bool = true;
    }
}

impl GyroEffect for DeadZone {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let step = surroundings.step;
        if self.arcsec_per_s == 0.0 || step.length_s == 0.0 {
            return;
        }
        let rate = |control: [f64; 3]| surroundings.axes.about_input(control);
        let change_arcsec_s = rate(step.end.rate_control_arcsec_s) - rate(step.start.rate_control_arcsec_s);
        let mean_arcsec_s = (head.input_arcsec + head.added_arcsec) / step.length_s;
        head.added_arcsec -= step.length_s * unsensed_rate(self.arcsec_per_s, mean_arcsec_s, change_arcsec_s);
    }
}

/// Mean over a step of the rate while it is in the zone; the rate grows linearly by `change` about `mean`.
fn unsensed_rate(zone: f64, mean: f64, change: f64) -> f64 {
    if mean.abs() + 0.5 * change.abs() < zone {
        return mean;
    }
    if change == 0.0 || mean.abs() - 0.5 * change.abs() >= zone {
        return 0.0;
    }
    // Shares of the step at which the rate passes the two limits of the zone.
    let at = |limit: f64| (0.5 + (limit - mean) / change).clamp(0.0, 1.0);
    let (from, to) = (at(-zone.copysign(change)), at(zone.copysign(change)));
    (to - from) * (mean + change * (0.5 * (from + to) - 0.5))
}
