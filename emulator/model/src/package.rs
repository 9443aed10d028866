//! The gyro package (Casteren §2, figure 5) and the transfer function (§4, eqs 1–3, figure 7).

use geu_protocol::Gyro;

use crate::attitude::MotionStep;
use crate::device::{Head, MAX_HEADS};
use crate::effect::discovered::{self, Term};
use crate::effect::{
    CALIBRATION_COLUMN, COLUMNS, DISCOVERED_COLUMN, EffectInputs, GyroEffects, GyroSubStep, HeadStates, Probe,
    SampleTiming, Temperatures, UNIT_COLUMNS, UnitEffects, UnitStates,
};
use crate::parameter_spec::{MISALIGNMENTS, numbers};
use crate::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};

/// Axes of one gyro: unit vectors in the control frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axes {
    pub input_control: [f64; 3],
    pub output_control: [f64; 3],
    pub spin_control: [f64; 3],
}

impl Axes {
    /// Axes with these input and output axes; the output axis is 0 in a gyro that has none, and with it the spin axis.
    pub const fn new(input_control: [f64; 3], output_control: [f64; 3]) -> Axes {
        Axes { input_control, output_control, spin_control: cross(input_control, output_control) }
    }

    /// The output axis of a gyro that has one.
    pub fn output(&self) -> Option<[f64; 3]> {
        (self.output_control != [0.0; 3]).then_some(self.output_control)
    }

    /// The part of a vector of the control frame about the input axis.
    #[inline]
    pub fn about_input(&self, control: [f64; 3]) -> f64 {
        dot(self.input_control, control)
    }

    /// The part about the output axis.
    #[inline]
    pub fn about_output(&self, control: [f64; 3]) -> f64 {
        dot(self.output_control, control)
    }

    /// The part about the spin axis.
    #[inline]
    pub fn about_spin(&self, control: [f64; 3]) -> f64 {
        dot(self.spin_control, control)
    }

    /// The axes of `gyro` of the default unit (Casteren figure 5).
    pub const fn of(gyro: Gyro) -> &'static Axes {
        const X: [f64; 3] = [1.0, 0.0, 0.0];
        const Y: [f64; 3] = [0.0, 1.0, 0.0];
        const Z: [f64; 3] = [0.0, 0.0, 1.0];
        const AXES: [Axes; 4] = [Axes::new(X, Y), Axes::new(Y, X), Axes::new(Z, Y), Axes::new(Z, X)];
        &AXES[gyro.index()]
    }

    /// True if a gyro with these axes has a number of that name: the projection of the input axis on its
    /// own control axis is unity by definition (Casteren §4).
    pub fn has_number(&self, name: &str) -> bool {
        let own = MISALIGNMENTS.into_iter().zip(self.input_control);
        own.into_iter().all(|(number, part)| part.abs() < 1.0 || number != name)
    }
}

numbers! {
    /// The unit's own parameters, which a calibration solves and a recalibration rewrites.
    pub struct Calibration {
        /// SF: arcsec per count.
        scale_factor: 1.0, 0.5..=2.0, "arcsec/count";
        /// D: arcsec per sample interval that are sensed and not counted.
        drift_arcsec_per_half_s: 0.0, -10.0..=10.0, "arcsec/sample";
        /// Projection of the input axis on X; 0 for GYRX, whose own axis it is.
        x_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
        /// Projection of the input axis on Y; 0 for GYRY, whose own axis it is.
        y_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
        /// Projection of the input axis on Z; 0 for GYRZA and GYRZB, whose own axis it is.
        z_arcsec: 0.0, -3600.0..=3600.0, "arcsec";
    }
}

/// Contributions to the count of one gyro over a sample interval: the true angle and all changes add up to `unquantised`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Trace {
    /// True rotation about the input axis, arcsec.
    pub true_arcsec: f64,
    /// Change by each column of [`crate::effect::columns`], counts.
    pub changes: [f64; COLUMNS],
    /// The count before rounding.
    pub unquantised: f64,
    /// N of the running sub-step after the last column.
    now: f64,
}

impl Probe for Trace {
    const LOOKS: bool = true;

    fn begin(&mut self, true_arcsec: f64) {
        self.true_arcsec += true_arcsec;
        self.unquantised += true_arcsec;
        self.now = true_arcsec;
    }

    fn after(&mut self, column: usize, counts: f64) {
        self.changed(column, counts - self.now);
        self.now = counts;
    }

    fn changed(&mut self, column: usize, counts: f64) {
        self.changes[column] += counts;
        self.unquantised += counts;
    }
}

/// One gyro of the package as it stands over a sample interval.
#[derive(Clone, Copy)]
pub struct ResolvedGyro<'a> {
    pub head: &'a Head,
    pub calibration: &'a Calibration,
    pub effects: &'a GyroEffects,
    pub discovered: &'a [Term],
}

