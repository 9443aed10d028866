//! Update between checkouts: refines scale factor and drift of the Z gyros from survey scans of ordinary recordings, and
//! computes when a redetermination is due (Casteren §3.1, §3.2, §5, table 1).
//!
//! A scan is a motion segment at a steady rate about Z with θ held; rests and slower segments beside it separate drift from
//! scale factor. The calibration is the prior, with sigmas grown since by the paper's stability figures: a few scans cannot
//! spoil a checkout, and a drift that the scans do not observe stays. The misalignments are solved too, with their own
//! sigmas, so that their uncertainty counts, and are then held.

mod result;
mod scans;

use geu_model::Configuration;
use geu_model::effect::Effects;
use geu_model::package::Calibration;
use geu_model::sensor::SensorNumbers;
use geu_model::units::{PPM, S_PER_DAY, SAMPLE_INTERVAL_S};
use geu_protocol::Gyro;
use nalgebra::DMatrix;

use crate::calibrate::{AttitudeSource, CalibrateError, excluded_lines};
use crate::counts::AccumulatedCounts;
use crate::evaluation::Evaluation;
use crate::observe::ExcludedData;
use crate::refine::{Prior, Refined, refine};
use crate::solve::{CalibrationParameter, Observation, PER_GYRO, SolveError, UNKNOWNS};
use crate::window::{ManoeuvreWindow, REST_ARCSEC_S};

use scans::select_segments;

pub use result::{CalibrationUpdate, ParameterUpdate, ScanSegment, ShortTerm};
pub use scans::{MAX_SCAN_ARCSEC_S, SHORTEST_S, STEADY_WITHIN_ARCSEC_S};

/// The survey's rate about Z, 3.85 arcmin/s (Casteren §5), at which the transfer function has to be best.
pub const SURVEY_ARCSEC_S: f64 = 231.0;
/// Slower segments determine the drift and hardly the scale factor.
pub const MIN_SCAN_ARCSEC_S: f64 = 60.0;
/// A redetermination is due after a fortnight (Casteren §3.1, §3.2).
pub const FORTNIGHT_S: f64 = 14.0 * S_PER_DAY;
/// Change of a scale factor in a month: 0.004 % (table 1).
pub const SCALE_FACTOR_PER_MONTH: f64 = 40.0 * PPM;
/// Change of a scale factor in a fortnight, for a month of 30 days.
pub const SCALE_FACTOR_PER_FORTNIGHT: f64 = SCALE_FACTOR_PER_MONTH * 14.0 / 30.0;
/// Change of a scale factor within 30 min, and from one 30 min to the next: 0.002 % (table 1, §3.2).
pub const SCALE_FACTOR_PER_HALF_HOUR: f64 = 20.0 * PPM;
/// Change of a scale factor with the temperature of the electronics: 0.0025 % per 2 K (§3.2).
pub const SCALE_FACTOR_PER_K: f64 = 12.5 * PPM;
/// Change of a drift in a fortnight: 6″/h (§3.1, table 1), in arcsec per sample interval.
pub const DRIFT_PER_FORTNIGHT: f64 = 6.0 * SAMPLE_INTERVAL_S / 3600.0;
/// A change that exceeds the stability figures by this many sigmas is not explained by them.
pub const BEYOND_SIGMAS: f64 = 5.0;

/// The updated gyros.
pub const GYROS: [Gyro; 2] = [Gyro::ZA, Gyro::ZB];
const Z: [f64; 3] = [0.0, 0.0, 1.0];
/// The updated parameters, in the order of the results.
pub const PARAMETERS: [CalibrationParameter; 4] = [
    CalibrationParameter { gyro: Gyro::ZA, index: 0, axis: Z },
    CalibrationParameter { gyro: Gyro::ZA, index: 1, axis: Z },
    CalibrationParameter { gyro: Gyro::ZB, index: 0, axis: Z },
    CalibrationParameter { gyro: Gyro::ZB, index: 1, axis: Z },
];

