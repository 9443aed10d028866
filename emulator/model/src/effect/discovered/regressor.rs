//! What a formula can be made of.

use crate::effect::EffectInputs;
use crate::temperature::SENSOR_NOMINAL_C;
use crate::units::{RAD_PER_DEG, S_PER_DAY};

/// A quantity that a term can follow, by its place in the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Regressor(usize);

struct Entry {
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    value: fn(&EffectInputs) -> f64,
}

/// The table. The rates come first, then their magnitudes and the accelerations in the same order.
const TABLE: [Entry; 13] = [
    Entry { name: "rate_x", unit: "arcsec/s", meaning: "mean rate about the X control axis", value: |s| rate(s, 0) },
    Entry { name: "rate_y", unit: "arcsec/s", meaning: "mean rate about the Y control axis", value: |s| rate(s, 1) },
    Entry { name: "rate_z", unit: "arcsec/s", meaning: "mean rate about the Z control axis", value: |s| rate(s, 2) },
    Entry { name: "abs(rate_x)", unit: "arcsec/s", meaning: "magnitude of rate_x", value: |s| rate(s, 0).abs() },
    Entry { name: "abs(rate_y)", unit: "arcsec/s", meaning: "magnitude of rate_y", value: |s| rate(s, 1).abs() },
    Entry { name: "abs(rate_z)", unit: "arcsec/s", meaning: "magnitude of rate_z", value: |s| rate(s, 2).abs() },
    Entry { name: "acceleration_x", unit: "arcsec/s^2", meaning: "change of rate_x", value: |s| acceleration(s, 0) },
    Entry { name: "acceleration_y", unit: "arcsec/s^2", meaning: "change of rate_y", value: |s| acceleration(s, 1) },
    Entry { name: "acceleration_z", unit: "arcsec/s^2", meaning: "change of rate_z", value: |s| acceleration(s, 2) },
    Entry {
        name: "temperature",
        unit: "K",
        meaning: "electronics temperature above its reference",
        value: |s| s.temperatures.electronics_c - s.temperatures.electronics_reference_c,
    },
    Entry {
        name: "sensor_temperature",
        unit: "K",
        meaning: "sensor temperature above 70 °C",
        value: |s| s.temperatures.sensor_c - SENSOR_NOMINAL_C,
    },
    Entry {
        name: "theta",
        unit: "deg",
        meaning: "solar aspect angle less 90°",
        value: |s| 0.5 * (s.step.start.theta_rad + s.step.end.theta_rad) / RAD_PER_DEG - 90.0,
    },
    Entry {
        name: "time",
        unit: "d",
        meaning: "days since the start of the run",
        value: |s| (s.end_s - 0.5 * s.step.length_s) / S_PER_DAY,
    },
];

#[inline]
fn rate(surroundings: &EffectInputs, axis: usize) -> f64 {
    surroundings.step.angle_control_arcsec[axis] / surroundings.step.length_s
}

#[inline]
fn acceleration(surroundings: &EffectInputs, axis: usize) -> f64 {
    let step = surroundings.step;
    (step.end.rate_control_arcsec_s[axis] - step.start.rate_control_arcsec_s[axis]) / step.length_s
}

impl Regressor {
    /// Number of regressors.
    pub const COUNT: usize = TABLE.len();

    /// All of them, in the order of a formula's factors.
    pub const ALL: [Regressor; Regressor::COUNT] = {
        let mut all = [Regressor(0); Regressor::COUNT];
        let mut index = 0;
        while index < Regressor::COUNT {
            all[index] = Regressor(index);
            index += 1;
        }
        all
    };

    /// The regressor of that name.
    pub fn from_name(name: &str) -> Option<Regressor> {
        Regressor::ALL.into_iter().find(|regressor| regressor.name() == name)
    }

    /// Name in a formula.
    pub fn name(self) -> &'static str {
        TABLE[self.0].name
    }

    pub fn unit(self) -> &'static str {
        TABLE[self.0].unit
    }

    /// A few words.
    pub fn meaning(self) -> &'static str {
        TABLE[self.0].meaning
    }

    /// Value over a sub-step with a length.
    #[inline]
    pub fn value(self, surroundings: &EffectInputs) -> f64 {
        (TABLE[self.0].value)(surroundings)
    }

    /// Control axis of a rate, its magnitude or an acceleration; `None` if it is no motion.
    pub fn axis(self) -> Option<usize> {
        (self.0 < MOTIONS).then_some(self.0 % 3)
    }

    /// Index in [`Regressor::ALL`].
    pub fn index(self) -> usize {
        self.0
    }
}

/// Number of rates, magnitudes and accelerations.
const MOTIONS: usize = 9;
/// Places in [`Regressor::ALL`] of each rate and its magnitude.
pub(super) const MAGNITUDES: [(usize, usize); 3] = [(0, 3), (1, 4), (2, 5)];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{MotionState, MotionStep};
    use crate::effect::Temperatures;
    use crate::package::Axes;
    use geu_protocol::Gyro;

    #[test]
    fn every_regressor_has_the_value_worked_out_by_hand() {
        let moment = |rate_control_arcsec_s, theta_deg: f64| MotionState {
            rate_control_arcsec_s,
            theta_rad: theta_deg * RAD_PER_DEG,
            ..MotionState::default()
        };
        let step = MotionStep {
            start: moment([4.0, -9.0, 100.0], 79.0),
            end: moment([6.0, -9.5, 100.0], 81.0),
            length_s: 0.25,
            angle_control_arcsec: [1.25, -2.5, 25.0],
        };
        let temperatures = Temperatures {
            electronics_c: 21.5,
            electronics_reference_c: 20.0,
            electronics_rate_k_per_h: 0.0,
            sensor_c: 67.0,
        };
        // The middle of the sub-step is 43 200 s: half a day.
        let surroundings = EffectInputs {
            step: &step,
            axes: Axes::of(Gyro::X),
            temperatures: &temperatures,
            end_s: 43_200.125,
            full_scale_arcsec_s: 720.0,
        };
        for (name, expected) in [
            ("rate_x", 5.0),
            ("rate_y", -10.0),
            ("rate_z", 100.0),
            ("abs(rate_x)", 5.0),
            ("abs(rate_y)", 10.0),
            ("abs(rate_z)", 100.0),
            ("acceleration_x", 8.0),
            ("acceleration_y", -2.0),
            ("acceleration_z", 0.0),
            ("temperature", 1.5),
            ("sensor_temperature", -3.0),
            ("theta", -10.0),
            ("time", 0.5),
        ] {
            let regressor = Regressor::from_name(name).expect(name);
            assert!((regressor.value(&surroundings) - expected).abs() < 1e-12, "{name}");
        }
    }

    #[test]
    fn a_magnitude_stands_beside_its_own_rate() {
        for (rate, magnitude) in MAGNITUDES {
            assert_eq!(format!("abs({})", TABLE[rate].name), TABLE[magnitude].name);
        }
    }
}
