//! The paper's numbers hold, and a unit that departs from them is found out.

use geu_selftest::{ClaimCheck, experiments, measure};

fn measured(name: &str, overrides: &[&str]) -> Vec<ClaimCheck> {
    let experiment = experiments().find(|experiment| experiment.name == name).expect("an experiment");
    let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
    measure(experiment, 1, &overrides).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn every_number_holds_with_the_default_seed() {
    for experiment in experiments() {
        for result in measure(experiment, 1, &[]).expect("a valid configuration") {
            assert!(result.holds(), "{}: {result:?}, {} sigma off", experiment.name, result.off_sigma());
        }
    }
}

#[test]
fn names_are_unique() {
    let names: std::collections::HashSet<&str> = experiments().map(|experiment| experiment.name).collect();
    assert_eq!(names.len(), experiments().count());
}

#[test]
fn a_drift_six_sigma_off_is_found_out_and_one_four_sigma_off_is_not() {
    let sigma_deg_per_h = measured("drift", &[])[0].measured.sigma;
    for (sigmas, holds) in [(4.0, true), (6.0, false)] {
        let arcsec_per_h = 5400.0 + sigmas * sigma_deg_per_h * 3600.0;
        let result = measured("drift", &[&format!("gyro.GYRY.drift.arcsec_per_h={arcsec_per_h}")])[0];
        assert_eq!(result.holds(), holds, "{result:?}, {} sigma off", result.off_sigma());
    }
}

#[test]
fn a_unit_that_departs_from_the_paper_is_found_out() {
    for (name, claim, departure) in [
        ("drift ramp", 1, "gyro.GYRX.drift-ramp.arcsec_per_h_per_day=0.5"),
        (
            "angle random walk",
            0,
            "gyro={GYRX={angle-random-walk={arcsec_per_sqrt_s=0.02}}, GYRY={angle-random-walk={arcsec_per_sqrt_s=0.02}}}",
        ),
        ("launch", 0, "gyro.GYRZA.scale-factor.ppm=2001"),
        ("nonlinearity", 1, "gyro.GYRY.scale-factor-nonlinearity.cubic_ppm=850"),
        ("clock and scale factor", 1, "gyro.GYRZA.scale-factor-step={ppm=10, time_s=6000}"),
        ("clearance", 0, "gyro.GYRX.pivot-clearance.clearance_arcsec=15"),
        ("thermal misalignment", 1, "unit.misalignment-thermal.time_constant_s=330"),
        ("limit cycle", 0, "scenario.limit_cycle.rate_arcsec_s=4.9"),
        ("limit cycle", 1, "scenario.limit_cycle.period_s=5.01"),
        ("quadratic scale factor", 0, "gyro.GYRY.scale-factor-quadratic.ppm=410"),
        ("dead zone", 0, "gyro.GYRY.dead-zone.arcsec_per_s=4"),
        ("sensor lag", 0, "gyro.GYRY.sensor-lag.time_constant_s=2.01"),
        ("scale-factor noise", 0, "gyro.GYRX.scale-factor-noise.ppm_sqrt_s=11000"),
        ("bias instability", 0, "gyro.GYRX.bias-instability.arcsec_per_h=1800"),
        ("drift hysteresis", 2, "gyro.GYRX.drift-temperature-hysteresis.width_k=0.25"),
        ("stability", 0, "gyro.GYRZA.scale-factor-ramp.ppm_per_day=2000"),
    ] {
        let result = measured(name, &[departure])[claim];
        assert!(!result.holds(), "{departure}: {result:?}");
    }
}
