//! Gaps between exact rows of a reference, filled with the motion of the gyros.
//!
//! The rows stay as they are. In a gap the attitude relative to that by the gyros is linear from the row before to the row after.

use geu_calibration::AccumulatedCounts;
use geu_model::attitude::{AttitudeRow, GAP_SPACINGS, RecordedAttitude};
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::Vector3;

use super::reference_motion::{GLITCH_ARCSEC, GLITCH_SIGMAS};
use super::relative_rows::{GyroMotion, Row};
use super::turns::turn;

/// Turn of a lone row there and back over the turns beside it: an effect or a wrong time does not come back within a row.
const LONE: f64 = 4.0;
/// Distance of a node from a row, in intervals of the nodes, from which it is used in a gap.
const BESIDE: f64 = 0.5;

/// Indices of the rows far from those beside them, which agree; the sigma of a row is `scale` times the stated one.
pub fn lone_rows(rows: &[Row], scale: Vector3<f64>) -> Vec<usize> {
    let turn = |row: usize| rows[row].beyond_arcsec;
    let is_lone = |row: &usize| {
        let [before, there, back, after] = [row - 1, *row, row + 1, row + 2].map(turn);
        let off = (there - back) / 2.0;
        let limit = GLITCH_SIGMAS * scale.component_mul(&rows[*row].sigma);
        let is_far = (0..3).any(|axis| off[axis].abs() > limit[axis].max(GLITCH_ARCSEC));
        is_far
            && off.norm() > LONE * [before, there + back, after].map(|own| own.norm()).into_iter().fold(0.0, f64::max)
    };
    (2..rows.len().saturating_sub(2)).filter(is_lone).collect()
}

