//! The redundant pair: what GYRZA tells of the Z axis and GYRZB does not, against what their calibration and noise allow.
//!
//! Two tests: over the last minute, for faults that come at once, and since the start, for drifts that the minute does
//! not show (5 sigma of the reference unit are 176″/h over the minute, 10″/h over half an hour).
//!
//! The difference is one of angles, so quantisation stands in it only at the two ends, a twelfth of a count squared each
//! for each gyro, however long the stretch between (Casteren §2: no fraction of a count is lost between samples). What
//! grows is the walk of the angles, the walk of the drifts, and what the calibration does not know.

use std::collections::VecDeque;

use geu_model::package::Calibration;
use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use geu_protocol::Gyro;

use crate::believed::PriorCalibration;
use crate::noise::{ROUNDING_VARIANCE, RandomWalks};
use crate::transfer::{GyroSet, Transfer};

/// Length of the short test, s.
pub const WINDOW_S: f64 = 60.0;
const WINDOW: usize = (WINDOW_S / SAMPLE_INTERVAL_S) as usize;
/// Sigmas beyond which a difference is told. A walk of the angles crosses u sigma 2uφ(u) times per window (Slepian's
/// process): at 5 once in 47 days of 60 s windows, at 4 three times in two days. Rounding, most of the sigma of a gyro as good as the
/// paper's, ends at 3.5 of its own sigmas and makes it rarer.
pub const THRESHOLD_SIGMA: f64 = 5.0;
/// Sigmas below which an alarm ends: the rounding at the ends must not tell the same alarm again and again.
pub const RECOVERY_SIGMA: f64 = 3.0;
const PAIR: [Gyro; 2] = [Gyro::Za, Gyro::Zb];

/// A difference and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ParityResidual {
    /// GYRZA − GYRZB, arcsec.
    pub arcsec: f64,
    /// Its standard deviation, as calibration and noise allow it.
    pub sigma_arcsec: f64,
}

impl ParityResidual {
    /// The difference in sigmas.
    pub fn sigmas(self) -> f64 {
        if self.sigma_arcsec > 0.0 { self.arcsec.abs() / self.sigma_arcsec } else { 0.0 }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ParityTest {
    /// Over the last [`WINDOW_S`].
    Window,
    /// Since the start.
    Start,
}

impl std::fmt::Display for ParityTest {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            ParityTest::Window => write!(f, "over {WINDOW_S} s"),
            ParityTest::Start => write!(f, "since the start"),
        }
    }
}

/// Sums since the start.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    samples: f64,
    counts: [f64; 4],
    elapsed_s: f64,
}

/// Follows the difference of the redundant pair through samples.
#[derive(Debug, Clone)]
pub struct ParityMonitor {
    transfer: Transfer,
    calibrations: [Calibration; 4],
    sigmas: [Calibration; 4],
    walks: [RandomWalks; 4],
    now: Sums,
    /// The sums at the ends of samples without a break, oldest first, a window's worth at most.
    history: VecDeque<Sums>,
    stretches: f64,
    is_alarmed: [bool; 2],
}

/// What a sample made of the difference.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ParityResult {
    /// Since the start.
    pub accumulated: ParityResidual,
    /// Over the last [`WINDOW_S`], once they are there without a break.
    pub window: Option<ParityResidual>,
    /// Tests that began (`true`) or ceased to exceed, by the order of [`ParityTest`].
    pub changed: [Option<bool>; 2],
    /// Tests that exceed, by the order of [`ParityTest`].
    pub is_alarmed: [bool; 2],
}

impl ParityMonitor {
    /// A monitor at the start: the drifts are those believed.
    pub fn new(believed: &PriorCalibration) -> ParityMonitor {
        ParityMonitor {
            transfer: Transfer::new(&believed.calibrations, GyroSet::WithZa),
            calibrations: believed.calibrations,
            sigmas: believed.sigmas,
            walks: believed.walks,
            now: Sums::default(),
            history: VecDeque::with_capacity(WINDOW + 1),
            stretches: 0.0,
            is_alarmed: [false; 2],
        }
    }

    /// Some samples are not there. Drifts walk on meanwhile.
    pub fn skip(&mut self, samples: u64) {
        self.history.clear();
        self.now.elapsed_s += samples as f64 * SAMPLE_INTERVAL_S;
    }

    /// Takes the counts of the sample that follows.
    pub fn take(&mut self, counts: [f64; 4]) -> ParityResult {
        if self.history.is_empty() {
            self.stretches += 1.0;
            self.history.push_back(self.now);
        }
        self.now.samples += 1.0;
        self.now.elapsed_s += SAMPLE_INTERVAL_S;
        for (sum, count) in self.now.counts.iter_mut().zip(counts) {
            *sum += count;
        }
        self.history.push_back(self.now);
        let accumulated = self.difference(&Sums::default(), self.stretches);
        let window = (self.history.len() > WINDOW).then(|| {
            let from = self.history.pop_front().unwrap_or_default();
            self.difference(&from, 1.0)
        });
        let mut changed = [None; 2];
        for (index, difference) in [window, Some(accumulated)].into_iter().enumerate() {
            let (alarmed, sigmas) = (&mut self.is_alarmed[index], difference.map(ParityResidual::sigmas));
            let limit = if *alarmed { RECOVERY_SIGMA } else { THRESHOLD_SIGMA };
            let exceeds = sigmas.map_or(*alarmed, |sigmas| sigmas > limit);
            changed[index] = (exceeds != *alarmed).then_some(exceeds);
            *alarmed = exceeds;
        }
        ParityResult { accumulated, window, changed, is_alarmed: self.is_alarmed }
    }

