//! The motion between the rows of a reference that is noisy or slow, from the gyros themselves.
//!
//! Effects that depend on a rate need the motion within a sample, and a star tracker does not show it: 3″ of noise each second are a
//! rate of 4″/s. The gyros' increments show it; the reference minus their rotation changes slowly and is smoothed. The residual is still
//! that against the rows: in each block, their departure from the smoothed motion is subtracted again.

use geu_calibration::AccumulatedCounts;
use geu_calibration::transfer::misalignment_matrix;
use geu_model::Configuration;
use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::units::SAMPLE_INTERVAL_S;
use nalgebra::{Matrix3x4, Matrix4x3, Vector3, Vector4};

use super::{TIMING, median, nodes};

/// Spacing of rows up to which an exact reference is used as it is.
const MAX_SPACING_S: f64 = 1.2 * SAMPLE_INTERVAL_S;
/// Sigma of a row's angle below which a reference is exact: rounding of the gyros' counts alone shows 0.4.
const EXACT_ARCSEC: f64 = 0.6;
/// Reach of the smoothing to either side, and the minimum number of rows: a scale factor that is off turns the difference at the start of a
/// slew, and noise of 3″ each second leaves a rate of 0.02″/s.
const REACH_S: f64 = 30.0;
const REACH_ROWS: usize = 4;
/// A row farther from the smoothed difference, in sigmas, is a glitch.
const GLITCH_SIGMAS: f64 = 8.0;
/// Minimum eigenvalue of the normal matrix of the gyros in use: 1 with a gyro along each axis, the square of a misalignment without.
const MIN_EIGENVALUE: f64 = 0.5;
/// Median of the absolute value of a standard normal variable.
const MEDIAN_OF_NORMAL: f64 = 0.674_489_750_196_081_7;
/// Weights of a cubic through seven nodes (Savitzky and Golay): half of the rounding's variance stays, and 94 % of a limit cycle of 5 s.
const CUBIC: [f64; 7] = [-2.0 / 21.0, 3.0 / 21.0, 6.0 / 21.0, 7.0 / 21.0, 6.0 / 21.0, 3.0 / 21.0, -2.0 / 21.0];

/// A smoothed reference.
#[derive(Debug)]
pub struct SmoothedReference {
    /// The motion, with a row at each node.
    pub motion: RecordedAttitude,
    /// Mean departure of the rows within each block, counts of each gyro; `None` for a block without rows.
    pub departure: Vec<Option<[f64; TIMING]>>,
    /// 1 sigma of a row about each axis.
    pub sigma_arcsec: [f64; 3],
    /// Times of the rows that are left out.
    pub glitches_s: Vec<f64>,
}

/// A row of the reference: time, and rotation beyond that of the gyros.
struct Row {
    t_s: f64,
    difference: [f64; 3],
    smooth: [f64; 3],
    is_used: bool,
}

