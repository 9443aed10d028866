//! The configurations that ship: each can be run, and holds what it says.

use geu_model::attitude::{AttitudeProfile, Leg, Motion};
use geu_model::effect::{EffectSpec, GyroEffects, UnitEffects, WiringEffects};
use geu_model::units::{ORBIT_S, RAD_PER_DEG};
use geu_model::{Configuration, GyroUnit};

fn shipped(name: &str, text: &str) -> Configuration {
    Configuration::parse(name, text, &[]).unwrap_or_else(|error| panic!("{error}"))
}

fn paper() -> Configuration {
    shipped("configs/paper.toml", include_str!("../../../configs/paper.toml"))
}

fn checkout() -> Configuration {
    shipped("configs/checkout.toml", include_str!("../../../configs/checkout.toml"))
}

/// True if the paper has the effect: its paper value is neither `0` nor `off`.
fn the_paper_has(spec: &EffectSpec) -> bool {
    !matches!(spec.paper, "0" | "off")
}

#[test]
fn paper_toml_has_every_effect_of_the_paper_and_no_other() {
    let configuration = paper();
    for (index, spec) in UnitEffects::SPECS.iter().enumerate() {
        assert_eq!(configuration.unit.has(index), the_paper_has(spec), "{}", spec.code);
    }
    for gyro in &configuration.gyros {
        for (index, spec) in GyroEffects::SPECS.iter().enumerate() {
            assert_eq!(gyro.effects.has(index), the_paper_has(spec), "{}", spec.code);
        }
        for (index, spec) in WiringEffects::SPECS.iter().enumerate() {
            assert_eq!(gyro.wiring.has(index), the_paper_has(spec), "{}", spec.code);
        }
        // The paper gives one of drift and two of scale factor beside the launch's (§3.1, §3.2).
        assert_eq!(gyro.effects.courses.len(), 3);
    }
    let reference = Configuration::reference();
    assert_eq!(configuration.scenario, reference.scenario);
    for (own, reference) in configuration.gyros.iter().zip(&reference.gyros) {
        assert_eq!(own.calibration, reference.calibration);
    }
}

#[test]
fn every_number_of_paper_toml_states_its_source() {
    let text = include_str!("../../../configs/paper.toml");
    let effects = &text[text.find("[unit]").expect("effects of the unit")..];
    let mut before = "";
    for line in effects.lines() {
        if line.contains(" = {") {
            assert!(before.contains("(Casteren") || before.contains("table 1"), "no source before: {line}");
        }
        before = line;
    }
}

#[test]
fn paper_toml_runs() {
    let mut unit = GyroUnit::new(&paper());
    let counts: i64 = (0..1540).map(|_| i64::from(unit.end_sample().sample.increments[1])).sum();
    // θ from 90° to 60° by 770 s, at GYRY's scale factor 0.9987·(1 − 0.002); drift, sun, Z rate and bending are a few 100″.
    assert!((counts as f64 + 108_000.0 / 0.9967).abs() < 500.0, "{counts}");
}

#[test]
fn no_accumulated_count_of_a_day_is_further_from_its_angle_than_rounding() {
    // Beside half a count, what adding up a day of counts as f64 costs.
    let bound = 0.5 + 1e-6;
    for configuration in [Configuration::reference(), paper()] {
        let mut unit = GyroUnit::new(&configuration);
        let (mut counts, mut angles) = ([0.0; 4], [0.0; 4]);
        for row in 1..=172_800 {
            let (ended, traces) = unit.end_sample_traced();
            for gyro in 0..4 {
                counts[gyro] += f64::from(ended.sample.increments[gyro]);
                angles[gyro] += traces[gyro].unquantised;
                let difference = counts[gyro] - angles[gyro];
                assert!(difference.abs() <= bound, "gyro {gyro}, row {row}: {difference}");
            }
        }
        assert_eq!(unit.lost_counts(), [0.0; 4]);
    }
}

/// A leg in degrees: name, θ and ψ turned, θ at the start.
fn turned(leg: &Leg) -> (&'static str, f64, f64, f64) {
    let degrees = |rad: f64| (rad / RAD_PER_DEG * 1e6).round() * 1e-6;
    let [theta, psi] = [0, 1].map(|axis| degrees(leg.end_rad[axis] - leg.start_rad[axis]));
    (leg.name, theta, psi, degrees(leg.start_rad[0]))
}

