//! An independent model: a second implementation of the model's page, made from the page alone. It shares no code with the
//! model or the protocol, so that an agreement of the two confirms the reading of the page.
//!
//! It simulates motions of the reference unit with the errors of a two-week-old calibration and injected effects, and
//! writes the recording of a bench: a CAN capture and the attitude of a better sensor.

mod device;
mod injected;
mod motion;
mod noise;
mod product;
mod reference;
mod unit;
mod wire;

pub use device::{
    Case, DeviceEffect, DeviceMotionKind, DevicePlant, DeviceRecording, DeviceReference, DeviceUnit, HeadTruth, Mix,
    Output, Wire,
};
pub use injected::PlantedEffect;
pub use motion::MotionKind;
pub use reference::ReferenceKind;

use motion::Motion;
use noise::Noise;
use unit::Unit;

/// Step of every integral, by its middle. An accumulated angle is right to 0.01″: the limit cycle's middle misses
/// 0.0002″, and a corner of the rate's profile inside a step 36″/s² × (0.025 s)²/8.
const STEP_S: f64 = 0.025;
const STEPS: usize = 20;
const SAMPLE_INTERVAL_S: f64 = 0.5;
/// Stream of the reference's noise, after the four of the gyros.
const REFERENCE_STREAM: u64 = 7;

/// GYRX, GYRY, GYRZA, GYRZB, in the order of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gyro {
    /// About +X.
    X,
    /// About +Y.
    Y,
    /// About +Z.
    Za,
    /// About +Z, too.
    Zb,
}

/// All four.
pub const GYROS: [Gyro; 4] = [Gyro::X, Gyro::Y, Gyro::Za, Gyro::Zb];

impl Gyro {
    /// Name on the link and in a configuration.
    pub fn name(self) -> &'static str {
        ["GYRX", "GYRY", "GYRZA", "GYRZB"][self as usize]
    }
}

/// Calibration parameters of one gyro.
#[derive(Debug, Clone, Copy)]
pub struct Calibration {
    /// SF, arcsec for a count.
    pub scale_factor: f64,
    /// D.
    pub drift_arcsec_per_half_s: f64,
    /// On X, Y and Z; 0 on the gyro's own axis.
    pub misalignment_arcsec: [f64; 3],
}

/// A scenario and noises from a seed, and injected effects.
#[derive(Debug, Clone)]
pub struct IndependentModel {
    /// Seed of the scenario, the calibration's errors and the noises; each draws from a stream of its own.
    pub seed: u64,
    /// On-board time.
    pub duration_s: f64,
    /// The start of the first sample interval.
    pub start_unix_s: u64,
    /// Time at which the sensor heater is switched off, if at all.
    pub heater_off_s: Option<f64>,
    /// Motion of the spacecraft or table.
    pub motion: MotionKind,
    /// Reference.
    pub reference: ReferenceKind,
    /// Effects that the reference unit does not have.
    pub effects: Vec<PlantedEffect>,
}

/// The recording of a bench, and the true calibration.
#[derive(Debug, Clone)]
pub struct Recording {
    /// `link.log`: a capture as `candump -l` writes it.
    pub link: String,
    /// `reference.csv`.
    pub reference: String,
    /// True values of the unit.
    pub calibrations: [Calibration; 4],
}

impl IndependentModel {
    /// Three hours.
    pub fn new(seed: u64, effects: Vec<PlantedEffect>) -> IndependentModel {
        IndependentModel {
            seed,
            duration_s: 10_800.0,
            start_unix_s: 1_795_000_000,
            heater_off_s: None,
            motion: MotionKind::Survey,
            reference: ReferenceKind::Rates,
            effects,
        }
    }

    /// Simulates the recording.
    ///
    /// # Panics
    /// On an unknown effect.
    pub fn record(&self) -> Recording {
        let mut motion = Motion::drawn(self.motion, &mut Noise::new(self.seed, 0), self.duration_s);
        let mut unit = Unit::new(self);
        let mut jitter = Noise::new(self.seed, 1);
        let (mut link, mut end_s) = (String::new(), 0.0);
        for sequence in 0..(self.duration_s / SAMPLE_INTERVAL_S).round() as u32 {
            let sample = unit.sample(&motion, end_s);
            end_s += sample.length_s;
            motion.answer(end_s, sample.counts);
            // Receive stamps lag by 0.9 ms, with a jitter of 0.15 ms.
            let received_s = end_s + 0.9e-3 + 0.15e-3 * jitter.normal();
            wire::frames(&mut link, self.start_unix_s, received_s, sequence, &sample);
        }
        // A second more, for readers of truth ahead of the counts.
        let noise = Noise::new(self.seed, REFERENCE_STREAM);
        let reference = reference::reference(self.reference, &motion, noise, self.start_unix_s, end_s + 1.0);
        Recording { link, reference, calibrations: unit.calibrations }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn simulated(seed: u64, effects: &[PlantedEffect]) -> Recording {
        IndependentModel { duration_s: 3000.0, ..IndependentModel::new(seed, effects.to_vec()) }.record()
    }

    /// The words of a gyro in INCREMENTS.
    fn words(recording: &Recording, gyro: Gyro) -> Vec<&str> {
        let of_line = |line: &'_ str| line.find("1A0#").map(|at| at + 4 + 4 * gyro as usize);
        recording.link.lines().filter_map(|line| of_line(line).map(|at| &line[at..at + 4])).collect()
    }

    #[test]
    fn a_seed_gives_the_same_bytes_and_another_seed_other_bytes() {
        let [one, again, other] = [1, 1, 2].map(|seed| simulated(seed, &[]));
        assert!(one.link == again.link && one.reference == again.reference);
        assert!(one.link != other.link && one.reference != other.reference);
    }

    #[test]
    fn an_effect_on_a_gyro_changes_neither_the_others_nor_the_reference() {
        let drift = PlantedEffect::new("drift", &[Gyro::Y], &[("arcsec_per_h", 100.0)]);
        let [null, injected] = [simulated(1, &[]), simulated(1, &[drift])];
        assert!(null.reference == injected.reference);
        for gyro in GYROS {
            assert_eq!(words(&null, gyro) == words(&injected, gyro), gyro != Gyro::Y, "{}", gyro.name());
        }
    }

    #[test]
    fn an_amplitude_of_0_changes_no_byte() {
        let effects = injected::catalogue().map(|(code, parameter)| PlantedEffect::new(code, &[], &[(parameter, 0.0)]));
        // An injected noise replaces the unit's own.
        let effects: Vec<PlantedEffect> = effects.filter(|effect| !effect.code.ends_with("-random-walk")).collect();
        let [null, nothing] = [simulated(1, &[]), simulated(1, &effects)];
        assert!(null.link == nothing.link && null.reference == nothing.reference);
    }

    #[test]
    #[should_panic(expected = "drift-step: no parameter ppm")]
    fn a_parameter_that_an_effect_does_not_have_is_refused() {
        simulated(1, &[PlantedEffect::new("drift-step", &[Gyro::X], &[("ppm", 1.0), ("time_s", 5.0)])]);
    }
}