impl SmoothedReference {
    /// Smooths a reference on the time scale of the counts; `None` if it is exact and fast, or the times do not rise.
    pub fn new(
        counts: &AccumulatedCounts,
        reference: &RecordedAttitude,
        nominal: &Configuration,
        blocks: usize,
    ) -> Option<SmoothedReference> {
        let calibrations = nominal.gyros.each_ref().map(|gyro| gyro.calibration);
        let matrix = misalignment_matrix(&calibrations);
        let turned = rotation(counts, reference, &matrix, nominal);
        let gyros = recorded(&counts.node_s, &turned, reference)?;
        let (first_s, last_s) = (gyros.start_s(), gyros.end_s());
        let mut near = 0;
        let mut rows: Vec<Row> = reference
            .rows()
            .filter(|(t_s, _)| (first_s..=last_s).contains(t_s))
            .map(|(t_s, angle)| {
                let own = gyros.at(t_s, &mut near).0;
                let difference = std::array::from_fn(|axis| angle[axis] - own[axis]);
                Row { t_s, difference, smooth: [0.0; 3], is_used: true }
            })
            .collect();
        let sigma_arcsec = std::array::from_fn(|axis| second_difference_sigma(&rows, axis));
        let mut spacings: Vec<f64> = rows.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).collect();
        let is_exact = sigma_arcsec.iter().all(|sigma| *sigma < EXACT_ARCSEC) && median(&mut spacings) <= MAX_SPACING_S;
        if is_exact || rows.len() <= 2 * REACH_ROWS {
            return None;
        }
        smooth(&mut rows);
        let limits: [f64; 3] = std::array::from_fn(|axis| {
            let mut sizes: Vec<f64> = rows.iter().map(|row| (row.difference[axis] - row.smooth[axis]).abs()).collect();
            GLITCH_SIGMAS * (median(&mut sizes) / MEDIAN_OF_NORMAL).max(EXACT_ARCSEC)
        });
        for row in &mut rows {
            row.is_used = (0..3).all(|axis| (row.difference[axis] - row.smooth[axis]).abs() <= limits[axis]);
        }
        smooth(&mut rows);
        let mut place = 0;
        let added = |t_s: f64| -> [f64; 3] {
            while place + 2 < rows.len() && rows[place + 1].t_s < t_s {
                place += 1;
            }
            let (from, to) = (&rows[place], &rows[place + 1]);
            let share = ((t_s - from.t_s) / (to.t_s - from.t_s)).clamp(0.0, 1.0);
            std::array::from_fn(|axis| from.smooth[axis] + share * (to.smooth[axis] - from.smooth[axis]))
        };
        let angles: Vec<[f64; 3]> = counts.node_s.iter().copied().map(added).collect();
        let angles: Vec<[f64; 3]> = angles
            .iter()
            .enumerate()
            .map(|(node, added)| {
                let own = cubic(&turned, node);
                std::array::from_fn(|axis| own[axis] + added[axis])
            })
            .collect();
        let scale_factors = calibrations.map(|calibration| calibration.scale_factor);
        Some(SmoothedReference {
            motion: recorded(&counts.node_s, &angles, reference)?,
            departure: departures(&rows, &counts.node_s, blocks, &matrix, scale_factors),
            sigma_arcsec,
            glitches_s: rows.iter().filter(|row| !row.is_used).map(|row| row.t_s).collect(),
        })
    }
}

/// Accumulated rotation about the control axes by the calibration as given; broken gyros sense that of the reference if the others do not
/// determine it.
fn rotation(
    counts: &AccumulatedCounts,
    reference: &RecordedAttitude,
    matrix: &Matrix4x3<f64>,
    nominal: &Configuration,
) -> Vec<[f64; 3]> {
    let mut is_broken = vec![[false; TIMING]; counts.node_s.len()];
    for found in &counts.breaks {
        for node in is_broken.iter_mut().take(found.to + 1).skip(found.from + 1) {
            node.iter_mut().zip(found.gyros).for_each(|(node, gyro)| *node |= gyro);
        }
    }
    let all = inverse(matrix, [false; TIMING]);
    let (mut near, mut sum, mut before) = (0, [0.0; 3], reference.at(counts.node_s[0], &mut 0).0);
    let mut of_node = |node: usize| {
        let now = reference.at(counts.node_s[node], &mut near).0;
        if node > 0 {
            let moved = Vector3::from_fn(|axis, _| now[axis] - before[axis]);
            let without = if is_broken[node] == [false; TIMING] { all } else { inverse(matrix, is_broken[node]) };
            let sensed = Vector4::from_fn(|gyro, _| {
                if is_broken[node][gyro] && without.is_none() {
                    return (matrix.row(gyro) * moved)[0];
                }
                let calibration = &nominal.gyros[gyro].calibration;
                let increment = counts.accumulated[gyro][node] - counts.accumulated[gyro][node - 1];
                increment * calibration.scale_factor + calibration.drift_arcsec_per_half_s
            });
            let rotation = without.or(all).map_or(moved, |inverse| inverse * sensed);
            (0..3).for_each(|axis| sum[axis] += rotation[axis]);
        }
        before = now;
        sum
    };
    (0..counts.node_s.len()).map(&mut of_node).collect()
}

/// Rotation from sensed angles by least squares, without broken gyros; `None` if the others do not determine it, or only by their
/// misalignments.
fn inverse(matrix: &Matrix4x3<f64>, is_broken: [bool; TIMING]) -> Option<Matrix3x4<f64>> {
    let mut used = *matrix;
    (0..TIMING).filter(|&gyro| is_broken[gyro]).for_each(|gyro| used.row_mut(gyro).fill(0.0));
    let normal = used.transpose() * used;
    let is_determined = normal.symmetric_eigenvalues().min() > MIN_EIGENVALUE;
    is_determined.then_some(normal.try_inverse()? * used.transpose())
}

