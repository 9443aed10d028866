//! Calibration of one recording: the windows to evaluate, the calibration parameters, and the first-order method beside
//! them.

mod described;
mod parts;

use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_model::units::ARCSEC_PER_DEG;

use crate::absolute::AbsoluteData;
use crate::counts::AccumulatedCounts;
pub use crate::evaluation::{AttitudeSource, ConfiguredWiringFault};
use crate::evaluation::{Evaluation, Observed};
use crate::first_order;
use crate::noise::RandomWalks;
use crate::observe::{CompensatedCounts, ExcludedData};
use crate::solve::{self, Observation, Solution, SolveError};
use crate::transfer::Transfer;
use crate::window::ManoeuvreWindow;
pub use described::calibrate_described;
pub use parts::CalibrationParts;

/// A calibration with the data it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibrated {
    pub solution: Solution,
    /// Result of the first-order method, or why it has none.
    pub first_order: Result<[Calibration; 4], String>,
    pub observations: Vec<Observation>,
    pub left_out: Vec<ExcludedData>,
    /// Noise of the reference about each axis, arcsec.
    pub reference_sigma_arcsec: [f64; 3],
    /// Unix time of the recording's start, s.
    pub time_s: f64,
    /// True if the gyros' path and the parameters converged; always with a reference.
    pub is_settled: bool,
    /// Angle random walk of each gyro of a described unit, arcsec/√s: the configured one, or the measured one if that is larger.
    pub noise: Vec<f64>,
}

/// Why a recording could not be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrateError {
    #[error("expected a recording of at least 4 samples, got {0}")]
    TooShort(usize),
    /// The list has no calibration manoeuvre.
    #[error("expected calibration manoeuvres (pointing, z-scan, y-scan, x-scan, or names of your own), got only {0}")]
    NoManoeuvres(String),
    /// Too little of a described unit's recording has a reference.
    #[error(
        "the recording ({from_s:.1}…{to_s:.1} s) and the reference ({reference_from_s:.1}…{reference_to_s:.1} s): expected \
         {min_s:.0} s or more in common; --start sets the start of a recording without receive times"
    )]
    NoOverlap { from_s: f64, to_s: f64, reference_from_s: f64, reference_to_s: f64, min_s: f64 },
    /// No fix of the star sensor lies in the recording.
    #[error("expected fixes of the star sensor within the recording, {from_s:.1}…{to_s:.1} s, got none")]
    NoFixes {
        /// Start of the recording on the time scale of the capture.
        from_s: f64,
        to_s: f64,
    },
    #[error(transparent)]
    Wiring(#[from] ConfiguredWiringFault),
    /// More than can be solved together.
    #[error("expected at most {MAX_WINDOWS} manoeuvres, which are solved together, got {0}; give a list of fewer")]
    TooMany(usize),
    /// The manoeuvres do not determine the parameters.
    #[error("the manoeuvres do not determine the parameters:\n{source}{}", excluded_lines(.left_out))]
    Unsolvable {
        source: SolveError,
        /// The data that were not used.
        left_out: Vec<ExcludedData>,
    },
}

/// A line for each entry, to append to a message.
pub(crate) fn excluded_lines<T: std::fmt::Display>(left_out: &[T]) -> String {
    left_out.iter().map(|left_out| format!("\nleft out: {left_out}")).collect()
}

/// Maximum number of manoeuvres solved together, within seconds; the work grows with their cube.
pub const MAX_WINDOWS: usize = 400;
/// Maximum number of passes that lay the gyros' path with the parameters of the pass before.
const PASSES: usize = 4;
/// A change of the parameters, in sigmas, that needs no further pass.
const SETTLED_SIGMA: f64 = 0.1;

/// Calibrates a recording. The effects of `configuration` are subtracted, its random walks weigh the equations.
/// Without `windows` the whole recording is used, cut where the unit rests, or at the fixes.
///
/// # Errors
/// [`CalibrateError`]: the cause, and the data that were not used.
pub fn calibrate(
    configuration: &Configuration,
    counts: &AccumulatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    attitude: &AttitudeSource,
) -> Result<Calibrated, CalibrateError> {
    match attitude {
        AttitudeSource::Reference(reference, sigma_arcsec) => {
            let mut parts = CalibrationParts::new(configuration, windows, *sigma_arcsec)?;
            parts.add(counts, reference)?;
            parts.finish()
        }
        AttitudeSource::Sensors(sensors) => with_sensors(configuration, counts, windows, (attitude, sensors)),
    }
}

