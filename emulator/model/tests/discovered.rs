//! The discovered effect: its terms, their text form, and rejected terms.

use std::sync::Arc;

use geu_model::attitude::{AttitudeRow, RecordedAttitude};
use geu_model::device::Device;
use geu_model::effect::DISCOVERED_COLUMN;
use geu_model::effect::discovered::{MAX_TERMS, Regressor};
use geu_model::{Configuration, GyroUnit, Trace, Truth};

fn parsed(text: &str) -> Configuration {
    Configuration::parse("test.toml", text, &[]).unwrap_or_else(|error| panic!("{error}"))
}

fn refused(text: &str) -> String {
    Configuration::parse("test.toml", text, &[]).expect_err(text).to_string()
}

/// The reference unit with these terms of GYRY.
fn with_terms(terms: &str) -> Configuration {
    Configuration::reference_with(&[format!("gyro.GYRY.discovered=[{terms}]")])
        .unwrap_or_else(|error| panic!("{error}"))
}

fn traces(configuration: &Configuration, truth: &Truth, samples: usize) -> Vec<Vec<Trace>> {
    let mut unit = GyroUnit::on(configuration, truth);
    let _ = unit.command(&[7, 0]);
    (0..samples).map(|_| unit.end_sample_traced().1).collect()
}

/// At `t`: rates of 2t about X, −40 about Y and 50 about Z, arcsec/s; θ = 80°.
fn turning() -> Truth {
    let rows: Vec<AttitudeRow> = (0..=12)
        .map(|index| {
            let (t_s, before_s) = (f64::from(index) * 0.5, (f64::from(index) - 1.0).max(0.0) * 0.5);
            let length_s = t_s - before_s;
            let angle_control_arcsec = [t_s * t_s - before_s * before_s, -40.0 * length_s, 50.0 * length_s];
            AttitudeRow { t_s, angle_control_arcsec, theta_psi_rad: Some((80f64.to_radians(), 0.0)) }
        })
        .collect();
    Truth::Recorded(Arc::new(RecordedAttitude::new(rows).expect("good rows")))
}

#[test]
fn every_term_adds_the_angle_worked_out_by_hand() {
    // Integrals over 5 s; the electronics are 1.5 K above their reference. Each sub-step of 0.1 s counts with its mean rate,
    // so that the sum of (2t)² is less than 500/3 by 50 times 0.1·(0.2)²/12.
    let mut expected = vec![
        ("rate_x", 25.0),
        ("rate_y", -200.0),
        ("rate_z", 250.0),
        ("abs(rate_x)", 25.0),
        ("abs(rate_y)", 200.0),
        ("abs(rate_z)", 250.0),
        ("acceleration_x", 10.0),
        ("acceleration_y", 0.0),
        ("acceleration_z", 0.0),
        ("temperature", 7.5),
        ("theta", -50.0),
        ("time", 12.5 / 86_400.0),
    ];
    // The sensor cools in a test of its own.
    let named: Vec<&str> = Regressor::ALL.iter().map(|regressor| regressor.name()).collect();
    let tried: Vec<&str> = expected.iter().map(|(name, _)| *name).collect();
    assert_eq!(named.into_iter().filter(|name| *name != "sensor_temperature").collect::<Vec<_>>(), tried);
    expected.extend([
        ("rate_x^2", 500.0 / 3.0 - 50.0 * 0.1 * 0.04 / 12.0),
        ("rate_y^3", -320_000.0),
        ("rate_y*rate_z", -10_000.0),
        ("rate_y*abs(rate_y)", -8_000.0),
        ("acceleration_x*theta*temperature", -150.0),
    ]);
    for (formula, arcsec) in expected {
        let configuration = parsed(&format!(
            "temperature.electronics = {{ mean_c = 21.5, reference_c = 20.0, amplitude_k = 0.0 }}\n[gyro.GYRZA]\n\
             calibration = {{ scale_factor = 1.25 }}\ndiscovered = [{{ formula = \"{formula}\", coefficient = 0.5 }}]"
        ));
        let traces = traces(&configuration, &turning(), 10);
        let sums: [f64; 4] =
            std::array::from_fn(|gyro| traces.iter().map(|t| t[gyro].changes[DISCOVERED_COLUMN]).sum());
        let off = sums[2] * 1.25 - 0.5 * arcsec;
        assert!(off.abs() <= 1e-9 * arcsec.abs().max(1.0), "{formula}: {} for {}", sums[2] * 1.25, 0.5 * arcsec);
        assert_eq!([sums[0], sums[1], sums[3]], [0.0; 3], "{formula}");
    }
}

#[test]
fn a_term_follows_the_sensor_that_cools() {
    let configuration = parsed("[gyro.GYRX]\ndiscovered = [{ formula = \"sensor_temperature\", coefficient = 1.0 }]");
    let change = |row: &Vec<Trace>| row[0].changes[DISCOVERED_COLUMN];
    let traces = traces(&configuration, &Truth::Scenario, 2401);
    // Warm over the first sample interval; after 1200 s, one time constant, 50 K·(1 − 1/e) below 70 °C.
    assert_eq!(change(&traces[0]), 0.0);
    let expected = -50.0 * (1.0 - (-1.0f64).exp()) * 0.5;
    assert!((change(&traces[2400]) / expected - 1.0).abs() < 1e-9, "{} for {expected}", change(&traces[2400]));
}