/// The motion of the reference without the rows that are not used, with a row at each node in its gaps. `rows` are those within the counts.
pub fn filled(
    rows: &[Row],
    counts: &AccumulatedCounts,
    gyros: &GyroMotion,
    reference: &RecordedAttitude,
    spacing_s: f64,
) -> Option<RecordedAttitude> {
    let used: Vec<&Row> = rows.iter().filter(|row| row.is_used).collect();
    let is_gap = |from: &Row, to: &Row| {
        let is_long = to.t_s - from.t_s > GAP_SPACINGS * spacing_s;
        !to.begins && (is_long || to.number > from.number + 1)
    };
    let mut gaps = used.windows(2).filter(|pair| is_gap(pair[0], pair[1])).peekable();
    let mut unused = rows.iter().filter(|row| !row.is_used).map(|row| row.number).peekable();
    let mut unknown_s = reference.unknown_s().map(|gap| gap[1]).peekable();
    let (mut near, mut before, mut unknown) = (0, None, Vec::new());
    let mut all: Vec<AttitudeRow> = Vec::with_capacity(rows.len());
    let mut sun = |t_s: f64| {
        reference.knows_sun().then(|| reference.at(t_s, &mut near).1).map(|moment| (moment.theta_rad, moment.psi_rad))
    };
    for (number, (t_s, angle)) in reference.rows().enumerate() {
        let angle = Vector3::from(angle);
        let mut turned = angle - before.unwrap_or(angle);
        before = Some(angle);
        if unused.next_if_eq(&number).is_some() {
            continue;
        }
        if let Some(pair) = gaps.next_if(|pair| pair[1].number == number) {
            let (from, to) = (pair[0], pair[1]);
            let beside_s = BESIDE * counts.interval_s;
            let [first, last] = [from.t_s + beside_s, to.t_s - beside_s]
                .map(|end_s| counts.node_s.partition_point(|node_s| *node_s < end_s));
            let mut attitude = from.absolute();
            for node in first..last {
                let node_s = counts.node_s[node];
                let share = (node_s - from.t_s) / (to.t_s - from.t_s);
                let own = turn(from.relative_arcsec.lerp(&to.relative_arcsec, share)) * gyros.attitudes[node];
                let turned = (attitude.inverse() * own).scaled_axis() * ARCSEC_PER_RAD;
                attitude = own;
                all.push(AttitudeRow { t_s: node_s, angle_control_arcsec: turned.into(), theta_psi_rad: sun(node_s) });
            }
            turned = (attitude.inverse() * to.absolute()).scaled_axis() * ARCSEC_PER_RAD;
        }
        while unknown_s.next_if(|end_s| *end_s <= t_s).is_some() {
            unknown.push(all.len());
        }
        all.push(AttitudeRow { t_s, angle_control_arcsec: turned.into(), theta_psi_rad: sun(t_s) });
    }
    unknown.dedup();
    RecordedAttitude::with_unknown_turns(all, unknown, &[], true).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    use geu_calibration::transfer::sensing_matrix;
    use geu_model::Configuration;
    use geu_model::units::SAMPLE_INTERVAL_S;
    use nalgebra::UnitQuaternion;

    use crate::measured::relative_rows;

    /// Attitude at a node of a turn about an axis that moves.
    fn attitude(node: usize) -> UnitQuaternion<f64> {
        let t = node as f64 * SAMPLE_INTERVAL_S;
        turn(Vector3::new(3.0 * (1.25 * t).sin(), 30.0 * t, 0.0)) * turn(Vector3::new(0.0, 0.0, 200.0 * t))
    }

    /// The reference with these rows, counts of a unit with an error of the scale factor of 1000 ppm, and the motion by these.
    fn recorded(numbers: &[usize], glitch: usize) -> (RecordedAttitude, AccumulatedCounts, GyroMotion) {
        let own = |number: usize| if number == glitch { UnitQuaternion::identity() } else { attitude(number) };
        let mut before = own(numbers[0]);
        let row = |number: &usize| {
            let now = own(*number);
            let turned = (std::mem::replace(&mut before, now).inverse() * now).scaled_axis() * ARCSEC_PER_RAD;
            let t_s = *number as f64 * SAMPLE_INTERVAL_S;
            AttitudeRow { t_s, angle_control_arcsec: turned.into(), theta_psi_rad: None }
        };
        let reference = RecordedAttitude::with_gaps(numbers.iter().map(row).collect()).expect("rows");
        let nominal = Configuration::reference();
        let matrix = sensing_matrix(&nominal);
        let mut counts = AccumulatedCounts::starting_at(0);
        for node in 1..=200 {
            let turned = (attitude(node - 1).inverse() * attitude(node)).scaled_axis() * ARCSEC_PER_RAD * 1.001;
            let sensed = &matrix * turned;
            let increments: [f64; 4] = std::array::from_fn(|gyro| {
                let calibration = &nominal.gyros[gyro].calibration;
                (sensed[gyro] - calibration.drift_arcsec_per_half_s) / calibration.scale_factor
            });
            counts.push(node as f64 * SAMPLE_INTERVAL_S, &increments, 20.0);
        }
        let gyros = GyroMotion::new(&counts, &reference, &matrix, &nominal, true);
        (reference, counts, gyros)
    }

    #[test]
    fn a_gap_and_a_lone_row_are_filled_and_the_other_rows_stay() {
        let numbers: Vec<usize> = (0..=200).filter(|number| !(80..110).contains(number)).collect();
        let (reference, counts, gyros) = recorded(&numbers, 50);
        let mut rows = relative_rows::rows(&counts, &gyros, &reference, &[]).expect("rows");
        let lone = lone_rows(&rows, Vector3::repeat(0.1));
        assert_eq!(lone, [50]);
        lone.into_iter().for_each(|row| rows[row].is_used = false);
        let filled = filled(&rows, &counts, &gyros, &reference, SAMPLE_INTERVAL_S).expect("a motion");
        let times_s: Vec<f64> = filled.rows().map(|row| row.0).collect();
        assert_eq!(times_s, (0..=200).map(|node| node as f64 * SAMPLE_INTERVAL_S).collect::<Vec<_>>());
        let mut own = attitude(0);
        let mut before = Vector3::zeros();
        for (node, (_, angle)) in filled.rows().enumerate() {
            own *= turn(Vector3::from(angle) - before);
            before = angle.into();
            let off_arcsec = (own.inverse() * attitude(node)).angle() * ARCSEC_PER_RAD;
            // By the gyros alone the last one is off by 3″.
            let limit_arcsec = if node == 50 || (80..110).contains(&node) { 0.5 } else { 1e-3 };
            assert!(off_arcsec < limit_arcsec, "{node}: {off_arcsec}");
        }
    }

    #[test]
    fn the_start_of_a_turn_and_a_row_within_the_noise_are_not_lone() {
        let numbers: Vec<usize> = (0..=200).collect();
        let (reference, counts, gyros) = recorded(&numbers, 1000);
        let mut rows = relative_rows::rows(&counts, &gyros, &reference, &[]).expect("rows");
        assert!(lone_rows(&rows, Vector3::repeat(0.1)).is_empty());
        // A turn that the gyros do not sense begins, and another one comes back after two rows.
        rows[60].beyond_arcsec.x += 50.0;
        rows[120].beyond_arcsec.x += 50.0;
        rows[122].beyond_arcsec.x -= 50.0;
        assert!(lone_rows(&rows, Vector3::repeat(0.1)).is_empty());
        rows[160].beyond_arcsec.x += 50.0;
        rows[161].beyond_arcsec.x -= 50.0;
        assert_eq!(lone_rows(&rows, Vector3::repeat(0.1)), [160]);
        assert!(lone_rows(&rows, Vector3::repeat(10.0)).is_empty());
    }
}
