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
use geu_calibration::AccumulatedCounts;
use geu_calibration::track::rotation_of_heads;
use geu_calibration::transfer::sensing_matrix;
use geu_checks::median;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use nalgebra::{DVector, MatrixXx3, UnitQuaternion, Vector3};

use super::reference_sigma::{ReferenceSigma, with_rounding};
use super::smoothing::{LineSums, Point, REACH_ROWS, REACHES, SHORT_REACHES, without_rounding};
use super::turns::{accumulated, attitudes, coning_about_axes, recorded, turn};
use super::{BLOCK, TIMING, nodes};

/// Spacing of rows up to which an exact reference is used as it is, in intervals of the nodes.
const MAX_SPACING: f64 = 1.2;
/// Sigma of a row's angle below which a reference is exact: rounding of the gyros' counts alone shows 0.4.
const EXACT_ARCSEC: f64 = 0.6;
/// Size of a count from which its rounding is smoothed out of the motion: a smaller one is less than the noise of a gyro within a block.
const COARSE_ARCSEC: f64 = 0.5;
/// Share of the gyros' noise up to which the noise of a reference does not matter.
const WHITE_SHARE: f64 = 0.05;
/// Distance over which the relative attitude shows its walk, rows and nodes.
const FAR_ROWS: usize = 4;
const FAR_NODES: f64 = 4.0;
/// A row farther from the smoothed difference, in sigmas, is a glitch.
const GLITCH_SIGMAS: f64 = 8.0;
/// A smoothed reference.
#[derive(Debug)]
pub struct SmoothedReference {
    /// The motion, with a row at each node.
    pub motion: RecordedAttitude,
    /// Mean departure of the rows within each block, counts of each gyro; `None` for a block without rows.
    pub departure: Vec<Option<[f64; TIMING]>>,
    /// Growth of the accumulated angle of each gyro over a block by the noise of the reference: 1 sigma by that about each axis, counts.
    pub walk: [Vec<Vector3<f64>>; TIMING],
    /// Variance of the white noise of each block, as a multiple of that of rows of the mean weight: 1 without stated sigmas.
    pub white_scale: [Vec<f64>; TIMING],
    /// Times of the rows that are left out.
    pub glitches_s: Vec<f64>,
}

/// A row of the reference.
struct Row {
    t_s: f64,
    /// Attitude by the gyros.
    attitude: UnitQuaternion<f64>,
    /// Turn since the row before relative to that by the gyros, about control axes.
    beyond_arcsec: Vector3<f64>,
    /// Attitude relative to that by the gyros, about inertial axes.
    relative_arcsec: Vector3<f64>,
    smooth_arcsec: Vector3<f64>,
    /// Stated sigma about control axes, with the rounding of the counts; 1 if none is stated.
    sigma: Vector3<f64>,
    is_used: bool,
    /// True if the turn since the row before is not known.
    begins: bool,
}

impl Row {
    /// Weight by the sigma about each control axis.
    fn weights(&self) -> Vector3<f64> {
        self.sigma.map(|sigma| 1.0 / (sigma * sigma))
    }

    /// Departure from the smoothed motion, about control axes.
    fn departure(&self) -> Vector3<f64> {
        self.attitude.inverse() * (self.relative_arcsec - self.smooth_arcsec)
    }
}

