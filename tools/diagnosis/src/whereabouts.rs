//! Where the data leave a model: along which variable on each gyro, over the whole recording and in each of its stretches.
//!
//! A variable is taken as an error of rate in proportion to it. Its integral, whitened like the residual, is set against what is left
//! of that beside the sixteen; the number is the size that fits, in its sigmas.

use std::f64::consts::TAU;

use geu_model::temperature::SENSOR_NOMINAL_C;
use geu_model::units::{ORBIT_S, RAD_PER_DEG, S_PER_DAY, SAMPLE_INTERVAL_S};
use rayon::prelude::*;

use crate::bank::Column;
use crate::measured::{BLOCK, CHANNELS, MeasuredData, Series, TIMING};
use crate::normal::NormalEquations;
use crate::state::DiagnosisCase;
use crate::stretches::MotionSegment;
use crate::whitening::NoiseModel;

/// A variable of which a stretch holds less than this share of what its length would hold is not to be told in it.
const LEAST_SHARE: f64 = 0.1;

/// The variables, as formulas spell them where they can be in one; `constant` is a drift.
pub const VARIABLES: [&str; 22] = [
    "constant",
    "rate_x",
    "rate_y",
    "rate_z",
    "abs(rate_x)",
    "abs(rate_y)",
    "abs(rate_z)",
    "rate_x^2",
    "rate_y^2",
    "rate_z^2",
    "rate_x^3",
    "rate_y^3",
    "rate_z^3",
    "acceleration_x",
    "acceleration_y",
    "acceleration_z",
    "temperature",
    "sensor_temperature",
    "theta",
    "time",
    "sin(orbit)",
    "cos(orbit)",
];

/// Sigmas beyond which it is told: in a thousand places chance never gets there.
pub const STANDS_OUT: f64 = 5.0;

/// For each of [`VARIABLES`], how much of it there is, in sigmas; nothing where the data cannot tell.
pub type Significances = [Option<f64>; VARIABLES.len()];

/// Where the data leave one model.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualMap {
    /// On each gyro over the whole recording, beside the sixteen.
    pub whole: [Significances; TIMING],
    /// On each gyro in each stretch. The sixteen are not taken out of the variables here: what they can explain all through a
    /// recording they need not in one stretch of it.
    pub stretches: [Vec<Significances>; TIMING],
}

/// Where the data leave each of several models, run with the lag that was found, with the same noise.
pub fn whereabouts<const MODELS: usize>(
    case: &DiagnosisCase,
    noise: &[NoiseModel; CHANNELS],
    models: [&Series; MODELS],
    stretches: &[MotionSegment],
) -> [ResidualMap; MODELS] {
    let variables = variables(case.measured);
    // The lag, the last of them, is common to all gyros: left free, what is on one would show on the others.
    let nuisances = &case.nuisances[..case.nuisances.len().saturating_sub(1)];
    let of = |model: &Series| {
        let normal = NormalEquations::new(case.whitenings(noise), &case.measured.residual(model), nuisances);
        let left = normal.left();
        let of_gyro = |gyro: usize| {
            let of_variable = |column: &Column| -> (Option<f64>, Vec<Option<f64>>) {
                let gain = normal.gain(&normal.products_of(gyro, column));
                let white = normal.white(gyro, column).values;
                (gain.map(|gain| gain.size / gain.sigma), in_stretches(&left[gyro], &white, stretches))
            };
            let told: Vec<_> = variables.iter().map(of_variable).collect();
            let whole: Significances = std::array::from_fn(|variable| told[variable].0);
            let of_stretch =
                |stretch: usize| -> Significances { std::array::from_fn(|variable| told[variable].1[stretch]) };
            (whole, (0..stretches.len()).map(of_stretch).collect::<Vec<_>>())
        };
        let told: Vec<(Significances, Vec<Significances>)> = (0..TIMING).into_par_iter().map(of_gyro).collect();
        ResidualMap {
            whole: std::array::from_fn(|gyro| told[gyro].0),
            stretches: std::array::from_fn(|gyro| told[gyro].1.clone()),
        }
    };
    models.map(of)
}

/// How much of a whitened variable a whitened residual holds in each stretch, in sigmas.
fn in_stretches(left: &[f64], white: &[f64], stretches: &[MotionSegment]) -> Vec<Option<f64>> {
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let (whole, blocks) = (squares(white), white.len().max(1) as f64);
    let of = |stretch: &MotionSegment| {
        let (left, white) = (left.get(stretch.blocks())?, white.get(stretch.blocks())?);
        let own = squares(white);
        let is_told = own > 0.0 && own >= LEAST_SHARE * whole * white.len() as f64 / blocks;
        is_told.then(|| left.iter().zip(white).map(|(left, white)| left * white).sum::<f64>() / own.sqrt())
    };
    stretches.iter().map(of).collect()
}

/// The integral of each variable over time, averaged over blocks.
fn variables(measured: &MeasuredData) -> [Column; VARIABLES.len()] {
    let mut columns: [Column; VARIABLES.len()] =
        std::array::from_fn(|_| Column { from: 0, values: Vec::with_capacity(measured.block_count()) });
    let (mut near, mut sums, mut averages) = (0, [0.0; VARIABLES.len()], [0.0; VARIABLES.len()]);
    let (mut angle, mut moment) = measured.reference.at(0.0, &mut near);
    for node in 1..=measured.block_count() * BLOCK {
        let before = (angle, moment);
        (angle, moment) = measured.reference.at(node as f64 * SAMPLE_INTERVAL_S, &mut near);
        let rate: [f64; 3] = std::array::from_fn(|axis| (angle[axis] - before.0[axis]) / SAMPLE_INTERVAL_S);
        let acceleration: [f64; 3] = std::array::from_fn(|axis| {
            (moment.rate_control_arcsec_s[axis] - before.1.rate_control_arcsec_s[axis]) / SAMPLE_INTERVAL_S
        });
        let time_s = (node as f64 - 0.5) * SAMPLE_INTERVAL_S;
        let (sin, cos) = (TAU * time_s / ORBIT_S).sin_cos();
        let last = |celsius: &[f64]| celsius.get(node).or(celsius.last()).copied();
        let surroundings = [
            last(&measured.counts.electronics_c).unwrap_or(0.0),
            // Nothing where none is told: a constant then, of which the sixteen leave nothing.
            last(&measured.counts.sensor_c).map_or(0.0, |sensor_c| sensor_c - SENSOR_NOMINAL_C),
            0.5 * (before.1.theta_rad + moment.theta_rad) / RAD_PER_DEG - 90.0,
            time_s / S_PER_DAY,
            sin,
            cos,
        ];
        let values = [1.0]
            .into_iter()
            .chain(rate)
            .chain(rate.map(f64::abs))
            .chain(rate.map(|rate| rate.powi(2)))
            .chain(rate.map(|rate| rate.powi(3)))
            .chain(acceleration)
            .chain(surroundings);
        for ((sum, average), value) in sums.iter_mut().zip(&mut averages).zip(values) {
            *sum += value * SAMPLE_INTERVAL_S;
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

/// The variable that stands out most, and by how much.
pub fn strongest(sigmas: &Significances) -> Option<(usize, f64)> {
    let told = sigmas.iter().enumerate().filter_map(|(variable, sigmas)| Some((variable, (*sigmas)?)));
    told.max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
}
