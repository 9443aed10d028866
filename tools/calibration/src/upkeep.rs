//! Upkeep between checkouts: scale factor and drift of the Z gyros refined from survey scans of ordinary recordings, and
//! when a redetermination is due (Casteren §3.1, §3.2, §5, table 1).
//!
//! A scan is a stretch at a steady rate about Z with θ held; rests and slower stretches beside it part drift from scale
//! factor. What the calibration knew comes in as a prior whose sigma has grown since by the paper's stability figures, so
//! a few scans cannot spoil what a checkout determined, and where the scans tell nothing of the drift it stays.
//! The misalignments are solved along with their own sigmas, so that their uncertainty counts, and are then held.

mod scans;

use geu_model::Configuration;
use geu_model::effect::Effects;
use geu_model::package::Calibration;
use geu_model::units::{PPM, S_PER_DAY, SAMPLE_INTERVAL_S};
use geu_protocol::Gyro;
use nalgebra::DMatrix;
use serde_json::{Value, json};

use crate::absolute;
use crate::calibrate::{AttitudeSource, ConfiguredWiringFault, corrected, steps_of_path, steps_of_reference};
use crate::counts::AccumulatedCounts;
use crate::effects::EffectContribution;
use crate::noise::RandomWalks;
use crate::observe::{self, CompensatedCounts, ExcludedData, reference_sigma_arcsec};
use crate::refine::{Prior, Refined, refine};
use crate::report;
use crate::solve::{CalibrationParameter, Observation, PER_GYRO, SolveError, UNKNOWNS};
use crate::transfer::{GyroSet, Transfer};
use crate::window::{ManoeuvreWindow, REST_ARCSEC_S};

use scans::chosen;

pub use scans::{MOST_ARCSEC_S, SHORTEST_S, STEADY_ARCSEC_S};

/// The survey's rate about Z, 3.85 arcmin/s (Casteren §5): where the transfer function has to be best.
pub const SURVEY_ARCSEC_S: f64 = 231.0;
/// Slower stretches tell the drift and hardly the scale factor.
pub const LEAST_SCAN_ARCSEC_S: f64 = 60.0;
/// A redetermination is due after a fortnight (Casteren §3.1, §3.2).
pub const FORTNIGHT_S: f64 = 14.0 * S_PER_DAY;
/// Change of a scale factor in a fortnight: 0.004 % per month of 30 days (table 1).
pub const SCALE_FACTOR_PER_FORTNIGHT: f64 = 40.0 * PPM * 14.0 / 30.0;
/// Change of a scale factor within 30 min, and from one 30 min to the next: 0.002 % (table 1, §3.2).
pub const SCALE_FACTOR_PER_HALF_HOUR: f64 = 20.0 * PPM;
/// Change of a scale factor with the temperature of the electronics: 0.0025 % per 2 K (§3.2).
pub const SCALE_FACTOR_PER_K: f64 = 12.5 * PPM;
/// Change of a drift in a fortnight: 6″/h (§3.1, table 1), in arcsec per sample interval.
pub const DRIFT_PER_FORTNIGHT: f64 = 6.0 * SAMPLE_INTERVAL_S / 3600.0;
/// A change this many sigmas beyond what the stability figures allow is none of theirs.
pub const BEYOND_SIGMAS: f64 = 5.0;

/// The gyros that are kept up.
pub const GYROS: [Gyro; 2] = [Gyro::Za, Gyro::Zb];
/// What is kept up, in the order of the results.
pub const PARAMETERS: [CalibrationParameter; 4] = [
    CalibrationParameter { gyro: Gyro::Za, index: 0 },
    CalibrationParameter { gyro: Gyro::Za, index: 1 },
    CalibrationParameter { gyro: Gyro::Zb, index: 0 },
    CalibrationParameter { gyro: Gyro::Zb, index: 1 },
];

