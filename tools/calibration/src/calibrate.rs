//! One recording calibrated: which manoeuvres, what effects are taken off, which rotations, then the sixteen parameters
//! and the hand method beside them.

use std::borrow::Cow;

use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::effect::WiringEffects;
use geu_model::package::Calibration;
use geu_model::units::ARCSEC_PER_DEG;
use geu_protocol::Gyro;
use geu_recording::ReferenceAttitude;

use crate::absolute::{self, AbsoluteData, GyroPath};
use crate::counts::AccumulatedCounts;
use crate::effects::{EffectContribution, MotionSteps};
use crate::hand;
use crate::noise::RandomWalks;
use crate::observe::{self, CompensatedCounts, ExcludedData, ReferenceSeries, reference_sigma_arcsec};
use crate::solve::{self, Observation, Solution, SolveError};
use crate::transfer::{GyroSet, Transfer};
use crate::window::{self, ManoeuvreWindow};

/// What tells the inertial rotations.
#[derive(Debug, Clone, Copy)]
pub enum AttitudeSource<'a> {
    /// A reference attitude; its noise where it is known, else it is estimated.
    Reference(&'a ReferenceAttitude, Option<f64>),
    Sensors(&'a AbsoluteData),
}

/// A calibration with all that it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    pub solution: Solution,
    /// Those of the hand method, or why it has none.
    pub hand: Result<[Calibration; 4], String>,
    pub observations: Vec<Observation>,
    pub left_out: Vec<ExcludedData>,
    /// Noise of the reference about each axis, arcsec.
    pub reference_sigma_arcsec: [f64; 3],
    /// Unix time of the recording's start, s.
    pub time_s: f64,
    /// Whether the gyros' path and the parameters came to agree; always with a reference.
    pub is_settled: bool,
}

/// Why a recording could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    /// Nothing stands in it.
    #[error("expected a recording of at least 4 samples, got {0}")]
    TooShort(usize),
    /// The list has no calibration manoeuvre.
    #[error("expected calibration manoeuvres (pointing, z-scan, y-scan, x-scan, or names of your own), got only {0}")]
    NoManoeuvres(String),
    /// No fix of the star sensor lies in the recording.
    #[error("expected fixes of the star sensor within the recording, {from_s:.1}…{to_s:.1} s, got none")]
    NoFixes {
        /// Its start on the time scale of the capture.
        from_s: f64,
        to_s: f64,
    },
    /// Faults of the wiring are believed.
    #[error(transparent)]
    Wiring(#[from] ConfiguredWiringFault),
    /// More than can be solved together.
    #[error("expected at most {MOST_WINDOWS} manoeuvres, which are solved together, got {0}; give a list of fewer")]
    TooMany(usize),
    /// The manoeuvres do not determine the parameters.
    #[error("the manoeuvres do not determine the parameters:\n{source}{}", notes(.left_out))]
    Unsolvable {
        source: SolveError,
        /// What was not used, which may be why.
        left_out: Vec<ExcludedData>,
    },
}

fn notes(left_out: &[ExcludedData]) -> String {
    left_out.iter().map(|left_out| format!("\nleft out: {left_out}")).collect()
}

/// The equations of so many manoeuvres are solved within seconds; the work grows with their cube.
pub const MOST_WINDOWS: usize = 400;
/// How often at most the gyros' path is laid with the parameters that it gave.
const PASSES: usize = 4;
/// A change of the parameters, in sigmas, that is not worth another pass.
const SETTLED_SIGMA: f64 = 0.1;

/// A fault of the wiring in what is believed: counts that went through it tell nothing that can be taken off.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "gyro.{gyro}: expected a unit without faults of its wiring, got {code}; mend the recording, or leave the fault out of the configuration"
)]
pub struct ConfiguredWiringFault {
    pub gyro: &'static str,
    pub code: &'static str,
}

/// Counts at the time of the motion that they tell, by the clock and the time offset that are believed; and what is left to
/// believe of the unit.
///
/// # Errors
/// A believed fault of the wiring.
pub(crate) fn corrected<'a>(
    configuration: &'a Configuration,
    counts: &'a AccumulatedCounts,
) -> Result<(Cow<'a, Configuration>, Cow<'a, AccumulatedCounts>), ConfiguredWiringFault> {
    for (own, gyro) in configuration.gyros.iter().zip(Gyro::ALL) {
        if let Some(index) = (0..WiringEffects::SPECS.len()).find(|&index| own.wiring.has(index)) {
            return Err(ConfiguredWiringFault { gyro: gyro.name(), code: WiringEffects::SPECS[index].code });
        }
    }
    let (mut configuration, mut counts) = (Cow::Borrowed(configuration), Cow::Borrowed(counts));
    let clock_ppm = configuration.unit.constant.clock_frequency.ppm;
    if !counts.is_received && clock_ppm != 0.0 {
        counts.to_mut().correct_clock(clock_ppm);
    }
    // Counts at t tell the motion of t − seconds: those of an earlier unit without the offset.
    let offset_s = configuration.unit.constant.time_offset.seconds;
    if offset_s != 0.0 {
        configuration.to_mut().unit.constant.time_offset = Default::default();
        counts.to_mut().start_ns -= (offset_s * 1e9).round() as i64;
    }
    Ok((configuration, counts))
}

