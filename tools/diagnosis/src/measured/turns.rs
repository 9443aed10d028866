//! Attitudes from accumulated angles, and back.

use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::{UnitQuaternion, Vector3};

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