/// A motion with these accumulated angles at the nodes, and θ and ψ of the reference.
fn recorded(node_s: &[f64], angles: &[[f64; 3]], reference: &RecordedAttitude) -> Option<RecordedAttitude> {
    let mut near = 0;
    let row = |node: usize| {
        let before = angles[node.saturating_sub(1)];
        let moment = reference.knows_sun().then(|| reference.at(node_s[node], &mut near).1);
        AttitudeRow {
            t_s: node_s[node],
            angle_control_arcsec: std::array::from_fn(|axis| angles[node][axis] - before[axis]),
            theta_psi_rad: moment.map(|moment| (moment.theta_rad, moment.psi_rad)),
        }
    };
    let rows: Vec<AttitudeRow> = (0..node_s.len()).map(row).collect();
    RecordedAttitude::new(&rows).ok()
}

/// Sigma of a row from the median of the second differences.
fn second_difference_sigma(rows: &[Row], axis: usize) -> f64 {
    let difference =
        |three: &[Row]| three[0].difference[axis] - 2.0 * three[1].difference[axis] + three[2].difference[axis];
    let mut sizes: Vec<f64> = rows.windows(3).map(|three| difference(three).abs()).collect();
    median(&mut sizes) / MEDIAN_OF_NORMAL / 6f64.sqrt()
}

/// Smooths the difference by a straight line through the neighbours of each row.
fn smooth(rows: &mut [Row]) {
    let line = |own: usize| -> [f64; 3] {
        let at_s = rows[own].t_s;
        let from = rows.partition_point(|row| row.t_s < at_s - REACH_S).min(own.saturating_sub(REACH_ROWS));
        let to = rows.partition_point(|row| row.t_s <= at_s + REACH_S).max(own + 1 + REACH_ROWS).min(rows.len());
        let mut sums = [0.0; 3];
        let mut moments = [[0.0; 2]; 3];
        for row in rows[from..to].iter().filter(|row| row.is_used) {
            let t = row.t_s - at_s;
            sums.iter_mut().zip([1.0, t, t * t]).for_each(|(sum, value)| *sum += value);
            for (moment, value) in moments.iter_mut().zip(row.difference) {
                (moment[0], moment[1]) = (moment[0] + value, moment[1] + value * t);
            }
        }
        let determinant = sums[0] * sums[2] - sums[1] * sums[1];
        moments.map(|[value, slope]| match determinant > 0.0 {
            true => (sums[2] * value - sums[1] * slope) / determinant,
            false => value / sums[0].max(1.0),
        })
    };
    let smooth: Vec<[f64; 3]> = (0..rows.len()).map(line).collect();
    rows.iter_mut().zip(smooth).for_each(|(row, smooth)| row.smooth = smooth);
}

/// The angle at a node by the cubic through its neighbours; at the ends as it is.
fn cubic(angles: &[[f64; 3]], node: usize) -> [f64; 3] {
    let reach = CUBIC.len() / 2;
    let Some(near) = node.checked_sub(reach).and_then(|from| angles.get(from..=node + reach)) else {
        return angles[node];
    };
    // Relative to the node, where the sum loses no digits.
    std::array::from_fn(|axis| {
        let own = angles[node][axis];
        own + near.iter().zip(CUBIC).map(|(angle, weight)| weight * (angle[axis] - own)).sum::<f64>()
    })
}

/// Mean departure of the used rows of each block from the smoothed difference, in counts.
fn departures(
    rows: &[Row],
    node_s: &[f64],
    blocks: usize,
    matrix: &Matrix4x3<f64>,
    scale_factors: [f64; TIMING],
) -> Vec<Option<[f64; TIMING]>> {
    let of_block = |block: usize| {
        let nodes = nodes(block);
        let (from_s, to_s) = (node_s[nodes.start - 1], node_s[nodes.end - 1]);
        let from = rows.partition_point(|row| row.t_s <= from_s);
        let to = rows.partition_point(|row| row.t_s <= to_s);
        let own = || rows[from..to].iter().filter(|row| row.is_used);
        let departure = |row: &Row| Vector3::from_fn(|axis, _| row.difference[axis] - row.smooth[axis]);
        let mean = own().map(departure).sum::<Vector3<f64>>() / own().count() as f64;
        let sensed = matrix * mean;
        (own().count() > 0).then(|| std::array::from_fn(|gyro| sensed[gyro] / scale_factors[gyro]))
    };
    (0..blocks).map(of_block).collect()
}