#[test]
fn checkout_toml_contains_the_six_manoeuvres_with_their_precautions() {
    let scenario = checkout().scenario;
    let end_s = AttitudeProfile::length_s(&scenario).expect("an end");
    let mut motion = Motion::new(AttitudeProfile::new(&scenario).expect("possible"), scenario.limit_cycle);
    let mut legs: Vec<Leg> = Vec::new();
    let mut t_s = 0.0;
    while t_s < end_s {
        t_s += 10.0;
        motion.advance(t_s);
        legs.extend(motion.take_legs().into_iter().filter(|leg| leg.name != "hold"));
    }
    let turned: Vec<_> = legs.iter().map(turned).collect();
    // The manoeuvres of the paper, row by row.
    let orbit = |theta_deg: f64| ("stabilise", 0.0, 360.0, theta_deg);
    assert_eq!(
        turned,
        [
            orbit(90.0),
            ("pointing", 0.0, 0.0, 90.0),
            orbit(90.0),
            ("pointing", 0.0, 0.0, 90.0),
            orbit(90.0),
            ("z-scan", 0.0, 360.0, 90.0),
            ("slew", -30.0, 0.0, 90.0),
            orbit(60.0),
            ("slew", 2.0, 0.0, 60.0),
            ("slew", 0.0, 3.0, 62.0),
            ("y-scan", 58.0, 0.0, 62.0),
            ("slew", 0.0, 3.0, 120.0),
            orbit(120.0),
            ("slew", -2.0, 0.0, 120.0),
            ("slew", 0.0, 3.0, 118.0),
            ("y-scan", -58.0, 0.0, 118.0),
            ("slew", 0.0, 3.0, 60.0),
            orbit(60.0),
            ("x-scan", 0.0, 360.0, 60.0),
        ]
    );
    // A ramp beside the orbit, and 12°/min over 58° with a ramp of 20 s.
    let lasts = |index: usize| legs[index].end_s - legs[index].start_s;
    assert!((lasts(0) - ORBIT_S - 5.825).abs() < 1e-3);
    assert!((lasts(10) - 310.0).abs() < 1e-6);
    assert!((lasts(1) - 600.0).abs() < 1e-6);
}

#[test]
fn the_floats_stand_on_a_stop_where_the_checkout_says_so() {
    // Clearance of 12″ at every gyro; a float's place is the accumulated part of the counts that is the clearance's.
    let overrides: Vec<String> = ["GYRX", "GYRY", "GYRZA", "GYRZB"]
        .iter()
        .map(|gyro| format!("gyro.{gyro}.pivot-clearance.clearance_arcsec=12"))
        .collect();
    let text = include_str!("../../../configs/checkout.toml");
    let configuration = Configuration::parse("configs/checkout.toml", text, &overrides).expect("valid");
    let pivot = GyroEffects::SPECS.iter().position(|spec| spec.code == "pivot-clearance").expect("an effect");
    let column = geu_model::effect::HEAD_COLUMNS + pivot;
    let scenario = &configuration.scenario;
    let mut motion = Motion::new(AttitudeProfile::new(scenario).expect("possible"), scenario.limit_cycle);
    let mut unit = GyroUnit::new(&configuration);
    let (mut places, mut at_ends) = ([0.0; 4], Vec::new());
    let mut legs: Vec<Leg> = Vec::new();
    let samples = (AttitudeProfile::length_s(scenario).expect("an end") * 2.0) as usize;
    for sample in 1..=samples {
        let (_, traces) = unit.end_sample_traced();
        for (index, trace) in traces.iter().enumerate() {
            places[index] += trace.changes[column] * configuration.gyros[index].calibration.scale_factor;
        }
        let t_s = sample as f64 * 0.5;
        motion.advance(t_s);
        legs.extend(motion.take_legs());
        while legs.get(at_ends.len()).is_some_and(|leg| leg.end_s <= t_s) {
            at_ends.push(places);
        }
    }
    // Casteren §5.3. Legs 9 and 14 are the slews about the sun vector before a scan about Y, 10 and 15 the scans, 11 and
    // 16 the slews after. GYRX and GYRZA rest at the stop of the scan's sign from the slew of 2° on.
    let stop = |place: f64, sign: f64| assert!((place - 6.0 * sign).abs() < 0.35, "{place}, not the stop at {sign}");
    for (legs, sign) in [([9, 10], 1.0), ([14, 15], -1.0)] {
        for leg in legs {
            for gyro in [0, 2] {
                stop(at_ends[leg][gyro], sign);
            }
        }
    }
    // GYRY and GYRZB rest at opposite stops before and after: cos θ has changed sign.
    for (leg, sign) in [(9, 1.0), (11, -1.0), (14, -1.0), (16, 1.0)] {
        for gyro in [1, 3] {
            stop(at_ends[leg][gyro], sign);
        }
    }
    // Pointings begin with the floats about their preferred position (§5.1).
    for leg in [0, 2] {
        assert!(at_ends[leg].iter().all(|place| place.abs() < 0.6), "{:?}", at_ends[leg]);
    }
}

#[test]
fn the_shipped_plan_is_a_plan() {
    let mut configuration = Configuration::reference();
    let text = include_str!("../../../configs/faults.toml");
    configuration.add_plan("configs/faults.toml", text).unwrap_or_else(|error| panic!("{error}"));
    assert!(configuration.faults.len() >= 5 && configuration.expectations.len() == 3);
}