/// Calibrates a recording. `configuration` is what is believed of the unit: its effects are taken off, its walks weigh.
/// Without `windows` a whole recording is used, cut where the unit rests, or at the fixes.
///
/// # Errors
/// [`CalibrateError`]: what cannot be solved, and what was left out.
pub fn calibrate(
    configuration: &Configuration,
    counts: &AccumulatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
) -> Result<Calibrated, CalibrateError> {
    if counts.len() < 4 {
        return Err(CalibrateError::TooShort(counts.len()));
    }
    let (configuration, counts) = corrected(configuration, counts)?;
    let (configuration, counts) = (&*configuration, &*counts);
    let believed = configuration.gyros.each_ref().map(|gyro| gyro.calibration);
    let walks = RandomWalks::configured(configuration);
    match attitude {
        AttitudeSource::Reference(reference, sigma_arcsec) => {
            let truth = &*reference.truth;
            let sigma_arcsec = sigma_arcsec.map_or_else(
                || reference_sigma_arcsec(counts, truth, reference.start_ns, &believed),
                |sigma_arcsec| [sigma_arcsec; 3],
            );
            let known = ReferenceSeries { truth, start_ns: reference.start_ns, sigma_arcsec };
            let effects =
                EffectContribution::of(configuration, counts, || steps_of_reference(counts, truth, reference.start_ns));
            let measured = CompensatedCounts { counts, effects: effects.as_ref() };
            let windows = chosen(&measured, windows, &Transfer::new(&believed, GyroSet::WithZa), attitude)?;
            let (observations, left_out) = observe::with_reference(&measured, &windows, &known);
            finish(counts, observations, left_out, &walks, &believed, sigma_arcsec)
        }
        AttitudeSource::Sensors(sensors) => {
            // While the path settles stars are taken as exact: weights that mistrust them would lean on what the path itself
            // still gets wrong.
            let mut numbers = sensors.numbers;
            numbers.sse.star_arcsec = 0.0;
            let mut settled = None;
            let mut calibrations = believed;
            let mut effects: Option<EffectContribution> = None;
            let mut pass = 0;
            loop {
                pass += 1;
                let transfer = Transfer::new(&calibrations, GyroSet::WithZa);
                let no_fixes = || {
                    let from_s = counts.start_ns as f64 * 1e-9;
                    CalibrateError::NoFixes { from_s, to_s: from_s + counts.end_s() }
                };
                let measured = CompensatedCounts { counts, effects: effects.as_ref() };
                let path = absolute::path(&measured, sensors, &transfer).ok_or_else(no_fixes)?;
                let of_path = EffectContribution::of(configuration, counts, || steps_of_path(&path));
                let measured = CompensatedCounts { counts, effects: of_path.as_ref() };
                let windows = chosen(&measured, windows, &transfer, attitude)?;
                let (observations, left_out) =
                    absolute::with_sensors(&measured, &windows, sensors, &numbers, &walks, &path);
                let mut found = finish(counts, observations, left_out, &walks, &calibrations, [f64::NAN; 3])?;
                let changes = found.solution.values().into_iter().zip(solve::values(&calibrations));
                // The last pass, with the stars as they err, does not bear on the path.
                if let Some(is_settled) = settled {
                    found.is_settled = is_settled;
                    return Ok(found);
                }
                found.is_settled = changes
                    .zip(found.solution.sigmas())
                    .all(|((now, before), sigma)| (now - before).abs() < SETTLED_SIGMA * sigma);
                if found.is_settled || pass == PASSES {
                    if numbers == sensors.numbers {
                        return Ok(found);
                    }
                    settled = Some(found.is_settled);
                    numbers = sensors.numbers;
                }
                calibrations = found.solution.calibrations;
                effects = of_path;
            }
        }
    }
}

fn finish(
    counts: &AccumulatedCounts,
    observations: Vec<Observation>,
    mut left_out: Vec<ExcludedData>,
    walks: &[RandomWalks; 4],
    believed: &[Calibration; 4],
    reference_sigma_arcsec: [f64; 3],
) -> Result<Calibrated, CalibrateError> {
    if let Some(start_s) = counts.runs_back_s {
        let why = "times run back there, and its instants would be there twice".to_owned();
        left_out.push(ExcludedData { name: "what follows".to_owned(), start_s, gyro: None, why });
    }
    match solve::solve(&observations, walks, believed) {
        Ok(solution) => {
            let hand = hand::solve(&observations, believed);
            let time_s = counts.start_ns as f64 * 1e-9;
            Ok(Calibrated { solution, hand, observations, left_out, reference_sigma_arcsec, time_s, is_settled: true })
        }
        Err(source) => Err(CalibrateError::Unsolvable { source, left_out }),
    }
}

