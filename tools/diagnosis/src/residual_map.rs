//! Residual map: significance of each variable in the residual, on each gyro, over the recording and in each of its motion segments.
//!
//! Each variable represents a rate error in proportion to it. Its whitened integral is fitted to the whitened residual with the
//! calibration parameters projected out; the significance is the fitted amplitude in sigmas.

use std::f64::consts::TAU;

use geu_model::temperature::SENSOR_NOMINAL_C;
use geu_model::units::{ORBIT_S, RAD_PER_DEG, S_PER_DAY};
use rayon::prelude::*;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{BLOCK, CHANNELS, MeasuredData, ModelRun, TIMING};
use crate::motion_segments::MotionSegment;
use crate::normal_equations::{NormalEquations, Nuisance};
use crate::signature_bank::Column;
use crate::small_motions::{blocks_of_axes, small_arcsec};
use crate::whitening::NoiseModel;

/// Minimum share of a variable's square in a segment, relative to the segment's share of the recording.
const MIN_SHARE: f64 = 0.1;

/// The motion and temperatures of one sample.
struct Inputs {
    rate: [f64; 3],
    acceleration: [f64; 3],
    electronics_c: f64,
    /// Above nominal.
    sensor_k: f64,
    theta_deg: f64,
    time_s: f64,
}

impl Inputs {
    fn orbit_rad(&self) -> f64 {
        TAU * self.time_s / ORBIT_S
    }
}

const COUNT: usize = 22;
/// Number of variables, the first ones, to which calibration parameters are in proportion.
pub const CALIBRATED: usize = 4;
/// Name of a variable and its value.
type Variable = (&'static str, fn(&Inputs) -> f64);

/// The variables, named as in formulas if they can be in one; `constant` is a drift.
const TABLE: [Variable; COUNT] = [
    ("constant", |_| 1.0),
    ("rate_x", |now| now.rate[0]),
    ("rate_y", |now| now.rate[1]),
    ("rate_z", |now| now.rate[2]),
    ("abs(rate_x)", |now| now.rate[0].abs()),
    ("abs(rate_y)", |now| now.rate[1].abs()),
    ("abs(rate_z)", |now| now.rate[2].abs()),
    ("rate_x^2", |now| now.rate[0].powi(2)),
    ("rate_y^2", |now| now.rate[1].powi(2)),
    ("rate_z^2", |now| now.rate[2].powi(2)),
    ("rate_x^3", |now| now.rate[0].powi(3)),
    ("rate_y^3", |now| now.rate[1].powi(3)),
    ("rate_z^3", |now| now.rate[2].powi(3)),
    ("acceleration_x", |now| now.acceleration[0]),
    ("acceleration_y", |now| now.acceleration[1]),
    ("acceleration_z", |now| now.acceleration[2]),
    ("temperature", |now| now.electronics_c),
    ("sensor_temperature", |now| now.sensor_k),
    ("theta", |now| now.theta_deg - 90.0),
    ("time", |now| now.time_s / S_PER_DAY),
    ("sin(orbit)", |now| now.orbit_rad().sin()),
    ("cos(orbit)", |now| now.orbit_rad().cos()),
];

/// Names of the variables.
pub const VARIABLES: [&str; COUNT] = {
    let (mut names, mut index) = ([""; COUNT], 0);
    while index < COUNT {
        names[index] = TABLE[index].0;
        index += 1;
    }
    names
};

/// Threshold of a significance, sigmas: noise does not reach it in a thousand values.
pub const SIGNIFICANT: f64 = 5.0;

/// Significance of each of [`VARIABLES`]; `None` if the data do not determine it.
pub type Significances = [Option<f64>; COUNT];

/// Significances in the residual of one model.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualMap {
    /// On each gyro over the whole recording.
    pub whole: [Significances; TIMING],
    /// On each gyro in each segment, without projecting out the calibration parameters: they explain a variable only if they do so
    /// over the whole recording.
    pub segments: [Vec<Significances>; TIMING],
}