impl SmoothedReference {
    /// Smooths a reference on the time scale of the counts, with the stated sigma of each row or none; `None` if it is exact, fast and
    /// without gaps, or the times do not rise. The comparison of the stated sigmas with the scatter comes first.
    pub fn new(
        counts: &AccumulatedCounts,
        reference: &RecordedAttitude,
        sigma_arcsec: &[[f64; 3]],
        nominal: &Configuration,
        blocks: usize,
    ) -> (Option<ReferenceSigma>, Option<SmoothedReference>) {
        let matrix = sensing_matrix(nominal);
        // Two gyros do not show a motion.
        if rotation_of_heads(&matrix, counts.gyros).is_none() {
            return (None, None);
        }
        let (turned, coning) = rotation(counts, reference, &matrix, nominal);
        let is_coarse = counts.rounded_to.iter().all(|count| *count >= COARSE_ARCSEC);
        let turned = if is_coarse { without_rounding(&turned) } else { turned };
        let block_s = BLOCK as f64 * counts.interval_s;
        let attitudes = attitudes(&turned, &coning);
        let Some(mut rows) = rows(counts, (&turned, &coning), &attitudes, reference, sigma_arcsec) else {
            return (None, None);
        };
        let scale = Vector3::from_fn(|axis, _| second_difference_sigma(&rows, axis));
        let largest = rows.iter().map(|row| scale.component_mul(&row.sigma).max()).fold(0.0, f64::max);
        let is_stated = !sigma_arcsec.is_empty() && rows.len() > 2 * REACH_ROWS;
        let stated = is_stated.then(|| ReferenceSigma::new(sigma_arcsec, scale));
        let mut spacings: Vec<f64> = rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
        let spacing_s = median(&mut spacings);
        let has_gaps = reference.gaps_s().len() > reference.unknown_s().count();
        let is_quiet = if is_coarse { largest < EXACT_ARCSEC } else { !is_white(&rows, block_s / spacing_s) };
        let is_exact = is_quiet && spacing_s <= MAX_SPACING * counts.interval_s && !has_gaps;
        if is_exact || rows.len() <= 2 * REACH_ROWS {
            return (stated, None);
        }
        let reaches = if is_coarse { REACHES } else { SHORT_REACHES };
        smooth(&mut rows, None, (block_s, reaches));
        let scatter: [f64; 3] = std::array::from_fn(|axis| {
            let mut sizes: Vec<f64> = rows.iter().map(|row| row.departure()[axis].abs() / row.sigma[axis]).collect();
            median(&mut sizes) / MEDIAN_OF_NORMAL
        });
        for row in &mut rows {
            let departure = row.departure();
            let limit = |axis: usize| GLITCH_SIGMAS * (scatter[axis] * row.sigma[axis]).max(EXACT_ARCSEC);
            row.is_used = (0..3).all(|axis| departure[axis].abs() <= limit(axis));
        }
        smooth(&mut rows, Some(scale), (block_s, reaches));
        let ones = Vector3::repeat(1.0);
        let mean = mean_weights(rows.iter().filter(|row| row.is_used)).unwrap_or(ones);
        let sigma_arcsec = scale.component_div(&mean.map(f64::sqrt));
        let variance = |block: usize| {
            let own = mean_weights(of_block(&rows, &counts.node_s, block));
            own.map_or(ones, |own| mean.component_div(&own))
        };
        let variances: Vec<Vector3<f64>> = (0..blocks).map(variance).collect();
        let mut place = 0;
        let relative = |t_s: f64| {
            while place + 2 < rows.len() && rows[place + 1].t_s < t_s {
                place += 1;
            }
            let (from, to) = (&rows[place], &rows[place + 1]);
            let share = ((t_s - from.t_s) / (to.t_s - from.t_s)).clamp(0.0, 1.0);
            from.smooth_arcsec.lerp(&to.smooth_arcsec, share)
        };
        let relative: Vec<Vector3<f64>> = counts.node_s.iter().copied().map(relative).collect();
        let smoothed = attitudes.iter().zip(relative).map(|(gyros, relative)| turn(relative) * gyros);
        let angles = accumulated(smoothed, &coning);
        let scale_factors: Vec<f64> = nominal.gyros.iter().map(|gyro| gyro.calibration.scale_factor).collect();
        let scale_factors = &scale_factors[..];
        let smoothed = recorded(&counts.node_s, &angles, reference).map(|motion| SmoothedReference {
            motion,
            departure: departures(&rows, &counts.node_s, blocks, &matrix, scale_factors),
            walk: walk(&angles, &variances, &matrix, scale_factors, sigma_arcsec * (spacing_s / block_s).sqrt()),
            white_scale: white_scale(&variances, &matrix, sigma_arcsec),
            glitches_s: rows.iter().filter(|row| !row.is_used).map(|row| row.t_s).collect(),
        });
        (stated, smoothed)
    }
}

