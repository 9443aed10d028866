//! Attitudes from accumulated angles, and back.

use geu_calibration::AccumulatedCounts;
use geu_model::Configuration;
use geu_model::attitude::{AttitudeRow, RecordedAttitude};
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

/// A motion with these accumulated angles at these times, and θ and ψ of the reference.
pub fn recorded(times_s: &[f64], angles: &[Vector3<f64>], reference: &RecordedAttitude) -> Option<RecordedAttitude> {
    let mut near = 0;
    let row = |node: usize| {
        let before = angles[node.saturating_sub(1)];
        let moment = reference.knows_sun().then(|| reference.at(times_s[node], &mut near).1);
        AttitudeRow {
            t_s: times_s[node],
            angle_control_arcsec: (angles[node] - before).into(),
            theta_psi_rad: moment.map(|moment| (moment.theta_rad, moment.psi_rad)),
        }
    };
    let rows: Vec<AttitudeRow> = (0..times_s.len()).map(row).collect();
    RecordedAttitude::new(rows).ok()
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

#[cfg(test)]
mod tests {
    use super::*;

    use geu_calibration::without_coning;

    #[test]
    fn turns_from_row_to_row_without_their_coning_are_the_integrals_of_the_rates() {
        // A cone of 20 deg/s at 1 Hz, in steps of a hundredth of a row.
        let angle = |step: usize| {
            let (sin, cos) = (std::f64::consts::TAU * 1e-4 * step as f64).sin_cos();
            Vector3::new(sin, 1.0 - cos, 0.1 * sin) * (20.0 * 3600.0 / std::f64::consts::TAU)
        };
        let mut attitude = UnitQuaternion::identity();
        let of_row = |row: usize| {
            let before = attitude;
            (row.saturating_sub(1) * 100..row * 100).for_each(|step| attitude *= turn(angle(step + 1) - angle(step)));
            let turned = (before.inverse() * attitude).scaled_axis() * ARCSEC_PER_RAD;
            AttitudeRow { t_s: 0.01 * row as f64, angle_control_arcsec: turned.into(), theta_psi_rad: None }
        };
        let rows: Vec<AttitudeRow> = (0..=1000).map(of_row).collect();
        let rows = RecordedAttitude::new(rows).expect("rows");
        let error = |motion: &RecordedAttitude| {
            let off = motion.rows().enumerate().map(|(row, (_, own))| (Vector3::from(own) - angle(100 * row)).norm());
            off.fold(0.0, f64::max)
        };
        let with = error(&rows);
        // The ends are as they are.
        assert!(with > 10.0 && error(&without_coning(rows)) < 0.01 * with);
    }
}
