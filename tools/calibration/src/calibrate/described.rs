//! Calibration of a described unit with a reference attitude, from windows of any motion.
//!
//! A unit on the move is late against its reference by its link, and its clock may be fast: both are solved with the parameters. The
//! noise is measured in the residual, since few descriptions state one.

use std::borrow::Cow;
use std::sync::Arc;

use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::package::dot;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_recording::ReferenceAttitude;

use super::{CalibrateError, Calibrated, MAX_WINDOWS};
use crate::coning::without_coning;
use crate::counts::AccumulatedCounts;
use crate::effects::EffectContribution;
use crate::evaluation::{AttitudeSource, Evaluation, steps_of_reference};
use crate::noise::{ROUNDING_VARIANCE, RandomWalks};
use crate::observe::{CompensatedCounts, variance, with_reference};
use crate::solve::{CalibrationParameter, Solution, SolveError, TrialsOfObservations, sensing_axes, solve_described};
use crate::transfer::sensing_matrix;
use crate::window::{ManoeuvreWindow, cut_at, cut_evenly};

/// Equations that are solved together, at most.
const MAX_EQUATIONS: usize = 1200;
/// Windows of a recording, at most, and the equations of a gyro that are needed.
const MAX_PARTS: usize = 300;
const MIN_PARTS: usize = 8;
/// Sigma of the time offset, s, and of the frequency of a clock without receive times, relative, before the data.
const OFFSET_S: f64 = 0.1;
const FREQUENCY: f64 = 1e-3;
/// Frequency error that receive times leave, relative.
const RECEIVED_FREQUENCY: f64 = 1e-9;
/// Passes: the first finds the times, the second the parameters from which the noise is known.
const PASSES: usize = 4;
/// Noise of the first pass: angle random walk, arcsec/√s, and noise of the reference, arcsec.
const FIRST: [f64; 2] = [0.1, 1.0];
/// Smallest noise, so that equations without any can be weighed: angle random walk, arcsec/√s, and noise of the reference, arcsec.
const MIN_NOISE: [f64; 2] = [1e-4, 1e-3];
/// Length of rows of rates or turns from which only their ends are known, nodes.
const LONG_ROW_NODES: f64 = 4.0;
/// Nodes over which the walk of an angle is measured; an error that lasts shows over up to a quarter of the recording, if the square of its
/// walk is this much larger there.
const WALKED: usize = 16;
const SHORTEST_SHARE: usize = 4;
const LASTING: f64 = 2.0;

/// Calibrates a recording of a described unit against a reference with this noise about each axis, 1 sigma, arcsec; estimated from the data
/// if it is `None`. The effects of `configuration` are subtracted. Without `windows` the whole recording is used.
///
/// # Errors
/// [`CalibrateError`]: the cause, and the data that were not used.
pub fn calibrate_described(
    configuration: &Configuration,
    counts: &AccumulatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    (reference, sigma_arcsec): (&ReferenceAttitude, Option<f64>),
) -> Result<Calibrated, CalibrateError> {
    let device = Arc::new(configuration.device.at_nodes(counts.interval_s));
    let parameters = CalibrationParameter::of_unit(&device);
    let configuration = Configuration { device, ..configuration.clone() };
    let attitude = AttitudeSource::Reference(reference, sigma_arcsec.map(|sigma_arcsec| [sigma_arcsec; 3]));
    let Evaluation { configuration, counts, prior, walks: configured, .. } =
        Evaluation::new(&configuration, counts, &attitude)?;
    let mut counts = counts.into_owned();
    let mut reference = Cow::Borrowed(reference);
    if reference.is_attitude {
        reference.to_mut().truth = Arc::new(without_coning(RecordedAttitude::clone(&reference.truth)));
    }
    let reference = &*reference;
    counts.leave_out_unknown(reference, &sensing_matrix(&configuration));
    let sizes = sizes(&configuration, &parameters, counts.is_received);
    let floored = |walk: &RandomWalks, angle: f64| RandomWalks {
        angle_arcsec_per_sqrt_s: walk.angle_arcsec_per_sqrt_s.max(angle),
        ..*walk
    };
    let mut walks: Vec<RandomWalks> = configured.iter().map(|walk| floored(walk, FIRST[0])).collect();
    let mut reference_sigma_arcsec = [sigma_arcsec.unwrap_or(FIRST[1]).max(MIN_NOISE[1]); 3];
    let (mut timing, mut about) = ([0.0; 2], prior.clone());
    let mut pass = 0;
    loop {
        pass += 1;
        let effects = EffectContribution::simulate(&configuration, &counts, || steps_of_reference(&counts, reference));
        let measured = CompensatedCounts { counts: &counts, effects: effects.as_ref() };
        let selected = select(&counts, windows, reference)?;
        let (observations, left_out) = with_reference(&measured, &selected, reference, reference_sigma_arcsec);
        let usable = |gyro: usize| observations.iter().filter(|own| own.counts[gyro].is_some()).count();
        if let Some(gyro) = counts.gyros.gyros().find(|gyro| usable(gyro.index()) < MIN_PARTS) {
            let (found, name) = (usable(gyro.index()), gyro.name());
            let why = format!("{name}: expected {MIN_PARTS} windows or more with usable counts, got {found}");
            return Err(CalibrateError::Unsolvable { source: SolveError::Undetermined(vec![why]), left_out });
        }
        let trials = TrialsOfObservations::new(&observations, reference, counts.offset_s(reference), sizes[1]);
        let mut solution =
            solve_described(&observations, &walks, (&prior, &about), parameters.clone(), (&sizes, &trials))
                .map_err(|source| CalibrateError::Unsolvable { source, left_out: left_out.clone() })?;
        let found = solution.timing.get_or_insert_default();
        let moved = [found[0].0, found[1].0];
        for (total, own) in timing.iter_mut().zip(found) {
            *total += own.0;
            own.0 = *total;
        }
        if pass == PASSES {
            return Ok(Calibrated {
                solution,
                first_order: Err("the hand method is of the default unit".to_owned()),
                observations,
                left_out,
                reference_sigma_arcsec,
                time_s: counts.start_s(),
                is_settled: true,
                noise: walks.iter().map(|walk| walk.angle_arcsec_per_sqrt_s).collect(),
            });
        }
        about.clone_from(&solution.calibrations);
        let noise = match has_long_rows(&counts, reference) {
            true => noise_of_windows(&solution, &walks),
            false => noise(&measured, reference, &solution, moved),
        };
        walks = configured.iter().zip(&noise).map(|(walk, own)| floored(walk, own.0.max(MIN_NOISE[0]))).collect();
        let white = noise.iter().map(|own| own.1).sum::<f64>() / noise.len() as f64;
        reference_sigma_arcsec = [sigma_arcsec.unwrap_or(white.sqrt()).max(MIN_NOISE[1]); 3];
        counts.start_ns -= (moved[0] * 1e9).round() as i64;
        counts.correct_clock(moved[1] * 1e6);
    }
}

