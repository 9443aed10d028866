//! A survey day: 24 h simulated with the model, reconstructed, and compared with the exact attitude (Casteren §1, §3).

use geu_model::attitude::{AttitudeProfile, Manoeuvre, Motion};
use geu_model::effect::{EffectConfiguration, Effects, UNIT_COLUMNS, WIRING_COLUMNS, columns, discovered};
use geu_model::noise::NoiseStream;
use geu_model::package::{Axes, Calibration};
use geu_model::simulation::ReferenceSource;
use geu_model::units::{ARCSEC_PER_RAD, ORBIT_S};
use geu_model::{Configuration, GyroUnit, Truth};
use geu_protocol::Gyro;
use nalgebra::{UnitQuaternion, Vector3};

use super::fix::SUN_EVERY_S;
use super::{
    AttitudeFix, FilterError, FilterNoise, NodeEstimates, Reconstruction, StateEstimate, attitude_of, reconstruct,
};
use crate::checkout::true_calibrations;
use crate::counts::AccumulatedCounts;
use crate::effects::CLEARANCE_SIGMA_ARCSEC;
use crate::transfer::GyroSet;

/// The mission's requirement on the boresight (Casteren §1).
pub const REQUIREMENT_ARCSEC: f64 = 20.0;
/// Minimum time between attitude fixes; typically 30 min (Casteren §3).
pub const FIX_SPACING_S: f64 = 1800.0;
/// Scale on which the model's non-linearity is cubic, arcsec/s.
const NONLINEARITY_ARCSEC_S: f64 = 720.0;

/// A recording with its exact attitude.
#[derive(Debug, Clone)]
pub struct SurveyDay {
    pub counts: AccumulatedCounts,
    /// Fixes of the star sensor, the mean of its slits, every 30 min at most.
    pub fixes: Vec<AttitudeFix>,
    /// Samples of the sun sensor, about every 10 min.
    pub sun: Vec<AttitudeFix>,
    /// Exact attitude at each node, control frame to inertial.
    pub attitude: Vec<UnitQuaternion<f64>>,
}

impl SurveyDay {
    /// Simulates a configuration on its scenario.
    pub fn simulate(configuration: &Configuration, samples: usize) -> SurveyDay {
        let mut unit = GyroUnit::new(configuration);
        // At the ends of the unit's own samples, which the estimates are for.
        let mut reference = ReferenceSource::new(configuration, &Truth::Scenario);
        let sensors = &configuration.sensors;
        let mut day = SurveyDay {
            counts: AccumulatedCounts::starting_at(0),
            fixes: vec![],
            sun: vec![],
            attitude: Vec::with_capacity(samples + 1),
        };
        let now = |motion: &Motion| {
            let [about_x, about_y] = motion.departure_control_arcsec();
            let moment = motion.now();
            attitude_of(moment.theta_rad, moment.psi_rad, moment.t_s)
                * UnitQuaternion::from_scaled_axis(Vector3::new(about_x, about_y, 0.0) / ARCSEC_PER_RAD)
        };
        day.attitude.push(now(reference.motion()));
        let mut next_sun_s = 0.0;
        for _ in 0..samples {
            let sample = unit.end_sample();
            let end_s = sample.end_ns as f64 * 1e-9;
            day.counts.push_sample(end_s, &sample.sample);
            let sample = reference.advance(end_s);
            for slits in sample.fixes {
                let t_s = slits[0].t_s;
                if day.fixes.last().is_none_or(|last| t_s - last.t_s >= FIX_SPACING_S) {
                    let seen = slits.map(|fix| ([fix.theta_deg, fix.psi_deg], fix.sigma_arcsec));
                    day.fixes.push(AttitudeFix::star_through_slits(t_s, &seen, sensors.sse.star_arcsec));
                }
            }
            if let Some(seen) = sample.sun.filter(|_| end_s >= next_sun_s) {
                next_sun_s = end_s + SUN_EVERY_S;
                day.sun.push(AttitudeFix::sun(end_s, seen.theta_arcsec, seen.roll_arcsec, &sensors.fss));
            }
            day.attitude.push(now(reference.motion()));
        }
        day
    }
}

