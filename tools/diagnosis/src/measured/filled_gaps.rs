//! Gaps between exact rows of a reference, filled with the motion of the gyros.
//!
//! The rows stay as they are, but for wrong ones. In a gap the attitude relative to that by the gyros changes evenly from the row before to the row after.

use geu_calibration::AccumulatedCounts;
use geu_checks::{LONE, MAX_WRONG};
use geu_model::attitude::{AttitudeRow, GAP_SPACINGS, RecordedAttitude, Sun};
use geu_model::units::ARCSEC_PER_RAD;
use nalgebra::{UnitQuaternion, Vector3};

use super::reference_motion::{GLITCH_ARCSEC, GLITCH_SIGMAS};
use super::relative_rows::{GyroMotion, Row};

/// Jump as a share of the change of the gyros' turn from row to row, up to which it may be an error of the interpolation between nodes, or of a
/// gyro that repeats a sample.
const BEND: f64 = 1.0;
/// Minimum distance from a row of a node that is used in a gap, in intervals of the nodes.
const BESIDE: f64 = 0.5;

/// Leaves out the rows that jump away from the attitude before and come back; returns true if there are any. The sigma of a row is `scale` times
/// the stated one.
pub fn leave_out_wrong(rows: &mut [Row], scale: Vector3<f64>) -> bool {
    for part in rows.chunk_by_mut(|_, next| !next.begins) {
        wrong_rows(part, scale).into_iter().for_each(|row| part[row].is_used = false);
        let begins = part.first().is_some_and(|first| first.begins);
        part.iter_mut().find(|row| row.is_used).into_iter().for_each(|first| first.begins = begins);
    }
    rows.iter().any(|row| !row.is_used)
}

/// Indices of the wrong rows of a part of which all turns are known.
fn wrong_rows(rows: &[Row], scale: Vector3<f64>) -> Vec<usize> {
    let Some(last) = rows.len().checked_sub(1).filter(|last| *last >= 4) else { return Vec::new() };
    let jump = |from: usize, to: usize| between(&rows[from], &rows[to]).angle() * ARCSEC_PER_RAD;
    let turn = |row: usize| (rows[row - 1].attitude.inverse() * rows[row].attitude).scaled_axis() * ARCSEC_PER_RAD;
    let bend = |row: usize| if (1..last).contains(&row) { (turn(row + 1) - turn(row)).norm() } else { 0.0 };
    let is_far = |row: usize, jump: f64| {
        let noise = GLITCH_SIGMAS * scale.component_mul(&rows[row].sigma).max();
        jump > noise.max(GLITCH_ARCSEC) && jump > BEND * (row - 1..=row + 1).map(bend).fold(0.0, f64::max)
    };
    let mut wrong = Vec::new();
    let mut row = 1;
    while row <= last {
        let far = jump(row - 1, row);
        let is_small = |other: f64| LONE * other <= far;
        let is_lone = is_far(row, far) && (row < 2 || is_small(jump(row - 2, row - 1)));
        let is_back =
            |other: &usize| is_small(jump(row - 1, *other)) && (*other == last || is_small(jump(*other, other + 1)));
        let back = (row + 1..=last.min(row + MAX_WRONG)).filter(|_| is_lone).find(is_back);
        // A right row may lie between wrong ones.
        wrong.extend((row..back.unwrap_or(row)).filter(|other| !is_small(jump(row - 1, *other))));
        row = back.unwrap_or(row) + 1;
    }
    // From the first and the last row there is one jump alone.
    let is_end = |own: usize, beside: [usize; 3]| {
        let far = jump(own, beside[0]);
        let is_small = |pair: &[usize]| LONE * jump(pair[0], pair[1]) <= far;
        is_far(own.max(beside[0]), far)
            && beside.windows(2).all(is_small)
            && !beside.iter().any(|row| wrong.contains(row))
    };
    let ends = [(0, [1, 2, 3]), (last, [last - 1, last - 2, last - 3])]
        .map(|(own, beside)| is_end(own, beside).then_some(own));
    wrong.extend(ends.into_iter().flatten());
    wrong
}

/// Change of the attitude relative to that by the gyros from a row to another one, in inertial space.
fn between(from: &Row, to: &Row) -> UnitQuaternion<f64> {
    to.relative() * from.relative().inverse()
}

