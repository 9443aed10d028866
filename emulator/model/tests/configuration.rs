//! Configurations: what is read comes back, and what is wrong is pointed at.

use geu_model::effect::{Effects, HeadEffects, UnitEffects};
use geu_model::{Configuration, Unit};

fn refused(text: &str) -> String {
    Configuration::parse("test.toml", text, &[]).expect_err("must be refused").to_string()
}

#[test]
fn the_reference_reads_back_from_both_forms_it_is_shown_in() {
    let reference = Configuration::reference();
    for complete in [false, true] {
        let text = reference.to_toml(complete);
        assert_eq!(Configuration::parse("shown", &text, &[]).expect("valid"), reference, "{text}");
    }
}

#[test]
fn a_start_reads_back_to_the_microsecond() {
    let mut configuration = Configuration::reference();
    let mut state = 1u64;
    for _ in 0..1000 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        configuration.start_unix_ns = ((state >> 8) % 4_000_000_000_000_001) as i64 * 1000;
        let shown = configuration.to_toml(false);
        assert_eq!(
            Configuration::parse("shown", &shown, &[]).expect("valid").start_unix_ns,
            configuration.start_unix_ns
        );
    }
}

#[test]
fn every_effect_with_every_course_reads_back() {
    let mut text = String::new();
    let mut section =
        |name: &str, specs: &[geu_model::effect::EffectSpec], numbers: &dyn Fn(usize) -> Vec<&'static str>| {
            text += &format!("\n[{name}]\n");
            for (index, spec) in specs.iter().enumerate() {
                let amplitudes: Vec<&str> = numbers(index).into_iter().filter(|n| *n != "x_arcsec").collect();
                let with = |key: &dyn Fn(&str) -> String| {
                    amplitudes
                        .iter()
                        .take(spec.amplitudes.len())
                        .map(|n| format!("{} = 0.5", key(n)))
                        .collect::<Vec<_>>()
                        .join(", ")
                };
                text += &format!("{} = {{ {} }}\n", spec.code, with(&|n| n.to_owned()));
                text += &format!("{}-step = {{ {}, time_s = 3 }}\n", spec.code, with(&|n| n.to_owned()));
                text += &format!("{}-ramp = {{ {} }}\n", spec.code, with(&|n| format!("{n}_per_day")));
                text += &format!("{}-temperature = {{ {} }}\n", spec.code, with(&|n| format!("{n}_per_k")));
                text += &format!(
                    "{}-periodic = {{ {}, period_s = 9, phase_rad = 1 }}\n",
                    spec.code,
                    with(&|n| format!("amplitude_{n}"))
                );
            }
        };
    let (unit, head) = (UnitEffects::default(), HeadEffects::default());
    let amplitudes = |numbers: &dyn geu_model::number::Numbers, count: usize| -> Vec<&'static str> {
        numbers.specs().iter().take(count).map(|spec| spec.name).collect()
    };
    section("unit", UnitEffects::SPECS, &|i| amplitudes(unit.numbers(i), UnitEffects::SPECS[i].amplitudes.len()));
    section("gyro.GYRX", HeadEffects::SPECS, &|i| amplitudes(head.numbers(i), HeadEffects::SPECS[i].amplitudes.len()));
    let read = Configuration::parse("all.toml", &text, &[]).unwrap_or_else(|error| panic!("{error}\n{text}"));
    assert!(read.gyros[0].effects.courses.len() >= 4 * HeadEffects::SPECS.len());
    assert_eq!(Configuration::parse("shown", &read.to_toml(true), &[]).expect("valid"), read);
}

#[test]
fn an_unknown_key_is_refused_with_the_valid_ones_and_a_caret() {
    let message = refused("seed = 3\n\n[gyro.GYRX]\ndrfit = { arcsec_per_h = 1.0 }\n");
    for part in [
        "test.toml:4:1: unknown key `drfit` in gyro.GYRX",
        "did you mean `drift`?",
        "scale-factor",
        "4 | drfit = {",
        "^^^^^",
    ] {
        assert!(message.contains(part), "{part}\n{message}");
    }
}