#[test]
fn no_term_and_a_coefficient_of_zero_change_no_bit() {
    let plain = Configuration::reference();
    for terms in ["", r#"{ formula = "rate_y^2", coefficient = 0 }"#] {
        let configuration = with_terms(terms);
        assert_eq!(configuration.columns(), plain.columns());
        let rows =
            traces(&plain, &Truth::Scenario, 2000).into_iter().zip(traces(&configuration, &Truth::Scenario, 2000));
        for (row, (plain, own)) in rows.enumerate() {
            for gyro in 0..4 {
                let bits = [&plain, &own].map(|traces| traces[gyro].unquantised.to_bits());
                assert_eq!((bits[0], plain[gyro]), (bits[1], own[gyro]), "{terms}: gyro {gyro}, row {row}");
            }
        }
    }
}

#[test]
fn terms_add_up_and_so_do_their_columns() {
    let one = r#"{ formula = "rate_y^2", coefficient = 4e-7 }"#;
    let other = r#"{ formula = "abs(rate_z)*temperature", coefficient = -1e-5 }"#;
    let runs = [one, other, &format!("{one}, {other}")].map(|terms| traces(&with_terms(terms), &Truth::Scenario, 2000));
    let mut most: f64 = 0.0;
    for row in 0..2000 {
        let [one, other, both] = runs.each_ref().map(|run| run[row][1].changes[DISCOVERED_COLUMN]);
        assert!((one + other - both).abs() < 1e-9, "{row}: {one} {other} {both}");
        most = most.max(both.abs());
        let Trace { true_arcsec, changes, unquantised, .. } = runs[2][row][1];
        assert!((true_arcsec + changes.iter().sum::<f64>() - unquantised).abs() < 1e-9, "{row}");
    }
    // (720″/s)²·4·10⁻⁷ over half a second, and something of the other term.
    assert!((0.05..0.2).contains(&most), "{most}");
}

#[test]
fn terms_read_back_from_both_forms_they_are_shown_in_and_in_one_spelling() {
    let configuration = with_terms(
        r#"{ formula = "temperature * abs(rate_z)^2", coefficient = 4e-7 }, { coefficient = -1e6, formula = "theta" }"#,
    );
    for complete in [false, true] {
        let text = configuration.to_toml(complete);
        let line = r#"discovered = [{ formula = "rate_z^2*temperature", coefficient = 4e-7 }, { formula = "theta", coefficient = -1000000.0 }]"#;
        assert!(text.lines().any(|own| own == line), "{text}");
        assert_eq!(parsed(&text), configuration);
    }
    let complete = configuration.to_toml(true);
    for regressor in Regressor::ALL {
        let (name, meaning) = (regressor.name(), regressor.meaning());
        assert!(complete.contains(&format!("#     {name}: {meaning} ({})", regressor.unit())), "{name}\n{complete}");
    }
    assert!(!Configuration::reference().to_toml(false).contains("discovered"));
    assert!(
        Configuration::schema(Device::iras())
            .to_string()
            .contains(r#"acceleration_z|temperature|sensor_temperature|theta|time"#)
    );
}

#[test]
fn an_override_gives_terms_and_reaches_into_them() {
    let terms = r#"gyro.GYRX.discovered=[{formula="rate_y^2",coefficient=4e-7}]"#;
    let overrides = [terms, "gyro.GYRX.discovered.0.coefficient=5e-7"].map(str::to_owned);
    let configuration = Configuration::reference_with(&overrides).unwrap_or_else(|error| panic!("{error}"));
    let [term] = configuration.gyros[0].discovered[..] else { panic!("{:?}", configuration.gyros[0].discovered) };
    assert_eq!((term.formula.to_string().as_str(), term.coefficient), ("rate_y^2", 5e-7));
}

#[test]
fn what_is_no_term_is_pointed_at() {
    let term = |inside: &str| format!("[gyro.GYRX]\ndiscovered = [{{ {inside} }}]");
    let many = vec!["{ formula = \"time\", coefficient = 1 }"; MAX_TERMS + 1].join(", ");
    for (text, parts) in [
        (
            term("formula = \"rate_q^2\", coefficient = 1"),
            &[
                "test.toml:2:27: expected one of rate_x, rate_y, rate_z, abs(rate_x)",
                "time in place of `rate_q` for `gyro.GYRX.discovered.0.formula`, got \"rate_q^2\"",
                "|                           ^^^^^^^^^^",
            ][..],
        ),
        (term("formula = \"rate_x^4\", coefficient = 1"), &["expected ^2, ^3 or nothing behind `rate_x`"]),
        (term("formula = \"time*theta*rate_x*rate_y\", coefficient = 1"), &["at most three different factors"]),
        (term("formula = 3, coefficient = 1"), &["expected a text", "got 3"]),
        (term("coefficient = 1"), &["expected a text for `gyro.GYRX.discovered.0.formula`, got nothing"]),
        (term("formula = \"time\""), &["expected `gyro.GYRX.discovered.0.coefficient`", "±1000000", "got none"]),
        (term("formula = \"time\", coefficient = 1000001"), &["±1000000", "got 1000001"]),
        (term("formula = \"time\", coefficient = nan"), &["±1000000", "got nan"]),
        (term("formula = \"time\", coeficient = 1"), &["unknown key `coeficient`", "did you mean `coefficient`?"]),
        ("[gyro.GYRX]\ndiscovered = 3".to_owned(), &["expected a list of tables", "got 3"]),
        ("[gyro.GYRX]\ndiscovered-step = []".to_owned(), &["unknown key `discovered-step`", "`discovered`"]),
        ("[unit]\ndiscovered = []".to_owned(), &["unknown key `discovered` in unit"]),
        (format!("[gyro.GYRX]\ndiscovered = [{many}]"), &["test.toml:2:1", "expected at most 16 terms", "got 17"]),
    ] {
        let message = refused(&text);
        for part in parts {
            assert!(message.contains(part), "{text}: {part:?} not in\n{message}");
        }
    }
}