/// Accuracy and time of the prior calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorAccuracy {
    /// Time of the calibration, s on the time scale of the capture.
    pub at_s: f64,
    /// Standard deviation of each, in the order of [`CalibrationParameter::all`].
    pub sigmas: [f64; UNKNOWNS],
}

impl PriorAccuracy {
    /// Sigmas after a checkout with the paper's sensors, at most: 20 ppm, 6″/h, 3″ (docs/calibration.md has the results).
    pub const AFTER_CHECKOUT: [f64; 3] = [20.0 * PPM, DRIFT_PER_FORTNIGHT, 3.0];

    /// The accuracy of a checkout at an instant.
    pub fn after_checkout(at_s: f64) -> PriorAccuracy {
        PriorAccuracy {
            at_s,
            sigmas: std::array::from_fn(|index| PriorAccuracy::AFTER_CHECKOUT[(index % PER_GYRO).min(2)]),
        }
    }
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpdateError {
    /// The recording cannot be evaluated.
    #[error(transparent)]
    Recording(#[from] CalibrateError),
    /// The calibration is later than the recording.
    #[error("expected a calibration before the recording, which starts at {start_s:.1} s, got one at {at_s:.1} s")]
    Later { start_s: f64, at_s: f64 },
    #[error(
        "expected survey scans: {SHORTEST_S:.0} s or more at a steady {MIN_SCAN_ARCSEC_S:.0}…{MAX_SCAN_ARCSEC_S:.0} arcsec/s \
         about Z (the survey has {SURVEY_ARCSEC_S:.0}; steady within {STEADY_WITHIN_ARCSEC_S:.0}), less than \
         {REST_ARCSEC_S:.0} arcsec/s about Y, with sound counts of a Z gyro; got none{}",
        excluded_lines(&summary(.0))
    )]
    NoScan(Vec<ExcludedData>),
    #[error(transparent)]
    Unsolvable(#[from] SolveError),
}

/// The excluded data, a line for each reason.
pub fn summary(left_out: &[ExcludedData]) -> Vec<String> {
    let mut lines: Vec<(&ExcludedData, usize)> = Vec::new();
    for found in left_out {
        let kind = |name: &str| name.split(' ').next().unwrap_or_default().to_owned();
        let same = |other: &&mut (&ExcludedData, usize)| {
            other.0.why == found.why && other.0.gyro == found.gyro && kind(&other.0.name) == kind(&found.name)
        };
        match lines.iter_mut().find(same) {
            Some(line) => line.1 += 1,
            None => lines.push((found, 1)),
        }
    }
    let text = |(first, count): &(&ExcludedData, usize)| match count {
        1 => first.to_string(),
        _ => format!("{first} (and {} more like it)", count - 1),
    };
    lines.iter().map(text).collect()
}

/// Passes with the sensors, whose path rests on the Z gyros.
const PASSES: usize = 2;

/// Refines scale factor and drift of the Z gyros. The effects of `configuration` are subtracted, its random walks weigh the
/// equations. With `legs`, those called survey, pointing or hold are used; without, the whole recording, or the intervals
/// between fixes.
///
/// # Errors
/// [`UpdateError`]: the expected data, and the data found instead.
pub fn update(
    configuration: &Configuration,
    known: &PriorAccuracy,
    counts: &AccumulatedCounts,
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
) -> Result<CalibrationUpdate, UpdateError> {
    let evaluation = Evaluation::new(configuration, counts, attitude)?;
    let counts = &*evaluation.counts;
    if known.at_s > counts.start_s() + counts.end_s() {
        return Err(UpdateError::Later { start_s: counts.start_s(), at_s: known.at_s });
    }
    let (numbers, passes) = match attitude {
        AttitudeSource::Reference(..) => (SensorNumbers::default(), 1),
        AttitudeSource::Sensors(sensors) => (sensors.numbers, PASSES),
    };
    let prior: [Calibration; 4] = std::array::from_fn(|gyro| evaluation.prior[gyro]);
    let (mut calibrations, mut effects) = (prior, None);
    let mut pass = 0;
    loop {
        pass += 1;
        let observed = evaluation.observe(&calibrations, &numbers, effects.as_ref(), |_, _, left_out| {
            Ok(select_segments(counts, &calibrations, legs, attitude, left_out))
        })?;
        let updated = refine_observed(&evaluation, &prior, known, observed.observations, observed.left_out)?;
        if pass == passes {
            return Ok(updated);
        }
        (calibrations, effects) = (updated.calibrations, observed.effects);
    }
}

/// The prior at the start of the recording: the sigmas of the calibration and the change since by the paper's figures,
/// each taken as one sigma.
fn priors(configuration: &Configuration, known: &PriorAccuracy, since_s: f64, electronics_above_k: f64) -> Vec<Prior> {
    let fortnights = since_s.max(0.0) / FORTNIGHT_S;
    let all = CalibrationParameter::all().zip(known.sigmas).filter(|(parameter, _)| GYROS.contains(&parameter.gyro));
    all.map(|(parameter, sigma)| {
        let grown = match parameter.index {
            // A configured temperature dependence is already subtracted.
            0 if follows_temperature(configuration, parameter.gyro) => SCALE_FACTOR_PER_FORTNIGHT * fortnights,
            0 => (SCALE_FACTOR_PER_FORTNIGHT * fortnights).hypot(SCALE_FACTOR_PER_K * electronics_above_k),
            1 => DRIFT_PER_FORTNIGHT * fortnights,
            _ => 0.0,
        };
        // A sigma of 0 would be an equation without noise.
        Prior { parameter, sigma: sigma.hypot(grown).max(1e-12) }
    })
    .collect()
}

fn follows_temperature(configuration: &Configuration, gyro: Gyro) -> bool {
    let effects = &configuration.gyros[gyro.index()].effects;
    let scale_factor = effects.constant.specs().iter().position(|spec| spec.code == "scale-factor");
    effects.courses.iter().any(|course| Some(course.effect) == scale_factor && course.profile.spec.follows_temperature)
}

/// Mean temperature of the electronics over the scans, °C.
fn electronics_c(counts: &AccumulatedCounts, segments: &[ScanSegment]) -> f64 {
    let (mut sum_c, mut nodes) = (0.0, 0.0);
    for scan in segments.iter().filter(|segment| segment.is_scan()) {
        let [from, to] = [scan.start_s, scan.end_s].map(|t_s| counts.node_s.partition_point(|&node_s| node_s < t_s));
        let own = &counts.electronics_c[from..to.min(counts.electronics_c.len())];
        sum_c += own.iter().sum::<f64>();
        nodes += own.len() as f64;
    }
    sum_c / f64::max(nodes, 1.0)
}

fn refine_observed(
    evaluation: &Evaluation,
    prior: &[Calibration; 4],
    known: &PriorAccuracy,
    mut observations: Vec<Observation>,
    mut left_out: Vec<ExcludedData>,
) -> Result<CalibrationUpdate, UpdateError> {
    let Evaluation { configuration, counts, walks, .. } = evaluation;
    left_out.retain(|found| found.gyro.is_none_or(|gyro| GYROS.contains(&gyro)));
    observations.retain(|found| GYROS.iter().any(|&gyro| found.counts[gyro.index()].is_some()));
    let mut used: Vec<ScanSegment> = observations.iter().map(ScanSegment::from).collect();
    if !used.iter().any(ScanSegment::is_scan) {
        return Err(UpdateError::NoScan(left_out));
    }
    let electronics_above_k = electronics_c(counts, &used) - configuration.electronics.numbers.reference_c;
    let since_s = counts.start_s() - known.at_s;
    let priors = priors(configuration, known, since_s, electronics_above_k);
    let refined = refine(&observations, walks, prior, &priors)?;
    for residual in &refined.residuals {
        if let Some(index) = GYROS.iter().position(|&gyro| gyro == residual.gyro) {
            used[residual.manoeuvre].residuals[index] = Some((residual.arcsec, residual.sigma_arcsec));
        }
    }
    let column = PARAMETERS.map(|parameter| priors.iter().position(|prior| prior.parameter == parameter).unwrap_or(0));
    let new_sigmas = column.map(|column| refined.covariance[(column, column)].max(0.0).sqrt());
    let end_s = used.iter().map(|found| found.end_s).fold(0.0, f64::max);
    let (mut calibrations, mut sigmas) = (*prior, known.sigmas);
    let changes = std::array::from_fn(|index| {
        let (parameter, new_sigma) = (PARAMETERS[index], new_sigmas[index]);
        let gyro = parameter.gyro.index();
        let new = parameter.value(&refined.calibrations[gyro]);
        parameter.set(&mut calibrations[gyro], new);
        sigmas[parameter.position()] = new_sigma;
        let prior_sigma = priors[column[index]].sigma;
        let walked_arcsec_s = if parameter.index == 1 { walks[gyro].drift_sigma_arcsec_s(end_s) } else { 0.0 };
        let per_fortnight = [SCALE_FACTOR_PER_FORTNIGHT, DRIFT_PER_FORTNIGHT][parameter.index];
        let share = new_sigma / per_fortnight;
        ParameterUpdate {
            parameter,
            old: parameter.value(&prior[gyro]),
            old_sigma: prior_sigma.hypot(walked_arcsec_s * SAMPLE_INTERVAL_S),
            new,
            new_sigma,
            allowed: per_fortnight * (since_s + end_s).max(0.0) / FORTNIGHT_S,
            due_in_s: FORTNIGHT_S * (1.0 - share * share).max(0.0).sqrt(),
        }
    });
    Ok(CalibrationUpdate {
        changes,
        correlation: DMatrix::from_fn(4, 4, |a, b| {
            refined.covariance[(column[a], column[b])] / new_sigmas[a] / new_sigmas[b]
        }),
        calibrations,
        sigmas,
        chi2: refined.chi2,
        degrees_of_freedom: refined.degrees_of_freedom,
        short_term: GYROS.map(|gyro| short_term(&used, &refined, gyro)),
        used,
        left_out,
        known_at_s: known.at_s,
        at_s: counts.start_s() + end_s,
        electronics_above_k,
    })
}

/// Compares successive scans: the residual of a gyro over the rotation is a departure of its scale factor.
fn short_term(used: &[ScanSegment], refined: &Refined, gyro: Gyro) -> ShortTerm {
    let scans: Vec<(usize, f64)> = refined
        .residuals
        .iter()
        .enumerate()
        .filter(|(_, residual)| residual.gyro == gyro && used[residual.manoeuvre].is_scan())
        .map(|(row, residual)| (row, used[residual.manoeuvre].turned_z_arcsec()))
        .collect();
    let start_s = |row: usize| used[refined.residuals[row].manoeuvre].start_s;
    let (mut pairs, mut squares, mut expected) = (0, 0.0, 0.0);
    for pair in scans.windows(2) {
        let [(a, turned_a), (b, turned_b)] = [pair[0], pair[1]];
        if start_s(b) - start_s(a) > 3600.0 {
            continue;
        }
        pairs += 1;
        squares += (refined.residuals[b].arcsec / turned_b - refined.residuals[a].arcsec / turned_a).powi(2);
        let covariance = |a: usize, b: usize| refined.residual_covariance[(a, b)];
        expected += covariance(a, a) / (turned_a * turned_a) + covariance(b, b) / (turned_b * turned_b)
            - 2.0 * covariance(a, b) / (turned_a * turned_b);
    }
    let rms = |sum: f64| (sum / f64::max(pairs as f64, 1.0)).sqrt();
    ShortTerm { pairs, rms: rms(squares), expected_rms: rms(expected) }
}