/// How well the parameters were known, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorAccuracy {
    /// When they were determined, s on the time scale of the capture.
    pub at_s: f64,
    /// Standard deviation of each, in the order of [`CalibrationParameter::all`].
    pub sigmas: [f64; UNKNOWNS],
}

impl PriorAccuracy {
    /// What a checkout with the paper's sensors gives at least: 20 ppm, 6″/h, 3″ (docs/calibration.md has what it gave).
    pub const BY_CHECKOUT: [f64; 3] = [20.0 * PPM, DRIFT_PER_FORTNIGHT, 3.0];

    /// Known as after a checkout at an instant.
    pub fn by_checkout(at_s: f64) -> PriorAccuracy {
        PriorAccuracy {
            at_s,
            sigmas: std::array::from_fn(|index| PriorAccuracy::BY_CHECKOUT[(index % PER_GYRO).min(2)]),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterUpdate {
    /// Which; a scale factor or a drift in arcsec per sample interval.
    pub parameter: CalibrationParameter,
    pub old: f64,
    /// Its sigma: that of the calibration, grown by the stability figures up to the recording and by the configured walk
    /// over it.
    pub old_sigma: f64,
    /// As refined, at the end of the recording.
    pub new: f64,
    /// Its sigma.
    pub new_sigma: f64,
    /// What the stability figures allow it to have changed since the calibration.
    pub allowed: f64,
    /// When its uncertainty, growing by the stability figure, will reach what a fortnight allows: s after the end of the
    /// recording; 0 where it has already.
    pub due_in_s: f64,
}

impl ParameterUpdate {
    pub fn change(&self) -> f64 {
        self.new - self.old
    }

    /// How far the change stands out of what was known, aged by the stability figures: the update's own standard deviation
    /// is the root of the fall of the variance.
    pub fn beyond_stability(&self) -> f64 {
        self.change() / (self.old_sigma.powi(2) - self.new_sigma.powi(2)).max(f64::MIN_POSITIVE).sqrt()
    }

    /// Whether it is more than the paper's stability explains: then the gyro is not the one that was calibrated.
    pub fn is_beyond_stability(&self) -> bool {
        self.beyond_stability().abs() > BEYOND_SIGMAS
    }

    /// Whether the new value is another than the old, by 3 of its sigmas.
    pub fn is_significant(&self) -> bool {
        self.change().abs() > 3.0 * self.new_sigma
    }

    /// Whether the scans told more of it than was known: the variance fell below half.
    pub fn is_observable(&self) -> bool {
        self.new_sigma < self.old_sigma * std::f64::consts::FRAC_1_SQRT_2
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct ScanSegment {
    pub name: String,
    /// Start, s since the start of the recording.
    pub start_s: f64,
    pub end_s: f64,
    pub rate_z_arcsec_s: f64,
    /// Of each Z gyro, what it counted more than fitted, and its standard deviation, arcsec; nothing where its counts
    /// cannot be trusted.
    pub residuals: [Option<(f64, f64)>; 2],
}

impl ScanSegment {
    /// Whether it tells the scale factor.
    pub fn is_scan(&self) -> bool {
        self.rate_z_arcsec_s.abs() >= LEAST_SCAN_ARCSEC_S
    }

    fn turned_z_arcsec(&self) -> f64 {
        self.rate_z_arcsec_s * (self.end_s - self.start_s)
    }
}

/// Scale factors of successive scans against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShortTerm {
    /// Pairs of successive scans that begin within an hour.
    pub pairs: usize,
    pub rms: f64,
    pub expected_rms: f64,
}

impl ShortTerm {
    pub fn excess(&self) -> f64 {
        (self.rms.powi(2) - self.expected_rms.powi(2)).max(0.0).sqrt()
    }

    /// Whether that is more than table 1 allows, and no chance.
    pub fn is_exceeded(&self) -> bool {
        let chance = 1.0 + BEYOND_SIGMAS * (2.0 / self.pairs.max(1) as f64).sqrt();
        self.excess() > SCALE_FACTOR_PER_HALF_HOUR && self.rms.powi(2) > chance * self.expected_rms.powi(2)
    }
}

/// The four values with all that they rest on.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationUpdate {
    /// In the order of [`PARAMETERS`].
    pub changes: [ParameterUpdate; 4],
    pub correlation: DMatrix<f64>,
    /// All sixteen, of which the four are new.
    pub calibrations: [Calibration; 4],
    /// Sigmas of all sixteen, as known but for the four.
    pub sigmas: [f64; UNKNOWNS],
    /// χ² of the equations and of the departures from what was known.
    pub chi2: f64,
    pub degrees_of_freedom: usize,
    pub used: Vec<ScanSegment>,
    pub left_out: Vec<ExcludedData>,
    /// When the believed values were determined, and the end of the last stretch, for which the new ones hold; s on the
    /// time scale of the capture.
    pub known_at_s: f64,
    pub at_s: f64,
    /// Electronics over the scans above the calibration's reference, K.
    pub electronics_above_k: f64,
    pub short_term: [ShortTerm; 2],
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpkeepError {
    /// Faults of the wiring are believed.
    #[error(transparent)]
    Wiring(#[from] ConfiguredWiringFault),
    /// Nothing stands in it.
    #[error("expected a recording of at least 4 samples, got {0}")]
    TooShort(usize),
    /// The calibration is later than the recording.
    #[error("expected a calibration before the recording, which starts at {start_s:.1} s, got one at {at_s:.1} s")]
    Later { start_s: f64, at_s: f64 },
    /// No fix of the star sensor lies in the recording.
    #[error("expected fixes of the star sensor within the recording, got none")]
    NoFixes,
    /// No scan.
    #[error(
        "expected survey scans: {SHORTEST_S:.0} s or more at a steady {LEAST_SCAN_ARCSEC_S:.0}…{MOST_ARCSEC_S:.0} arcsec/s \
         about Z (the survey has {SURVEY_ARCSEC_S:.0}; steady within {STEADY_ARCSEC_S:.0}), less than \
         {REST_ARCSEC_S:.0} arcsec/s about Y, with sound counts of a Z gyro; got none{}",
        notes(.0)
    )]
    NoScan(Vec<ExcludedData>),
    /// Numbers that are none.
    #[error(transparent)]
    Unsolvable(#[from] SolveError),
}

fn notes(left_out: &[ExcludedData]) -> String {
    summary(left_out).into_iter().map(|line| format!("\nleft out: {line}")).collect()
}

/// What was left out, a line for each reason.
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
    let words = |(first, count): &(&ExcludedData, usize)| match count {
        1 => first.to_string(),
        _ => format!("{first} (and {} more like it)", count - 1),
    };
    lines.iter().map(words).collect()
}

/// Passes with the sensors, whose path rests on the Z gyros.
const PASSES: usize = 2;

/// Refines scale factor and drift of the Z gyros. `configuration` is what is believed of the unit: its effects are taken
/// off, its walks weigh. With `legs`, those called survey, pointing or hold are looked at; without, the whole recording, or what
/// lies between fixes.
///
/// # Errors
/// [`UpkeepError`]: what was looked for, and what was found in its place.
pub fn update(
    configuration: &Configuration,
    known: &PriorAccuracy,
    counts: &AccumulatedCounts,
    legs: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
) -> Result<CalibrationUpdate, UpkeepError> {
    if counts.len() < 4 {
        return Err(UpkeepError::TooShort(counts.len()));
    }
    let (configuration, counts) = corrected(configuration, counts)?;
    let (configuration, counts) = (&*configuration, &*counts);
    let start_s = counts.start_ns as f64 * 1e-9;
    if known.at_s > start_s + counts.end_s() {
        return Err(UpkeepError::Later { start_s, at_s: known.at_s });
    }
    let believed = configuration.gyros.each_ref().map(|gyro| gyro.calibration);
    let walks = RandomWalks::configured(configuration);
    match attitude {
        AttitudeSource::Reference(reference, sigma_arcsec) => {
            let truth = &*reference.truth;
            let sigma_arcsec = sigma_arcsec.map_or_else(
                || reference_sigma_arcsec(counts, truth, reference.start_ns, &believed),
                |sigma_arcsec| [sigma_arcsec; 3],
            );
            let rotations = observe::ReferenceSeries { truth, start_ns: reference.start_ns, sigma_arcsec };
            let effects =
                EffectContribution::of(configuration, counts, || steps_of_reference(counts, truth, reference.start_ns));
            let mut left_out = Vec::new();
            let windows = chosen(counts, &believed, legs, attitude, &mut left_out);
            let measured = CompensatedCounts { counts, effects: effects.as_ref() };
            let (observations, broken) = observe::with_reference(&measured, &windows, &rotations);
            left_out.extend(broken);
            finish(configuration, known, counts, observations, left_out)
        }
        AttitudeSource::Sensors(sensors) => {
            let (mut calibrations, mut effects) = (believed, None);
            let mut pass = 0;
            loop {
                pass += 1;
                let measured = CompensatedCounts { counts, effects: effects.as_ref() };
                let transfer = Transfer::new(&calibrations, GyroSet::WithZa);
                let path = absolute::path(&measured, sensors, &transfer).ok_or(UpkeepError::NoFixes)?;
                let of_path = EffectContribution::of(configuration, counts, || steps_of_path(&path));
                let measured = CompensatedCounts { counts, effects: of_path.as_ref() };
                let mut left_out = Vec::new();
                let windows = chosen(counts, &calibrations, legs, attitude, &mut left_out);
                let (observations, broken) =
                    absolute::with_sensors(&measured, &windows, sensors, &sensors.numbers, &walks, &path);
                left_out.extend(broken);
                let found = finish(configuration, known, counts, observations, left_out)?;
                if pass == PASSES {
                    return Ok(found);
                }
                calibrations = found.calibrations;
                effects = of_path;
            }
        }
    }
}

/// What was known at the start of the recording: the sigmas of the calibration, and what has changed since by the paper's
/// figures, each taken as one sigma.
fn priors(configuration: &Configuration, known: &PriorAccuracy, since_s: f64, electronics_above_k: f64) -> Vec<Prior> {
    let fortnights = since_s.max(0.0) / FORTNIGHT_S;
    let all = CalibrationParameter::all().zip(known.sigmas).filter(|(parameter, _)| GYROS.contains(&parameter.gyro));
    all.map(|(parameter, sigma)| {
        let grown = match parameter.index {
            0 => {
                // Where the configuration tells the dependence, it was taken off.
                let by_temperature = if follows_temperature(configuration, parameter.gyro) {
                    0.0
                } else {
                    SCALE_FACTOR_PER_K * electronics_above_k
                };
                (SCALE_FACTOR_PER_FORTNIGHT * fortnights).hypot(by_temperature)
            }
            1 => DRIFT_PER_FORTNIGHT * fortnights,
            _ => 0.0,
        };
        // A sigma of nothing would be a row without noise.
        Prior { parameter, sigma: sigma.hypot(grown).max(1e-12) }
    })
    .collect()
}

fn follows_temperature(configuration: &Configuration, gyro: Gyro) -> bool {
    let effects = &configuration.gyros[gyro as usize].effects;
    let scale_factor = effects.constant.specs().iter().position(|spec| spec.code == "scale-factor");
    effects.courses.iter().any(|course| {
        Some(course.effect) == scale_factor && matches!(course.law, geu_model::course::TimeFunction::Temperature)
    })
}

fn finish(
    configuration: &Configuration,
    known: &PriorAccuracy,
    counts: &AccumulatedCounts,
    mut observations: Vec<Observation>,
    mut left_out: Vec<ExcludedData>,
) -> Result<CalibrationUpdate, UpkeepError> {
    let start_s = counts.start_ns as f64 * 1e-9;
    left_out.retain(|found| found.gyro.is_none_or(|gyro| GYROS.contains(&gyro)));
    observations.retain(|found| GYROS.iter().any(|&gyro| found.counts[gyro as usize].is_some()));
    let mut used: Vec<ScanSegment> = observations
        .iter()
        .map(|found| ScanSegment {
            name: found.name.clone(),
            start_s: found.start_s,
            end_s: found.end_s,
            rate_z_arcsec_s: found.rotation_control_arcsec[2] / (found.end_s - found.start_s),
            residuals: [None; 2],
        })
        .collect();
    if !used.iter().any(ScanSegment::is_scan) {
        return Err(UpkeepError::NoScan(left_out));
    }
    // Mean temperature over the scans.
    let (mut sum_c, mut nodes) = (0.0, 0.0);
    for scan in used.iter().filter(|scan| scan.is_scan()) {
        let [from, to] = [scan.start_s, scan.end_s].map(|t_s| counts.node_s.partition_point(|&node_s| node_s < t_s));
        let own = &counts.electronics_c[from..to.min(counts.electronics_c.len())];
        sum_c += own.iter().sum::<f64>();
        nodes += own.len() as f64;
    }
    let electronics_above_k = sum_c / f64::max(nodes, 1.0) - configuration.electronics.numbers.reference_c;
    let believed = configuration.gyros.each_ref().map(|gyro| gyro.calibration);
    let since_s = start_s - known.at_s;
    let priors = priors(configuration, known, since_s, electronics_above_k);
    let walks = RandomWalks::configured(configuration);
    let found = refine(&observations, &walks, &believed, &priors)?;
    let (refined, covariance) = (&found.calibrations, &found.covariance);
    for residual in &found.residuals {
        if let Some(index) = GYROS.iter().position(|&gyro| gyro == residual.gyro) {
            used[residual.manoeuvre].residuals[index] = Some((residual.arcsec, residual.sigma_arcsec));
        }
    }
    let column = PARAMETERS.map(|parameter| priors.iter().position(|prior| prior.parameter == parameter).unwrap_or(0));
    let sigma = |index: usize| covariance[(index, index)].max(0.0).sqrt();
    let end_s = used.iter().map(|found| found.end_s).fold(0.0, f64::max);
    let (mut calibrations, mut sigmas) = (believed, known.sigmas);
    let changes = std::array::from_fn(|index| {
        let (parameter, column) = (PARAMETERS[index], column[index]);
        let gyro = parameter.gyro as usize;
        *parameter.of_mut(&mut calibrations[gyro]) = parameter.of(&refined[gyro]);
        sigmas[PER_GYRO * gyro + parameter.index] = sigma(column);
        let per_fortnight = [SCALE_FACTOR_PER_FORTNIGHT, DRIFT_PER_FORTNIGHT][parameter.index];
        let share = sigma(column) / per_fortnight;
        ParameterUpdate {
            parameter,
            old: parameter.of(&believed[gyro]),
            old_sigma: match parameter.index {
                1 => priors[column].sigma.hypot(walks[gyro].drift_sigma_arcsec_s(end_s) * SAMPLE_INTERVAL_S),
                _ => priors[column].sigma,
            },
            new: parameter.of(&refined[gyro]),
            new_sigma: sigma(column),
            allowed: per_fortnight * (since_s + end_s).max(0.0) / FORTNIGHT_S,
            due_in_s: FORTNIGHT_S * (1.0 - share * share).max(0.0).sqrt(),
        }
    });
    let correlation =
        DMatrix::from_fn(4, 4, |a, b| covariance[(column[a], column[b])] / sigma(column[a]) / sigma(column[b]));
    let short_term = GYROS.map(|gyro| short_term(&used, &found, gyro));
    Ok(CalibrationUpdate {
        changes,
        correlation,
        calibrations,
        sigmas,
        chi2: found.chi2,
        degrees_of_freedom: found.degrees_of_freedom,
        used,
        left_out,
        known_at_s: known.at_s,
        at_s: start_s + end_s,
        electronics_above_k,
        short_term,
    })
}

/// Successive scans compared: what a gyro counted more, over what was turned, is a departure of its scale factor.
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

impl CalibrationUpdate {
    /// Probability of a χ² as large or larger.
    pub fn probability(&self) -> f64 {
        crate::solve::probability(self.chi2, self.degrees_of_freedom)
    }

    /// When the first of the four is due, s after [`CalibrationUpdate::at_s`].
    pub fn due_in_s(&self) -> f64 {
        self.changes.iter().map(|change| change.due_in_s).fold(FORTNIGHT_S, f64::min)
    }

    /// Whether something has changed that stability does not explain, so that only a checkout helps.
    pub fn needs_checkout(&self) -> bool {
        self.changes.iter().any(ParameterUpdate::is_beyond_stability)
            || self.short_term.iter().any(ShortTerm::is_exceeded)
    }

    /// The result as JSON. `gyros` is that of a calibration (cli.md), so that what reads one reads this: the four refined,
    /// the others as believed. `known_time_s` is when the believed values held, `time_s` when the new do;
    /// `changes` has old and new value and sigma of each, `allowed` by the stability figures since, `beyond_stability`
    /// in sigmas, `due_in_s` after `time_s`; `short_term` compares successive scans (relative);
    /// `used` has each stretch with its residuals, `left_out` the others with the reason.
    pub fn json(&self) -> Value {
        let gyro_values = |of: &dyn Fn(usize) -> Value| -> Value {
            GYROS
                .iter()
                .enumerate()
                .map(|(index, gyro)| (gyro.name().to_owned(), of(index)))
                .collect::<serde_json::Map<_, _>>()
                .into()
        };
        let changes = self.changes.iter().map(|change| {
            json!({
                "parameter": change.parameter.label(),
                "unit": if change.parameter.index == 0 { "" } else { "arcsec/half s" },
                "old": { "value": change.old, "sigma": change.old_sigma },
                "new": { "value": change.new, "sigma": change.new_sigma },
                "allowed": change.allowed,
                "beyond_stability": change.beyond_stability(),
                "significant": change.is_significant(),
                "told_by_scans": change.is_observable(),
                "due_in_s": change.due_in_s,
            })
        });
        json!({
            "gyros": report::gyros(&self.calibrations, Some(&self.sigmas)),
            "chi2": { "value": self.chi2, "dof": self.degrees_of_freedom, "probability": self.probability() },
            "known_time_s": self.known_at_s,
            "time_s": self.at_s,
            "changes": changes.collect::<Vec<_>>(),
            "correlation": (0..4).map(|row| self.correlation.row(row).iter().copied().collect()).collect::<Vec<Vec<f64>>>(),
            "electronics_above_reference_k": self.electronics_above_k,
            "short_term": gyro_values(&|index| {
                let ShortTerm { pairs, rms, expected_rms } = self.short_term[index];
                json!({ "pairs": pairs, "rms": rms, "expected_rms": expected_rms })
            }),
            "due_in_s": self.due_in_s(),
            "checkout_due": self.needs_checkout(),
            "used": self.used.iter().map(|used| json!({
                "stretch": used.name,
                "start_s": used.start_s,
                "end_s": used.end_s,
                "rate_z_arcsec_s": used.rate_z_arcsec_s,
                "residuals": gyro_values(&|index| used.residuals[index].map_or(Value::Null, |(arcsec, sigma_arcsec)| {
                    json!({ "arcsec": arcsec, "sigma_arcsec": sigma_arcsec })
                })),
            })).collect::<Vec<_>>(),
            "left_out": self.left_out.iter().map(|left_out| json!({
                "stretch": left_out.name,
                "start_s": left_out.start_s,
                "gyro": left_out.gyro.map(Gyro::name),
                "why": left_out.why,
            })).collect::<Vec<_>>(),
        })
    }
}
