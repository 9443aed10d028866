//! The gyro package (Casteren §2, figure 5) and the transfer function (§4, eqs 1–3, figure 7).

use geu_protocol::Gyro;

use crate::attitude::Step;
use crate::effect::{Head, HeadEffects, HeadStates, Surroundings, Tap, Temperatures, Timing};
use crate::number::numbers;
use crate::units::{ARCSEC_PER_RAD, HALF_SECOND_S};

/// Axes of one gyro: unit vectors in the control frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axes {
    /// Input axis.
    pub input_control: [f64; 3],
    /// Output axis.
    pub output_control: [f64; 3],
    /// Spin axis: input × output.
    pub spin_control: [f64; 3],
}

const fn axes(input_control: [f64; 3], output_control: [f64; 3]) -> Axes {
    let ([a, b, c], [x, y, z]) = (input_control, output_control);
    Axes { input_control, output_control, spin_control: [b * z - c * y, c * x - a * z, a * y - b * x] }
}

impl Axes {
    /// The axes of `gyro` (Casteren figure 5).
    pub const fn of(gyro: Gyro) -> &'static Axes {
        const X: [f64; 3] = [1.0, 0.0, 0.0];
        const Y: [f64; 3] = [0.0, 1.0, 0.0];
        const Z: [f64; 3] = [0.0, 0.0, 1.0];
        const AXES: [Axes; 4] = [axes(X, Y), axes(Y, X), axes(Z, Y), axes(Z, X)];
        &AXES[gyro as usize]
    }

    /// Whether a number of that name means something to a gyro with these axes: the projection of the input axis on its
    /// own control axis is unity by definition (Casteren §4).
    pub fn has_number(&self, name: &str) -> bool {
        let own = ["x_arcsec", "y_arcsec", "z_arcsec"].into_iter().zip(self.input_control);
        own.into_iter().all(|(number, part)| part == 0.0 || number != name)
    }
}

numbers! {
    /// The unit's own parameters, which a calibration solves and a recalibration rewrites.
    pub struct Calibration {
        /// SF: arcsec per count.
        scale_factor: 1.0, 0.5..=2.0;
        /// D: arcsec per half second that are sensed and not counted.
        drift_arcsec_per_half_s: 0.0, -10.0..=10.0;
        /// Projection of the input axis on X; 0 for GYRX, whose own axis it is.
        x_arcsec: 0.0, -3600.0..=3600.0;
        /// Projection of the input axis on Y; 0 for GYRY, whose own axis it is.
        y_arcsec: 0.0, -3600.0..=3600.0;
        /// Projection of the input axis on Z; 0 for GYRZA and GYRZB, whose own axis it is.
        z_arcsec: 0.0, -3600.0..=3600.0;
    }
}

/// How the counts of one gyro over a half second came about.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// True rotation about the input axis, arcsec.
    pub true_arcsec: f64,
    /// N with the calibration alone, before the clock's factors.
    pub calibrated_counts: f64,
    /// N after each effect of [`HeadEffects::SPECS`], in order, before the clock's factors.
    pub after_counts: [f64; HeadEffects::SPECS.len()],
    /// N with the clock's factors, before rounding.
    pub counts: f64,
}

impl Tap for Trace {
    fn calibrated(&mut self, true_arcsec: f64, head: &Head) {
        self.true_arcsec += true_arcsec;
        self.calibrated_counts += head.counts();
    }

    fn after(&mut self, index: usize, head: &Head) {
        self.after_counts[index] += head.counts();
    }

    fn closed(&mut self, counts: f64) {
        self.counts += counts;
    }
}

/// One gyro: its axes and what its effects remember.
#[derive(Debug, Clone)]
pub struct GyroHead {
    axes: &'static Axes,
    states: HeadStates,
}

impl GyroHead {
    /// At the start of a run.
    pub fn start(seed: u64, gyro: Gyro) -> GyroHead {
        GyroHead { axes: Axes::of(gyro), states: HeadStates::start(seed, gyro) }
    }

    /// Counts one half second: N = (M Δφ + … − D)/SF over its sub-steps, as a real number.
    #[inline]
    pub fn count(
        &mut self,
        calibration: &Calibration,
        effects: &HeadEffects,
        timing: &Timing,
        temperatures: &Temperatures,
        steps: &[Step],
        tap: &mut impl Tap,
    ) -> f64 {
        let length_s: f64 = steps.iter().map(|step| step.length_s).sum();
        effects.begin(&mut self.states, length_s);
        let mut counts = 0.0;
        let offset = [calibration.x_arcsec, calibration.y_arcsec, calibration.z_arcsec];
        for step in steps {
            let angle = step.angle_control_arcsec;
            let along = dot(self.axes.input_control, angle);
            let mut head = Head {
                input_arcsec: along + dot(offset, angle) / ARCSEC_PER_RAD,
                added_arcsec: 0.0,
                drift_arcsec: calibration.drift_arcsec_per_half_s * (step.length_s / HALF_SECOND_S),
                scale_factor: calibration.scale_factor,
            };
            tap.calibrated(along, &head);
            let surroundings = Surroundings { step, axes: self.axes, temperatures };
            effects.apply(&mut self.states, &mut head, &surroundings, tap);
            let closed = close(&head, timing);
            tap.closed(closed);
            counts += closed;
        }
        counts
    }
}

/// N of equation 1 with the clock's factors (Casteren §3.2): SF falls by the clock's error, D per on-board half second
/// by twice as much in all. The sub-step is already shorter by once the error, so once remains.
#[inline]
fn close(head: &Head, timing: &Timing) -> f64 {
    let drift_arcsec = head.drift_arcsec * (1.0 - timing.clock_error);
    (head.input_arcsec + head.added_arcsec - drift_arcsec) / (head.scale_factor * (1.0 - timing.clock_error))
}

#[inline]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spin_axes_are_those_the_paper_implies() {
        // model.md, "The package": +Z, −Z, −X, +Y.
        let expected = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(Gyro::ALL.map(|gyro| Axes::of(gyro).spin_control), expected);
    }
}