#[test]
fn what_is_wrong_is_pointed_at() {
    for (text, parts) in [
        ("seed = ", &["test.toml:1:", "expected TOML"][..]),
        ("seed = -1", &["test.toml:1:8", "whole number", "got -1"]),
        ("[gyro.GYRQ]", &["unknown key `GYRQ` in gyro", "GYRX, GYRY, GYRZA, GYRZB"]),
        (
            "[gyro.GYRX]\ndrift = { arcsec_per_h = 40000.0 }",
            &["test.toml:2:26", "±36000", "gyro.GYRX.drift.arcsec_per_h", "got 40000.0"],
        ),
        ("[gyro.GYRX]\ndrift = { arcsec_per_h = \"much\" }", &["got \"much\""]),
        ("[gyro.GYRX]\ndrift = { arcsec_per_h = nan }", &["got nan"]),
        (
            "[gyro.GYRX]\ncalibration = { x_arcsec = 1.0 }",
            &["unknown key `x_arcsec` in gyro.GYRX.calibration", "y_arcsec, z_arcsec"],
        ),
        ("[gyro.GYRX]\nmisalignment = { x_arcsec = 1.0 }", &["unknown key `x_arcsec`"]),
        ("[gyro.GYRX]\ndrift-step = { arcsec_per_h = 1.0 }", &["expected `gyro.GYRX.drift-step.time_s`", "got none"]),
        ("[gyro.GYRX]\ndrift-ramp = { arcsec_per_h = 1.0 }", &["expected one of: arcsec_per_h_per_day"]),
        ("[gyro.GYRX]\ndrift = 3", &["expected a table for `gyro.GYRX.drift`", "got 3"]),
        ("[scenario]\ntheta_deg = 59.0", &["60…120", "got 59.0"]),
        ("[[manoeuvre]]\nkind = \"loop\"", &["expected one of pointing", "got \"loop\""]),
        ("[[manoeuvre]]\nkind = \"y-scan\"", &["expected `manoeuvre.0.to_theta_deg`"]),
        (
            "[[manoeuvre]]\nkind = \"y-scan\"\nto_theta_deg = 91.0",
            &["test.toml:3:1", "impossible manoeuvre 1", "ramps", "got 1.0"],
        ),
        ("manoeuvre = 3", &["expected a list of tables"]),
        ("[temperature]\nelectronics_table = [[0, 1], [0, 2]]", &["times to rise"]),
        ("[temperature]\nelectronics_table = [[0, 1020]]", &["-60…100", "got 1020"]),
        ("[temperature]\nelectronics_table = [[0, 1, 2]]", &["pairs of numbers"]),
    ] {
        let message = refused(text);
        for part in parts {
            assert!(message.contains(part), "{text:?}: {part:?} not in\n{message}");
        }
    }
}

#[test]
fn overrides_reach_every_depth() {
    let overrides = |list: &[&str]| list.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
    let configuration = Configuration::reference_with(&overrides(&[
        "seed=9",
        "gyro.GYRX.drift.arcsec_per_h=10",
        "gyro.GYRX.calibration.scale_factor=1.5",
        "manoeuvre.0.duration_s=42",
        "unit.clock-frequency.ppm = 14.0",
        "scenario.limit_cycle.rate_arcsec_s=0",
    ]))
    .expect("valid");
    assert_eq!(configuration.seed, 9);
    assert_eq!(configuration.gyros[0].effects.constant.drift.arcsec_per_h, 10.0);
    assert_eq!(configuration.gyros[0].calibration.scale_factor, 1.5);
    assert_eq!(configuration.gyros[0].calibration.y_arcsec, 45.0);
    assert_eq!(configuration.scenario.manoeuvres[0].numbers().value(0), 42.0);
    assert_eq!(configuration.unit.constant.clock_frequency.ppm, 14.0);
    for (wrong, part) in [
        ("gyro.GYRX.drift.arcsec_per_h=99999", "±36000"),
        ("gyro.GYRX.drfit.arcsec_per_h=9", "did you mean `drift`?"),
        ("nothing", "expected PATH=VALUE, got nothing"),
        ("=3", "expected PATH=VALUE"),
    ] {
        let message = Configuration::reference_with(&overrides(&[wrong])).expect_err("refused").to_string();
        assert!(message.contains(part), "{wrong}: {message}");
    }
}