/// The motion from the first to the last row that is used, with a row at each node in its gaps. `rows` are those within the counts.
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
    let is_used = |number: usize| used.binary_search_by_key(&number, |row| row.number).is_ok();
    let mut unknown_s = reference.unknown_s().map(|gap| gap[1]).peekable();
    let (mut near, mut before, mut unknown) = (0, None, Vec::new());
    let mut all: Vec<AttitudeRow> = Vec::with_capacity(rows.len());
    let mut sun = |t_s: f64| {
        let moment = reference.knows_sun().then(|| reference.at(t_s, &mut near).1)?;
        Some(Sun { theta_rad: moment.theta_rad, psi_rad: moment.psi_rad, ..Sun::default() })
    };
    let row = |t_s: f64, turned: Vector3<f64>, sun: Option<Sun>| AttitudeRow {
        t_s,
        angle_control_arcsec: turned.into(),
        theta_psi_rad: sun.map(|sun| (sun.theta_rad, sun.psi_rad)),
    };
    for (number, (t_s, angle)) in reference.rows().enumerate() {
        let angle = Vector3::from(angle);
        let mut turned = angle - before.unwrap_or(angle);
        before = Some(angle);
        if !is_used(number) {
            continue;
        }
        if let Some(pair) = gaps.next_if(|pair| pair[1].number == number) {
            let (from, to) = (pair[0], pair[1]);
            let beside_s = BESIDE * counts.interval_s;
            let [first, last] = [from.t_s + beside_s, to.t_s - beside_s]
                .map(|end_s| counts.node_s.partition_point(|node_s| *node_s < end_s));
            let (mut attitude, change) = (from.absolute(), between(from, to).scaled_axis());
            let [sun_from, sun_to] = [from, to].map(|row| sun(row.t_s));
            for node in first..last {
                let node_s = counts.node_s[node];
                let share = (node_s - from.t_s) / (to.t_s - from.t_s);
                let relative = UnitQuaternion::from_scaled_axis(change * share) * from.relative();
                let own = relative * gyros.attitudes[node];
                let turned = (attitude.inverse() * own).scaled_axis() * ARCSEC_PER_RAD;
                attitude = own;
                all.push(row(node_s, turned, sun_from.zip(sun_to).map(|(from, to)| from.towards(&to, share))));
            }
            turned = (attitude.inverse() * to.absolute()).scaled_axis() * ARCSEC_PER_RAD;
        }
        while unknown_s.next_if(|end_s| *end_s <= t_s).is_some() {
            // Before the first row nothing is known anyway.
            unknown.extend((!all.is_empty()).then_some(all.len()));
        }
        all.push(row(t_s, turned, sun(t_s)));
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

    use crate::measured::relative_rows;

    const NODES: usize = 200;
    const SIGMA_ARCSEC: f64 = 0.1;

    /// A limit cycle, and turns about Y and Z, the one about Y from node 150 on at once 360″/s faster.
    fn attitude(t_s: f64) -> UnitQuaternion<f64> {
        let faster_arcsec = 360.0 * (t_s - 75.0).max(0.0);
        turn(Vector3::new(3.0 * (1.25 * t_s).sin(), 30.0 * t_s + faster_arcsec, 0.0))
            * turn(Vector3::new(0.0, 0.0, 200.0 * t_s))
    }

    fn turn(arcsec: Vector3<f64>) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(arcsec / ARCSEC_PER_RAD)
    }

    /// A reference with rows at these times, the `wrong` ones far off, and its rows beside gyros with an error of the scale factor of
    /// 1000 ppm in [`NODES`] nodes.
    struct Recorded {
        reference: RecordedAttitude,
        counts: AccumulatedCounts,
        gyros: GyroMotion,
        rows: Vec<Row>,
    }

    fn recorded(times_s: &[f64], wrong: &[usize]) -> Recorded {
        recorded_in_parts(times_s, wrong, Vec::new())
    }

    /// A recording with unknown turns before some rows.
    fn recorded_in_parts(times_s: &[f64], wrong: &[usize], unknown: Vec<usize>) -> Recorded {
        let own = |row: usize| if wrong.contains(&row) { turn(Vector3::repeat(1e4)) } else { attitude(times_s[row]) };
        let mut before = own(0);
        let row = |row: usize| {
            let now = own(row);
            let turned = (std::mem::replace(&mut before, now).inverse() * now).scaled_axis() * ARCSEC_PER_RAD;
            let theta_psi_rad = Some((1.0, 3.1 + 1e-3 * times_s[row]));
            AttitudeRow { t_s: times_s[row], angle_control_arcsec: turned.into(), theta_psi_rad }
        };
        let rows = (0..times_s.len()).map(row).collect();
        let reference = RecordedAttitude::with_unknown_turns(rows, unknown, &[], true).expect("rows");
        let nominal = Configuration::reference();
        let matrix = sensing_matrix(&nominal);
        let mut counts = AccumulatedCounts::starting_at(0);
        for node in 1..=NODES {
            let [from, to] = [node - 1, node].map(|node| attitude(node as f64 * SAMPLE_INTERVAL_S));
            let sensed = &matrix * ((from.inverse() * to).scaled_axis() * ARCSEC_PER_RAD * 1.001);
            let increments: [f64; 4] = std::array::from_fn(|gyro| {
                let calibration = &nominal.gyros[gyro].calibration;
                (sensed[gyro] - calibration.drift_arcsec_per_half_s) / calibration.scale_factor
            });
            counts.push(node as f64 * SAMPLE_INTERVAL_S, &increments, 20.0);
        }
        let gyros = GyroMotion::new(&counts, &reference, &matrix, &nominal, false);
        let rows = relative_rows::rows(&counts, &gyros, &reference, &[]).expect("rows");
        Recorded { reference, counts, gyros, rows }
    }

    /// Times of rows every sample, from and to beyond the counts.
    fn times_s(late_s: f64) -> Vec<f64> {
        (-4..NODES as i32 + 4).map(|row| f64::from(row) * SAMPLE_INTERVAL_S + late_s).collect()
    }

    fn left_out_s(recorded: &mut Recorded) -> Vec<f64> {
        leave_out_wrong(&mut recorded.rows, Vector3::repeat(SIGMA_ARCSEC));
        recorded.rows.iter().filter(|row| !row.is_used).map(|row| row.t_s).collect()
    }

    #[test]
    fn gaps_and_wrong_rows_are_filled_and_the_other_rows_stay() {
        for late_s in [0.0, 0.2] {
            let times_s: Vec<f64> = times_s(late_s).into_iter().filter(|t_s| !(40.0..55.0).contains(t_s)).collect();
            let wrong: Vec<usize> = [20, 40, 41, 42].to_vec();
            let mut own = recorded(&times_s, &wrong);
            assert_eq!(left_out_s(&mut own), wrong.iter().map(|row| times_s[*row]).collect::<Vec<_>>());
            let Recorded { reference, counts, gyros, rows } = &own;
            let filled = filled(rows, counts, gyros, reference, SAMPLE_INTERVAL_S).expect("a motion");
            assert!(filled.gaps_s().is_empty());
            let (mut found, mut before, mut near) = (attitude(filled.start_s()), Vector3::zeros(), 0);
            let mut at_nodes = 0;
            for (t_s, angle) in filled.rows() {
                found *= turn(Vector3::from(angle) - before);
                before = angle.into();
                let is_of_gyros = !(0..times_s.len()).any(|row| times_s[row] == t_s && !wrong.contains(&row));
                at_nodes += usize::from(is_of_gyros);
                let off_arcsec = (found.inverse() * attitude(t_s)).angle() * ARCSEC_PER_RAD;
                // The gyros alone are off by 3″ after the gap.
                assert!(off_arcsec < if is_of_gyros { 0.3 } else { 1e-3 }, "{t_s}: {off_arcsec}");
                let psi_rad = filled.at(t_s, &mut near).1.psi_rad;
                assert!((psi_rad - 3.1 - 1e-3 * t_s).abs() < 1e-9, "{t_s}: {psi_rad}");
            }
            assert!(at_nodes > 30, "{at_nodes}");
        }
    }

    #[test]
    fn the_first_and_the_last_row_may_be_wrong() {
        let times_s: Vec<f64> = (0..=NODES).map(|node| node as f64 * SAMPLE_INTERVAL_S).collect();
        assert_eq!(left_out_s(&mut recorded(&times_s, &[0, NODES])), [0.0, NODES as f64 * SAMPLE_INTERVAL_S]);
    }

    #[test]
    fn jumps_of_the_rate_and_of_the_angle_and_long_departures_are_not_wrong_rows() {
        for late_s in [0.0, 0.1, 0.2, 0.25, 0.3] {
            assert!(left_out_s(&mut recorded(&times_s(late_s), &[])).is_empty(), "{late_s}");
        }
        let wrong: Vec<usize> = (60..60 + MAX_WRONG + 1).collect();
        assert!(left_out_s(&mut recorded(&times_s(0.0), &wrong)).is_empty());
        let mut own = recorded(&times_s(0.0), &[]);
        own.rows.iter_mut().skip(100).for_each(|row| row.relative_arcsec.x += 50.0);
        assert!(left_out_s(&mut own).is_empty());
        // A gyro that repeats a sample and catches up.
        let late = own.rows[30].attitude * own.rows[31].attitude.inverse();
        own.rows[31].attitude = own.rows[30].attitude;
        own.rows[31].relative_arcsec = (late.inverse() * own.rows[31].relative()).scaled_axis() * ARCSEC_PER_RAD;
        assert!(left_out_s(&mut own).is_empty());
    }

    #[test]
    fn right_rows_beside_wrong_ones_stay() {
        for wrong in [vec![60, 62], vec![1, 2, 3], vec![197, 198, 199]] {
            let times_s: Vec<f64> = (0..=NODES).map(|node| node as f64 * SAMPLE_INTERVAL_S).collect();
            let expected_s: Vec<f64> = wrong.iter().map(|row| times_s[*row]).collect();
            assert_eq!(left_out_s(&mut recorded(&times_s, &wrong)), expected_s);
        }
    }

    #[test]
    fn wrong_rows_at_the_ends_of_the_counts_leave_nothing_in_the_motion() {
        for (late_s, wrong) in [(0.0, vec![4, 203]), (0.2, vec![4, 202])] {
            let mut own = recorded(&times_s(late_s), &wrong);
            assert_eq!(left_out_s(&mut own).len(), wrong.len());
            let Recorded { reference, counts, gyros, rows } = &own;
            let filled = filled(rows, counts, gyros, reference, SAMPLE_INTERVAL_S).expect("a motion");
            let ends_s = [rows.first(), rows.last()].map(|row| row.expect("rows").t_s);
            assert!(filled.start_s() >= ends_s[0] && filled.end_s() <= ends_s[1]);
            let (first_arcsec, last_arcsec) = (filled.rows().next(), filled.rows().last());
            let turned = Vector3::from(last_arcsec.expect("rows").1) - Vector3::from(first_arcsec.expect("rows").1);
            // The wrong rows are 17000″ off.
            assert!((turned.z - 200.0 * (filled.end_s() - filled.start_s())).abs() < 500.0, "{turned}");
        }
    }

    #[test]
    fn the_gap_before_a_part_stays_unknown_without_its_first_row() {
        let mut own = recorded(&times_s(0.0), &[60]);
        own.rows[56].begins = true;
        assert!(leave_out_wrong(&mut own.rows, Vector3::repeat(SIGMA_ARCSEC)));
        assert!(!own.rows[56].is_used && own.rows[57].is_used && own.rows[57].begins);
        // One lies before the counts, and one within them.
        let own = recorded_in_parts(&times_s(0.0), &[], vec![2, 60]);
        let Recorded { reference, counts, gyros, rows } = &own;
        let filled = filled(rows, counts, gyros, reference, SAMPLE_INTERVAL_S).expect("a motion");
        assert_eq!(filled.gaps_s(), [[27.5, 28.0]]);
    }

    #[test]
    fn a_row_within_the_noise_is_not_wrong() {
        for (moved_arcsec, expected) in [(6.0, 0), (20.0, 1)] {
            let mut own = recorded(&times_s(0.0), &[]);
            own.rows[50].relative_arcsec.x += moved_arcsec;
            leave_out_wrong(&mut own.rows, Vector3::repeat(1.0));
            assert_eq!(own.rows.iter().filter(|row| !row.is_used).count(), expected, "{moved_arcsec}");
        }
    }
}