/// The parameters that the six manoeuvres of the checkout determine (Casteren §5): the configuration's own with the constant
/// departures, and the scale factor at the rates of the manoeuvres, 12′/s both ways for GYRY, orbital speed for Z,
/// orbital speed times cos 60° for X.
pub fn checkout_calibration(configuration: &Configuration) -> [Calibration; 4] {
    let orbital_arcsec_s = 1_296_000.0 / ORBIT_S;
    let scans =
        [(0.5 * orbital_arcsec_s, 1.0), (NONLINEARITY_ARCSEC_S, 0.5), (orbital_arcsec_s, 1.0), (orbital_arcsec_s, 1.0)];
    let mut calibrations = true_calibrations(configuration);
    for ((own, calibration), (rate_arcsec_s, share_positive)) in
        configuration.gyros.iter().zip(&mut calibrations).zip(scans)
    {
        let effects = &own.effects.constant;
        let ppm = effects.scale_factor.ppm
            + effects.scale_factor_nonlinearity.cubic_ppm * (rate_arcsec_s / NONLINEARITY_ARCSEC_S).powi(2)
            + effects.scale_factor_asymmetry.ppm * share_positive
            - configuration.unit.constant.clock_frequency.ppm;
        calibration.scale_factor = own.calibration.scale_factor * (1.0 + ppm * 1e-6);
    }
    calibrations
}

/// A calibration with errors: drift, scale factor and misalignments 1 sigma of the noise's start. Drawn from the seed.
pub fn with_errors(calibrations: &[Calibration; 4], noise: &FilterNoise, seed: u64) -> [Calibration; 4] {
    let drift = noise.start_drift_arcsec_per_half_s();
    Gyro::ALL.map(|gyro| {
        let mut stream = NoiseStream::of_sensor(seed, &format!("calibration {}", gyro.name()));
        let mut off = |sigma: f64| sigma * stream.standard_normal();
        let axes = Axes::of(gyro);
        let mut own = calibrations[gyro.index()];
        for (name, value) in
            [("x_arcsec", &mut own.x_arcsec), ("y_arcsec", &mut own.y_arcsec), ("z_arcsec", &mut own.z_arcsec)]
        {
            let error = off(noise.start_misalignment_arcsec);
            *value += if axes.has_number(name) { error } else { 0.0 };
        }
        own.scale_factor *= 1.0 + off(noise.start_scale_factor_ppm) * 1e-6;
        own.drift_arcsec_per_half_s += off(drift);
        own
    })
}

/// Error of the boresight of an estimate.
fn boresight_error_arcsec(estimate: &StateEstimate, exact: &UnitQuaternion<f64>) -> f64 {
    let boresight = exact.inverse() * (estimate.attitude * Vector3::x());
    boresight.y.hypot(boresight.z) * ARCSEC_PER_RAD
}

/// Errors of the boresight over a run, arcsec.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AttitudeErrorStats {
    pub rms_arcsec: f64,
    /// 95th percentile over the nodes.
    pub p95_arcsec: f64,
    pub max_arcsec: f64,
}

impl AttitudeErrorStats {
    /// Errors of estimates against the exact attitude.
    pub fn from_estimates(estimates: &[StateEstimate], exact: &[UnitQuaternion<f64>]) -> AttitudeErrorStats {
        AttitudeErrorStats::new(
            estimates.iter().zip(exact).map(|(own, exact)| boresight_error_arcsec(own, exact)).collect(),
        )
    }

    fn new(mut errors: Vec<f64>) -> AttitudeErrorStats {
        if errors.is_empty() {
            return AttitudeErrorStats::default();
        }
        let count = errors.len();
        let rms_arcsec = (errors.iter().map(|error| error * error).sum::<f64>() / count as f64).sqrt();
        errors.sort_by(f64::total_cmp);
        AttitudeErrorStats { rms_arcsec, p95_arcsec: errors[(count - 1) * 95 / 100], max_arcsec: errors[count - 1] }
    }
}

/// A survey day against its truth.
#[derive(Debug, Clone)]
pub struct SurveyDayReport {
    pub filtered: AttitudeErrorStats,
    pub smoothed: AttitudeErrorStats,
    pub fixes: usize,
    pub reconstruction: Reconstruction,
}