/// Sigma of each parameter before the data, of the time offset and of the clock.
fn sizes(configuration: &Configuration, parameters: &[CalibrationParameter], is_received: bool) -> Vec<f64> {
    let range_arcsec_s = configuration.device.range_arcsec_s;
    let frequency = if is_received { RECEIVED_FREQUENCY } else { FREQUENCY };
    let own = parameters.iter().map(|own| own.of_described(range_arcsec_s));
    own.chain([OFFSET_S, frequency]).collect()
}

/// The windows of a list, or the interval that recording and reference have in common.
fn select(
    counts: &AccumulatedCounts,
    windows: Option<&[ManoeuvreWindow]>,
    reference: &ReferenceAttitude,
) -> Result<Vec<ManoeuvreWindow>, CalibrateError> {
    let most = MAX_PARTS.min(MAX_EQUATIONS / counts.gyros.heads());
    if let Some(windows) = windows {
        if windows.len() > MAX_WINDOWS {
            return Err(CalibrateError::TooMany(windows.len()));
        }
        return Ok(windows.to_vec());
    }
    let offset_s = counts.offset_s(reference);
    let (from_s, to_s) = (reference.truth.start_s() - offset_s, reference.truth.end_s() - offset_s);
    let cut = match has_long_rows(counts, reference) {
        true => cut_at(counts, &ends_s(&reference.truth, offset_s), most),
        false => {
            let trials: Vec<[f64; 2]> = match &reference.trials[..] {
                [] => vec![[from_s, to_s]],
                trials => trials.iter().map(|own| [own.from_s - offset_s, own.to_s - offset_s]).collect(),
            };
            let whole_s: f64 = trials.iter().map(|own| own[1] - own[0]).sum();
            let share = |own: &[f64; 2]| ((most as f64 * (own[1] - own[0]) / whole_s) as usize).max(1);
            let cut = trials.iter().flat_map(|own| cut_evenly(counts, own[0], own[1], share(own)));
            let named = |(index, own): (usize, ManoeuvreWindow)| {
                ManoeuvreWindow::new(&format!("window {}", index + 1), own.start_s, own.end_s)
            };
            cut.enumerate().map(named).collect()
        }
    };
    if cut.len() >= MIN_PARTS {
        return Ok(cut);
    }
    let at_s = counts.start_s();
    Err(CalibrateError::NoOverlap {
        from_s: at_s,
        to_s: at_s + counts.end_s(),
        reference_from_s: at_s + from_s,
        reference_to_s: at_s + to_s,
        min_s: (MIN_PARTS * crate::window::SHORTEST_NODES) as f64 * counts.interval_s,
    })
}

/// Instants at which the angle of long rows is known, s since node 0: within rest, a quarter before its ends, or the ends of rows without it.
fn ends_s(truth: &RecordedAttitude, offset_s: f64) -> Vec<f64> {
    let rows: Vec<(f64, [f64; 3])> = truth.rows().collect();
    let is_rest = |ends: &&[(f64, [f64; 3])]| ends[0].1 == ends[1].1 && truth.is_known(0.5 * (ends[0].0 + ends[1].0));
    let rest = rows.windows(2).filter(is_rest);
    let within = rest.flat_map(|ends| [0.25, 0.75].map(|share| ends[0].0 + share * (ends[1].0 - ends[0].0) - offset_s));
    let within: Vec<f64> = within.collect();
    if within.len() > MIN_PARTS { within } else { rows.iter().map(|row| row.0 - offset_s).collect() }
}

