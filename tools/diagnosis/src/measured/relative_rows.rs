//! The rows of a reference relative to the attitude by the gyros, which changes slowly in inertial space.

use geu_calibration::AccumulatedCounts;
use geu_calibration::track::rotation_of_heads;
use geu_checks::median;
use geu_model::Configuration;
use geu_model::attitude::RecordedAttitude;
use geu_model::units::{ARCSEC_PER_RAD, SAMPLE_INTERVAL_S};
use nalgebra::{DVector, MatrixXx3, UnitQuaternion, Vector3};

use super::BLOCK;
use super::reference_sigma::with_rounding;
use super::smoothing::without_rounding;
use super::turns::{attitudes, coning_about_axes, recorded, turn};
use crate::significance::MEDIAN_OF_NORMAL;

/// Share of the gyros' noise up to which the noise of a reference does not matter.
const WHITE_SHARE: f64 = 0.05;
/// Distance over which the relative attitude shows its walk, rows and nodes.
const FAR_ROWS: usize = 4;
const FAR_NODES: f64 = 4.0;

/// The motion by the gyros with the calibration as given.
pub struct GyroMotion {
    /// Accumulated rotation about the control axes at each node.
    pub turned_arcsec: Vec<Vector3<f64>>,
    /// Coning in the interval before each node, about control axes.
    pub coning_arcsec: Vec<Vector3<f64>>,
    /// Attitude at each node, control frame to inertial.
    pub attitudes: Vec<UnitQuaternion<f64>>,
}

/// A row of the reference beside the gyros.
pub struct Row {
    /// Index among the rows of the reference.
    pub number: usize,
    pub t_s: f64,
    /// Attitude by the gyros.
    pub attitude: UnitQuaternion<f64>,
    /// Turn since the row before relative to that by the gyros, about control axes.
    pub beyond_arcsec: Vector3<f64>,
    /// Attitude relative to that by the gyros, about inertial axes.
    pub relative_arcsec: Vector3<f64>,
    /// The relative attitude without noise.
    pub smooth_arcsec: Vector3<f64>,
    /// Stated sigma about control axes, with the rounding of the counts; 1 if none is stated.
    pub sigma: Vector3<f64>,
    pub is_used: bool,
    /// True if the turn since the row before is not known.
    pub begins: bool,
}

impl Row {
    /// Attitude relative to that by the gyros.
    pub fn relative(&self) -> UnitQuaternion<f64> {
        turn(self.relative_arcsec)
    }

    /// Attitude by the reference; that of the first row is the gyros'.
    pub fn absolute(&self) -> UnitQuaternion<f64> {
        self.relative() * self.attitude
    }

    /// Weight by the sigma about each control axis.
    pub fn weights(&self) -> Vector3<f64> {
        self.sigma.map(|sigma| 1.0 / (sigma * sigma))
    }

    /// Departure from the smoothed motion, about control axes.
    pub fn departure(&self) -> Vector3<f64> {
        self.attitude.inverse() * (self.relative_arcsec - self.smooth_arcsec)
    }
}

impl GyroMotion {
    /// The motion by these counts, without the rounding of coarse ones. Broken gyros sense the motion of the reference if the others do not
    /// determine it.
    pub fn new(
        counts: &AccumulatedCounts,
        reference: &RecordedAttitude,
        matrix: &MatrixXx3<f64>,
        nominal: &Configuration,
        is_coarse: bool,
    ) -> GyroMotion {
        let (turned, coning_arcsec) = rotation(counts, reference, matrix, nominal);
        let turned_arcsec = if is_coarse { without_rounding(&turned) } else { turned };
        let attitudes = attitudes(&turned_arcsec, &coning_arcsec);
        GyroMotion { turned_arcsec, coning_arcsec, attitudes }
    }
}

/// Accumulated rotation about the control axes, and the coning before each node.
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

/// Rows of the reference within the counts, relative to the attitude by the gyros, which equals that of the first row.
pub fn rows(
    counts: &AccumulatedCounts,
    gyros: &GyroMotion,
    reference: &RecordedAttitude,
    sigma_arcsec: &[[f64; 3]],
) -> Option<Vec<Row>> {
    let GyroMotion { turned_arcsec, coning_arcsec, attitudes } = gyros;
    let path = recorded(&counts.node_s, turned_arcsec, reference)?;
    let (first_s, last_s) = (path.start_s(), path.end_s());
    let (mut near, mut before) = (0, None);
    let mut unknown_s = reference.unknown_s().map(|gap| gap[1]).peekable();
    let within = reference.rows().enumerate().filter(|(_, (t_s, _))| (first_s..=last_s).contains(t_s));
    let row = |(number, (t_s, angle)): (usize, (f64, [f64; 3]))| {
        let sigma = sigma_arcsec.get(number).map_or(Vector3::repeat(1.0), |own| with_rounding((*own).into()));
        let angle = Vector3::from(angle);
        let node = counts.node_s.partition_point(|node_s| *node_s <= t_s).saturating_sub(1);
        let next = (node + 1).min(attitudes.len() - 1);
        let share = (t_s - counts.node_s[node]) / (counts.node_s[next] - counts.node_s[node]).max(f64::MIN_POSITIVE);
        let since = Vector3::from(path.at(t_s, &mut near).0) + turned_arcsec[0] - turned_arcsec[node];
        let attitude = attitudes[node] * turn(since + coning_arcsec[next] * share);
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
        Row { number, t_s, attitude, beyond_arcsec, relative_arcsec, smooth_arcsec, sigma, is_used: true, begins }
    };
    Some(within.map(row).collect())
}

/// Sigma of a row about a control axis from the median of the second differences, as a multiple of the stated one.
pub fn second_difference_sigma(rows: &[Row], axis: usize) -> f64 {
    let difference = |of: &[Row]| {
        let [first, middle, last] = [0, 1, 2].map(|row| of[row].sigma[axis].powi(2));
        let stated = ((first + 4.0 * middle + last) / 6.0).sqrt();
        (of[2].beyond_arcsec[axis] - of[1].beyond_arcsec[axis]).abs() / stated
    };
    let mut sizes: Vec<f64> = rows.windows(3).map(difference).collect();
    median(&mut sizes) / MEDIAN_OF_NORMAL / 6f64.sqrt()
}

/// True if the rows differ from the gyros about an axis by noise, of which neighbouring second differences have different signs. Those of a motion
/// that a gyro does not sense, at a drift and scale factor that may be off, have the same.
pub fn is_noisy(rows: &[Row], axis: usize) -> bool {
    let second = |own: &[Row]| own[1].beyond_arcsec[axis] - own[0].beyond_arcsec[axis];
    let of_neighbours = |of: &dyn Fn(f64, f64) -> f64| {
        let pairs = rows.windows(3).map(|own| of(second(&own[..2]), second(&own[1..])).abs());
        median(&mut pairs.collect::<Vec<_>>())
    };
    of_neighbours(&|one, next| one + next) < of_neighbours(&|one, next| one - next)
}

/// True if the white noise of the relative attitude, averaged over the nodes of a block of that many rows, is a share of its walk over a block
/// or more: the walk is that of the gyros, white noise that of the reference. Second differences over a distance of n rows have 6 variances of the white noise and 2 n of the walk's growth.
pub fn is_white(rows: &[Row], rows_per_block: f64) -> bool {
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
