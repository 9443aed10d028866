//! The in-orbit checkout (Casteren §5): simulated, calibrated, and compared with the truth.
//!
//! The sequence is that of `configs/checkout.toml`; precautions are what can be taken out of it. Nothing is written:
//! counts, reference attitude and absolute sensors go straight into the calibration.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use geu_model::attitude::{AttitudeProfile, Manoeuvre, RecordedAttitude};
use geu_model::effect::EffectConfiguration;
use geu_model::package::{Axes, Calibration};
use geu_model::units::{PPM, SAMPLE_INTERVAL_S};
use geu_model::{Configuration, Simulation};
use geu_protocol::Gyro;
use geu_recording::ReferenceAttitude;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::absolute::{AbsoluteData, StarFix};
use crate::calibrate::{AttitudeSource, CalibrateError, Calibrated, calibrate};
use crate::counts::{AccumulatedCounts, increments};
use crate::effects::CLEARANCE_KNOWN_ARCSEC;
use crate::solve::{BEFORE_LAUNCH, CalibrationParameter, UNKNOWNS, values};
use crate::transfer::misalignment_matrix;
use crate::window::ManoeuvreWindow;

const SEQUENCE: &str = include_str!("../../../configs/checkout.toml");
/// The hold after the last manoeuvre, samples: half of what the limit cycle's overlay looks at.
const HOLD: usize = 120;

/// Precautions that keep floats and misalignments in a harmless state (Casteren §5).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Precautions {
    /// An orbit's scan before each manoeuvre.
    pub stabilisation: bool,
    /// The 2° about Y, with the scan's own sign, before each Y-scan.
    pub pre_slew: bool,
    /// The slews about the sun vector before the fixes of a Y-scan.
    pub sun_slews: bool,
}

impl Precautions {
    pub const ALL: Precautions = Precautions { stabilisation: true, pre_slew: true, sun_slews: true };

    /// The precautions that a unit needs: without pivots and thermal misalignment there is nothing to bring to rest by an
    /// orbit's scan, and the checkout takes four hours instead of fourteen.
    pub fn needed_by(unit: &Configuration) -> Precautions {
        let (unit, gyros) = (&unit.unit, &unit.gyros);
        let is_thermal = has(unit, |effects| effects.misalignment_thermal.arcsec_per_deg);
        let has_pivots =
            gyros.iter().any(|gyro| has(&gyro.effects, |effects| effects.pivot_clearance.clearance_arcsec));
        Precautions { stabilisation: is_thermal || has_pivots, ..Precautions::ALL }
    }
}

/// True for a nonzero amplitude, or for any time course.
fn has<E>(effects: &EffectConfiguration<E>, amplitude: impl Fn(&E) -> f64) -> bool {
    amplitude(&effects.constant) != 0.0 || !effects.courses.is_empty()
}

/// A slew about Y that is shorter than this serves the pivots, not the attitude.
const PRE_SLEW_DEG: f64 = 10.0;

/// A unit on the sequence of the checkout.
///
/// # Panics
/// Never: the sequence is built in and tested.
pub fn sequence(unit: &Configuration, precautions: Precautions) -> Configuration {
    let mut configuration = unit.clone();
    let sequence = Configuration::parse("configs/checkout.toml (built in)", SEQUENCE, &[]).expect("a valid sequence");
    let mut scenario = sequence.scenario;
    scenario.limit_cycle = unit.scenario.limit_cycle;
    scenario.psi_deg = unit.scenario.psi_deg;
    let mut theta_deg = scenario.theta_deg;
    scenario.manoeuvres.retain(|manoeuvre| {
        let (keep, to_theta_deg) = match manoeuvre {
            Manoeuvre::Stabilise(_) => (precautions.stabilisation, f64::NAN),
            Manoeuvre::YScan(scan) => (true, scan.to_theta_deg),
            Manoeuvre::Slew(slew) if slew.by_psi_deg.is_finite() => (precautions.sun_slews, slew.to_theta_deg),
            Manoeuvre::Slew(slew) => {
                let is_long = (slew.to_theta_deg - theta_deg).abs() > PRE_SLEW_DEG;
                (is_long || precautions.pre_slew, slew.to_theta_deg)
            }
            _ => (true, f64::NAN),
        };
        if keep && to_theta_deg.is_finite() {
            theta_deg = to_theta_deg;
        }
        keep
    });
    configuration.scenario = scenario;
    configuration
}

/// Data of a simulated checkout.
#[derive(Debug, Clone)]
pub struct CheckoutRun {
    pub counts: AccumulatedCounts,
    /// The legs of the simulation.
    pub windows: Vec<ManoeuvreWindow>,
    pub reference: ReferenceAttitude,
    pub sensors: AbsoluteData,
}

