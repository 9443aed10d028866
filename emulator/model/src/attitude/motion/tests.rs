//! Rotations against closed forms.

use std::f64::consts::TAU;

use super::*;
use crate::attitude::{Manoeuvre, Scenario};

fn motion(scenario: &Scenario) -> Motion {
    Motion::new(AttitudeProfile::new(scenario).expect("possible"), scenario.limit_cycle)
}

fn still() -> Scenario {
    Scenario { theta_deg: 90.0, psi_deg: 0.0, limit_cycle: LimitCycle::default(), manoeuvres: Vec::new() }
}

#[test]
fn a_pointing_turns_with_the_sun() {
    // Casteren eq 8 without its misprint: θ = 60°, ψ = 40°, one hour; ω_sun = 360·3600/365.25/24 = 147.844″/h (a pocket calculator).
    let scenario = Scenario { theta_deg: 60.0, psi_deg: 40.0, ..still() };
    let angle = motion(&scenario).advance(3600.0).angle_control_arcsec;
    for (got, expected) in angle.into_iter().zip([98.081734, -95.032254, -56.627515]) {
        assert!((got - expected).abs() < 1e-5, "{got} {expected}");
    }
}

#[test]
fn whole_and_partial_intervals_agree_in_every_kind_of_manoeuvre() {
    let scenario = crate::Configuration::reference().scenario;
    let (mut coarse, mut fine) = (motion(&scenario), motion(&scenario));
    for sample in 1..=40_000 {
        let end_s = 0.5 * f64::from(sample);
        let whole = coarse.advance(end_s);
        let mut sum = [0.0; 3];
        for part in (0..7).rev() {
            let step = fine.advance(end_s - 0.5 * f64::from(part) / 7.0);
            for (sum, angle) in sum.iter_mut().zip(step.angle_control_arcsec) {
                *sum += angle;
            }
        }
        for (a, b) in whole.angle_control_arcsec.into_iter().zip(sum) {
            assert!((a - b).abs() < 1e-9, "{end_s}: {a} {b}");
        }
    }
}

#[test]
fn a_scan_about_the_sun_vector_turns_once_about_it() {
    // A Z-scan at θ = 90°: Δψ = 360° about Z, and the sun's part about Z vanishes with cos θ.
    let scenario = Scenario { manoeuvres: vec![Manoeuvre::of_kind("z-scan").expect("a kind")], ..still() };
    let angle = motion(&scenario).advance(7000.0).angle_control_arcsec;
    assert!((angle[2] - TAU * ARCSEC_PER_RAD).abs() < 1e-6, "{}", angle[2]);
}

#[test]
fn the_departure_by_the_limit_cycle_is_its_integral_about_zero() {
    let cycle = LimitCycle { rate_arcsec_s: 4.0, phase_x_rad: 0.7, ..LimitCycle::default() };
    let mut with = motion(&Scenario { limit_cycle: cycle, ..still() });
    let mut without = motion(&still());
    let (mut turned, start) = ([0.0; 2], with.departure_control_arcsec());
    for tenth in 1..=100 {
        let end_s = f64::from(tenth) * 0.1;
        let (a, b) = (with.advance(end_s).angle_control_arcsec, without.advance(end_s).angle_control_arcsec);
        for axis in 0..2 {
            turned[axis] += a[axis] - b[axis];
            let departure = with.departure_control_arcsec()[axis];
            assert!((departure - start[axis] - turned[axis]).abs() < 1e-9);
            // 4·5/2π, under the 5 arcsec of Casteren §6.
            assert!(departure.abs() < 3.184);
        }
    }
}

#[test]
fn the_limit_cycle_swings_by_its_rate_times_its_period() {
    let with = Scenario { limit_cycle: LimitCycle { rate_arcsec_s: 4.0, ..LimitCycle::default() }, ..still() };
    let half_swing = |scenario: &Scenario| motion(scenario).advance(2.5).angle_control_arcsec[0];
    // The integral of 4 sin(2πt/5) over half a period is 4·5/π.
    assert!((half_swing(&with) - half_swing(&still()) - 20.0 / std::f64::consts::PI).abs() < 1e-12);
}