/// Calibrates with star and sun sensor. The path of the gyros joins the fixes: it is laid with the parameters of the pass before.
fn with_sensors(
    configuration: &Configuration,
    counts: &AccumulatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    (attitude, sensors): (&AttitudeSource, &AbsoluteData),
) -> Result<Calibrated, CalibrateError> {
    let evaluation = Evaluation::new(configuration, counts, attitude)?;
    check_list(windows)?;
    // While the path settles stars are taken as exact: weights that mistrust them would lean on the errors that the
    // path still has.
    let mut numbers = sensors.numbers;
    numbers.sse.star_arcsec = 0.0;
    let (mut calibrations, mut effects, mut settled) = (evaluation.prior.clone(), None, None);
    let mut pass = 0;
    loop {
        pass += 1;
        let observed = evaluation.observe(&calibrations, &numbers, effects.as_ref(), |measured, transfer, _| {
            let selected = match windows {
                Some(windows) => with_slews(measured, windows, transfer),
                None => between_fixes(sensors),
            };
            check_number(selected.len())?;
            Ok(selected)
        })?;
        let Observed { observations, left_out, effects: own_effects, .. } = observed;
        let recording = (evaluation.counts.start_s(), evaluation.counts.runs_back_s);
        let mut calibrated = solve_observations((observations, left_out), &evaluation.walks, &calibrations, recording)?;
        // The last pass, with the stars as they err, does not change the path.
        if let Some(is_settled) = settled {
            calibrated.is_settled = is_settled;
            return Ok(calibrated);
        }
        let changes = calibrated
            .solution
            .values()
            .into_iter()
            .zip(solve::values_of(&calibrated.solution.parameters, &calibrations));
        calibrated.is_settled = changes
            .zip(calibrated.solution.sigmas())
            .all(|((now, before), sigma)| (now - before).abs() < SETTLED_SIGMA * sigma);
        if calibrated.is_settled || pass == PASSES {
            if numbers == sensors.numbers {
                return Ok(calibrated);
            }
            settled = Some(calibrated.is_settled);
            numbers = sensors.numbers;
        }
        calibrations = calibrated.solution.calibrations;
        effects = own_effects;
    }
}

/// Solves observations of a recording that starts at `start_s`; at `runs_back_s` its times run backward.
fn solve_observations(
    (observations, mut left_out): (Vec<Observation>, Vec<ExcludedData>),
    walks: &[RandomWalks],
    prior: &[Calibration],
    (start_s, runs_back_s): (f64, Option<f64>),
) -> Result<Calibrated, CalibrateError> {
    if let Some(start_s) = runs_back_s {
        let why = "times run backward there".to_owned();
        left_out.push(ExcludedData { name: "the rest".to_owned(), start_s, gyro: None, why });
    }
    match solve::solve(&observations, walks, prior) {
        Ok(solution) => Ok(Calibrated {
            solution,
            first_order: first_order::solve(&observations, prior),
            observations,
            left_out,
            reference_sigma_arcsec: [f64::NAN; 3],
            time_s: start_s,
            is_settled: true,
            noise: Vec::new(),
        }),
        Err(source) => Err(CalibrateError::Unsolvable { source, left_out }),
    }
}

/// Checks that a list has calibration manoeuvres.
fn check_list(windows: Option<&[ManoeuvreWindow]>) -> Result<(), CalibrateError> {
    match windows {
        Some([]) => Err(CalibrateError::NoManoeuvres("an empty list".to_owned())),
        Some(windows) if windows.iter().all(ManoeuvreWindow::is_precaution) => {
            let mut names: Vec<&str> = windows.iter().map(|window| window.name.as_str()).collect();
            names.dedup();
            Err(CalibrateError::NoManoeuvres(names.join(", ")))
        }
        _ => Ok(()),
    }
}

fn check_number(windows: usize) -> Result<(), CalibrateError> {
    if windows > MAX_WINDOWS { Err(CalibrateError::TooMany(windows)) } else { Ok(()) }
}

/// A slew after a Y-scan that turns less than this about Y is the precaution before its second fix (Casteren §5.3).
const SLEW_ABOUT_SUN_ARCSEC: f64 = ARCSEC_PER_DEG;

/// The windows between the fixes of the star sensor.
fn between_fixes(sensors: &AbsoluteData) -> Vec<ManoeuvreWindow> {
    let window = |(index, [start_s, end_s]): (usize, [f64; 2])| {
        ManoeuvreWindow::new(&format!("stretch {}", index + 1), start_s, end_s)
    };
    sensors.between_fixes().enumerate().map(window).collect()
}

/// The calibration manoeuvres of a list, a Y-scan up to the end of the slew about the sun vector that follows it.
fn with_slews(measured: &CompensatedCounts, windows: &[ManoeuvreWindow], transfer: &Transfer) -> Vec<ManoeuvreWindow> {
    let selected = windows.iter().enumerate().filter(|(_, window)| !window.is_precaution());
    selected.map(|(index, window)| with_slew(measured, transfer, window, windows.get(index + 1))).collect()
}

/// A window, extended to the end of `next` if that is the slew about the sun vector after a Y-scan.
fn with_slew(
    measured: &CompensatedCounts,
    transfer: &Transfer,
    window: &ManoeuvreWindow,
    next: Option<&ManoeuvreWindow>,
) -> ManoeuvreWindow {
    let (counts, mut window) = (measured.counts, window.clone());
    let node = |t_s: f64| Some(counts.at_node(counts.nearest(t_s - counts.start_s())?));
    if let Some(slew) = next.filter(|next| next.is_slew_after(&window))
        && let (Some(from), Some(to)) = (node(slew.start_s), node(slew.end_s))
    {
        let counted = std::array::from_fn(|gyro| measured.between(gyro, &from, &to));
        let turned = transfer.about_control_arcsec(counted, to.samples - from.samples);
        if turned[1].abs() < SLEW_ABOUT_SUN_ARCSEC {
            window.end_s = slew.end_s;
        }
    }
    window
}