/// Why a day could not be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurveyDayError {
    /// The scenario has no fix, or the day no sample.
    #[error("{0}")]
    Filter(#[from] FilterError),
    /// The survey alone is infeasible.
    #[error("survey: {0}")]
    Survey(#[from] geu_model::attitude::InfeasibleManoeuvre),
}

/// Simulates a survey day with the gyros of a configuration and reconstructs it.
///
/// The day is the configuration's survey, without the manoeuvres before it and without end; a configuration without a
/// survey is used as it is. The calibration is [`checkout_calibration`] with errors of 6″/h, 20 ppm and 3″ drawn from the seed, the fixes
/// are the star sensor's alone, or with the sun sensor's every 10 min.
///
/// # Errors
/// A survey that is infeasible from the scenario's start, a duration without a sample.
pub fn survey_day(
    configuration: &Configuration,
    samples: usize,
    in_use: GyroSet,
    with_sun: bool,
) -> Result<SurveyDayReport, SurveyDayError> {
    let mut configuration = configuration.clone();
    let scenario = &mut configuration.scenario;
    let survey = scenario.manoeuvres.iter().find_map(|manoeuvre| match manoeuvre {
        Manoeuvre::Survey(survey) => Some(*survey),
        _ => None,
    });
    if let Some(mut endless) = survey {
        endless.scans = 0.0;
        scenario.manoeuvres = vec![Manoeuvre::Survey(endless)];
        AttitudeProfile::new(scenario)?;
    }
    let day = SurveyDay::simulate(&configuration, samples);
    let mut noise = FilterNoise::from_configuration(&configuration, in_use);
    let calibrations = with_errors(&checkout_calibration(&configuration), &noise, configuration.seed);
    for (gyro, clearance_arcsec) in Gyro::ALL.into_iter().zip(&mut noise.clearance_arcsec) {
        let mut stream = NoiseStream::of_sensor(configuration.seed, &format!("clearance {}", gyro.name()));
        let known = *clearance_arcsec + CLEARANCE_SIGMA_ARCSEC * stream.standard_normal();
        *clearance_arcsec = if *clearance_arcsec > 0.0 { known.max(0.0) } else { 0.0 };
    }
    let mut fixes = day.fixes.clone();
    if with_sun {
        fixes.extend(day.sun.iter().cloned());
    }
    let mut errors: [Vec<f64>; 2] = Default::default();
    let visit = |node: usize, own: &NodeEstimates| {
        for (errors, estimate) in errors.iter_mut().zip([&own.filtered, &own.smoothed]) {
            errors.push(boresight_error_arcsec(estimate, &day.attitude[node]));
        }
    };
    let reconstruction = reconstruct(&day.counts, &calibrations, in_use, &noise, &fixes, visit)?;
    let [filtered, smoothed] = errors.map(AttitudeErrorStats::new);
    Ok(SurveyDayReport { filtered, smoothed, fixes: fixes.len() - reconstruction.fixes_outside, reconstruction })
}

#[derive(Debug, Clone, PartialEq)]
pub struct EffectCost {
    pub code: &'static str,
    /// Smoothed boresight with this effect and no other.
    pub alone: AttitudeErrorStats,
    /// Smoothed boresight with every effect but this.
    pub without: AttitudeErrorStats,
}

/// A survey day for each effect of a configuration, with it alone and without it; an effect counts with its courses, on
/// all gyros.
///
/// # Errors
/// See [`survey_day`].
pub fn cost_of_effects(
    configuration: &Configuration,
    samples: usize,
    in_use: GyroSet,
    mut progress: impl FnMut(usize, usize),
) -> Result<(AttitudeErrorStats, Vec<EffectCost>), SurveyDayError> {
    let codes = effect_codes(configuration);
    let runs = 2 * codes.len() + 1;
    let mut done = 0;
    let mut smoothed = |keep: &dyn Fn(&str) -> bool| -> Result<AttitudeErrorStats, SurveyDayError> {
        let share = survey_day(&keeping(configuration, keep), samples, in_use, false)?.smoothed;
        done += 1;
        progress(done, runs);
        Ok(share)
    };
    let none = smoothed(&|_| false)?;
    let costs = codes
        .iter()
        .map(|&code| {
            Ok(EffectCost { code, alone: smoothed(&|own| own == code)?, without: smoothed(&|own| own != code)? })
        })
        .collect::<Result<_, SurveyDayError>>()?;
    Ok((none, costs))
}

/// Codes of the effects that a configuration has, in physical order.
fn effect_codes(configuration: &Configuration) -> Vec<&'static str> {
    let codes = columns();
    let of_unit_and_heads = |column: &usize| (UNIT_COLUMNS..WIRING_COLUMNS).contains(column);
    configuration.columns().into_iter().filter(of_unit_and_heads).map(|column| codes[column]).collect()
}

/// The configuration with only the effects that `keep` names.
fn keeping(configuration: &Configuration, keep: &dyn Fn(&str) -> bool) -> Configuration {
    fn drop_from<E: Effects>(effects: &mut EffectConfiguration<E>, keep: &dyn Fn(&str) -> bool) {
        let specs = effects.constant.specs();
        for (index, spec) in specs.iter().enumerate().filter(|(_, spec)| !keep(spec.code)) {
            let numbers = effects.constant.numbers_mut(index);
            (0..spec.amplitudes.len()).for_each(|amplitude| *numbers.value_mut(amplitude) = 0.0);
        }
        effects.courses.retain(|course| keep(specs[course.effect].code));
    }
    let mut configuration = configuration.clone();
    drop_from(&mut configuration.unit, keep);
    for gyro in &mut configuration.gyros {
        drop_from(&mut gyro.effects, keep);
        if !keep(discovered::CODE) {
            gyro.discovered.clear();
        }
    }
    configuration
}
