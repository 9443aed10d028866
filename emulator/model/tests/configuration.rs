//! Configurations: what is read comes back, and what is wrong is pointed at.

use geu_model::Configuration;
use geu_model::device::Device;
use geu_model::effect::{GyroEffects, UnitEffects};

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
        ("[gyro.GYRX]\ndrift = 3", &["expected a table, { name = number }, for `gyro.GYRX.drift`", "got 3"]),
        ("[scenario]\ntheta_deg = 59.0", &["60…120", "got 59.0"]),
        ("[[manoeuvre]]\nkind = \"loop\"", &["expected one of pointing", "got \"loop\""]),
        ("[[manoeuvre]]\nkind = \"y-scan\"", &["expected `manoeuvre.0.to_theta_deg`"]),
        (
            "[[manoeuvre]]\nkind = \"y-scan\"\nto_theta_deg = 91.0",
            &["test.toml:3:1", "impossible manoeuvre 1", "ramps", "got 1.0"],
        ),
        ("manoeuvre = 3", &["expected a list of tables"]),
        (
            "[gyro.GYRX]\npivot-clearance = { clearance_arcsec = 12.0, preferred_arcsec = -6.5 }",
            &["test.toml:2:65: ", "half the clearance, ±6", "`gyro.GYRX.pivot-clearance.preferred_arcsec`", "got -6.5"],
        ),
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
fn a_float_may_rest_where_its_largest_clearance_reaches() {
    let preferred = "[gyro.GYRX]\npivot-clearance = { preferred_arcsec = 6 }\n";
    for (course, is_good) in [
        // No clearance yet: a fault may bring it.
        ("", true),
        ("pivot-clearance-step = { clearance_arcsec = 12, time_s = 9 }", true),
        ("pivot-clearance-step = { clearance_arcsec = 11, time_s = 9 }", false),
        ("pivot-clearance-periodic = { amplitude_clearance_arcsec = -12, period_s = 9 }", true),
        ("pivot-clearance-periodic = { amplitude_clearance_arcsec = -11, period_s = 9 }", false),
        // Sooner or later 100″.
        ("pivot-clearance-ramp = { clearance_arcsec_per_day = 1 }", true),
        ("pivot-clearance-temperature = { clearance_arcsec_per_k = -1 }", true),
    ] {
        let read = Configuration::parse("test.toml", &format!("{preferred}{course}"), &[]);
        assert_eq!(read.is_ok(), is_good, "{course}");
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
        ("# seed=3", "expected PATH=VALUE"),
        (
            "manoeuvre.99.duration_s=42",
            "expected manoeuvre.INDEX.NAME=VALUE with an INDEX less than 8, got manoeuvre.99",
        ),
        ("manoeuvre.first.duration_s=42", "got manoeuvre.first"),
        ("manoeuvre.0=1", "got manoeuvre.0; a longer list is given whole, manoeuvre=[…], or in the file"),
        ("gyro.GYRX={}", "expected gyro.GYRX.NAME=VALUE, got nothing to set in gyro.GYRX"),
        ("seed=3\nunit.clock-frequency.ppm=9", "without a line break"),
    ] {
        let message = Configuration::reference_with(&overrides(&[wrong])).expect_err("refused").to_string();
        assert!(message.contains(part), "{wrong}: {message}");
    }
}

#[test]
fn overrides_reach_into_a_list_however_it_is_written() {
    for list in ["manoeuvre = [{ kind = \"pointing\" }]", "[[manoeuvre]]\nkind = \"pointing\""] {
        let overrides = ["manoeuvre.0.duration_s=42".to_owned()];
        let configuration =
            Configuration::parse("test.toml", list, &overrides).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(configuration.scenario.manoeuvres[0].numbers().value(0), 42.0);
    }
}

#[test]
fn the_schema_knows_every_key_that_is_shown() {
    let schema = Configuration::schema(Device::iras()).to_string();
    for spec in GyroEffects::SPECS.iter().chain(UnitEffects::SPECS) {
        assert!(schema.contains(&format!("\"{}\"", spec.code)), "{}", spec.code);
    }
    // An infinity is null where TOML is validated as JSON.
    assert!(schema.contains(r#""null""#));
    assert!(schema.contains("\"drift-step\"") && schema.contains("\"arcsec_per_h_per_day\""));
}

#[test]
fn the_schema_of_a_unit_has_its_heads_and_an_identifier_of_its_own() {
    let schema = Configuration::schema(Device::iras());
    assert_eq!(schema["$id"], concat!("urn:geu:configuration:", env!("CARGO_PKG_VERSION")));
    let device = Device::from_name("mm5.10").expect("a known unit");
    let schema = Configuration::schema(device.into());
    assert_eq!(schema["$id"], concat!("urn:geu:configuration:", env!("CARGO_PKG_VERSION"), ":mm5.10"));
    let heads: Vec<&String> = schema["properties"]["gyro"]["properties"].as_object().expect("heads").keys().collect();
    assert_eq!(heads, ["X", "Z"]);
}