/// Residual maps of several models, which have the estimated lag and the same noise.
pub fn residual_maps<const MODELS: usize>(
    case: &DiagnosisCase,
    noise: &[NoiseModel; CHANNELS],
    models: [&ModelRun; MODELS],
    segments: &[MotionSegment],
) -> [ResidualMap; MODELS] {
    let measured = case.measured;
    // A smoothed motion contains the noise of the gyros.
    let evidence = measured.smoothed.as_ref().zip(models.first()).map(|(_, path)| {
        let small_arcsec = small_arcsec(measured, &case.nominal.device, noise);
        let largest = small_arcsec.iter().take(measured.gyros().heads()).copied().fold(0.0, f64::max);
        blocks_of_axes(measured, path, largest)
    });
    let variables = variables(measured, evidence);
    // Without the lag, the last nuisance parameter: it is common to all gyros and would spread the residual of one to the others.
    let mut nuisances = case.nuisances[..case.nuisances.len().saturating_sub(1)].to_vec();
    if measured.smoothed.is_some() {
        // Else the difference of a calibration parameter and its variable would be the small motions.
        let heads = 0..measured.gyros().heads();
        let on_gyro = |gyro: usize, own: &Column| -> Nuisance {
            std::array::from_fn(|channel| (channel == gyro).then(|| own.values.clone()))
        };
        nuisances.extend(heads.flat_map(|gyro| variables[1..CALIBRATED].iter().map(move |own| on_gyro(gyro, own))));
    }
    models.map(|model| {
        let residual = case.measured.residual(model);
        let normal = NormalEquations::new(case.whitenings(noise), &residual, &nuisances, &case.a_priori(&[]));
        let left = normal.projected_residual();
        let on_gyro = |gyro: usize| -> Vec<(Option<f64>, Vec<Option<f64>>)> {
            let significance = |column: &Column| {
                let white = normal.white(gyro, column);
                let gain = normal.gain(&normal.products(gyro, &white));
                (
                    gain.map(|gain| gain.size / gain.sigma),
                    in_segments(&left[gyro], &white.values, segments, case.measured.block_s()),
                )
            };
            variables.iter().map(significance).collect()
        };
        let gyros: Vec<_> = (0..case.measured.gyros().heads()).into_par_iter().map(on_gyro).collect();
        let in_segment = |gyro: usize, segment: usize| std::array::from_fn(|index| gyros[gyro][index].1[segment]);
        let has = |gyro: usize| gyro < gyros.len();
        ResidualMap {
            whole: std::array::from_fn(|gyro| std::array::from_fn(|index| gyros.get(gyro)?[index].0)),
            segments: std::array::from_fn(|gyro| {
                let own = (0..segments.len()).filter(|_| has(gyro));
                own.map(|segment| in_segment(gyro, segment)).collect()
            }),
        }
    })
}

/// Significance of a whitened variable in a whitened residual, in each segment.
fn in_segments(left: &[f64], white: &[f64], segments: &[MotionSegment], block_s: f64) -> Vec<Option<f64>> {
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let (whole, blocks) = (squares(white), white.len().max(1) as f64);
    let significance = |segment: &MotionSegment| {
        let (left, white) = (left.get(segment.blocks(block_s))?, white.get(segment.blocks(block_s))?);
        let own = squares(white);
        let is_determined = own > 0.0 && own >= MIN_SHARE * whole * white.len() as f64 / blocks;
        is_determined.then(|| left.iter().zip(white).map(|(left, white)| left * white).sum::<f64>() / own.sqrt())
    };
    segments.iter().map(significance).collect()
}

/// The integral of each variable over time, averaged over blocks, with the motion about each axis in the blocks of `evidence` alone, if given.
fn variables(measured: &MeasuredData, evidence: Option<[Vec<bool>; 3]>) -> [Column; COUNT] {
    let moves = |axis: usize, node: usize| evidence.as_ref().is_none_or(|blocks| blocks[axis][(node - 1) / BLOCK]);
    let about_axes = |node: usize, value: &dyn Fn(usize) -> f64| -> [f64; 3] {
        std::array::from_fn(|axis| if moves(axis, node) { value(axis) } else { 0.0 })
    };
    let mut columns: [Column; COUNT] =
        std::array::from_fn(|_| Column { from: 0, values: Vec::with_capacity(measured.block_count()) });
    let interval_s = measured.interval_s();
    let (mut near, mut sums, mut averages) = (0, [0.0; COUNT], [0.0; COUNT]);
    let (mut angle, mut motion) = measured.reference.at(0.0, &mut near);
    for node in 1..=measured.block_count() * BLOCK {
        let (angle_before, before) = (angle, motion);
        (angle, motion) = measured.reference.at(node as f64 * interval_s, &mut near);
        let [rate_before, rate_after] = [before, motion].map(|motion| motion.rate_control_arcsec_s);
        let last = |celsius: &[f64]| celsius.get(node).or(celsius.last()).copied();
        let now = Inputs {
            rate: about_axes(node, &|axis| (angle[axis] - angle_before[axis]) / interval_s),
            acceleration: about_axes(node, &|axis| (rate_after[axis] - rate_before[axis]) / interval_s),
            electronics_c: last(&measured.counts.electronics_c).unwrap_or(0.0),
            // Zero if unavailable; the calibration parameters project out a constant.
            sensor_k: last(&measured.counts.sensor_c).map_or(0.0, |sensor_c| sensor_c - SENSOR_NOMINAL_C),
            theta_deg: 0.5 * (before.theta_rad + motion.theta_rad) / RAD_PER_DEG,
            time_s: (node as f64 - 0.5) * interval_s,
        };
        for ((sum, average), (_, value)) in sums.iter_mut().zip(&mut averages).zip(TABLE) {
            *sum += value(&now) * interval_s;
            *average += *sum / BLOCK as f64;
        }
        if node % BLOCK == 0 {
            for (column, average) in columns.iter_mut().zip(&mut averages) {
                column.values.push(std::mem::take(average));
            }
        }
    }
    columns
}

/// The most significant variable and its significance.
pub fn strongest(significances: &Significances) -> Option<(usize, f64)> {
    let known = significances.iter().enumerate().filter_map(|(variable, own)| Some((variable, (*own)?)));
    known.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
}
