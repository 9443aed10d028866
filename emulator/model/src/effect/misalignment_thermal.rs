//! The package turns about Y with the solar aspect angle (Casteren §3.4, §5.3).
//!
//! The turn δ follows k(θ − 90°) with a first-order lag and starts settled. An input axis along X turns by
//! −δ to Z, one along Z by +δ to X, and one along Y senses the turning itself. Between the ends of a sub-step θ is taken as straight, so a scan at
//! constant speed is followed exactly; off-axis terms use δ in the sub-step's middle.

use super::{GyroSubStep, UnitEffect};
use crate::attitude::MotionStep;
use crate::package::ResolvedGyro;
use crate::units::{ARCSEC_PER_RAD, RAD_PER_DEG};

effect! {
    /// Turn of the package about Y with θ.
    pub struct MisalignmentThermal ("misalignment-thermal", "thermal misalignment") {
        /// Settled turn for each degree of θ above 90°.
        arcsec_per_deg: 0.0, -60.0..=60.0, "arcsec/°";
        /// Time constant of the lag.
        time_constant_s: 300.0, 1.0..=1e5, "s", TimeConstant;
    }
    amplitudes: [{ per_day: 60.0, per_k: 60.0 }],
    paper: "tens of arcsec over a Y-scan, lag of its duration",
    source: "Casteren §3.4, §5.3",
}

/// The turn; nothing before the first sub-step.
pub type State = Option<f64>;

impl UnitEffect for MisalignmentThermal {
    type State = State;

    #[inline]
    fn apply(&self, state: &mut State, heads: &mut [GyroSubStep], gyros: &[ResolvedGyro], step: &MotionStep) {
        let settled_arcsec = |theta_rad: f64| self.arcsec_per_deg * (theta_rad / RAD_PER_DEG - 90.0);
        let (from, to) = (settled_arcsec(step.start.theta_rad), settled_arcsec(step.end.theta_rad));
        let before = state.unwrap_or(from);
        if self.arcsec_per_deg == 0.0 && before == 0.0 {
            *state = Some(0.0);
            return;
        }
        if step.length_s == 0.0 {
            return;
        }
        // δ' = (k(θ − 90°) − δ)/τ with a straight right-hand side, solved exactly.
        let lead_arcsec = (to - from) / step.length_s * self.time_constant_s;
        let left = libm::exp(-step.length_s / self.time_constant_s);
        let after = to - lead_arcsec + (before - from + lead_arcsec) * left;
        *state = Some(after);
        let turn_rad = 0.5 * (before + after) / ARCSEC_PER_RAD;
        let [x, _, z] = step.angle_control_arcsec;
        for (head, gyro) in heads.iter_mut().zip(gyros) {
            let [along_x, along_y, along_z] = gyro.head.axes.input_control;
            head.input_arcsec += turn_rad * (along_z * x - along_x * z);
            head.added_arcsec += along_y * (after - before);
        }
    }
}

#[cfg(test)]
mod tests {
    use geu_protocol::Gyro;

    use super::*;
    use crate::attitude::MotionState;
    use crate::device::Device;
    use crate::effect::GyroEffects;
    use crate::package::Calibration;

    #[test]
    fn the_turn_settles_after_a_scan_with_its_time_constant() {
        let law = MisalignmentThermal { arcsec_per_deg: 0.9, time_constant_s: 280.0 };
        let (mut state, mut heads) = (
            None,
            [GyroSubStep {
                input_arcsec: 0.0,
                added_arcsec: 0.0,
                drift_arcsec: 0.0,
                scale_factor: 1.0,
                added_counts: 0.0,
            }; 4],
        );
        let (device, parts) = (Device::iras(), (Calibration::default(), GyroEffects::default()));
        let gyros: Vec<ResolvedGyro> = device
            .heads
            .iter()
            .map(|head| ResolvedGyro { head, calibration: &parts.0, effects: &parts.1, discovered: &[] })
            .collect();
        let mut step = |from_deg: f64, to_deg: f64| {
            let at = |deg: f64| MotionState { theta_rad: deg * RAD_PER_DEG, ..MotionState::default() };
            law.apply(
                &mut state,
                &mut heads,
                &gyros,
                &MotionStep { start: at(from_deg), end: at(to_deg), length_s: 0.1, ..MotionStep::default() },
            );
            heads[Gyro::Y.index()].added_arcsec
        };
        // 60° to 120° in 300 s at 12°/min: GYRY has sensed 0.9·60 arcsec less what lags behind, 0.9·0.2·280·(1 − e^(−300/280)).
        let mut sensed_arcsec = 0.0;
        for index in 0..3000 {
            sensed_arcsec = step(60.0 + 0.02 * f64::from(index), 60.0 + 0.02 * f64::from(index + 1));
        }
        assert!((sensed_arcsec - (54.0 - 50.4 * (1.0 - (-300.0f64 / 280.0).exp()))).abs() < 1e-9);
        for _ in 0..100_000 {
            sensed_arcsec = step(120.0, 120.0);
        }
        assert!((sensed_arcsec - 54.0).abs() < 1e-9);
    }
}
