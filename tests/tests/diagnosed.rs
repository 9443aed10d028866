//! The diagnosis of a recording of the independent model, and what it must say.

use std::fs;

use geu_diagnosis::outcome::{Class, DiagnosedEffect};
use geu_diagnosis::{Diagnosis, DiagnosisOptions, Verdict, diagnose_rows, report};
use geu_model::Configuration;
use geu_plant::{GYROS, IndependentModel, PlantedEffect, ReferenceKind};
use geu_protocol::Gyros;
use geu_recording::ReferenceAttitude;
use geu_tests::comparison::Received;
use geu_tests::give_way;

pub const STAR_TRACKER: ReferenceKind = ReferenceKind::Quaternions { steps: 40, sigma_arcsec: 4.0 };

/// The diagnosis of a recording, and its reference with `change` made to each row: `None` leaves it out.
pub fn diagnosed(model: &IndependentModel, change: impl Fn(usize, &str) -> Option<String>) -> Diagnosis {
    diagnosed_of(model, model.record(), &Configuration::reference(), change)
}

/// The diagnosis of a recording of which a frame in fifty is lost, at random.
pub fn diagnosed_with_losses(model: &IndependentModel) -> Diagnosis {
    let mut recording = model.record();
    let mut state = model.seed;
    let is_kept = |_: &&str| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        state >> 33 > (1 << 31) / 50
    };
    recording.link = recording.link.lines().filter(is_kept).collect::<Vec<_>>().join("\n") + "\n";
    diagnosed_of(model, recording, &Configuration::reference(), as_recorded)
}

/// The diagnosis of a recording beside a configuration with `number` on each gyro.
pub fn diagnosed_beside(model: &IndependentModel, number: &str, value: f64) -> Diagnosis {
    let set = GYROS.map(|gyro| format!("gyro.{}.{number}={value}", gyro.name()));
    let given = Configuration::reference_with(&set).expect("valid");
    diagnosed_of(model, model.record(), &given, as_recorded)
}

fn diagnosed_of(
    model: &IndependentModel,
    recording: geu_plant::Recording,
    given: &Configuration,
    change: impl Fn(usize, &str) -> Option<String>,
) -> Diagnosis {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let [link, changed] = ["link.log", "changed.csv"].map(|name| directory.path().join(name));
    fs::write(&link, recording.link).expect("written");
    let rows = recording.reference.lines().enumerate();
    let rows: Vec<String> =
        rows.filter_map(|(row, text)| if row == 0 { Some(text.to_owned()) } else { change(row, text) }).collect();
    fs::write(&changed, rows.join("\n")).expect("written");
    let Received { rows, defects } = Received::read(&link);
    let reference = ReferenceAttitude::read_with_gaps(&changed.to_string_lossy()).expect("a reference");
    let options = DiagnosisOptions::new(reference.start_ns);
    let diagnosis = diagnose_rows(&rows, &defects, given, &reference, &options).expect("a recording");
    println!("== seed {}: {:?}: {}", model.seed, model.effects, diagnosis.verdict.name());
    missing(&diagnosis).for_each(|entry| println!("   {}", report::heading(entry)));
    diagnosis.findings.iter().for_each(|finding| println!("   {}: {}", finding.kind, finding.text));
    diagnosis
}

pub fn as_recorded(_: usize, row: &str) -> Option<String> {
    Some(row.to_owned())
}

pub fn missing(diagnosis: &Diagnosis) -> impl Iterator<Item = &DiagnosedEffect> {
    diagnosis.entries.iter().filter(|entry| entry.class == Class::MissingEffect)
}

pub fn assert_consistent(diagnosis: &Diagnosis) {
    assert_eq!((diagnosis.verdict, missing(diagnosis).count()), (Verdict::Consistent, 0));
}

/// Asserts that every entry is an injected effect or not distinguishable from one, on its gyros, and that each has its own entries.
pub fn assert_all_named(diagnosis: &Diagnosis, injected: &[PlantedEffect]) {
    let is_named = |entry: &DiagnosedEffect, own: &PlantedEffect| {
        let mut same = entry.alternatives.iter().filter(|other| other.is_indistinguishable());
        entry.code == own.code || same.any(|other| other.code == own.code)
    };
    assert_eq!(diagnosis.verdict, Verdict::Explained, "{injected:?}");
    assert!(missing(diagnosis).all(|entry| injected.iter().any(|own| is_named(entry, own))), "{injected:?}");
    assert!(missing(diagnosis).count() >= injected.len(), "{injected:?}");
    for own in injected {
        let gyros = Gyros::ALL.filter(|gyro| own.gyros.contains(&GYROS[gyro]));
        let is_own = |entry: &DiagnosedEffect| is_named(entry, own) && (injected.len() == 1 || entry.gyros == gyros);
        assert!(missing(diagnosis).any(is_own), "{injected:?}");
    }
}

/// Asserts the same of a single effect.
pub fn assert_named(diagnosis: &Diagnosis, injected: &PlantedEffect) {
    assert_all_named(diagnosis, std::slice::from_ref(injected));
}
