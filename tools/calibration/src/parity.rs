//! Parity check of the redundant pair: GYRZA against GYRZB, within the limits of calibration and noise.
//!
//! Two tests: over the last minute, for sudden faults, and since the start, for drifts that a minute does not show (5 sigma
//! of the reference unit are 176″/h over the minute, 10″/h over half an hour).
//!
//! The residual is a difference of angles, so quantisation enters only at the two ends, a twelfth of a count squared each
//! for each gyro, independent of the length (Casteren §2: no fraction of a count is lost between samples). The random walks
//! of angles and drifts and the errors of the calibration grow with time.

use std::collections::VecDeque;

use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use geu_protocol::Gyro;

use crate::noise::ROUNDING_VARIANCE;
use crate::prior::PriorCalibration;
use crate::track::TrackerEvent;
use crate::transfer::{GyroSet, Transfer};

/// Length of the short test, s.
pub const WINDOW_S: f64 = 60.0;
const WINDOW: usize = (WINDOW_S / SAMPLE_INTERVAL_S) as usize;
/// Sigmas beyond which a residual raises an alarm. A walk of the angles crosses u sigma 2uφ(u) times per window (Slepian's
/// process): at 5 once in 47 days of 60 s windows, at 4 three times in two days. Rounding, most of the sigma of a gyro as good as the
/// paper's, ends at 3.5 of its own sigmas and makes it rarer.
pub const THRESHOLD_SIGMA: f64 = 5.0;
/// Sigmas below which an alarm ends, so that the rounding at the ends does not raise it again and again.
pub const RECOVERY_SIGMA: f64 = 3.0;
const PAIR: [Gyro; 2] = [Gyro::ZA, Gyro::ZB];

/// A residual and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ParityResidual {
    /// GYRZA − GYRZB, arcsec.
    pub arcsec: f64,
    /// Standard deviation by calibration and noise.
    pub sigma_arcsec: f64,
}

impl ParityResidual {
    /// The residual in sigmas.
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

/// Computes the parity residual of the redundant pair over samples.
#[derive(Debug, Clone)]
pub struct ParityMonitor {
    transfer: Transfer,
    prior: PriorCalibration,
    now: Sums,
    /// The sums at the ends of samples without a break, oldest first, one window at most.
    history: VecDeque<Sums>,
    /// Number of intervals without a break.
    intervals: f64,
    is_alarmed: [bool; 2],
}

/// The parity check after a sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ParityResult {
    /// Since the start.
    pub accumulated: ParityResidual,
    /// Over the last [`WINDOW_S`]; `None` if they are interrupted.
    pub window: Option<ParityResidual>,
    /// Alarms that started (`true`) or ended, in the order of [`ParityTest`].
    pub changed: [Option<bool>; 2],
    /// Current alarms, in the order of [`ParityTest`].
    pub is_alarmed: [bool; 2],
}

impl ParityResult {
    /// The alarms that started or ended.
    pub(crate) fn events(&self) -> impl Iterator<Item = TrackerEvent> {
        let residuals = [self.window.unwrap_or_default(), self.accumulated];
        let tests = [ParityTest::Window, ParityTest::Start].into_iter().zip(residuals).zip(self.changed);
        tests.filter_map(|((test, residual), changed)| match changed? {
            true => Some(TrackerEvent::Exceeds(test, residual)),
            false => Some(TrackerEvent::Recovered(test, residual)),
        })
    }
}

impl ParityMonitor {
    /// A monitor at the start, where the drifts are those of the prior.
    pub fn new(prior: &PriorCalibration) -> ParityMonitor {
        ParityMonitor {
            transfer: Transfer::new(&prior.calibrations, GyroSet::WithZa),
            prior: prior.clone(),
            now: Sums::default(),
            history: VecDeque::with_capacity(WINDOW + 1),
            intervals: 0.0,
            is_alarmed: [false; 2],
        }
    }

