//! The motion between the rows of a reference that is noisy or slow, from the gyros themselves.
//!
//! Effects that depend on a rate need the motion within a sample, and a star tracker does not show it: 3″ of noise each second are a
//! rate of 4″/s. The gyros' increments show it. The attitude of the reference relative to that of the gyros changes slowly in inertial
//! space, where it is smoothed. The residual is still that against the rows: in each block, their departure from the smoothed motion is
//! subtracted again.
//!
//! A turn carries the noise of the smoothed attitude from axis to axis, so that the accumulated angles walk: `walk`.
//!
//! Stated sigmas weight the rows. Their scale is that of the scatter found, as without a statement: a common factor changes no weight.

use crate::significance::MEDIAN_OF_NORMAL;
use geu_checks::median;
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::{MatrixXx3, Vector3};

use super::reference_motion::{GLITCH_ARCSEC, GLITCH_SIGMAS};
use super::relative_rows::{GyroMotion, Row};
use super::smoothing::{LineSums, Point, REACHES, SHORT_REACHES};
use super::turns::{accumulated, turn};
use super::{TIMING, nodes};

/// Traces of the smoothing in a reference.
#[derive(Debug)]
pub struct SmoothedReference {
    /// Mean departure of the rows within each block from the smoothed motion, counts of each gyro; 0 for a block without rows.
    pub departure: Vec<[f64; TIMING]>,
    /// Growth of the accumulated angle of each gyro over a block by the noise of the reference: 1 sigma by that about each axis, counts.
    pub walk: [Vec<Vector3<f64>>; TIMING],
    /// Variance of the white noise of each block, as a multiple of that of rows of the mean weight: 1 without stated sigmas.
    pub white_scale: [Vec<f64>; TIMING],
}

/// Smooths rows of which the sigma is `scale` times the stated one. A glitch is no longer used.
pub fn smooth(rows: &mut [Row], scale: Vector3<f64>, block_s: f64, is_coarse: bool) {
    let reaches = if is_coarse { REACHES } else { SHORT_REACHES };
    by_lines(rows, None, (block_s, reaches));
    let scatter: [f64; 3] = std::array::from_fn(|axis| {
        let mut sizes: Vec<f64> = rows.iter().map(|row| row.departure()[axis].abs() / row.sigma[axis]).collect();
        median(&mut sizes) / MEDIAN_OF_NORMAL
    });
    for row in rows.iter_mut() {
        let departure = row.departure();
        let limit = |axis: usize| (GLITCH_SIGMAS * scatter[axis] * row.sigma[axis]).max(GLITCH_ARCSEC);
        row.is_used &= (0..3).all(|axis| departure[axis].abs() <= limit(axis));
    }
    by_lines(rows, Some(scale), (block_s, reaches));
}

/// Accumulated angles about the control axes at the nodes along the smoothed rows.
pub fn angles(rows: &[Row], node_s: &[f64], gyros: &GyroMotion) -> Vec<Vector3<f64>> {
    let mut place = 0;
    let relative = |t_s: f64| {
        while place + 2 < rows.len() && rows[place + 1].t_s < t_s {
            place += 1;
        }
        let (from, to) = (&rows[place], &rows[place + 1]);
        let share = ((t_s - from.t_s) / (to.t_s - from.t_s)).clamp(0.0, 1.0);
        from.smooth_arcsec.lerp(&to.smooth_arcsec, share)
    };
    let relative: Vec<Vector3<f64>> = node_s.iter().copied().map(relative).collect();
    let smoothed = gyros.attitudes.iter().zip(relative).map(|(gyros, relative)| turn(relative) * gyros);
    accumulated(smoothed, &gyros.coning_arcsec)
}

impl SmoothedReference {
    /// The traces in these rows, and in these angles at the nodes.
    pub fn new(
        rows: &[Row],
        (node_s, angles): (&[f64], &[Vector3<f64>]),
        (matrix, scale_factors): (&MatrixXx3<f64>, &[f64]),
        (scale, row_share): (Vector3<f64>, f64),
        blocks: usize,
    ) -> SmoothedReference {
        let ones = Vector3::repeat(1.0);
        let mean = mean_weights(rows.iter().filter(|row| row.is_used)).unwrap_or(ones);
        let sigma_arcsec = scale.component_div(&mean.map(f64::sqrt));
        let variance = |block: usize| {
            let own = mean_weights(of_block(rows, node_s, block));
            own.map_or(ones, |own| mean.component_div(&own))
        };
        let variances: Vec<Vector3<f64>> = (0..blocks).map(variance).collect();
        SmoothedReference {
            departure: departures(rows, node_s, blocks, matrix, scale_factors),
            walk: walk(angles, &variances, matrix, scale_factors, sigma_arcsec * row_share.sqrt()),
            white_scale: white_scale(&variances, matrix, sigma_arcsec),
        }
    }
}

