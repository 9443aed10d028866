//! Sequences of manoeuvres that are tried, between rests, from sun-pointing and back to it.

use geu_model::Configuration;
use geu_model::Truth;
use geu_model::attitude::{AttitudeProfile, Manoeuvre, RecordedAttitude, Scenario};
use geu_model::simulation::ReferenceSource;
use geu_model::units::SAMPLE_INTERVAL_S;

use crate::measured::PlannedMotion;

/// θ before and after an excursion.
const THETA_DEG: f64 = 90.0;
/// Rest before and after a sequence: with the shortest excursion a recording is long enough for a diagnosis.
const REST_S: f64 = 300.0;
/// The longest sequence: the length of a survey on which effects are usually found.
const MAX_S: f64 = 10_800.0;
/// Repetitions of a sequence.
const TIMES: [usize; 4] = [1, 2, 4, 8];
/// Rest after the last sample, so that the reference covers it.
const AFTER_S: f64 = 2.0;

/// A kind of manoeuvre with the numbers that differ from their defaults.
type Part = (&'static str, &'static [(&'static str, f64)]);

const TO_60: Part = ("y-scan", &[("to_theta_deg", 60.0)]);
const TO_120: Part = ("y-scan", &[("to_theta_deg", 120.0)]);
const BACK: Part = ("y-scan", &[("to_theta_deg", THETA_DEG)]);
const SLOWLY_TO_120: Part = ("y-scan", &[("to_theta_deg", 120.0), ("rate_arcmin_s", 3.0)]);
const SLOWLY_BACK: Part = ("y-scan", &[("to_theta_deg", THETA_DEG), ("rate_arcmin_s", 3.0)]);
const X_FORTH: Part = ("x-scan", &[("angle_deg", 90.0), ("rate_arcmin_s", 12.0)]);
const X_BACK: Part = ("x-scan", &[("angle_deg", -90.0), ("rate_arcmin_s", 12.0)]);

/// Excursions from rest at [`THETA_DEG`] and back: their names in a sentence, and their parts.
const EXCURSIONS: [(&str, &[Part]); 12] = [
    ("a rest of 20 min", &[("pointing", &[("duration_s", 1200.0)])]),
    ("a Y-scan to 60° and back", &[TO_60, BACK]),
    ("a Y-scan to 120° and back", &[TO_120, BACK]),
    ("a slow Y-scan to 120° and back", &[SLOWLY_TO_120, SLOWLY_BACK]),
    (
        "Z-scans by 90° and back",
        &[
            ("z-scan", &[("angle_deg", 90.0), ("rate_arcmin_s", 12.0)]),
            ("z-scan", &[("angle_deg", -90.0), ("rate_arcmin_s", 12.0)]),
        ],
    ),
    ("a Z-scan", &[("z-scan", &[("rate_arcmin_s", 12.0)])]),
    ("a Z-scan with angle_deg = -360", &[("z-scan", &[("angle_deg", -360.0), ("rate_arcmin_s", 12.0)])]),
    ("a Y-scan to 60° and back with X-scans between", &[TO_60, X_FORTH, X_BACK, BACK]),
    ("a Y-scan to 120° and back with X-scans between", &[TO_120, X_FORTH, X_BACK, BACK]),
    (
        "slews to 60° and back with 90° about the sun vector",
        &[
            ("slew", &[("to_theta_deg", 60.0), ("by_psi_deg", 90.0)]),
            ("slew", &[("to_theta_deg", THETA_DEG), ("by_psi_deg", -90.0)]),
        ],
    ),
    ("a raster", &[("raster", &[]), ("y-scan", &[("to_theta_deg", THETA_DEG), ("rate_arcmin_s", 1.0)])]),
    ("a survey of 16 scans", &[("survey", &[("scans", 16.0), ("angle_deg", 15.0)])]),
];

/// Excursions in their order, repeated, between rests.
#[derive(Debug, Clone, PartialEq)]
pub struct Sequence {
    /// Indices of [`EXCURSIONS`].
    excursions: Vec<usize>,
    times: usize,
    /// Duration.
    pub duration_s: f64,
}

impl Sequence {
    /// Name in a sentence.
    pub fn name(&self) -> String {
        let names: Vec<&str> = self.excursions.iter().map(|&index| EXCURSIONS[index].0).collect();
        let times = match self.times {
            1 => String::new(),
            2 => ", twice".to_owned(),
            times => format!(", {times} times"),
        };
        format!("{}{times}", names.join(" and "))
    }

    /// Indices of its parts among [`parts`], in their order.
    pub fn parts(&self) -> Vec<usize> {
        let excursions = self.excursions.iter().map(|&excursion| excursion + 1);
        let repeated = (0..self.times).flat_map(|_| excursions.clone());
        std::iter::once(0).chain(repeated).chain([0]).collect()
    }

    /// The scenario.
    pub fn scenario(&self, nominal: &Configuration) -> Scenario {
        let repeated = (0..self.times).flat_map(|_| self.excursions.iter());
        let excursions = repeated.flat_map(|&index| manoeuvres(EXCURSIONS[index].1));
        scenario(nominal, std::iter::once(rest()).chain(excursions).chain([rest()]).collect())
    }
}

/// Scenarios of a rest and of each excursion.
pub fn parts(nominal: &Configuration) -> Vec<Scenario> {
    let excursions = EXCURSIONS.iter().map(|(_, parts)| manoeuvres(parts));
    std::iter::once(vec![rest()]).chain(excursions).map(|manoeuvres| scenario(nominal, manoeuvres)).collect()
}

/// All sequences of one or two excursions, the shortest first.
pub fn sequences(nominal: &Configuration) -> Vec<Sequence> {
    let singles = (0..EXCURSIONS.len()).map(|index| vec![index]);
    let pairs = (0..EXCURSIONS.len()).flat_map(|one| (one + 1..EXCURSIONS.len()).map(move |other| vec![one, other]));
    let repeated = singles.chain(pairs).flat_map(|excursions| TIMES.map(|times| (excursions.clone(), times)));
    let timed = repeated.filter_map(|(excursions, times)| {
        let sequence = Sequence { excursions, times, duration_s: 0.0 };
        Some(Sequence { duration_s: AttitudeProfile::length_s(&sequence.scenario(nominal))?, ..sequence })
    });
    let mut sequences: Vec<Sequence> = timed.filter(|sequence| sequence.duration_s <= MAX_S).collect();
    sequences.sort_by(|one, other| one.duration_s.total_cmp(&other.duration_s));
    sequences
}

/// The motion of a scenario with an end; `None` if it is not possible.
pub fn planned(nominal: &Configuration, scenario: Scenario) -> Option<PlannedMotion> {
    let samples = (AttitudeProfile::length_s(&scenario)? / SAMPLE_INTERVAL_S).ceil() as usize;
    let configuration = Configuration { scenario, ..nominal.clone() };
    let mut reference = ReferenceSource::new(&configuration, &Truth::Scenario);
    let mut rows = vec![reference.start()];
    for node in 1..=samples + (AFTER_S / SAMPLE_INTERVAL_S) as usize {
        rows.push(reference.advance(node as f64 * SAMPLE_INTERVAL_S).row());
    }
    Some(PlannedMotion { motion: RecordedAttitude::new(rows).ok()?, samples })
}

fn rest() -> Manoeuvre {
    manoeuvre("pointing", &[("duration_s", REST_S)])
}

fn manoeuvres(parts: &[Part]) -> Vec<Manoeuvre> {
    parts.iter().map(|(kind, numbers)| manoeuvre(kind, numbers)).collect()
}

fn manoeuvre(kind: &str, numbers: &[(&str, f64)]) -> Manoeuvre {
    let mut manoeuvre = Manoeuvre::of_kind(kind).expect("a kind of manoeuvre");
    for (name, value) in numbers {
        let index = manoeuvre.numbers().specs().iter().position(|number| number.name == *name).expect("its number");
        *manoeuvre.numbers_mut().value_mut(index) = *value;
    }
    manoeuvre
}

fn scenario(nominal: &Configuration, manoeuvres: Vec<Manoeuvre>) -> Scenario {
    Scenario { theta_deg: THETA_DEG, psi_deg: 0.0, limit_cycle: nominal.scenario.limit_cycle, manoeuvres }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sequence_is_possible_and_begins_with_the_shortest() {
        let nominal = Configuration::reference();
        assert!(parts(&nominal).iter().all(|own| planned(&nominal, own.clone()).is_some()));
        let all = sequences(&nominal);
        assert!(all.len() > 100 && all.is_sorted_by(|one, other| one.duration_s <= other.duration_s));
        // Ten minutes are necessary for a diagnosis.
        assert!(all.iter().all(|sequence| (900.0..=MAX_S).contains(&sequence.duration_s)));
        for name in ["a Z-scan, 4 times", "a rest of 20 min", "a Y-scan to 60° and back and a Y-scan to 120° and back"]
        {
            assert!(all.iter().any(|own| own.name() == name), "{name}");
        }
    }
}
