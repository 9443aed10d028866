//! Feasibility and timing of attitude profiles.

use super::*;
use crate::attitude::LimitCycle;
use crate::attitude::manoeuvre::Slew;

fn scenario(manoeuvres: Vec<Manoeuvre>) -> Scenario {
    Scenario { theta_deg: 90.0, psi_deg: 0.0, limit_cycle: LimitCycle::default(), manoeuvres }
}

fn legs(manoeuvres: Vec<Manoeuvre>, count: usize) -> Vec<(&'static str, f64, f64)> {
    let mut plan = AttitudeProfile::new(&scenario(manoeuvres)).expect("possible");
    let mut legs = Vec::new();
    while legs.len() < count {
        plan.next_segment();
        legs.extend(plan.take_legs());
    }
    legs.iter().map(|leg| (leg.name, leg.start_s, leg.end_s)).collect()
}

#[test]
fn the_default_scenario_takes_the_time_its_rates_say() {
    let legs = legs(crate::Configuration::reference().scenario.manoeuvres, 9);
    // 30° at 720″/s is 150 s and one ramp of 20 s more; 60° is 300 s; 360° at orbital speed is 6180 s and
    // 209.709/36 = 5.825 s.
    let ends = [600.0, 770.0, 1090.0, 1260.0, 7445.825, 7615.825, 13801.650];
    for (leg, end_s) in legs.iter().zip(ends) {
        assert!((leg.2 - end_s).abs() < 1e-3, "{leg:?} {end_s}");
    }
    assert_eq!(legs[7].0, "survey");
    assert_eq!(legs[8].0, "slew");
}

#[test]
fn an_infeasible_manoeuvre_is_rejected_with_the_number_to_change() {
    let slew = |to_theta_deg, rate_arcmin_s| Manoeuvre::Slew(Slew { to_theta_deg, rate_arcmin_s, ..Slew::default() });
    let endless = Manoeuvre::of_kind("survey").expect("a kind");
    for (manoeuvres, index, field) in [
        (vec![slew(91.0, 12.0)], 0, "kind"),
        (vec![slew(60.0, 12.0), Manoeuvre::of_kind("z-scan").expect("a kind")], 1, "kind"),
        (vec![Manoeuvre::of_kind("x-scan").expect("a kind")], 0, "kind"),
        (vec![endless.clone(), slew(90.0, 12.0)], 1, "kind"),
        (vec![Manoeuvre::Raster(Raster { lines: 400.0, ..Raster::default() })], 0, "theta_step_arcmin"),
        (vec![Manoeuvre::Eclipse(Eclipse { duration_s: 12.0, ..Eclipse::default() })], 0, "duration_s"),
        (vec![Manoeuvre::Survey(Survey { theta_step_deg: 50.0, ..Survey::default() })], 0, "theta_step_deg"),
        (
            // Possible at 90° and for thousands of scans, but not at 60°.
            vec![Manoeuvre::Survey(Survey {
                theta_step_deg: 0.002,
                angle_deg: 3.2,
                rate_z_arcmin_s: 10.0,
                slew_rate_arcmin_s: 0.1,
                ..Survey::default()
            })],
            0,
            "angle_deg",
        ),
    ] {
        let refused = AttitudeProfile::new(&scenario(manoeuvres)).expect_err("impossible");
        assert_eq!((refused.index, refused.field), (index, field), "{refused}");
    }
}

#[test]
fn a_long_finite_survey_may_be_followed_by_something() {
    let survey = Manoeuvre::Survey(Survey { scans: 10_002.0, ..Survey::default() });
    let scenario = scenario(vec![survey, Manoeuvre::Pointing(Pointing::default())]);
    assert!(AttitudeProfile::new(&scenario).is_ok());
}

#[test]
fn a_finite_scenario_ends_in_a_hold() {
    let mut plan =
        AttitudeProfile::new(&scenario(vec![Manoeuvre::Pointing(Pointing { duration_s: 5.0 })])).expect("possible");
    assert_eq!(plan.next_segment().duration_s, 5.0);
    assert_eq!(plan.next_segment().duration_s, f64::INFINITY);
}

#[test]
fn an_eclipse_lasts_as_long_as_it_says_and_turns_about_x_as_the_paper_has_it() {
    let rested = Eclipse { rate_z_arcmin_s: 0.0, ..Eclipse::default() };
    let scenario = Scenario {
        theta_deg: 60.0,
        ..scenario(vec![Manoeuvre::Eclipse(Eclipse::default()), Manoeuvre::Eclipse(rested)])
    };
    let mut motion =
        crate::attitude::Motion::new(AttitudeProfile::new(&scenario).expect("possible"), scenario.limit_cycle);
    motion.advance(600.0);
    // Casteren §5: 2.22 arcmin/s, with the sun's 0.04 arcsec/s.
    assert!((motion.now().rate_control_arcsec_s[0] / 60.0 - 2.22).abs() < 0.01);
    motion.advance(1100.0);
    let mut legs = motion.take_legs();
    motion.advance(1300.0);
    legs.extend(motion.take_legs());
    let ends: Vec<(bool, f64)> = legs.iter().map(|leg| (leg.eclipse, (leg.end_s * 1e6).round() * 1e-6)).collect();
    assert_eq!(ends, [(true, 1200.0), (true, 2400.0)]);
    assert_eq!(legs[1].start_rad, legs[1].end_rad);
}

#[test]
fn a_finite_survey_and_a_raster_have_as_many_lines_as_asked() {
    let survey = Manoeuvre::Survey(Survey { scans: 3.0, ..Survey::default() });
    let raster = Manoeuvre::Raster(Raster { lines: 2.0, ..Raster::default() });
    let names: Vec<&str> = legs(vec![survey, raster], 9).iter().map(|leg| leg.0).collect();
    assert_eq!(names, ["survey", "slew", "survey", "slew", "survey", "raster", "raster", "raster", "hold"]);
}
