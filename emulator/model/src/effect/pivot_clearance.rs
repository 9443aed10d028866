//! The float moves in its pivots (Casteren §3.3, figure 6; direction of the creep: §5.1, §5.3).
//!
//! Between its stops, ±clearance/2 about the input axis, the float follows 1 % of the rate about the output axis, in its
//! sign; below 1.5″/s it creeps towards its preferred position at 0.015″/s and rests there. Its motion is sensed.

use super::{EffectInputs, GyroEffect, GyroSubStep};

/// Rate about the output axis below which the float creeps.
const THRESHOLD_ARCSEC_S: f64 = 1.5;
/// Share of the rate about the output axis with which the float moves.
const TRANSIT_SHARE: f64 = 0.01;
/// Speed of the creep.
const CREEP_ARCSEC_S: f64 = 0.015;

effect! {
    /// Freedom of the float in its pivots.
    pub struct PivotClearance ("pivot-clearance", "pivot clearance") {
        /// From stop to stop.
        clearance_arcsec: 0.0, 0.0..=100.0, "arcsec";
        /// Where the float rests; within half the clearance.
        preferred_arcsec: 0.0, -50.0..=50.0, "arcsec", PreferredValue;
    }
    amplitudes: [{ per_day: 100.0, per_k: 100.0 }],
    paper: "less than 14; a full transit at the creep takes 15.6 min",
    source: "Casteren §3.3, figure 6",
    {
        const NEEDS_OUTPUT_AXIS: bool = true;
        /// Without clearance the preferred position means nothing.
        fn consistency_error(&self) -> Option<(&'static str, String)> {
            let stop = 0.5 * self.clearance_arcsec;
            (stop > 0.0 && self.preferred_arcsec.abs() > stop)
                .then(|| ("preferred_arcsec", format!("a number within half the clearance, ±{stop},")))
        }
    }
}

/// The float's angle about the input axis; nothing before the first sub-step.
pub type State = Option<f64>;

impl GyroEffect for PivotClearance {
    type State = State;

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        let stop = 0.5 * self.clearance_arcsec.max(0.0);
        let preferred = self.preferred_arcsec.clamp(-stop, stop);
        let before = state.unwrap_or(preferred);
        let step = surroundings.step;
        if stop == 0.0 && before == 0.0 || step.length_s == 0.0 {
            return;
        }
        let turned_arcsec = surroundings.axes.about_output(step.angle_control_arcsec);
        let after = if turned_arcsec.abs() >= THRESHOLD_ARCSEC_S * step.length_s {
            before + TRANSIT_SHARE * turned_arcsec
        } else {
            let creep = CREEP_ARCSEC_S * step.length_s;
            before + (preferred - before).clamp(-creep, creep)
        };
        let after = after.clamp(-stop, stop);
        *state = Some(after);
        head.added_arcsec += after - before;
    }
}

#[cfg(test)]
mod tests {
    use geu_protocol::Gyro;

    use super::*;
    use crate::attitude::MotionStep;
    use crate::effect::Temperatures;
    use crate::package::Axes;

    const LAW: PivotClearance = PivotClearance { clearance_arcsec: 14.0, preferred_arcsec: 0.0 };
    const TEMPERATURES: Temperatures = Temperatures {
        electronics_c: 20.0,
        electronics_reference_c: 20.0,
        electronics_rate_k_per_h: 0.0,
        sensor_c: 70.0,
    };

    /// Float of GYRX after `seconds` at a constant rate about Y, its output axis.
    fn after(float: f64, rate_arcsec_s: f64, seconds: f64) -> f64 {
        let (mut state, mut sensed) = (Some(float), 0.0);
        for _ in 0..(seconds * 10.0).round() as usize {
            let step = MotionStep {
                length_s: 0.1,
                angle_control_arcsec: [0.0, rate_arcsec_s * 0.1, 0.0],
                ..MotionStep::default()
            };
            let surroundings = EffectInputs {
                step: &step,
                axes: Axes::of(Gyro::X),
                temperatures: &TEMPERATURES,
                end_s: 0.0,
                full_scale_arcsec_s: 720.0,
            };
            let mut head = GyroSubStep {
                input_arcsec: 0.0,
                added_arcsec: 0.0,
                drift_arcsec: 0.0,
                scale_factor: 1.0,
                added_counts: 0.0,
            };
            LAW.apply(&mut state, &mut head, &surroundings);
            sensed += head.added_arcsec;
        }
        let reached = state.unwrap_or(float);
        assert!((reached - float - sensed).abs() < 1e-9, "what moves is sensed");
        reached
    }

    #[test]
    fn a_scan_drives_the_float_to_its_stop_at_one_percent() {
        assert!((after(0.0, 500.0, 1.0) - 5.0).abs() < 1e-9);
        assert_eq!(after(0.0, 500.0, 100.0), 7.0);
        assert_eq!(after(7.0, -500.0, 100.0), -7.0);
    }

    #[test]
    fn below_the_threshold_it_creeps_home_and_rests() {
        // 14″ at 0.015″/s is 933 s, 15.6 min; 7″ is half of that.
        assert!(after(7.0, 1.4, 460.0) > 0.05);
        assert!(after(7.0, 1.4, 468.0).abs() < 1e-9);
        assert!(after(-7.0, -1.4, 900.0).abs() < 1e-9);
    }
}
