//! Attitudes from accumulated angles, and back.

use geu_calibration::AccumulatedCounts;
use geu_model::Configuration;
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::{Matrix3xX, UnitQuaternion, Vector3};

/// The turn by a rotation vector.
pub fn turn(arcsec: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(arcsec / ARCSEC_PER_RAD)
}

/// Attitudes, control frame to inertial, from accumulated angles and the coning before each; the first is the origin.
pub fn attitudes(angles: &[Vector3<f64>], coning: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let mut attitude = UnitQuaternion::identity();
    let of_node = |node: usize| {
        attitude *= turn(angles[node] - angles[node.saturating_sub(1)] + coning[node]);
        attitude
    };
    (0..angles.len()).map(of_node).collect()
}

/// Accumulated angles about the control axes from attitudes and the coning before each.
pub fn accumulated(attitudes: impl Iterator<Item = UnitQuaternion<f64>>, coning: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let (mut sum, mut before) = (Vector3::zeros(), None);
    let of_node = |(attitude, coning): (UnitQuaternion<f64>, &Vector3<f64>)| {
        let last = before.replace(attitude).unwrap_or(attitude);
        sum += (last.inverse() * attitude).scaled_axis() * ARCSEC_PER_RAD - coning;
        sum
    };
    attitudes.zip(coning).map(of_node).collect()
}

/// Coning in the interval before a node about the control axes of this inverse: each pair of gyros turns about the axis
/// perpendicular to both.
pub fn coning_about_axes(
    counts: &AccumulatedCounts,
    node: usize,
    inverse: &Matrix3xX<f64>,
    nominal: &Configuration,
) -> Vector3<f64> {
    let axis = |gyro: usize| inverse.column(gyro) * nominal.gyros[gyro].calibration.scale_factor;
    let pairs = (1..counts.coning.len()).flat_map(|other| (0..other).map(move |one| (one, other)));
    let of_pair = |(one, other): (usize, usize)| axis(one).cross(&axis(other)) * counts.coning[one][other][node];
    pairs.map(of_pair).sum::<Vector3<f64>>() / ARCSEC_PER_RAD
}
