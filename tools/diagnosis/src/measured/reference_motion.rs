//! The motion of a recording by the rows of its reference, with that of the gyros where rows are missing, slow or noisy.
//!
//! Fast rows that are exact stay as they are, and gaps between them are filled. Others are smoothed.

use geu_calibration::AccumulatedCounts;
use geu_calibration::track::rotation_of_heads;
use geu_calibration::transfer::sensing_matrix;
use geu_checks::median;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::units::PPM;
use geu_recording::ReferenceAttitude;
use nalgebra::Vector3;

use super::filled_gaps::{filled, leave_out_wrong};
use super::reference_sigma::ReferenceSigma;
use super::relative_rows::{self, GyroMotion, Row, is_noisy, is_white, second_difference_sigma};
use super::smoothed_reference::{SmoothedReference, angles, of_block, smooth};
use super::smoothing::REACH_ROWS;
use super::turns::recorded;
use super::{BLOCK, nodes};

/// Spacing of rows up to which exact ones show the motion between them, in intervals of the nodes.
const MAX_SPACING: f64 = 1.2;
/// Sigma of a row's angle, in counts, below which fast rows are exact: what is left of the rounding in the motion by the gyros shows 0.09.
const EXACT_COUNTS: f64 = 0.15;
/// Sigma of exact rows beside a gyro that does not sense a motion: a limit cycle shows 0.5.
const UNSENSED_COUNTS: f64 = 0.6;
/// A row farther from those beside it than this many sigmas, and than this distance, is a glitch.
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
    /// False for each block without rows, or beyond the first or the last of them; empty if `motion` is `None`.
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
        let nominal = &with_clock(nominal);
        let (matrix, sigma_arcsec) = (sensing_matrix(nominal), &reference.sigma_arcsec[..]);
        // Two gyros do not show a motion.
        if rotation_of_heads(&matrix, counts.gyros).is_none() {
            return ReferenceMotion::default();
        }
        let is_coarse = counts.rounded_to.iter().all(|count| *count >= COARSE_ARCSEC);
        let gyros = GyroMotion::new(counts, moved, &matrix, nominal, is_coarse);
        let rows = relative_rows::rows(counts, &gyros, moved, sigma_arcsec).filter(|rows| rows.len() > 2 * REACH_ROWS);
        let Some(mut rows) = rows else { return ReferenceMotion::default() };
        let scale = Vector3::from_fn(|axis, _| second_difference_sigma(&rows, axis));
        let largest = rows.iter().fold(Vector3::zeros(), |largest, row| largest.sup(&row.sigma)).component_mul(&scale);
        let sigma = (!sigma_arcsec.is_empty()).then(|| ReferenceSigma::new(sigma_arcsec, scale));
        let spacing_s = median(&mut rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect::<Vec<_>>());
        let block_s = BLOCK as f64 * counts.interval_s;
        let count = counts.rounded_to.iter().copied().fold(f64::INFINITY, f64::min);
        let is_exact_about = |axis: usize| {
            let is_unsensed = || largest[axis] < UNSENSED_COUNTS * count && !is_noisy(&rows, axis);
            largest[axis] < EXACT_COUNTS * count || is_unsensed()
        };
        let is_quiet = if is_coarse { (0..3).all(is_exact_about) } else { !is_white(&rows, block_s / spacing_s) };
        let given = ReferenceMotion { sigma, ..ReferenceMotion::default() };
        let has_wrong = reference.is_attitude && leave_out_wrong(&mut rows, scale);
        if is_quiet && spacing_s <= MAX_SPACING * counts.interval_s {
            let has_gaps = moved.gaps_s().len() > moved.unknown_s().count();
            if !has_wrong && !has_gaps {
                return given;
            }
            // At a jump of the rate the motion without rounding is off.
            let gyros = GyroMotion::new(counts, moved, &matrix, nominal, false);
            let Some(mut rows) = relative_rows::rows(counts, &gyros, moved, sigma_arcsec) else { return given };
            if !leave_out_wrong(&mut rows, scale) && !has_gaps {
                return given;
            }
            let Some(motion) = filled(&rows, counts, &gyros, moved, spacing_s) else { return given };
            let has_rows = has_rows(&rows, &counts.node_s, blocks, true);
            return ReferenceMotion { motion: Some(motion), has_rows, glitches_s: glitches_s(&rows), ..given };
        }
        smooth(&mut rows, scale, block_s, is_coarse);
        let angles = angles(&rows, &counts.node_s, &gyros);
        let scale_factors: Vec<f64> = nominal.gyros.iter().map(|gyro| gyro.calibration.scale_factor).collect();
        let along = (&counts.node_s[..], &angles[..]);
        let smoothed =
            SmoothedReference::new(&rows, along, (&matrix, &scale_factors), (scale, spacing_s / block_s), blocks);
        let Some(motion) = recorded(&counts.node_s, &angles, moved) else { return given };
        let has_rows = has_rows(&rows, &counts.node_s, blocks, false);
        let (motion, smoothed) = (Some(motion), Some(smoothed));
        ReferenceMotion { motion, smoothed, has_rows, glitches_s: glitches_s(&rows), ..given }
    }
}

/// The configuration with the factor that its clock has on counts as a part of the calibration ([`geu_model::effect::Head::counts`]).
fn with_clock(configuration: &Configuration) -> Configuration {
    let mut with = configuration.clone();
    let factor = 1.0 - configuration.unit.constant.clock_frequency.ppm * PPM;
    for calibration in with.gyros.iter_mut().map(|gyro| &mut gyro.calibration) {
        calibration.scale_factor *= factor;
        calibration.drift_arcsec_per_half_s *= factor;
    }
    with
}

/// For each block true if it has a row; with `all_nodes`, and if all its nodes are between the first and the last row of a part of which all turns
/// are known.
fn has_rows(rows: &[Row], node_s: &[f64], blocks: usize, all_nodes: bool) -> Vec<bool> {
    let ends_s = |part: &[Row]| {
        let mut used_s = part.iter().filter(|row| row.is_used).map(|row| row.t_s);
        let first_s = used_s.next()?;
        Some([first_s, used_s.next_back().unwrap_or(first_s)])
    };
    let parts_s: Vec<[f64; 2]> = rows.chunk_by(|_, next| !next.begins).filter_map(ends_s).collect();
    let is_within = |node: usize| {
        let begun = parts_s.partition_point(|part_s| part_s[0] <= node_s[node]);
        parts_s[..begun].last().is_some_and(|part_s| node_s[node] <= part_s[1])
    };
    let has_row = |block: usize| of_block(rows, node_s, block).next().is_some();
    (0..blocks).map(|block| has_row(block) && (!all_nodes || nodes(block).all(is_within))).collect()
}

/// Times of the rows that are left out.
fn glitches_s(rows: &[Row]) -> Vec<f64> {
    rows.iter().filter(|row| !row.is_used).map(|row| row.t_s).collect()
}