/// A slew after a Y-scan that turns less than this about Y is the precaution before its second fix (Casteren §5.3).
const SLEW_ABOUT_SUN_ARCSEC: f64 = ARCSEC_PER_DEG;

/// The windows to evaluate: the calibration manoeuvres of the list, a Y-scan up to the end of the slew about the sun
/// vector that follows it; without a list everything.
fn chosen(
    measured: &CompensatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    transfer: &Transfer,
    attitude: &AttitudeSource,
) -> Result<Vec<ManoeuvreWindow>, CalibrateError> {
    let counts = measured.counts;
    let start_s = counts.start_ns as f64 * 1e-9;
    let Some(windows) = windows else {
        let all: Vec<ManoeuvreWindow> = match attitude {
            AttitudeSource::Reference(reference, _) => {
                let offset_s = (counts.start_ns - reference.start_ns) as f64 * 1e-9;
                let (from_s, to_s) = (reference.truth.start_s() - offset_s, reference.truth.end_s() - offset_s);
                window::cut_at_rests(counts, transfer, from_s, to_s)
                    .into_iter()
                    .map(|window| ManoeuvreWindow {
                        start_s: window.start_s + start_s,
                        end_s: window.end_s + start_s,
                        ..window
                    })
                    .collect()
            }
            AttitudeSource::Sensors(sensors) => sensors
                .fixes
                .windows(2)
                .enumerate()
                .map(|(index, pair)| ManoeuvreWindow {
                    name: format!("stretch {}", index + 1),
                    start_s: pair[0].t_ns as f64 * 1e-9,
                    end_s: pair[1].t_ns as f64 * 1e-9,
                })
                .collect(),
        };
        return if all.len() > MOST_WINDOWS { Err(CalibrateError::TooMany(all.len())) } else { Ok(all) };
    };
    let mut chosen: Vec<ManoeuvreWindow> = Vec::new();
    for (index, window) in windows.iter().enumerate().filter(|(_, window)| !window.is_precaution()) {
        let mut window = window.clone();
        let slew = windows
            .get(index + 1)
            .filter(|next| window.name == "y-scan" && next.name == "slew" && (next.start_s - window.end_s).abs() < 0.5);
        if let Some(slew) = slew
            && let (Some(from), Some(to)) =
                (counts.nearest(slew.start_s - start_s), counts.nearest(slew.end_s - start_s))
        {
            let (from, to) = (counts.at_node(from), counts.at_node(to));
            let counted = std::array::from_fn(|gyro| measured.between(gyro, &from, &to));
            let turned = transfer.about_control_arcsec(counted, to.samples - from.samples);
            if turned[1].abs() < SLEW_ABOUT_SUN_ARCSEC {
                window.end_s = slew.end_s;
            }
        }
        chosen.push(window);
    }
    if chosen.len() > MOST_WINDOWS {
        return Err(CalibrateError::TooMany(chosen.len()));
    }
    if chosen.is_empty() {
        let mut names: Vec<&str> = windows.iter().map(|window| window.name.as_str()).collect();
        names.dedup();
        let names = if names.is_empty() { "an empty list".to_owned() } else { names.join(", ") };
        return Err(CalibrateError::NoManoeuvres(names));
    }
    Ok(chosen)
}

pub(crate) fn steps_of_reference(counts: &AccumulatedCounts, truth: &RecordedAttitude, start_ns: i64) -> MotionSteps {
    let offset_s = (counts.start_ns - start_ns) as f64 * 1e-9;
    let mut near = 0;
    let mut before = truth.at(counts.node_s[0] + offset_s, &mut near).0;
    counts.node_s[1..]
        .iter()
        .map(|&node_s| {
            let (turned, moment) = truth.at(node_s + offset_s, &mut near);
            let step = std::array::from_fn(|axis| turned[axis] - before[axis]);
            before = turned;
            (step, truth.knows_sun().then_some((moment.theta_rad, moment.psi_rad)))
        })
        .collect()
}

pub(crate) fn steps_of_path(path: &GyroPath) -> MotionSteps {
    let pairs = path.turned_control_arcsec.windows(2).zip(&path.points[1..]);
    pairs
        .map(|(pair, point)| {
            (std::array::from_fn(|axis| pair[1][axis] - pair[0][axis]), Some((point.theta_rad, point.psi_rad)))
        })
        .collect()
}