#[test]
fn an_amplitude_of_zero_changes_no_bit() {
    let plain = "[[manoeuvre]]\nkind = \"y-scan\"\nto_theta_deg = 60.0\n[gyro.GYRX]\ncalibration = { scale_factor = 1.1, drift_arcsec_per_half_s = 0.3, y_arcsec = 45.0 }\n";
    let mut zeros = plain.to_owned();
    // Amplitudes 0, shapes away from their defaults.
    let shapes = |numbers: &dyn geu_model::number::Numbers, amplitudes: usize| {
        let shapes = numbers.specs().iter().skip(amplitudes);
        shapes
            .map(|spec| format!("{} = {:?}", spec.name, (spec.least + spec.greatest.min(1e3)) * 0.4))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let (head, unit) = (HeadEffects::default(), UnitEffects::default());
    for (index, spec) in HeadEffects::SPECS.iter().enumerate() {
        zeros += &format!("{} = {{ {} }}\n", spec.code, shapes(head.numbers(index), spec.amplitudes.len()));
    }
    zeros += "[unit]\n";
    for (index, spec) in UnitEffects::SPECS.iter().enumerate() {
        zeros += &format!("{} = {{ {} }}\n", spec.code, shapes(unit.numbers(index), spec.amplitudes.len()));
    }
    assert_ne!(
        Configuration::parse("z", &zeros, &[]).expect("valid"),
        Configuration::parse("p", plain, &[]).expect("valid")
    );
    let unit = |text: &str| Unit::new(&Configuration::parse("t", text, &[]).expect("valid"));
    let (mut plain, mut zeros) = (unit(plain), unit(&zeros));
    for _ in 0..600 {
        let (a, b) = (plain.end_half_second_traced(), zeros.end_half_second_traced());
        assert_eq!(a.0, b.0);
        for (a, b) in a.1.iter().zip(&b.1) {
            assert_eq!(a.unquantised.to_bits(), b.unquantised.to_bits());
        }
    }
}

#[test]
fn switching_a_noise_on_moves_no_other() {
    // GYRX's counts do not change when another gyro's noise or another noise of GYRX with amplitude 0 comes or goes.
    let base = "[gyro.GYRX]\nangle-random-walk = { arcsec_per_sqrt_s = 1.0 }\n";
    // Beside another noise of the same gyro, the column of the first keeps every bit.
    let beside = format!("{base}drift-random-walk = {{ arcsec_per_s_per_sqrt_s = 0.1 }}\n");
    let column = geu_model::effect::columns().iter().position(|code| *code == "angle-random-walk").expect("a column");
    let walked = |text: &str| {
        let mut unit = Unit::new(&Configuration::parse("t", text, &[]).expect("valid"));
        (0..100).map(|_| unit.end_half_second_traced().1[0].changes[column].to_bits()).collect::<Vec<_>>()
    };
    assert_eq!(walked(base), walked(&beside));
    let with = format!(
        "{base}drift-random-walk = {{ arcsec_per_s_per_sqrt_s = 0.0 }}\n[gyro.GYRY]\nangle-random-walk = {{ arcsec_per_sqrt_s = 1.0 }}\n"
    );
    let counts = |text: &str| {
        let mut unit = Unit::new(&Configuration::parse("t", text, &[]).expect("valid"));
        (0..100).map(|_| unit.end_half_second().half_second.increments[0]).collect::<Vec<_>>()
    };
    assert_eq!(counts(base), counts(&with));
}

#[test]
fn the_schema_knows_every_key_that_is_shown() {
    let schema = Configuration::schema().to_string();
    for spec in HeadEffects::SPECS.iter().chain(UnitEffects::SPECS) {
        assert!(schema.contains(&format!("\"{}\"", spec.code)), "{}", spec.code);
    }
    assert!(schema.contains("\"drift-step\"") && schema.contains("\"arcsec_per_h_per_day\""));
}
