//! Compares the model with the recordings of an independent implementation: with the injected effects configured and the calibration
//! parameters refitted, only noise remains.

use geu_protocol::Gyro;
use geu_tests::comparison::{Case, RESIDUAL_ARCSEC, Recording, largest, squares};
use geu_tests::{give_way, recordings};
use toml_edit::DocumentMut;

/// Recordings with effects of our model only.
fn cases() -> impl Iterator<Item = Case> {
    give_way();
    recordings("").into_iter().flat_map(|directory| {
        let answers: DocumentMut =
            std::fs::read_to_string(directory.join("answers.toml")).expect("answers").parse().expect("TOML");
        ["01", "02", "03", "04", "05", "06", "07", "08", "10"].into_iter().map(move |name| {
            let (mut overrides, mut named) = (Vec::new(), Vec::new());
            let injected = answers["hidden"].as_array_of_tables().expect("a list");
            for entry in injected.iter().filter(|entry| entry["recording"].as_str() == Some(name)) {
                let code = entry["effect"].as_str().expect("a code");
                let list = entry.get("gyros").and_then(|item| item.as_array());
                let gyros: Vec<&str> = list.into_iter().flatten().filter_map(|gyro| gyro.as_str()).collect();
                let places: Vec<String> = if gyros.is_empty() {
                    vec!["unit".to_owned()]
                } else {
                    gyros.iter().map(|gyro| format!("gyro.{gyro}")).collect()
                };
                named.extend(gyros.into_iter().map(str::to_owned));
                for (key, value) in entry.iter().filter(|(key, _)| !["recording", "effect", "gyros"].contains(key)) {
                    overrides.extend(places.iter().map(|place| format!("{place}.{code}.{key}={value}")));
                }
            }
            let recording = Recording::read(
                &directory.join(name).join("link.log.gz"),
                &directory.join(name).join("reference.csv.gz"),
            );
            Case {
                name: name.to_owned(),
                gyros: named,
                without: recording.against(&[]),
                with: recording.against(&overrides),
            }
        })
    })
}

#[test]
fn two_independent_implementations_agree() {
    for Case { name, without, with, .. } in cases() {
        let (without, with) = (without.refitted(), with.refitted());
        for gyro in Gyro::ALL {
            let (before, after) = (&without[gyro.index()], &with[gyro.index()]);
            assert!(largest(after) < RESIDUAL_ARCSEC, "{name} {}: {:.2} arcsec left", gyro.name(), largest(after));
            // An effect shows on a gyro if it exceeds noise and rounding; the configured effect explains it.
            if largest(before) > 2.0 * RESIDUAL_ARCSEC {
                // Twice the largest noise is an rms of about 3 arcsec, noise alone of 0.9: a tenth of the squares.
                assert!(squares(after) < 0.1 * squares(before), "{name} {}", gyro.name());
            }
        }
    }
}

#[test]
fn injected_effects_lower_chi_squared_as_predicted_and_leave_noise() {
    println!("{}", Case::COLUMNS);
    for case in cases() {
        case.assert_chi_squared_falls_as_predicted();
    }
}
