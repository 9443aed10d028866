//! The motion of a recording by the rows of its reference, with that of the gyros where rows are missing, slow or noisy.
//!
//! Fast rows that are exact stay as they are, and gaps between them are filled. Others are smoothed.

use geu_calibration::AccumulatedCounts;
use geu_calibration::track::rotation_of_heads;
use geu_calibration::transfer::sensing_matrix;
use geu_checks::median;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_recording::ReferenceAttitude;
use nalgebra::Vector3;

use super::BLOCK;
use super::filled_gaps::{filled, lone_rows};
use super::reference_sigma::ReferenceSigma;
use super::relative_rows::{GyroMotion, is_white, rows, second_difference_sigma};
use super::smoothed_reference::{SmoothedReference, angles, of_block, smooth};
use super::smoothing::REACH_ROWS;
use super::turns::recorded;

/// Spacing of rows up to which exact ones show the motion between them, in intervals of the nodes.
const MAX_SPACING: f64 = 1.2;
/// Sigmas of a row's angle, in counts, below which fast rows are exact: about the axis with the smallest, where rounding shows 0.09, and about
/// the one with the largest, where small motions that a gyro does not sense show as much as noise.
const EXACT_COUNTS: [f64; 2] = [0.15, 0.6];
/// A row farther from those beside it, in sigmas, is a glitch, if it is as far as several roundings.
pub const GLITCH_SIGMAS: f64 = 8.0;
pub const GLITCH_ARCSEC: f64 = 4.8;
/// Size of a count from which its rounding is smoothed out of the motion: a smaller one is less than the noise of a gyro within a block.
const COARSE_ARCSEC: f64 = 0.5;

/// The motion of a recording by its reference.
#[derive(Debug, Default)]
pub struct ReferenceMotion {
    /// The motion; `None` if it is that of the rows as they are.
    pub motion: Option<RecordedAttitude>,
    /// Traces of the smoothing, if the rows are noisy or slow.
    pub smoothed: Option<SmoothedReference>,
    /// False for each block without rows; empty if `motion` is `None`.
    pub has_rows: Vec<bool>,
    /// The stated sigmas of the rows beside the scatter found, if there are any.
    pub sigma: Option<ReferenceSigma>,
    /// Times of the rows that are left out.
    pub glitches_s: Vec<f64>,
}

impl ReferenceMotion {
    /// The motion by the rows of a reference, `moved` to the time scale of the counts.
    pub fn new(
        counts: &AccumulatedCounts,
        moved: &RecordedAttitude,
        reference: &ReferenceAttitude,
        nominal: &Configuration,
        blocks: usize,
    ) -> ReferenceMotion {
        let (matrix, sigma_arcsec) = (sensing_matrix(nominal), &reference.sigma_arcsec[..]);
        // Two gyros do not show a motion.
        if rotation_of_heads(&matrix, counts.gyros).is_none() {
            return ReferenceMotion::default();
        }
        let is_coarse = counts.rounded_to.iter().all(|count| *count >= COARSE_ARCSEC);
        let gyros = GyroMotion::new(counts, moved, &matrix, nominal, is_coarse);
        let rows = rows(counts, &gyros, moved, sigma_arcsec).filter(|rows| rows.len() > 2 * REACH_ROWS);
        let Some(mut rows) = rows else { return ReferenceMotion::default() };
        let scale = Vector3::from_fn(|axis, _| second_difference_sigma(&rows, axis));
        let largest = rows.iter().fold(Vector3::zeros(), |largest, row| largest.sup(&row.sigma)).component_mul(&scale);
        let sigma = (!sigma_arcsec.is_empty()).then(|| ReferenceSigma::new(sigma_arcsec, scale));
        let spacing_s = median(&mut rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect::<Vec<_>>());
        let block_s = BLOCK as f64 * counts.interval_s;
        let [one, all] = EXACT_COUNTS.map(|counted| counted * counts.rounded_to.iter().copied().fold(0.0, f64::max));
        let is_quiet = match is_coarse {
            true => largest.min() < one && largest.max() < all,
            false => !is_white(&rows, block_s / spacing_s),
        };
        let is_exact = is_quiet && spacing_s <= MAX_SPACING * counts.interval_s;
        let lone = if is_exact && reference.is_attitude { lone_rows(&rows, scale) } else { Vec::new() };
        lone.into_iter().for_each(|row| rows[row].is_used = false);
        let has_gaps = moved.gaps_s().len() > moved.unknown_s().count() || rows.iter().any(|row| !row.is_used);
        let fits = ReferenceMotion { sigma, ..ReferenceMotion::default() };
        if is_exact && !has_gaps {
            return fits;
        }
        if !is_exact {
            smooth(&mut rows, scale, block_s, is_coarse);
        }
        let has_rows = (0..blocks).map(|block| of_block(&rows, &counts.node_s, block).next().is_some()).collect();
        let glitches_s = rows.iter().filter(|row| !row.is_used).map(|row| row.t_s).collect();
        let gaps = ReferenceMotion { has_rows, glitches_s, ..fits };
        if is_exact {
            let motion = filled(&rows, counts, &gyros, moved, spacing_s);
            return ReferenceMotion { motion, ..gaps };
        }
        let angles = angles(&rows, &counts.node_s, &gyros);
        let scale_factors: Vec<f64> = nominal.gyros.iter().map(|gyro| gyro.calibration.scale_factor).collect();
        let along = (&counts.node_s[..], &angles[..]);
        let smoothed =
            SmoothedReference::new(&rows, along, (&matrix, &scale_factors), (scale, spacing_s / block_s), blocks);
        let motion = recorded(&counts.node_s, &angles, moved);
        ReferenceMotion { smoothed: motion.as_ref().map(|_| smoothed), motion, ..gaps }
    }
}
