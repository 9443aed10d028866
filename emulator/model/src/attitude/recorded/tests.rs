use super::*;

fn rows(count: usize, angle: impl Fn(f64) -> f64) -> Vec<AttitudeRow> {
    let at = |index: usize| index as f64 * 0.5;
    (0..=count)
        .map(|index| AttitudeRow {
            t_s: at(index),
            angle_control_arcsec: [angle(at(index)) - angle(at(index.saturating_sub(1))), 0.0, 0.0],
            theta_psi_rad: None,
        })
        .collect()
}

#[test]
fn a_cubic_comes_back_exactly_and_a_limit_cycle_within_what_is_stated() {
    let cubic = |t: f64| 3.0 + t * (2.0 + t * (-1.5 + 0.25 * t));
    let swing = |t: f64| 4.0 * 5.0 / std::f64::consts::TAU * (1.0 - (std::f64::consts::TAU * t / 5.0).cos());
    for (angle, bound) in [(&cubic as &dyn Fn(f64) -> f64, 1e-12), (&swing, 0.0014)] {
        let recorded = RecordedAttitude::new(rows(40, angle)).expect("good rows");
        let mut near = 0;
        for index in 0..400 {
            let t_s = f64::from(index) * 0.05;
            let (got, _) = recorded.at(t_s, &mut near);
            // The intervals at the ends, with data on one side only, err up to ten times as much.
            let bound = if (3.0..17.0).contains(&t_s) { bound } else { 10.0 * bound };
            assert!((got[0] - (angle(t_s) - angle(0.0))).abs() <= bound, "{t_s}: {}", got[0] - angle(t_s) + angle(0.0));
        }
    }
}

#[test]
fn a_truth_moved_in_time_has_the_same_motion_at_the_moved_times() {
    let recorded = RecordedAttitude::new(rows(20, |t| t * t)).expect("good rows");
    let moved = recorded.clone().starting_at(-3.5);
    assert_eq!((moved.start_s(), moved.end_s()), (-3.5, 6.5));
    assert_eq!(moved.at(1.25, &mut 0).0, recorded.at(4.75, &mut 0).0);
    assert_eq!(moved.starting_at(0.0), recorded);
}

#[test]
fn gaps_and_overlaps_are_refused_with_the_row() {
    let mut gap = rows(20, |t| t);
    gap.drain(7..9);
    assert!(matches!(RecordedAttitude::new(gap), Err(AttitudeRowsError::Gap { index: 7, .. })));
    let mut overlap = rows(20, |t| t);
    overlap[5].t_s = overlap[4].t_s;
    assert!(matches!(RecordedAttitude::new(overlap.clone()), Err(AttitudeRowsError::NotRising { index: 5, .. })));
    assert!(matches!(RecordedAttitude::new(overlap[..3].to_vec()), Err(AttitudeRowsError::TooFew(2))));
}