pub fn simulate(configuration: &Configuration) -> CheckoutRun {
    let length_s = AttitudeProfile::length_s(&configuration.scenario).unwrap_or(0.0);
    let samples = (length_s * 2.0).ceil() as usize + HOLD;
    let start_s = configuration.start_unix_ns as f64 * 1e-9;
    let simulation = Simulation::new(configuration);
    let mut counts = AccumulatedCounts::starting_at(configuration.start_unix_ns);
    // On true time, as a receiver stamps it.
    counts.is_received = true;
    let mut rows = vec![simulation.start()];
    let mut sensors = AbsoluteData { numbers: configuration.sensors, ..AbsoluteData::default() };
    let mut fixes: BTreeMap<i64, StarFix> = BTreeMap::new();
    let mut windows = Vec::new();
    let t_ns = |t_s: f64| configuration.start_unix_ns + (t_s * 1e9).round() as i64;
    for (ended, reference) in simulation.take(samples) {
        let electronics_c = f64::from(ended.sample.electronics_centi_c) * 0.01;
        counts.push(ended.end_ns as f64 * 1e-9, &increments(&ended.sample), electronics_c);
        for sample in reference {
            rows.push(sample.row());
            windows.extend(sample.legs.iter().map(|leg| ManoeuvreWindow {
                name: leg.name.to_owned(),
                start_s: start_s + leg.start_s,
                end_s: start_s + leg.end_s,
            }));
            sensors.sun.extend(sample.sun.map(|sun| (t_ns(sample.t_s), [sun.theta_arcsec, sun.roll_arcsec])));
            for fix in sample.fixes.into_iter().flatten() {
                let new = StarFix { t_ns: t_ns(fix.t_s), star: fix.star.to_string(), slits: Vec::new() };
                let slit = (fix.slit.to_owned(), [fix.theta_deg, fix.psi_deg], fix.sigma_arcsec);
                fixes.entry(new.t_ns).or_insert(new).slits.push(slit);
            }
        }
    }
    sensors.fixes = fixes.into_values().collect();
    let truth = RecordedAttitude::new(rows).expect("rows of one sample each");
    let reference = ReferenceAttitude::of_truth(configuration.start_unix_ns, truth);
    CheckoutRun { counts, windows, reference, sensors }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttitudeSourceKind {
    Reference,
    Sensors,
}

impl CheckoutRun {
    /// Calibrates the checkout with a configuration of the unit.
    ///
    /// # Errors
    /// See [`calibrate`].
    pub fn calibrate(&self, prior: &Configuration, by: AttitudeSourceKind) -> Result<Calibrated, CalibrateError> {
        let attitude = match by {
            AttitudeSourceKind::Reference => AttitudeSource::Reference(&self.reference, Some([0.0; 3])),
            AttitudeSourceKind::Sensors => AttitudeSource::Sensors(&self.sensors),
        };
        calibrate(prior, &self.counts, Some(&self.windows), &attitude)
    }
}

/// The true calibration parameters of a unit: its calibration and the constant departures, which are a recalibration.
pub fn true_calibrations(unit: &Configuration) -> [Calibration; 4] {
    std::array::from_fn(|index| {
        let gyro = &unit.gyros[index];
        let (own, effects) = (gyro.calibration, &gyro.effects.constant);
        Calibration {
            scale_factor: own.scale_factor * (1.0 + effects.scale_factor.ppm * PPM),
            drift_arcsec_per_half_s: own.drift_arcsec_per_half_s
                + effects.drift.arcsec_per_h * SAMPLE_INTERVAL_S / 3600.0,
            x_arcsec: own.x_arcsec + effects.misalignment.x_arcsec,
            y_arcsec: own.y_arcsec + effects.misalignment.y_arcsec,
            z_arcsec: own.z_arcsec + effects.misalignment.z_arcsec,
        }
    })
}

/// The configuration of a unit before its checkout: nominal calibration parameters, but its noise and its other effects,
/// from tests on ground.
pub fn before_checkout(unit: &Configuration) -> Configuration {
    let mut prior = unit.clone();
    for gyro in &mut prior.gyros {
        gyro.calibration = Default::default();
        let effects = &mut gyro.effects.constant;
        (effects.scale_factor, effects.drift, effects.misalignment) = Default::default();
    }
    prior
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MonteCarloErrors {
    pub parameter: CalibrationParameter,
    /// Root mean square of the errors.
    pub rms_error: f64,
    pub mean_error: f64,
    /// Root mean square of the predicted sigmas.
    pub sigma: f64,
    /// Share of the runs with an error within the predicted sigma.
    pub coverage: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct MonteCarlo {
    pub runs: usize,
    /// Failed runs, with the reason.
    pub failed: Vec<(usize, String)>,
    pub scatter: Vec<MonteCarloErrors>,
    /// Mean of χ² over its degrees of freedom.
    pub mean_reduced_chi2: f64,
    /// Root mean square of the errors of the first-order method.
    pub first_order_rms_error: Option<[f64; UNKNOWNS]>,
}

/// The unit of one run: random calibration parameters within the uncertainty after launch, clearances within ±3″ of nominal,
/// ψ₀, phases of the limit cycle, seed.
pub fn drawn(unit: &Configuration, seed: u64, run: usize) -> Configuration {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(run as u64 + 1);
    let mut configuration = unit.clone();
    for parameter in CalibrationParameter::all() {
        let nominal = if parameter.index == 0 { 1.0 } else { 0.0 };
        let most = BEFORE_LAUNCH[parameter.index.min(2)];
        let value = nominal + most * (2.0 * random.random::<f64>() - 1.0);
        parameter.set(&mut configuration.gyros[parameter.gyro.index()].calibration, value);
    }
    for gyro in &mut configuration.gyros {
        let clearance_arcsec = &mut gyro.effects.constant.pivot_clearance.clearance_arcsec;
        let off = CLEARANCE_KNOWN_ARCSEC * (2.0 * random.random::<f64>() - 1.0);
        if *clearance_arcsec > 0.0 {
            *clearance_arcsec = (*clearance_arcsec + off).clamp(0.0, 100.0);
        }
    }
    configuration.scenario.psi_deg = 360.0 * random.random::<f64>();
    configuration.scenario.limit_cycle.phase_x_rad = TAU * random.random::<f64>();
    configuration.scenario.limit_cycle.phase_y_rad = TAU * random.random::<f64>();
    configuration.seed = u64::from(random.random::<u32>());
    configuration
}

/// A run with a calibration.
struct Run {
    errors: [f64; UNKNOWNS],
    sigmas: [f64; UNKNOWNS],
    reduced_chi2: f64,
    first_order: Option<[f64; UNKNOWNS]>,
}

/// Simulates and calibrates `runs` checkouts on all cores; the result does not depend on their number. `done` is called
/// after each.
pub fn campaign(
    unit: &Configuration,
    seed: u64,
    runs: usize,
    by: AttitudeSourceKind,
    done: impl Fn() + Sync,
) -> MonteCarlo {
    let all: Vec<Result<Run, String>> = (0..runs)
        .into_par_iter()
        .map(|run| {
            let configuration = sequence(&drawn(unit, seed, run), Precautions::needed_by(unit));
            let truth = values(&true_calibrations(&configuration));
            let calibrated = simulate(&configuration).calibrate(&before_checkout(unit), by);
            done();
            let calibrated = calibrated.map_err(|error| error.to_string())?;
            let solution = &calibrated.solution;
            let errors = |solved: &[f64]| std::array::from_fn(|index| solved[index] - truth[index]);
            let reduced = solution.chi2 / solution.degrees_of_freedom.max(1) as f64;
            let first_order = calibrated.first_order.as_ref().ok().map(|first_order| errors(&values(first_order)));
            let (errors, own) = (errors(&solution.values()), solution.sigmas());
            Ok(Run { errors, sigmas: std::array::from_fn(|index| own[index]), reduced_chi2: reduced, first_order })
        })
        .collect();
    let failed = all.iter().enumerate().filter_map(|(run, one)| Some((run, one.as_ref().err()?.clone()))).collect();
    let good: Vec<_> = all.iter().flatten().collect();
    let count = good.len().max(1) as f64;
    let mean = |of: &dyn Fn(&Run) -> f64| good.iter().map(|run| of(run)).sum::<f64>() / count;
    let scatter = CalibrationParameter::all()
        .enumerate()
        .map(|(index, parameter)| MonteCarloErrors {
            parameter,
            rms_error: mean(&|run| run.errors[index].powi(2)).sqrt(),
            mean_error: mean(&|run| run.errors[index]),
            sigma: mean(&|run| run.sigmas[index].powi(2)).sqrt(),
            coverage: mean(&|run| f64::from(u8::from(run.errors[index].abs() < run.sigmas[index]))),
        })
        .collect();
    let first_order_rms_error = good.iter().all(|run| run.first_order.is_some()).then(|| {
        std::array::from_fn(|index| {
            mean(&|run| run.first_order.map_or(0.0, |first_order| first_order[index].powi(2))).sqrt()
        })
    });
    MonteCarlo {
        runs: good.len(),
        failed,
        scatter,
        mean_reduced_chi2: mean(&|run| run.reduced_chi2),
        first_order_rms_error,
    }
}

/// Errors with a set of precautions.
#[derive(Debug, Clone, PartialEq)]
pub struct PrecautionResult {
    pub what: &'static str,
    /// Length of the sequence, s.
    pub length_s: f64,
    /// Largest error of an equation of each gyro with the true parameters, and the manoeuvre that has it, arcsec.
    pub equation_arcsec: [(f64, String); 4],
    pub errors: [f64; UNKNOWNS],
    /// Predicted sigma of each parameter.
    pub sigmas: [f64; UNKNOWNS],
    /// χ² and its degrees of freedom.
    pub chi2: (f64, usize),
}

/// Simulates the checkout of a unit without its random walks, with every precaution and without each, by the true attitude:
/// the difference is the benefit of the precaution. First with the unit's pivots alone, then with its thermal misalignment
/// alone, since their errors can mask each other.
///
/// # Errors
/// See [`calibrate`].
pub fn precautions(unit: &Configuration) -> Result<Vec<PrecautionResult>, CalibrateError> {
    let mut pivots = unit.without_noise();
    let mut thermal = pivots.clone();
    pivots.unit.constant.misalignment_thermal = Default::default();
    let mut none = before_checkout(unit);
    none.unit.constant.misalignment_thermal = Default::default();
    for gyro in thermal.gyros.iter_mut().chain(&mut none.gyros) {
        gyro.effects.constant.pivot_clearance = Default::default();
    }
    // The paper corrects GYRY and GYRZB, whose output axis is X, by the clearance.
    let corrected = |error_arcsec: f64| {
        let mut prior = none.clone();
        for gyro in Gyro::ALL.into_iter().filter(|&gyro| Axes::of(gyro).output_control[0] != 0.0) {
            let own = &mut prior.gyros[gyro.index()].effects.constant.pivot_clearance;
            *own = unit.gyros[gyro.index()].effects.constant.pivot_clearance;
            if own.clearance_arcsec > 0.0 {
                own.clearance_arcsec += error_arcsec;
            }
        }
        prior
    };
    let calibrated = |share: f64| {
        let mut prior = none.clone();
        prior.unit.constant.misalignment_thermal = unit.unit.constant.misalignment_thermal;
        prior.unit.constant.misalignment_thermal.arcsec_per_deg *= share;
        prior
    };
    let all = Precautions::ALL;
    let no_sun_slews = Precautions { sun_slews: false, ..all };
    let no_pre_slew = Precautions { pre_slew: false, ..all };
    let no_orbits = Precautions { stabilisation: false, ..all };
    let variants = [
        ("pivots: every precaution", &pivots, all, corrected(0.0)),
        ("pivots: clearance assumed 3 arcsec too large", &pivots, all, corrected(3.0)),
        ("pivots: no correction by the clearance", &pivots, all, none.clone()),
        ("pivots: no slews about the sun vector", &pivots, no_sun_slews, none.clone()),
        ("pivots: no pre-slew about Y", &pivots, no_pre_slew, corrected(0.0)),
        ("pivots: no stabilisation orbits", &pivots, no_orbits, corrected(0.0)),
        ("thermal: every precaution", &thermal, all, none.clone()),
        ("thermal: calibrated to a tenth", &thermal, all, calibrated(0.9)),
        ("thermal: no stabilisation orbits", &thermal, no_orbits, none.clone()),
    ];
    variants
        .into_par_iter()
        .map(|(what, unit, precautions, prior)| {
            let configuration = sequence(unit, precautions);
            let calibrated = simulate(&configuration).calibrate(&prior, AttitudeSourceKind::Reference)?;
            let truth = true_calibrations(&configuration);
            let (true_values, solution) = (values(&truth), &calibrated.solution);
            let matrix = misalignment_matrix(&truth);
            let equation_arcsec = std::array::from_fn(|gyro| {
                let errors = calibrated.observations.iter().filter_map(|observation| {
                    let turned = nalgebra::Vector3::from(observation.rotation_control_arcsec);
                    let calibration = &truth[gyro];
                    let measured = observation.counts[gyro]? * calibration.scale_factor
                        + observation.samples * calibration.drift_arcsec_per_half_s;
                    Some((measured - (matrix.row(gyro) * turned)[0], observation.name.clone()))
                });
                errors.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap_or_default()
            });
            let (solved, sigmas) = (solution.values(), solution.sigmas());
            Ok(PrecautionResult {
                what,
                length_s: AttitudeProfile::length_s(&configuration.scenario).unwrap_or(0.0),
                equation_arcsec,
                errors: std::array::from_fn(|index| solved[index] - true_values[index]),
                sigmas: std::array::from_fn(|index| sigmas[index]),
                chi2: (solution.chi2, solution.degrees_of_freedom),
            })
        })
        .collect()
}
