//! Diagnosis of recordings of an independent model: an injected effect is named on its gyro with its amplitude, an effect outside the
//! catalogue gets no name of the catalogue, and an effect-free recording gets none.

use std::collections::HashMap;
use std::fs;
use std::sync::Mutex;

use geu_diagnosis::outcome::DiagnosedEffect;
use geu_diagnosis::{Diagnosis, DiagnosisOptions, Thresholds, Verdict, diagnose_rows, report};
use geu_model::Configuration;
use geu_model::units::{AngleUnit, SAMPLE_INTERVAL_S};
use geu_plant::{GYROS, Gyro, IndependentModel, PlantedEffect};
use geu_protocol::Gyros;
use geu_recording::ReferenceAttitude;
use geu_tests::comparison::Recording;
use geu_tests::{give_way, recordings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::diagnosed::missing;

const ONSET: (&str, f64) = ("time_s", 5200.0);
const X: &[Gyro] = &[Gyro::X];
const Y: &[Gyro] = &[Gyro::Y];
const ZA: &[Gyro] = &[Gyro::Za];
const ZB: &[Gyro] = &[Gyro::Zb];
const UNIT: &[Gyro] = &[];

/// Thresholds of each scenario.
static THRESHOLDS: Mutex<Option<HashMap<u64, Thresholds>>> = Mutex::new(None);

fn recorded(plant: &IndependentModel) -> Recording {
    give_way();
    let directory = tempfile::tempdir().expect("a directory");
    let recording = plant.record();
    let [link, reference] = ["link.log", "reference.csv"].map(|name| directory.path().join(name));
    fs::write(&link, recording.link).expect("written");
    fs::write(&reference, recording.reference).expect("written");
    Recording::read(&link, &reference)
}

fn diagnosed(recording: &Recording, reference: &ReferenceAttitude, given: &Configuration) -> Diagnosis {
    let settings = DiagnosisOptions {
        known: &|key| THRESHOLDS.lock().expect("no panic").get_or_insert_default().get(&key).cloned(),
        keep: &|key, thresholds| {
            THRESHOLDS.lock().expect("no panic").get_or_insert_default().insert(key, thresholds.clone());
        },
        ..DiagnosisOptions::new(reference.start_ns)
    };
    diagnose_rows(&recording.rows, &[], given, reference, &settings).expect("a recording")
}

/// Errors of a test bench.
#[derive(Default)]
struct Bench {
    /// Delay of the reference's time stamps, s.
    late_s: f64,
    /// Error of the reference about each axis, 1 sigma.
    noise_arcsec: f64,
    /// Delay of the temperature, samples.
    temperature_late: usize,
}

impl Bench {
    fn apply(&self, recording: &mut Recording, reference: &str) {
        let reported: Vec<i16> = recording.rows.iter().map(|row| row.sample.electronics_centi_c).collect();
        for (index, row) in recording.rows.iter_mut().enumerate() {
            row.sample.electronics_centi_c = reported[index.saturating_sub(self.temperature_late)];
        }
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut before = [0.0; 3];
        let reported = reference.lines().enumerate().map(|(line, text)| {
            if line == 0 {
                return text.to_owned();
            }
            let mut fields: Vec<f64> = text.split(',').map(|field| field.parse().expect("a number")).collect();
            // Twelve uniform numbers, less six, are as good as normal.
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            for axis in 0..3 {
                let now = self.noise_arcsec * normal();
                fields[1 + axis] += (now - std::mem::replace(&mut before[axis], now)) / 0.5;
            }
            fields[0] += self.late_s;
            let fields: Vec<String> = fields.iter().map(|field| format!("{field:.6}")).collect();
            fields.join(",")
        });
        let reported = reported.collect::<Vec<_>>().join("\n");
        recording.reference = ReferenceAttitude::parse("reference.csv", &reported).expect("a reference");
    }
}

fn diagnosis(seed: u64, injected: &[PlantedEffect]) -> Diagnosis {
    diagnosis_of(seed, injected, None)
}

fn diagnosis_of(seed: u64, injected: &[PlantedEffect], bench: Option<&Bench>) -> Diagnosis {
    let is_cooling = injected.iter().any(|injected| injected.code.starts_with("drift-sensor-temperature"));
    let heater_off_s = is_cooling.then_some(4000.0);
    let plant = IndependentModel { heater_off_s, ..IndependentModel::new(seed, injected.to_vec()) };
    let mut recording = recorded(&plant);
    if let Some(bench) = bench {
        bench.apply(&mut recording, &plant.record().reference);
    }
    let diagnosis = diagnosed(&recording, &recording.reference, &Configuration::reference());
    let names: Vec<String> =
        injected.iter().map(|injected| format!("{} {:?}", injected.code, injected.gyros)).collect();
    println!("== seed {seed}: {}: {}", names.join(" + "), diagnosis.verdict.name());
    missing(&diagnosis).for_each(|entry| {
        println!(
            "   {}\n{}",
            report::heading(entry),
            report::labelled(6, &report::facts(entry, AngleUnit::from_name("arcsec")))
        )
    });
    if let Some(left) = &diagnosis.unexplained {
        println!("   left: {:?} {:?} {} {:?}", left.gyros, left.interval_s, left.shape, left.follows);
    }
    diagnosis
}

fn gyros(injected: &PlantedEffect) -> Gyros {
    let has = |gyro: usize| injected.gyros.is_empty() || injected.gyros.contains(&GYROS[gyro]);
    Gyros::ALL.filter(has)
}

/// True if the entry names the injected effect, itself or within its ambiguity group.
fn names(entry: &DiagnosedEffect, injected: &PlantedEffect) -> bool {
    let is_alternative = entry.alternatives.iter().any(|alternative| {
        alternative.code == injected.code && alternative.gyros == gyros(injected) && alternative.is_indistinguishable()
    });
    entry.gyros == gyros(injected) && (entry.code == injected.code || is_alternative)
}

/// Asserts that each effect is named, with its amplitude within `SIGMAS` if it has its own code, and that nothing else is named.
fn assert_named(seed: u64, injected: &[PlantedEffect]) {
    // With normal errors an amplitude of the sixty exceeds this in one of 250 sets of seeds.
    const SIGMAS: f64 = 4.0;
    let diagnosis = diagnosis(seed, injected);
    assert_eq!(diagnosis.verdict, Verdict::Explained, "{injected:?}");
    assert_eq!(missing(&diagnosis).count(), injected.len(), "{injected:?}");
    for injected in injected {
        let entry = missing(&diagnosis).find(|entry| names(entry, injected));
        let entry = entry.unwrap_or_else(|| panic!("{injected:?} is not named"));
        for (name, value) in injected.parameters.iter().filter(|_| entry.code == injected.code) {
            let Some(number) = entry.parameters.iter().find(|number| number.name == *name) else { continue };
            if let Some(sigma) = number.sigma {
                let off = (number.value - value).abs() / sigma;
                assert!(off < SIGMAS, "{} {name}: {} ± {sigma}, injected {value}", injected.code, number.value);
            }
        }
    }
}

fn assert_each_named(seed: u64, all: &[PlantedEffect]) {
    all.iter().for_each(|injected| assert_named(seed, std::slice::from_ref(injected)));
}

#[test]
fn two_effect_free_recordings_yield_no_detection() {
    assert_eq!(false_alarms(20..22, 10_800.0), Vec::<u64>::new());
}

/// Seeds whose effect-free recording is not `consistent` without a name.
fn false_alarms(seeds: std::ops::Range<u64>, duration_s: f64) -> Vec<u64> {
    let is_false = |seed: &u64| {
        let recording = recorded(&IndependentModel { duration_s, ..IndependentModel::new(*seed, Vec::new()) });
        let diagnosis = diagnosed(&recording, &recording.reference, &Configuration::reference());
        println!("== seed {seed}: {}", diagnosis.verdict.name());
        missing(&diagnosis).for_each(|entry| println!("   {}", report::heading(entry)));
        diagnosis.verdict != Verdict::Consistent || missing(&diagnosis).count() > 0
    };
    seeds.filter(is_false).collect()
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn twenty_effect_free_recordings_yield_no_detection() {
    assert_eq!(false_alarms(1000..1020, 3600.0), Vec::<u64>::new());
}

/// No false alarm in 100 recordings: with 95 % confidence the false alarm rate is below 3 % (0.97¹⁰⁰ is 4.8 %). To show the rate of
/// one in 400 that thresholds are set for would take 1200. Each recording is another scenario with its own thresholds, 1 h long.
#[test]
#[ignore = "a campaign: docs/diagnosis.md"]
fn campaign_of_a_hundred_effect_free_recordings() {
    assert_eq!(false_alarms(1000..1100, 3600.0), Vec::<u64>::new());
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn drifts_are_named() {
    assert_each_named(
        2,
        &[
            PlantedEffect::new("drift-step", Y, &[("arcsec_per_h", 16.0), ONSET]),
            PlantedEffect::new("drift-ramp", X, &[("arcsec_per_h_per_day", 420.0)]),
            PlantedEffect::new("drift-temperature", ZA, &[("arcsec_per_h_per_k", 12.0)]),
            PlantedEffect::new(
                "drift-periodic",
                ZB,
                &[("amplitude_arcsec_per_h", 20.0), ("period_s", 5000.0), ("phase_rad", 1.0)],
            ),
            PlantedEffect::new("drift-sensor-temperature", X, &[("arcsec_per_h_per_k", 1.0)]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn scale_factors_are_named() {
    assert_each_named(
        2,
        &[
            PlantedEffect::new("scale-factor-step", ZB, &[("ppm", 60.0), ONSET]),
            PlantedEffect::new("scale-factor-ramp", Y, &[("ppm_per_day", 1500.0)]),
            PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 12.5)]),
            PlantedEffect::new(
                "scale-factor-periodic",
                Y,
                &[("amplitude_ppm", 80.0), ("period_s", 5000.0), ("phase_rad", 1.0)],
            ),
            PlantedEffect::new("scale-factor-nonlinearity", Y, &[("cubic_ppm", 180.0)]),
            PlantedEffect::new("scale-factor-asymmetry", ZA, &[("ppm", 120.0)]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn clocks_and_links_are_named() {
    assert_each_named(
        2,
        &[
            PlantedEffect::new("clock-frequency", UNIT, &[("ppm", 14.0)]),
            PlantedEffect::new("clock-frequency-temperature", UNIT, &[("ppm_per_k", 3.0)]),
            PlantedEffect::new("time-offset", UNIT, &[("seconds", 0.03)]),
            PlantedEffect::new("time-offset", UNIT, &[("seconds", -0.03)]),
            PlantedEffect::new("lost-counts", X, &[("counts", -15.0), ("time_s", 6000.0)]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn pivots_are_named() {
    let clearance = ("clearance_arcsec", 11.5);
    assert_each_named(
        3,
        &[
            PlantedEffect::new("pivot-clearance", X, &[clearance]),
            PlantedEffect::new("pivot-clearance", ZB, &[clearance, ("preferred_arcsec", 3.0)]),
            PlantedEffect::new("pivot-clearance-step", Y, &[clearance, ONSET]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn misalignments_are_named() {
    assert_each_named(
        3,
        &[
            PlantedEffect::new("misalignment-step", X, &[("y_arcsec", 20.0), ONSET]),
            PlantedEffect::new("misalignment-ramp", ZA, &[("y_arcsec_per_day", 300.0)]),
            PlantedEffect::new("misalignment-temperature", ZB, &[("x_arcsec_per_k", 20.0)]),
            PlantedEffect::new("misalignment-thermal", UNIT, &[("arcsec_per_deg", 0.9), ("time_constant_s", 280.0)]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn products_and_accelerations_are_named() {
    assert_each_named(
        3,
        &[
            PlantedEffect::new("output-axis-acceleration", ZA, &[("seconds", 0.005)]),
            PlantedEffect::new("anisoinertia", X, &[("seconds", 0.02)]),
        ],
    );
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn pairs_are_named() {
    for pair in [
        [
            PlantedEffect::new("pivot-clearance", ZB, &[("clearance_arcsec", 9.0)]),
            PlantedEffect::new("drift-ramp", X, &[("arcsec_per_h_per_day", 420.0)]),
        ],
        [
            PlantedEffect::new("pivot-clearance", X, &[("clearance_arcsec", 9.0)]),
            PlantedEffect::new("drift-step", X, &[("arcsec_per_h", 30.0), ONSET]),
        ],
        [
            PlantedEffect::new("clock-frequency", UNIT, &[("ppm", 14.0)]),
            PlantedEffect::new("scale-factor-nonlinearity", Y, &[("cubic_ppm", 300.0)]),
        ],
    ] {
        assert_named(4, &pair);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn noises_are_named() {
    for injected in [
        PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.1)]),
        PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 2e-4)]),
        PlantedEffect::new("drift-random-walk", Y, &[("arcsec_per_s_per_sqrt_s", 2e-4)]),
        PlantedEffect::new("bias-instability", &GYROS, &[("arcsec_per_h", 20.0)]),
    ] {
        assert_named(4, &[injected]);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn wiring_is_named() {
    for injected in [
        PlantedEffect::new("sign-inversion-step", Y, &[("on", 1.0), ONSET]),
        PlantedEffect::new("axis-swap", &[Gyro::Y, Gyro::Za], &[("on", 1.0)]),
        PlantedEffect::new("stuck-output-step", X, &[("on", 1.0), ONSET]),
    ] {
        let diagnosis = diagnosis(9, std::slice::from_ref(&injected));
        let named: Vec<&str> = missing(&diagnosis).map(|entry| entry.code.as_str()).collect();
        assert_eq!(named, [injected.code.as_str()]);
        assert!(missing(&diagnosis).all(|entry| entry.gyros == gyros(&injected)));
        assert_eq!(diagnosis.verdict, Verdict::Explained);
    }
}

/// Asserts that each named effect is an injected one, or one of the codes `beside` that describe the bench.
fn assert_not_misnamed(seed: u64, injected: &[PlantedEffect], bench: &Bench, beside: &[&str]) {
    let diagnosis = diagnosis_of(seed, injected, Some(bench));
    for entry in missing(&diagnosis) {
        // Larger noise of all gyros may be reported for some of them.
        let is_noise =
            injected.iter().any(|injected| injected.code == entry.code && entry.code.ends_with("-random-walk"));
        let is_right =
            is_noise || injected.iter().any(|injected| names(entry, injected)) || beside.contains(&entry.code.as_str());
        assert!(is_right, "{} {:?} on {injected:?}", entry.code, entry.gyros);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn noise_five_times_as_large_yields_no_wrong_name() {
    let walks = [
        PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.05)]),
        PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 4e-5)]),
    ];
    for seed in 12..15 {
        assert_not_misnamed(seed, &walks, &Bench::default(), &[]);
        let injected = PlantedEffect::new("pivot-clearance", X, &[("clearance_arcsec", 11.5)]);
        assert_not_misnamed(seed, &[&walks[..], &[injected]].concat(), &Bench::default(), &[]);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_late_temperature_yields_no_wrong_name() {
    let bench = Bench { temperature_late: 600, ..Bench::default() };
    for injected in [
        PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 12.5)]),
        PlantedEffect::new("drift-temperature", Y, &[("arcsec_per_h_per_k", 12.0)]),
        PlantedEffect::new("pivot-clearance", ZB, &[("clearance_arcsec", 9.0)]),
    ] {
        assert_not_misnamed(15, &[injected], &bench, &[]);
    }
    assert_not_misnamed(15, &[], &bench, &[]);
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn the_delay_of_a_temperature_is_estimated() {
    let injected = [PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 25.0)])];
    for samples in [0, 440] {
        let bench = Bench { temperature_late: samples, ..Bench::default() };
        let diagnosis = diagnosis_of(19, &injected, Some(&bench));
        let (late_s, reported_s) = (samples as f64 * SAMPLE_INTERVAL_S, diagnosis.temperature_late_s);
        // Within three steps of the search; no delay is reported as 0.
        assert!(
            (reported_s - late_s).abs() < 60.0 && (reported_s == 0.0) == (late_s == 0.0),
            "{late_s} s: {reported_s} s"
        );
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_noisy_reference_yields_no_wrong_name() {
    let bench = Bench { noise_arcsec: 1.0, ..Bench::default() };
    for seed in 16..18 {
        assert_not_misnamed(seed, &[], &bench, &[]);
        assert_not_misnamed(
            seed,
            &[PlantedEffect::new("pivot-clearance", X, &[("clearance_arcsec", 11.5)])],
            &bench,
            &[],
        );
    }
}

#[test]
fn a_late_reference_is_named_a_time_offset_with_its_alternative() {
    let bench = Bench { late_s: 0.03, ..Bench::default() };
    let diagnosis = diagnosis_of(18, &[], Some(&bench));
    let reported: Vec<&DiagnosedEffect> = missing(&diagnosis).collect();
    let [entry] = reported[..] else { panic!("{} entries", reported.len()) };
    assert_eq!((entry.code.as_str(), entry.alternatives[0].code.as_str()), ("time-offset", "reference-late"));
    assert_not_misnamed(
        18,
        &[PlantedEffect::new("drift-step", Y, &[("arcsec_per_h", 30.0), ONSET])],
        &bench,
        &["time-offset"],
    );
}

#[test]
fn a_formula_outside_the_catalogue_is_proposed() {
    assert_in_no_catalogue(&[(
        PlantedEffect::new("rate-squared-coupling", ZB, &[("per_arcsec_s", 4e-7)]),
        Some("rate_y^2"),
    )]);
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn an_effect_outside_the_catalogue_gets_no_name_of_it() {
    assert_in_no_catalogue(&[
        (PlantedEffect::new("rate-product-coupling", Y, &[("per_arcsec_s", 3e-7)]), Some("rate_x*rate_z")),
        (PlantedEffect::new("rate-drift", X, &[("ppm", 100.0)]), Some("abs(rate_z)")),
        (PlantedEffect::new("count-backlash", ZA, &[("play_arcsec", 8.0)]), None),
    ]);
}

fn assert_in_no_catalogue(cases: &[(PlantedEffect, Option<&str>)]) {
    for (injected, formula) in cases {
        let diagnosis = diagnosis(11, std::slice::from_ref(injected));
        assert!(missing(&diagnosis).all(|entry| entry.code == "discovered"), "{injected:?}");
        match formula {
            Some(formula) => {
                let reported: Vec<&str> = missing(&diagnosis).filter_map(|entry| entry.formula.as_deref()).collect();
                assert_eq!(reported, [*formula]);
            }
            None => assert_eq!(diagnosis.verdict, Verdict::Unexplained),
        }
    }
}

/// One effect of each kind, in a test that is not ignored.
#[test]
fn effects_of_every_kind_are_named() {
    assert_each_named(
        2,
        &[
            PlantedEffect::new("drift-step", Y, &[("arcsec_per_h", 16.0), ONSET]),
            PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 12.5)]),
            PlantedEffect::new("pivot-clearance", X, &[("clearance_arcsec", 11.5)]),
        ],
    );
}

/// Codes, gyros and numbers of the effects injected into a recording, from answers.toml.
fn answers(text: &str, recording: &str) -> Vec<PlantedEffect> {
    let document: toml_edit::DocumentMut = text.parse().expect("TOML");
    let all = document["hidden"].as_array_of_tables().expect("tables");
    let own = all.iter().filter(|table| table["recording"].as_str() == Some(recording));
    /// Other names of the generator than the model has: an effect's code, or the name of a number.
    const RENAMED: [(&str, &str); 4] = [
        ("drift-warm-up", "drift-settling"),
        ("tau_s", "time_constant_s"),
        ("for_s", "duration_s"),
        ("arcsec_per_k", "arcsec_per_h_per_k_per_h"),
    ];
    let renamed = |name| RENAMED.iter().find(|(other, _)| *other == name).map_or(name, |(_, own)| *own);
    let injected = own.filter(|table| table["effect"].as_str() != Some("none")).map(|table| {
        let named = table.get("gyros").and_then(|gyros| gyros.as_array());
        let named: Vec<&str> = named.map_or(vec![], |names| names.iter().filter_map(|name| name.as_str()).collect());
        let gyros: Vec<Gyro> = GYROS.into_iter().filter(|gyro| named.contains(&gyro.name())).collect();
        let numbers = table.iter().filter_map(|(name, item)| {
            Some((renamed(name), item.as_float().or_else(|| item.as_integer().map(|value| value as f64))?))
        });
        PlantedEffect::new(renamed(table["effect"].as_str().expect("a code")), &gyros, &numbers.collect::<Vec<_>>())
    });
    injected.collect()
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn the_shared_recordings_are_named_with_their_amplitudes_and_predicted() {
    /// Max held-out residual rms, arcsec: rounding at both ends 0.41, angle random walk in half an hour 0.30, rate random walk since the
    /// other thirds 0.52 (0.0005 arcsec/s, in half an hour 0.9), together 0.73. The last has a dozen draws, gyros by thirds: 0.93 at
    /// three sigma. An effect on one gyro, estimated from one third to 2.5 arcsec/h, adds 1.1 at three sigma: 1.42. Measured 0.58 to
    /// 1.15.
    const HELD_OUT_ARCSEC: f64 = 1.5;
    let Some(shared) = recordings("") else { return };
    let text = fs::read_to_string(shared.join("answers.toml")).expect("answers");
    for number in (1..=18).filter(|number| *number != 16).chain(21..=23) {
        let name = format!("{number:02}");
        let [link, reference] = ["link.log.gz", "reference.csv.gz"].map(|file| shared.join(&name).join(file));
        let recording = Recording::read(&link, &reference);
        let diagnosis = diagnosed(&recording, &recording.reference, &Configuration::reference());
        let [before, after] = [&diagnosis.before, &diagnosis.after];
        let [before, after, held_out] = [before.fitted, after.fitted, after.held_out].map(|gap| gap.rms_arcsec);
        println!("== {name}: {}; gap {before:.2}, after {after:.2}, held out {held_out:.2}", diagnosis.verdict.name());
        missing(&diagnosis).for_each(|entry| {
            println!(
                "   {}\n{}",
                report::heading(entry),
                report::labelled(6, &report::facts(entry, AngleUnit::from_name("arcsec")))
            )
        });
        let injected = answers(&text, &name);
        assert_eq!(missing(&diagnosis).count(), injected.len(), "{name}");
        assert_eq!(diagnosis.verdict == Verdict::Consistent, injected.is_empty(), "{name}");
        assert!(held_out < HELD_OUT_ARCSEC, "{name}: {held_out}");
        for injected in &injected {
            if injected.code == "rate-squared-coupling" {
                let formula = missing(&diagnosis).find_map(|entry| entry.formula.as_ref());
                assert_eq!(formula.map(String::as_str), Some("rate_y^2"), "{name}");
                continue;
            }
            let entry = missing(&diagnosis).find(|entry| entry.code == injected.code && entry.gyros == gyros(injected));
            let entry = entry.unwrap_or_else(|| panic!("{name}: {injected:?} is not named"));
            for (number, value) in &injected.parameters {
                let found = entry.parameters.iter().find(|found| found.name == *number).expect("a number");
                let (off, sigma) = ((found.value - value).abs(), found.sigma.expect("a sigma"));
                // One of a dozen numbers exceeds this in one of thirty sets of recordings; these recordings do not change.
                assert!(off < 3.0 * sigma, "{name} {number}: {} ± {sigma}, not {value}", found.value);
            }
        }
    }
}