    /// The difference since `from`, over so many stretches.
    fn difference(&self, from: &Sums, stretches: f64) -> ParityResidual {
        let counts: [f64; 4] = std::array::from_fn(|gyro| self.now.counts[gyro] - from.counts[gyro]);
        let samples = self.now.samples - from.samples;
        let [x_arcsec, y_arcsec, _] = self.transfer.about_control_arcsec(counts, samples);
        let stretch_s = (from.elapsed_s, self.now.elapsed_s);
        let mut variance = 0.0;
        // GYRX and GYRY come in through misalignments alone: what they do not know is a ten thousandth here.
        for gyro in PAIR.map(|gyro| gyro as usize) {
            let (sigma, walks) = (&self.sigmas[gyro], &self.walks[gyro]);
            variance += 2.0 * stretches * ROUNDING_VARIANCE * self.calibrations[gyro].scale_factor.powi(2)
                + walks.angle_arcsec_per_sqrt_s.powi(2) * samples * SAMPLE_INTERVAL_S
                + walks.drift_covariance(stretch_s, stretch_s)
                + (sigma.drift_arcsec_per_half_s * samples).powi(2)
                + (sigma.scale_factor * counts[gyro]).powi(2)
                + (sigma.x_arcsec * x_arcsec / ARCSEC_PER_RAD).powi(2)
                + (sigma.y_arcsec * y_arcsec / ARCSEC_PER_RAD).powi(2);
        }
        let arcsec = self.transfer.redundancy_arcsec(counts, samples);
        ParityResidual { arcsec, sigma_arcsec: variance.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::{Configuration, GyroUnit};

    fn run(overrides: &[&str], samples: usize) -> Vec<ParityResult> {
        let overrides: Vec<String> = overrides.iter().map(|&text| text.to_owned()).collect();
        let configuration = Configuration::reference_with(&overrides).unwrap();
        let mut monitor = ParityMonitor::new(&PriorCalibration::from(&configuration));
        let mut unit = GyroUnit::new(&configuration);
        (0..samples).map(|_| monitor.take(unit.end_sample().sample.increments.map(f64::from))).collect()
    }

    #[test]
    fn the_reference_unit_does_not_alarm() {
        for seed in 1..=5 {
            let checked = run(&[&format!("seed={seed}")], 100_000);
            assert!(checked.iter().all(|checked| checked.is_alarmed == [false; 2]), "seed {seed}");
        }
    }

    #[test]
    fn differences_scatter_as_their_sigma_says() {
        // Walks ten times the paper's, so that they and not the rounding make the sigma.
        let (mut windows, mut starts) = (vec![], vec![]);
        for seed in 1..=200 {
            let mut overrides = vec![format!("seed={seed}")];
            for gyro in ["GYRZA", "GYRZB"] {
                overrides.push(format!("gyro.{gyro}.drift-random-walk.arcsec_per_s_per_sqrt_s=8e-5"));
                overrides.push(format!("gyro.{gyro}.drift-random-walk.correlation_time_s=1000"));
                overrides.push(format!("gyro.{gyro}.angle-random-walk.arcsec_per_sqrt_s=0.1"));
            }
            let checked = run(&overrides.iter().map(String::as_str).collect::<Vec<_>>(), 5000);
            // Windows that share nothing.
            windows.extend(checked.iter().skip(WINDOW).step_by(2 * WINDOW).map(|checked| checked.window.unwrap()));
            starts.push(checked[4999].accumulated);
        }
        for differences in [windows, starts] {
            let count = differences.len() as f64;
            let chi2 = differences.iter().map(|difference| difference.sigmas().powi(2)).sum::<f64>();
            // χ² of so many: its standard deviation is the root of twice the count.
            assert!((chi2 - count).abs() < 4.0 * (2.0 * count).sqrt(), "{chi2} of {count}");
        }
    }

    #[test]
    fn a_drift_step_is_told_soon_after_it_came_and_a_lost_stretch_is_no_alarm() {
        // 360″/h is 6″ in the minute.
        let step = ["gyro.GYRZB.drift-step.arcsec_per_h=360", "gyro.GYRZB.drift-step.time_s=300"];
        let checked = run(&step, 1000);
        let alarm = checked.iter().position(|checked| checked.changed[0] == Some(true)).unwrap() as f64 * 0.5;
        assert!((320.0..360.0).contains(&alarm), "{alarm}");
        let checked = checked.last().unwrap();
        // Added to D, counts fall: what GYRZA tells more grows.
        assert!((checked.accumulated.arcsec - 20.0).abs() < 2.0, "{checked:?}");
        assert_eq!(checked.is_alarmed, [true; 2]);

        let configuration = Configuration::reference();
        let mut monitor = ParityMonitor::new(&PriorCalibration::from(&configuration));
        let mut unit = GyroUnit::new(&configuration);
        for sample in 0..2000 {
            let counts = unit.end_sample().sample.increments.map(f64::from);
            if sample % 500 == 0 {
                monitor.skip(1);
            } else {
                assert_eq!(monitor.take(counts).is_alarmed, [false; 2]);
            }
        }
        assert_eq!(monitor.stretches, 4.0);
    }

    #[test]
    fn what_the_calibration_does_not_know_is_allowed_for() {
        let mut believed = PriorCalibration::from(&Configuration::parse("neutral", "", &[]).unwrap());
        believed.sigmas[2].drift_arcsec_per_half_s = 0.01;
        let mut monitor = ParityMonitor::new(&believed);
        let checked = (0..1000).map(|_| monitor.take([0.0; 4])).last().unwrap();
        assert!((checked.accumulated.sigma_arcsec - (100f64 + 4.0 / 12.0).sqrt()).abs() < 1e-9, "{checked:?}");
    }
}