/// Growth of each gyro's angle over each block by noise of the attitude of which the sigma about each axis is `sigma_arcsec`, averaged
/// over a block, and its variance in each block `relative` to that: the noise times the turn, without the part about the gyro's own axis.
fn walk(
    angles: &[Vector3<f64>],
    relative: &[Vector3<f64>],
    matrix: &MatrixXx3<f64>,
    scale_factors: &[f64],
    sigma_arcsec: Vector3<f64>,
) -> [Vec<Vector3<f64>>; TIMING] {
    std::array::from_fn(|gyro| {
        let Some(scale_factor) = scale_factors.get(gyro) else { return Vec::new() };
        let axis = matrix.row(gyro).transpose();
        let of_block = |block: usize| {
            let nodes = nodes(block);
            let turn_rad = (angles[nodes.end - 1] - angles[nodes.start - 1]) / ARCSEC_PER_RAD;
            let sigma_arcsec = sigma_arcsec.component_mul(&relative[block].map(f64::sqrt));
            axis.cross(&turn_rad).component_mul(&sigma_arcsec) / *scale_factor
        };
        (0..relative.len()).map(of_block).collect()
    })
}

/// Variance of the noise of the reference about each gyro's axis in each block, relative to that of rows of the mean weight.
fn white_scale(relative: &[Vector3<f64>], matrix: &MatrixXx3<f64>, sigma_arcsec: Vector3<f64>) -> [Vec<f64>; TIMING] {
    std::array::from_fn(|gyro| {
        if gyro >= matrix.nrows() {
            return Vec::new();
        }
        let shares = matrix.row(gyro).transpose().component_mul(&sigma_arcsec).map(|share| share * share);
        let of_block = |own: &Vector3<f64>| if shares.sum() > 0.0 { own.dot(&shares) / shares.sum() } else { 1.0 };
        relative.iter().map(of_block).collect()
    })
}

/// Smooths the relative attitude by straight lines through the neighbours of each row; the reach of the lines follows from the noise of a
/// row, or is the shortest one. A line does not reach over a gap of which the turn is not known.
fn by_lines(rows: &mut [Row], sigma_arcsec: Option<Vector3<f64>>, (block_s, reaches): (f64, &'static [f64])) {
    for part in rows.chunk_by_mut(|_, next| !next.begins) {
        let used = part.iter().filter(|row| row.is_used);
        let points =
            used.map(|row| Point { t_s: row.t_s, value: row.relative_arcsec, weight: 3.0 / row.sigma.norm_squared() });
        let sums = LineSums::new(points, block_s, reaches);
        for row in part {
            row.smooth_arcsec = sums.smooth(row.t_s, sigma_arcsec);
        }
    }
}

/// Used rows of a block.
pub fn of_block<'a>(rows: &'a [Row], node_s: &[f64], block: usize) -> impl Iterator<Item = &'a Row> + Clone {
    let nodes = nodes(block);
    let [from, to] = [nodes.start, nodes.end].map(|node| rows.partition_point(|row| row.t_s <= node_s[node - 1]));
    rows[from..to].iter().filter(|row| row.is_used)
}

/// Mean weight of rows about each control axis; `None` without rows.
fn mean_weights<'a>(rows: impl Iterator<Item = &'a Row> + Clone) -> Option<Vector3<f64>> {
    let count = rows.clone().count();
    (count > 0).then(|| rows.map(Row::weights).sum::<Vector3<f64>>() / count as f64)
}

/// Mean departure of the used rows of each block from the smoothed difference, with their weights, in counts.
fn departures(
    rows: &[Row],
    node_s: &[f64],
    blocks: usize,
    matrix: &MatrixXx3<f64>,
    scale_factors: &[f64],
) -> Vec<[f64; TIMING]> {
    let departure = |block: usize| {
        let own = of_block(rows, node_s, block);
        let Some(mean) = mean_weights(own.clone()) else { return [0.0; TIMING] };
        let weight = mean * own.clone().count() as f64;
        let weighted = own.map(|row| row.departure().component_mul(&row.weights())).sum::<Vector3<f64>>();
        let sensed = matrix * weighted.component_div(&weight);
        std::array::from_fn(|gyro| scale_factors.get(gyro).map_or(0.0, |scale_factor| sensed[gyro] / scale_factor))
    };
    (0..blocks).map(departure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    use geu_model::units::SAMPLE_INTERVAL_S;
    use nalgebra::UnitQuaternion;

    #[test]
    fn a_noisy_row_that_states_its_sigma_moves_neither_line_nor_average() {
        let row = |number: usize| Row {
            number,
            t_s: number as f64,
            attitude: UnitQuaternion::identity(),
            relative_arcsec: Vector3::repeat(if number == 12 { 90.0 } else { 0.0 }),
            sigma: Vector3::repeat(if number == 12 { 30.0 } else { 1.0 }),
            beyond_arcsec: Vector3::zeros(),
            smooth_arcsec: Vector3::zeros(),
            is_used: true,
            begins: false,
        };
        let mut rows: Vec<Row> = (0..25).map(row).collect();
        by_lines(&mut rows, None, (5.0, REACHES));
        // A 900th of the weight of each of 24.
        assert!(rows.iter().all(|row| row.smooth_arcsec.amax() < 90.0 / 900.0 / 24.0 * 1.1));
        let node_s: Vec<f64> = (0..=40).map(|node| f64::from(node) * SAMPLE_INTERVAL_S).collect();
        let departures = departures(&rows, &node_s, 4, &MatrixXx3::repeat(4, 1.0 / 3.0), &[1.0; 4]);
        assert!(departures[2][0].abs() < 90.0 / 900.0 / 4.0 * 1.1);
    }
}