    /// Skips missing samples, during which the drifts walk on.
    pub fn skip(&mut self, samples: u64) {
        self.history.clear();
        self.now.elapsed_s += samples as f64 * SAMPLE_INTERVAL_S;
    }

    /// Adds the counts of the next sample.
    pub fn push(&mut self, counts: [f64; 4]) -> ParityResult {
        if self.history.is_empty() {
            self.intervals += 1.0;
            self.history.push_back(self.now);
        }
        self.now.samples += 1.0;
        self.now.elapsed_s += SAMPLE_INTERVAL_S;
        for (sum, count) in self.now.counts.iter_mut().zip(counts) {
            *sum += count;
        }
        self.history.push_back(self.now);
        let accumulated = self.difference(&Sums::default(), self.intervals);
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

    /// The residual since `from`, over a number of intervals without a break.
    fn difference(&self, from: &Sums, intervals: f64) -> ParityResidual {
        let counts: [f64; 4] = std::array::from_fn(|gyro| self.now.counts[gyro] - from.counts[gyro]);
        let samples = self.now.samples - from.samples;
        let [x_arcsec, y_arcsec, _] = self.transfer.about_control_arcsec(counts, samples);
        let interval_s = (from.elapsed_s, self.now.elapsed_s);
        let mut variance = 0.0;
        // GYRX and GYRY enter through misalignments alone: their errors are a ten thousandth here.
        for gyro in PAIR.map(|gyro| gyro.index()) {
            let (sigma, walks) = (&self.prior.sigmas[gyro], &self.prior.walks[gyro]);
            variance += 2.0 * intervals * ROUNDING_VARIANCE * self.prior.calibrations[gyro].scale_factor.powi(2)
                + walks.angle_arcsec_per_sqrt_s.powi(2) * samples * SAMPLE_INTERVAL_S
                + walks.drift_covariance(interval_s, interval_s)
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
        (0..samples).map(|_| monitor.push(unit.end_sample().sample.increments.map(f64::from))).collect()
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
            // Independent windows.
            windows.extend(checked.iter().skip(WINDOW).step_by(2 * WINDOW).map(|checked| checked.window.unwrap()));
            starts.push(checked[4999].accumulated);
        }
        for differences in [windows, starts] {
            let count = differences.len() as f64;
            let chi2 = differences.iter().map(|difference| difference.sigmas().powi(2)).sum::<f64>();
            // The standard deviation of χ² is the root of twice the count.
            assert!((chi2 - count).abs() < 4.0 * (2.0 * count).sqrt(), "{chi2} of {count}");
        }
    }

    #[test]
    fn a_drift_step_raises_an_alarm_soon_and_lost_samples_raise_none() {
        // 360″/h is 6″ in the minute.
        let step = ["gyro.GYRZB.drift-step.arcsec_per_h=360", "gyro.GYRZB.drift-step.time_s=300"];
        let checked = run(&step, 1000);
        let alarm = checked.iter().position(|checked| checked.changed[0] == Some(true)).unwrap() as f64 * 0.5;
        assert!((320.0..360.0).contains(&alarm), "{alarm}");
        let checked = checked.last().unwrap();
        // Added to D, counts fall: the residual grows.
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
                assert_eq!(monitor.push(counts).is_alarmed, [false; 2]);
            }
        }
        assert_eq!(monitor.intervals, 4.0);
    }

    #[test]
    fn errors_of_the_calibration_enter_the_sigma() {
        let mut prior = PriorCalibration::from(&Configuration::parse("neutral", "", &[]).unwrap());
        prior.sigmas[2].drift_arcsec_per_half_s = 0.01;
        let mut monitor = ParityMonitor::new(&prior);
        let checked = (0..1000).map(|_| monitor.push([0.0; 4])).last().unwrap();
        assert!((checked.accumulated.sigma_arcsec - (100f64 + 4.0 / 12.0).sqrt()).abs() < 1e-9, "{checked:?}");
    }
}