/// True if the motion between nodes is not known.
fn has_long_rows(counts: &AccumulatedCounts, reference: &ReferenceAttitude) -> bool {
    reference.row_s() > LONG_ROW_NODES * counts.interval_s
}

/// Noise of each gyro from the residuals of the windows, all of it taken for an angle random walk, arcsec/√s and arcsec².
fn noise_of_windows(solution: &Solution, walks: &[RandomWalks]) -> Vec<(f64, f64)> {
    let of_gyro = |(gyro, walk): (usize, &RandomWalks)| {
        let own = solution.residuals.iter().filter(|own| own.gyro.index() == gyro && own.sigma_arcsec > 0.0);
        let squares: Vec<f64> = own.map(|own| (own.arcsec / own.sigma_arcsec).powi(2)).collect();
        let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
        (walk.angle_arcsec_per_sqrt_s * mean.sqrt(), 0.0)
    };
    walks.iter().enumerate().map(of_gyro).collect()
}

/// Noise of each gyro beside the reference: angle random walk, arcsec/√s, and the variance of white noise over the rounding, arcsec². From the
/// residual of a solution with these corrections of the times.
fn noise(
    measured: &CompensatedCounts,
    reference: &ReferenceAttitude,
    solution: &Solution,
    [lag_s, fast]: [f64; 2],
) -> Vec<(f64, f64)> {
    let (counts, truth) = (measured.counts, &reference.truth);
    let (offset_s, interval_s) = (counts.offset_s(reference), counts.interval_s);
    let axes = sensing_axes(&solution.parameters, &solution.calibrations);
    let mut near = 0;
    let turned: Vec<Option<[f64; 3]>> = counts
        .node_s
        .iter()
        .map(|&node_s| {
            let t_s = node_s * (1.0 - fast) - lag_s + offset_s;
            let is_inside = t_s >= truth.start_s() && t_s <= truth.end_s() && truth.is_known(t_s);
            is_inside.then(|| truth.at(t_s, &mut near).0)
        })
        .collect();
    let trials: Vec<usize> = counts.node_s.iter().map(|node_s| reference.trial_at(node_s + offset_s)).collect();
    let further = |trial: usize| {
        let name = reference.trials.get(trial).map(|own| &own.name);
        solution.trial_drifts.iter().find(|own| Some(&own.trial) == name)
    };
    let of_gyro = |gyro: usize| {
        let beside = |trial: usize| further(trial).and_then(|own| own.drifts[gyro]).map_or(0.0, |own| own.0);
        let beside: Vec<f64> = (0..reference.trials.len().max(1)).map(beside).collect();
        let drift = |trial: &usize| solution.calibrations[gyro].drift_arcsec_per_half_s + beside[*trial];
        let drifted: Vec<f64> = trials
            .iter()
            .scan(0.0, |sum, trial| {
                *sum += drift(trial) * (interval_s / SAMPLE_INTERVAL_S);
                Some(*sum)
            })
            .collect();
        let calibration = &solution.calibrations[gyro];
        let mut is_broken = vec![false; turned.len()];
        for own in counts.breaks.iter().filter(|own| own.gyros[gyro]) {
            is_broken[own.from..=own.to.min(turned.len() - 1)].fill(true);
        }
        let residual = |node: usize| {
            let angle = measured.of_gyro(gyro, node) * calibration.scale_factor + drifted[node];
            Some(angle - dot(axes[gyro], turned[node]?)).filter(|_| !is_broken[node])
        };
        let residuals: Vec<Option<f64>> = (0..turned.len()).map(residual).collect();
        let over = |nodes: usize| {
            let pairs = residuals.windows(nodes + 1).filter(|own| own.iter().all(Option::is_some));
            let mut squares: Vec<f64> = pairs.filter_map(|own| Some((own[nodes]? - own[0]?).powi(2))).collect();
            variance(&mut squares).unwrap_or(0.0)
        };
        let one = over(1);
        let walk_over = |nodes: usize| (over(nodes) - one) / ((nodes - 1) as f64 * interval_s);
        // An error that lasts, such as the rounding of a steady rate, adds more over a longer time than a walk does.
        let longer = (1..).map(|power| WALKED << power).take_while(|nodes| nodes * SHORTEST_SHARE < turned.len());
        let walk = longer
            .map(walk_over)
            .fold(walk_over(WALKED).max(0.0), |walk, own| if own > LASTING * walk { own } else { walk });
        let rounding = ROUNDING_VARIANCE * (counts.rounded_to[gyro] * calibration.scale_factor).powi(2);
        (walk.sqrt(), (0.5 * (one - walk * interval_s) - rounding).max(0.0))
    };
    (0..counts.gyros.heads()).map(of_gyro).collect()
}