/// The gyros: what their effects and the unit's remember.
#[derive(Debug, Clone)]
pub struct Package {
    heads: Vec<HeadStates>,
    unit: UnitStates,
}

#[derive(Debug, Clone, Copy, Default)]
pub struct SubStep {
    pub counted: MotionStep,
    /// True time since the start of the run at its end.
    pub end_s: f64,
}

impl Package {
    /// At the start of a run.
    pub fn start(seed: u64, gyros: impl Iterator<Item = Gyro>) -> Package {
        Package { heads: gyros.map(|gyro| HeadStates::start(seed, gyro)).collect(), unit: UnitStates::default() }
    }

    /// Counts one sample: N = (M Δφ + … − D)/SF over its sub-steps, as real numbers.
    /// `truths` is the true motion of each sub-step, where it is not what is counted and a tap looks.
    #[inline]
    pub fn count<T: Probe>(
        &mut self,
        gyros: &[ResolvedGyro],
        unit: &UnitEffects,
        temperatures: &Temperatures,
        steps: &[SubStep],
        truths: &[MotionStep],
        taps: &mut [T],
    ) -> [f64; MAX_HEADS] {
        let length_s: f64 = steps.iter().map(|step| step.counted.length_s).sum();
        for (gyro, states) in gyros.iter().zip(&mut self.heads) {
            gyro.effects.begin(states, temperatures, length_s);
        }
        let timings = unit.timing();
        let timing = unit.shared_timing();
        let mut counts = [0.0; MAX_HEADS];
        let mut heads = [GyroSubStep::default(); MAX_HEADS];
        let heads = &mut heads[..gyros.len()];
        for (index, sub_step) in steps.iter().enumerate() {
            let step = &sub_step.counted;
            for (head, gyro) in heads.iter_mut().zip(gyros) {
                *head = calibrated(gyro.head, gyro.calibration, step.angle_control_arcsec, step.length_s);
            }
            if T::LOOKS {
                look_at_start(taps, heads, gyros, &timings, [truths.get(index).unwrap_or(step), step]);
            }
            unit.apply(&mut self.unit, heads, gyros, step, taps);
            for (index, (head, gyro)) in heads.iter_mut().zip(gyros).enumerate() {
                let surroundings = EffectInputs::new(sub_step, gyro.head, temperatures);
                let tap = &mut taps[index];
                if !gyro.discovered.is_empty() {
                    discovered::apply(gyro.discovered, head, &surroundings);
                    if T::LOOKS {
                        tap.after(DISCOVERED_COLUMN, head.counts(&SampleTiming::default()));
                    }
                }
                gyro.effects.apply(&mut self.heads[index], head, &surroundings, tap);
                counts[index] += head.counts(&timing);
                if T::LOOKS {
                    for (column, timing) in timings.iter().enumerate() {
                        tap.after(UNIT_COLUMNS + column, head.counts(timing));
                    }
                }
            }
        }
        counts
    }
}

/// The head with its calibration alone.
#[inline]
pub(crate) fn calibrated(head: &Head, calibration: &Calibration, angle: [f64; 3], length_s: f64) -> GyroSubStep {
    let offset = [calibration.x_arcsec, calibration.y_arcsec, calibration.z_arcsec];
    GyroSubStep {
        input_arcsec: head.axes.about_input(angle) + dot(offset, angle) / ARCSEC_PER_RAD,
        added_arcsec: 0.0,
        drift_arcsec: calibration.drift_arcsec_per_half_s * (length_s / SAMPLE_INTERVAL_S),
        scale_factor: calibration.scale_factor * head.count_arcsec,
        added_counts: 0.0,
    }
}

/// The true angle, then the motion of another time where an effect shifted it, then the calibration.
fn look_at_start<T: Probe>(
    taps: &mut [T],
    heads: &[GyroSubStep],
    gyros: &[ResolvedGyro],
    timings: &[SampleTiming; UnitEffects::SPECS.len()],
    [truth, counted]: [&MotionStep; 2],
) {
    for ((tap, head), gyro) in taps.iter_mut().zip(heads).zip(gyros) {
        let axes = &gyro.head.axes;
        tap.begin(axes.about_input(truth.angle_control_arcsec));
        if let Some(column) = timings.iter().position(|timing| timing.shift_s != 0.0) {
            tap.after(UNIT_COLUMNS + column, axes.about_input(counted.angle_control_arcsec));
        }
        tap.after(CALIBRATION_COLUMN, head.counts(&SampleTiming::default()));
    }
}

/// Scalar product.
#[inline]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub const fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spin_axes_are_those_the_paper_implies() {
        // +Z, −Z, −X, +Y.
        let expected = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(Gyro::ALL.map(|gyro| Axes::of(gyro).spin_control), expected);
    }
}
