//! Contribution of configured effects to the counts, from the model on the measured motion. It is subtracted before the
//! calibration parameters are solved.

use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::configuration::GyroConfiguration;
use geu_model::effect::{CALIBRATION_COLUMN, UNIT_COLUMNS, WIRING_COLUMNS};
use geu_model::package::Calibration;
use geu_model::units::PPM;
use geu_model::{Configuration, GyroUnit, Truth};

use crate::counts::{AccumulatedCounts, Interpolation};
use crate::noise::{ErrorSource, ErrorTerm};

/// Error of the known clearance of the pivots: ±3″ (Casteren §5.3), taken as the bounds of a uniform error.
pub const CLEARANCE_KNOWN_ARCSEC: f64 = 3.0;
/// The 1 sigma error of the clearance: over √3.
pub const CLEARANCE_SIGMA_ARCSEC: f64 = CLEARANCE_KNOWN_ARCSEC / 1.732_050_807_568_877_2;

/// Counts that effects added, accumulated at nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectContribution {
    accumulated: Vec<Vec<f64>>,
    /// Change per arcsecond of clearance; empty without any.
    per_clearance: Vec<Vec<f64>>,
}

/// The motion at a node: rotation about the control axes since the node before, arcsec, and θ and ψ where known.
pub type MotionStep = ([f64; 3], Option<(f64, f64)>);
/// At each node after the first.
pub type MotionSteps = Vec<MotionStep>;

impl EffectContribution {
    /// True if the unit has an effect besides its noise. Effects have memory, so that a motion is followed from its start.
    pub fn is_expected(configuration: &Configuration) -> bool {
        let columns = configuration.without_noise().columns();
        columns.iter().any(|column| (UNIT_COLUMNS..WIRING_COLUMNS).contains(column))
    }

    /// Runs the model of `configuration`, without its noise, along the motion; `None` if it has no other effect.
    pub fn simulate(
        configuration: &Configuration,
        counts: &AccumulatedCounts,
        steps: impl FnOnce() -> MotionSteps,
    ) -> Option<EffectContribution> {
        if !EffectContribution::is_expected(configuration) {
            return None;
        }
        let (mut quiet, steps) = (configuration.without_noise(), steps());
        let times_s = ends_s(&quiet, counts.len());
        quiet.electronics.follow(times_s.iter().copied().zip(counts.electronics_c.iter().copied()).collect());
        let truth = moved(&times_s, steps.iter().copied())?;
        let accumulated = run(&quiet, &truth, steps.len());
        let mut wider = quiet;
        let mut has_pivots = false;
        for gyro in &mut wider.gyros {
            let pivots = &mut gyro.effects.constant.pivot_clearance;
            if pivots.clearance_arcsec > 0.0 {
                pivots.clearance_arcsec += 1.0;
                has_pivots = true;
            }
        }
        let per_clearance = if has_pivots {
            let with = run(&wider, &truth, steps.len()).into_iter().zip(&accumulated);
            with.map(|(with, own)| with.iter().zip(own).map(|(with, without)| with - without).collect()).collect()
        } else {
            Default::default()
        };
        Some(EffectContribution { accumulated, per_clearance })
    }

    /// Counts added to a gyro up to a node.
    pub fn at_node(&self, gyro: usize, node: usize) -> f64 {
        self.accumulated[gyro][node]
    }

    /// Counts added between two instants.
    pub fn between(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> f64 {
        to.apply(&self.accumulated[gyro]) - from.apply(&self.accumulated[gyro])
    }

    /// Error between two instants from the uncertainty of the clearance.
    pub fn disturbance(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> Option<ErrorTerm> {
        let nodes = self.per_clearance.get(gyro)?;
        let (count, variance) = (to.apply(nodes) - from.apply(nodes), CLEARANCE_SIGMA_ARCSEC * CLEARANCE_SIGMA_ARCSEC);
        (count.abs() > 1e-6).then(|| ErrorTerm::of_count(ErrorSource::Clearance { gyro }, variance, gyro, count))
    }
}

/// Counts from the float motion of each gyro up to each node, for clearances of its pivots; `None` without clearance.
pub fn float_motion(
    calibrations: &[Calibration; 4],
    clearance_arcsec: &[f64; 4],
    steps: impl ExactSizeIterator<Item = MotionStep>,
) -> Option<Vec<Vec<f64>>> {
    if clearance_arcsec.iter().all(|&clearance| clearance == 0.0) {
        return None;
    }
    let mut floats = Configuration::reference();
    floats.unit = Default::default();
    for (gyro, own) in floats.gyros.iter_mut().enumerate() {
        *own = GyroConfiguration { calibration: calibrations[gyro], ..Default::default() };
        own.effects.constant.pivot_clearance.clearance_arcsec = clearance_arcsec[gyro];
    }
    let samples = steps.len();
    Some(run(&floats, &moved(&ends_s(&floats, samples), steps)?, samples))
}

/// Ends of the model's own samples, so that it meets the motion where the unit met it, whatever the clocks of the
/// receive times.
fn ends_s(configuration: &Configuration, samples: usize) -> Vec<f64> {
    let length_s = configuration.device.interval_s / (1.0 + configuration.unit.constant.clock_frequency.ppm * PPM);
    (0..=samples).map(|node| node as f64 * length_s).collect()
}

/// The motion as a truth for the model.
fn moved(times_s: &[f64], steps: impl Iterator<Item = MotionStep>) -> Option<Truth> {
    let mut steps = steps.peekable();
    let start = AttitudeRow { t_s: 0.0, angle_control_arcsec: [0.0; 3], theta_psi_rad: steps.peek()?.1 };
    let row = |((angle_control_arcsec, theta_psi_rad), &t_s)| AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad };
    let mut rows = Vec::with_capacity(times_s.len());
    rows.push(start);
    rows.extend(steps.zip(&times_s[1..]).map(row));
    Some(Truth::Recorded(Arc::new(RecordedAttitude::new(rows).ok()?)))
}

/// Accumulated changes by every effect of unit and gyros.
fn run(configuration: &Configuration, truth: &Truth, samples: usize) -> Vec<Vec<f64>> {
    let mut unit = GyroUnit::on(configuration, truth);
    let mut accumulated = vec![vec![0.0]; configuration.device.heads.len()];
    for _ in 0..samples {
        let (_, traces) = unit.end_sample_traced();
        for (sums, trace) in accumulated.iter_mut().zip(&traces) {
            let changes = trace.changes[CALIBRATION_COLUMN + 1..WIRING_COLUMNS].iter().sum::<f64>();
            sums.push(sums[sums.len() - 1] + changes);
        }
    }
    accumulated
}
