//! A plant: a second implementation of the model's page, made from the page alone. It shares no code with the model or
//! the protocol, so that what both say alike was read alike twice.
//!
//! It flies a survey, lets the reference unit count as a two-week-old calibration leaves it, hides effects in it, and
//! writes what a bench would have: a CAN capture and the attitude of a better sensor.

mod hidden;
mod motion;
mod noise;
mod unit;
mod wire;

pub use hidden::PlantedEffect;

use motion::Motion;
use noise::Noise;
use unit::Unit;

/// The step of every integral, by its middle. An accumulated angle is right to 0.01″: the limit cycle's middle misses
/// 0.0002″, and a corner of the rate's profile inside a step 36″/s² × (0.025 s)²/8.
const STEP_S: f64 = 0.025;
const STEPS: usize = 20;
const SAMPLE_INTERVAL_S: f64 = 0.5;

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
    /// As it is called on the link and in a configuration.
    pub fn name(self) -> &'static str {
        ["GYRX", "GYRY", "GYRZA", "GYRZB"][self as usize]
    }
}

/// Four of the sixteen.
#[derive(Debug, Clone, Copy)]
pub struct Calibration {
    /// SF, arcsec for a count.
    pub scale_factor: f64,
    /// D.
    pub drift_arcsec_per_half_s: f64,
    /// On X, Y and Z; 0 on the gyro's own axis.
    pub misalignment_arcsec: [f64; 3],
}

/// What is recorded: a scenario and noises from a seed, and what is hidden.
#[derive(Debug, Clone)]
pub struct IndependentModel {
    /// Of the scenario, the calibration's errors and the noises; each draws from a stream of its own.
    pub seed: u64,
    /// Of on-board time.
    pub duration_s: f64,
    /// The start of the first sample interval.
    pub start_unix_s: u64,
    /// When the sensor heater is switched off, if ever.
    pub heater_off_s: Option<f64>,
    /// Effects that the reference unit does not have.
    pub hidden: Vec<PlantedEffect>,
}

/// What a bench would have, and what it would not.
#[derive(Debug, Clone)]
pub struct Recording {
    /// `link.log`: a capture as `candump -l` writes it.
    pub link: String,
    /// `reference.csv`: exact mean rates over samples of true time, θ and ψ.
    pub reference: String,
    /// The unit's true sixteen.
    pub calibrations: [Calibration; 4],
}

impl IndependentModel {
    /// Three hours.
    pub fn new(seed: u64, hidden: Vec<PlantedEffect>) -> IndependentModel {
        IndependentModel { seed, duration_s: 10_800.0, start_unix_s: 1_795_000_000, heater_off_s: None, hidden }
    }

    /// Flies it.
    ///
    /// # Panics
    /// On a hidden effect that it does not know.
    pub fn record(&self) -> Recording {
        let motion = Motion::drawn(&mut Noise::new(self.seed, 0), self.duration_s);
        let mut unit = Unit::new(self);
        let mut jitter = Noise::new(self.seed, 1);
        let (mut link, mut end_s) = (String::new(), 0.0);
        for sequence in 0..(self.duration_s / SAMPLE_INTERVAL_S).round() as u32 {
            let sample = unit.sample(&motion, end_s);
            end_s += sample.length_s;
            // Receive stamps lag by 0.9 ms, with a jitter of 0.15 ms.
            let received_s = end_s + 0.9e-3 + 0.15e-3 * jitter.normal();
            wire::frames(&mut link, self.start_unix_s, received_s, sequence, &sample);
        }
        // A second more, for whoever reads truth ahead of the counts.
        let reference = wire::reference(&motion, self.start_unix_s, end_s + 1.0);
        Recording { link, reference, calibrations: unit.calibrations }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flown(seed: u64, hidden: &[PlantedEffect]) -> Recording {
        IndependentModel { duration_s: 3000.0, ..IndependentModel::new(seed, hidden.to_vec()) }.record()
    }

    /// The words of a gyro in INCREMENTS.
    fn words(recording: &Recording, gyro: Gyro) -> Vec<&str> {
        let of_line = |line: &'_ str| line.find("1A0#").map(|at| at + 4 + 4 * gyro as usize);
        recording.link.lines().filter_map(|line| of_line(line).map(|at| &line[at..at + 4])).collect()
    }

    #[test]
    fn a_seed_gives_the_same_bytes_and_another_one_others() {
        let [one, again, other] = [1, 1, 2].map(|seed| flown(seed, &[]));
        assert!(one.link == again.link && one.reference == again.reference);
        assert!(one.link != other.link && one.reference != other.reference);
    }

    #[test]
    fn what_is_hidden_on_a_gyro_touches_neither_the_others_nor_the_reference() {
        let hidden = PlantedEffect::new("drift", &[Gyro::Y], &[("arcsec_per_h", 100.0)]);
        let [null, hidden] = [flown(1, &[]), flown(1, &[hidden])];
        assert!(null.reference == hidden.reference);
        for gyro in GYROS {
            assert_eq!(words(&null, gyro) == words(&hidden, gyro), gyro != Gyro::Y, "{}", gyro.name());
        }
    }

    #[test]
    fn an_amplitude_of_0_changes_no_byte() {
        let hidden = hidden::catalogue().map(|(code, parameter)| PlantedEffect::new(code, &[], &[(parameter, 0.0)]));
        // A hidden noise takes the place of the unit's own.
        let hidden: Vec<PlantedEffect> = hidden.filter(|hidden| !hidden.code.ends_with("-random-walk")).collect();
        let [null, nothing] = [flown(1, &[]), flown(1, &hidden)];
        assert!(null.link == nothing.link && null.reference == nothing.reference);
    }

    #[test]
    #[should_panic(expected = "drift-step: no parameter ppm")]
    fn a_parameter_that_an_effect_does_not_have_is_refused() {
        flown(1, &[PlantedEffect::new("drift-step", &[Gyro::X], &[("ppm", 1.0), ("time_s", 5.0)])]);
    }
}