/// Rows of the reference within the counts, relative to the attitude by the gyros, which equals that of the first row.
fn rows(
    counts: &AccumulatedCounts,
    (turned, coning): (&[Vector3<f64>], &[Vector3<f64>]),
    attitudes: &[UnitQuaternion<f64>],
    reference: &RecordedAttitude,
    sigma_arcsec: &[[f64; 3]],
) -> Option<Vec<Row>> {
    let gyros = recorded(&counts.node_s, turned, reference)?;
    let (first_s, last_s) = (gyros.start_s(), gyros.end_s());
    let (mut near, mut before) = (0, None);
    let mut unknown_s = reference.unknown_s().map(|gap| gap[1]).peekable();
    let within = reference.rows().enumerate().filter(|(_, (t_s, _))| (first_s..=last_s).contains(t_s));
    let row = |(number, (t_s, angle)): (usize, (f64, [f64; 3]))| {
        let sigma = sigma_arcsec.get(number).map_or(Vector3::repeat(1.0), |own| with_rounding((*own).into()));
        let angle = Vector3::from(angle);
        let node = counts.node_s.partition_point(|node_s| *node_s <= t_s).saturating_sub(1);
        let next = (node + 1).min(coning.len() - 1);
        let share = (t_s - counts.node_s[node]) / (counts.node_s[next] - counts.node_s[node]).max(f64::MIN_POSITIVE);
        let since = Vector3::from(gyros.at(t_s, &mut near).0) + turned[0] - turned[node] + coning[next] * share;
        let attitude = attitudes[node] * turn(since);
        let (angle_before, gyros_before, absolute_before) = before.unwrap_or((angle, attitude, attitude));
        let turned = turn(angle - angle_before);
        let beyond = attitude.inverse() * gyros_before * turned;
        let absolute = absolute_before * turned;
        before = Some((angle, attitude, absolute));
        let [beyond_arcsec, relative_arcsec] =
            [beyond, absolute * attitude.inverse()].map(|turn| turn.scaled_axis() * ARCSEC_PER_RAD);
        let smooth_arcsec = Vector3::zeros();
        let mut begins = false;
        while unknown_s.next_if(|end_s| *end_s <= t_s).is_some() {
            begins = true;
        }
        Row { t_s, attitude, beyond_arcsec, relative_arcsec, smooth_arcsec, sigma, is_used: true, begins }
    };
    Some(within.map(row).collect())
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

/// Accumulated rotation about the control axes by the calibration as given, and the coning before each node; broken gyros sense that of the
/// reference if the others do not determine it.
fn rotation(
    counts: &AccumulatedCounts,
    reference: &RecordedAttitude,
    matrix: &MatrixXx3<f64>,
    nominal: &Configuration,
) -> (Vec<Vector3<f64>>, Vec<Vector3<f64>>) {
    let none = counts.gyros.with_mask(0);
    let mut is_broken = vec![none; counts.node_s.len()];
    for found in &counts.breaks {
        for node in is_broken.iter_mut().take(found.to + 1).skip(found.from + 1) {
            *node = node.and(found.gyros);
        }
    }
    let all = rotation_of_heads(matrix, counts.gyros);
    let (mut near, mut sum) = (0, Vector3::zeros());
    let mut before = Vector3::from(reference.at(counts.node_s[0], &mut near).0);
    let mut of_node = |node: usize| {
        let now = Vector3::from(reference.at(counts.node_s[node], &mut near).0);
        let mut coning = Vector3::zeros();
        if node > 0 {
            let moved = now - before;
            let without = match is_broken[node].is_empty() {
                true => all.clone(),
                false => rotation_of_heads(matrix, counts.gyros.without(is_broken[node])),
            };
            let sensed = DVector::from_fn(matrix.nrows(), |gyro, _| {
                if is_broken[node][gyro] && without.is_none() {
                    return (matrix.row(gyro) * moved)[0];
                }
                let calibration = &nominal.gyros[gyro].calibration;
                let increment = counts.accumulated[gyro][node] - counts.accumulated[gyro][node - 1];
                increment * calibration.scale_factor
                    + calibration.drift_arcsec_per_half_s * (counts.interval_s / SAMPLE_INTERVAL_S)
            });
            sum += without.as_ref().or(all.as_ref()).map_or(moved, |inverse| inverse * sensed);
            if let Some(inverse) = &without {
                coning = coning_about_axes(counts, node, inverse, nominal);
            }
        }
        before = now;
        (sum, coning)
    };
    (0..counts.node_s.len()).map(&mut of_node).unzip()
}

/// Sigma of a row about a control axis from the median of the second differences, as a multiple of the stated one.
fn second_difference_sigma(rows: &[Row], axis: usize) -> f64 {
    let difference = |of: &[Row]| {
        let [first, middle, last] = [0, 1, 2].map(|row| of[row].sigma[axis].powi(2));
        let stated = ((first + 4.0 * middle + last) / 6.0).sqrt();
        (of[2].beyond_arcsec[axis] - of[1].beyond_arcsec[axis]).abs() / stated
    };
    let mut sizes: Vec<f64> = rows.windows(3).map(difference).collect();
    median(&mut sizes) / MEDIAN_OF_NORMAL / 6f64.sqrt()
}

/// True if the white noise of the relative attitude, averaged over the nodes of a block of that many rows, is a share of its walk over a block
/// or more: the walk is that of the gyros, white noise that of the reference. Second differences over a distance of n rows have 6 variances of the white noise and 2 n of the walk's growth.
fn is_white(rows: &[Row], rows_per_block: f64) -> bool {
    let variance = |distance: usize| {
        let off = |own: &[Row]| {
            let [first, middle, last] = [0, distance, 2 * distance].map(|row| own[row].relative_arcsec);
            (first - 2.0 * middle + last).norm()
        };
        median(&mut rows.windows(2 * distance + 1).map(off).collect::<Vec<_>>()).powi(2)
    };
    // Between two nodes the attitude of the gyros is interpolated.
    let distance = FAR_ROWS.max((FAR_NODES * rows_per_block / BLOCK as f64) as usize);
    let [near, far] = [variance(1), variance(distance)];
    let walk = (far - near).max(0.0) / (2.0 * (distance - 1) as f64);
    let white = (near - 2.0 * walk) / 6.0;
    white / BLOCK as f64 > WHITE_SHARE * walk * rows_per_block
}

/// Smooths the relative attitude by straight lines through the neighbours of each row; the reach of the lines follows from the noise of a
/// row, or is the shortest one. A line does not reach over a gap of which the turn is not known.
fn smooth(rows: &mut [Row], sigma_arcsec: Option<Vector3<f64>>, (block_s, reaches): (f64, &'static [f64])) {
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
fn of_block<'a>(rows: &'a [Row], node_s: &[f64], block: usize) -> impl Iterator<Item = &'a Row> + Clone {
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
) -> Vec<Option<[f64; TIMING]>> {
    let departure = |block: usize| {
        let own = of_block(rows, node_s, block);
        let weight = mean_weights(own.clone())? * own.clone().count() as f64;
        let weighted = own.map(|row| row.departure().component_mul(&row.weights())).sum::<Vector3<f64>>();
        let sensed = matrix * weighted.component_div(&weight);
        Some(std::array::from_fn(|gyro| {
            scale_factors.get(gyro).map_or(0.0, |scale_factor| sensed[gyro] / scale_factor)
        }))
    };
    (0..blocks).map(departure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noisy_row_that_states_its_sigma_moves_neither_line_nor_average() {
        let row = |number: usize| Row {
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
        smooth(&mut rows, None, (5.0, REACHES));
        // A 900th of the weight of each of 24.
        assert!(rows.iter().all(|row| row.smooth_arcsec.amax() < 90.0 / 900.0 / 24.0 * 1.1));
        let node_s: Vec<f64> = (0..=40).map(|node| f64::from(node) * SAMPLE_INTERVAL_S).collect();
        let departures = departures(&rows, &node_s, 4, &MatrixXx3::repeat(4, 1.0 / 3.0), &[1.0; 4]);
        assert!(departures[2].expect("rows")[0].abs() < 90.0 / 900.0 / 4.0 * 1.1);
    }
}
