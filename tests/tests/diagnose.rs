//! The diagnosis of recordings that our model did not make: what is hidden is named, on the gyro that has it, at its size; what stands
//! in no catalogue is not given a name of it; and where nothing is hidden nothing is named.

use std::collections::HashMap;
use std::fs;
use std::sync::Mutex;

use geu_diagnosis::outcome::{Class, DiagnosedEffect};
use geu_diagnosis::rivals::APART_CHI2;
use geu_diagnosis::{Diagnosis, DiagnosisOptions, Thresholds, Verdict, diagnose_rows, report};
use geu_model::Configuration;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_plant::{GYROS, Gyro, IndependentModel, PlantedEffect};
use geu_recording::ReferenceAttitude;
use geu_tests::comparison::Recording;
use geu_tests::recordings;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ONSET: (&str, f64) = ("time_s", 5200.0);
const X: &[Gyro] = &[Gyro::X];
const Y: &[Gyro] = &[Gyro::Y];
const ZA: &[Gyro] = &[Gyro::Za];
const ZB: &[Gyro] = &[Gyro::Zb];
const UNIT: &[Gyro] = &[];

/// Recordings of one flight have their thresholds in common.
static THRESHOLDS: Mutex<Option<HashMap<u64, Thresholds>>> = Mutex::new(None);

fn recorded(plant: &IndependentModel) -> Recording {
    let room = tempfile::tempdir().expect("a directory");
    let recording = plant.record();
    let [link, reference] = ["link.log", "reference.csv"].map(|name| room.path().join(name));
    fs::write(&link, recording.link).expect("written");
    fs::write(&reference, recording.reference).expect("written");
    Recording::read(&link, &reference)
}

fn diagnosed(recording: &Recording, reference: &ReferenceAttitude, believed: &Configuration) -> Diagnosis {
    let settings = DiagnosisOptions {
        seed: 1,
        clock_start_ns: reference.start_ns,
        manoeuvres: None,
        known: &|key| THRESHOLDS.lock().expect("no panic").get_or_insert_default().get(&key).cloned(),
        keep: &|key, thresholds| {
            THRESHOLDS.lock().expect("no panic").get_or_insert_default().insert(key, thresholds.clone());
        },
        progress: &|_| (),
    };
    diagnose_rows(&recording.rows, &[], believed, reference, &settings).expect("a recording")
}

/// What a bench tells otherwise than it is.
#[derive(Default)]
struct Bench {
    /// The reference's times are late by this.
    late_s: f64,
    /// The reference errs by this about each axis, 1 sigma.
    noise_arcsec: f64,
    /// The temperature is told so many samples late.
    temperature_late: usize,
}

impl Bench {
    fn tells(&self, recording: &mut Recording, reference: &str) {
        let told: Vec<i16> = recording.rows.iter().map(|row| row.sample.electronics_centi_c).collect();
        for (index, row) in recording.rows.iter_mut().enumerate() {
            row.sample.electronics_centi_c = told[index.saturating_sub(self.temperature_late)];
        }
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut before = [0.0; 3];
        let told = reference.lines().enumerate().map(|(line, text)| {
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
        let told = told.collect::<Vec<_>>().join("\n");
        recording.reference = ReferenceAttitude::parse("reference.csv", &told).expect("a reference");
    }
}

fn diagnosis(seed: u64, hidden: &[PlantedEffect]) -> Diagnosis {
    diagnosis_of(seed, hidden, None)
}

fn diagnosis_of(seed: u64, hidden: &[PlantedEffect], bench: Option<&Bench>) -> Diagnosis {
    let is_cooling = hidden.iter().any(|hidden| hidden.code.starts_with("drift-sensor-temperature"));
    let heater_off_s = is_cooling.then_some(4000.0);
    let plant = IndependentModel { heater_off_s, ..IndependentModel::new(seed, hidden.to_vec()) };
    let mut recording = recorded(&plant);
    if let Some(bench) = bench {
        bench.tells(&mut recording, &plant.record().reference);
    }
    let diagnosis = diagnosed(&recording, &recording.reference, &Configuration::reference());
    let names: Vec<String> = hidden.iter().map(|hidden| format!("{} {:?}", hidden.code, hidden.gyros)).collect();
    println!("== seed {seed}: {}: {}", names.join(" + "), diagnosis.verdict.name());
    missing(&diagnosis)
        .for_each(|entry| println!("   {}\n{}", report::heading(entry), report::labelled(6, &report::facts(entry))));
    if let Some(left) = &diagnosis.unexplained {
        println!("   left: {:?} {:?} {} {:?}", left.gyros, left.interval_s, left.shape, left.follows);
    }
    diagnosis
}

fn missing(diagnosis: &Diagnosis) -> impl Iterator<Item = &DiagnosedEffect> {
    diagnosis.entries.iter().filter(|entry| entry.class == Class::MissingEffect)
}

fn gyros(hidden: &PlantedEffect) -> [bool; 4] {
    let has = |gyro: &Gyro| hidden.gyros.is_empty() || hidden.gyros.contains(gyro);
    GYROS.each_ref().map(has)
}

/// Whether an entry names what is hidden, itself or as one of a group that cannot be told apart.
fn names(entry: &DiagnosedEffect, hidden: &PlantedEffect) -> bool {
    let is_rival = entry.rivals.iter().any(|rival| {
        rival.code == hidden.code
            && rival.gyros == gyros(hidden)
            && rival.behind_chi2.is_none_or(|behind| behind < APART_CHI2)
    });
    entry.gyros == gyros(hidden) && (entry.code == hidden.code || is_rival)
}

/// Each is named, and nothing else; what is named by its own code has its size within so many sigmas.
fn assert_named(seed: u64, hidden: &[PlantedEffect]) {
    // Of the sixty sizes told here a normal error makes one that is farther off in one of 250 sets of seeds.
    const SIGMAS: f64 = 4.0;
    let diagnosis = diagnosis(seed, hidden);
    assert_eq!(diagnosis.verdict, Verdict::Explained, "{hidden:?}");
    assert_eq!(missing(&diagnosis).count(), hidden.len(), "{hidden:?}");
    for hidden in hidden {
        let entry = missing(&diagnosis).find(|entry| names(entry, hidden));
        let entry = entry.unwrap_or_else(|| panic!("{hidden:?} is not named"));
        for (name, value) in hidden.parameters.iter().filter(|_| entry.code == hidden.code) {
            let Some(number) = entry.parameters.iter().find(|number| number.name == *name) else { continue };
            if let Some(sigma) = number.sigma {
                let off = (number.value - value).abs() / sigma;
                assert!(off < SIGMAS, "{} {name}: {} ± {sigma}, hidden {value}", hidden.code, number.value);
            }
        }
    }
}

fn assert_each_named(seed: u64, all: &[PlantedEffect]) {
    all.iter().for_each(|hidden| assert_named(seed, std::slice::from_ref(hidden)));
}

/// In three hours as everywhere in this file. How seldom chance is given a name it does not say; the next test does.
#[test]
fn nothing_is_named_in_two_recordings_where_nothing_is_hidden() {
    assert_eq!(false_alarms(20..22, 10_800.0), Vec::<u64>::new());
}

/// The seeds whose recording, with nothing hidden, is not told to be consistent without a name.
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

/// None of a hundred: with 95 % confidence a name is given to chance in less than 3 of 100 recordings (0.97¹⁰⁰ is 4.8 %). That it is one of
/// a hundred, as thresholds are set for, would take three hundred. Each is another flight with thresholds of its own; an hour, so that
/// a hundred are minutes.
#[test]
#[ignore = "minutes; .ci/run has it"]
fn in_a_hundred_recordings_where_nothing_is_hidden_chance_is_given_no_name() {
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
    for hidden in [
        PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.1)]),
        PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 2e-4)]),
        PlantedEffect::new("drift-random-walk", Y, &[("arcsec_per_s_per_sqrt_s", 2e-4)]),
    ] {
        assert_named(4, &[hidden]);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn wiring_is_named() {
    for hidden in [
        PlantedEffect::new("sign-inversion-step", Y, &[("on", 1.0), ONSET]),
        PlantedEffect::new("axis-swap", &[Gyro::Y, Gyro::Za], &[("on", 1.0)]),
        PlantedEffect::new("stuck-output-step", X, &[("on", 1.0), ONSET]),
    ] {
        let diagnosis = diagnosis(9, std::slice::from_ref(&hidden));
        let named: Vec<&str> = missing(&diagnosis).map(|entry| entry.code.as_str()).collect();
        assert_eq!(named, [hidden.code.as_str()]);
        assert!(missing(&diagnosis).all(|entry| entry.gyros == gyros(&hidden)));
        assert_eq!(diagnosis.verdict, Verdict::Explained);
    }
}

/// What is hidden is named, or nothing is beside what is wrong with the bench; never anything else.
fn assert_not_misnamed(seed: u64, hidden: &[PlantedEffect], bench: &Bench, beside: &[&str]) {
    let diagnosis = diagnosis_of(seed, hidden, Some(bench));
    for entry in missing(&diagnosis) {
        // Noise that is larger on all gyros may be told of some of them.
        let is_noise = hidden.iter().any(|hidden| hidden.code == entry.code && entry.code.ends_with("-random-walk"));
        let is_right =
            is_noise || hidden.iter().any(|hidden| names(entry, hidden)) || beside.contains(&entry.code.as_str());
        assert!(is_right, "{} {:?} on {hidden:?}", entry.code, entry.gyros);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn noise_five_times_as_large_misleads_nobody() {
    let walks = [
        PlantedEffect::new("angle-random-walk", &GYROS, &[("arcsec_per_sqrt_s", 0.05)]),
        PlantedEffect::new("drift-random-walk", &GYROS, &[("arcsec_per_s_per_sqrt_s", 4e-5)]),
    ];
    for seed in 12..15 {
        assert_not_misnamed(seed, &walks, &Bench::default(), &[]);
        let hidden = PlantedEffect::new("pivot-clearance", X, &[("clearance_arcsec", 11.5)]);
        assert_not_misnamed(seed, &[&walks[..], &[hidden]].concat(), &Bench::default(), &[]);
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_temperature_told_late_misleads_nobody() {
    let bench = Bench { temperature_late: 600, ..Bench::default() };
    for hidden in [
        PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 12.5)]),
        PlantedEffect::new("drift-temperature", Y, &[("arcsec_per_h_per_k", 12.0)]),
        PlantedEffect::new("pivot-clearance", ZB, &[("clearance_arcsec", 9.0)]),
    ] {
        assert_not_misnamed(15, &[hidden], &bench, &[]);
    }
    assert_not_misnamed(15, &[], &bench, &[]);
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn how_late_a_temperature_is_told_is_found() {
    let hidden = [PlantedEffect::new("scale-factor-temperature", &GYROS, &[("ppm_per_k", 25.0)])];
    for samples in [0, 440] {
        let bench = Bench { temperature_late: samples, ..Bench::default() };
        let diagnosis = diagnosis_of(19, &hidden, Some(&bench));
        let (late_s, told_s) = (samples as f64 * SAMPLE_INTERVAL_S, diagnosis.temperature_late_s);
        // To three steps of what is looked for; where none is late, none is told.
        assert!((told_s - late_s).abs() < 60.0 && (told_s == 0.0) == (late_s == 0.0), "{late_s} s: {told_s} s");
    }
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn a_reference_that_errs_misleads_nobody() {
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
fn a_reference_that_is_late_is_a_time_offset_or_its_rival_and_nothing_else() {
    let bench = Bench { late_s: 0.03, ..Bench::default() };
    let diagnosis = diagnosis_of(18, &[], Some(&bench));
    let told: Vec<&DiagnosedEffect> = missing(&diagnosis).collect();
    let [entry] = told[..] else { panic!("{} things told", told.len()) };
    assert_eq!((entry.code.as_str(), entry.rivals[0].code.as_str()), ("time-offset", "reference-late"));
    assert_not_misnamed(
        18,
        &[PlantedEffect::new("drift-step", Y, &[("arcsec_per_h", 30.0), ONSET])],
        &bench,
        &["time-offset"],
    );
}

#[test]
fn a_formula_that_is_in_no_catalogue_is_proposed() {
    assert_in_no_catalogue(&[(
        PlantedEffect::new("rate-squared-coupling", ZB, &[("per_arcsec_s", 4e-7)]),
        Some("rate_y^2"),
    )]);
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn what_is_in_no_catalogue_is_not_given_a_name_of_it() {
    assert_in_no_catalogue(&[
        (PlantedEffect::new("rate-product-coupling", Y, &[("per_arcsec_s", 3e-7)]), Some("rate_x*rate_z")),
        (PlantedEffect::new("rate-drift", X, &[("ppm", 100.0)]), Some("abs(rate_z)")),
        (PlantedEffect::new("count-backlash", ZA, &[("play_arcsec", 8.0)]), None),
    ]);
}

fn assert_in_no_catalogue(cases: &[(PlantedEffect, Option<&str>)]) {
    for (hidden, formula) in cases {
        let diagnosis = diagnosis(11, std::slice::from_ref(hidden));
        assert!(missing(&diagnosis).all(|entry| entry.code == "discovered"), "{hidden:?}");
        match formula {
            Some(formula) => {
                let told: Vec<&str> = missing(&diagnosis).filter_map(|entry| entry.formula.as_deref()).collect();
                assert_eq!(told, [*formula]);
            }
            None => assert_eq!(diagnosis.verdict, Verdict::Unexplained),
        }
    }
}

/// One of each kind, in a test that every run has.
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

/// The codes and gyros hidden in a recording, and its numbers, of answers.toml.
fn answers(text: &str, recording: &str) -> Vec<PlantedEffect> {
    let document: toml_edit::DocumentMut = text.parse().expect("TOML");
    let all = document["hidden"].as_array_of_tables().expect("tables");
    let own = all.iter().filter(|table| table["recording"].as_str() == Some(recording));
    let hidden = own.filter(|table| table["effect"].as_str() != Some("none")).map(|table| {
        let named = table.get("gyros").and_then(|gyros| gyros.as_array());
        let named: Vec<&str> = named.map_or(vec![], |names| names.iter().filter_map(|name| name.as_str()).collect());
        let gyros: Vec<Gyro> = GYROS.into_iter().filter(|gyro| named.contains(&gyro.name())).collect();
        let numbers = table.iter().filter_map(|(name, item)| {
            Some((name, item.as_float().or_else(|| item.as_integer().map(|value| value as f64))?))
        });
        PlantedEffect::new(table["effect"].as_str().expect("a code"), &gyros, &numbers.collect::<Vec<_>>())
    });
    hidden.collect()
}

#[test]
#[ignore = "minutes; .ci/run has it"]
fn the_shared_recordings_are_named_with_their_sizes_and_foretold() {
    /// Largest rms of the gap held out, arcsec: 0.41 are rounding at both ends, 0.30 the angle's walk in half an hour, 0.52 the rate's
    /// walk since the other thirds (0.0005 arcsec/s, in half an hour 0.9), together 0.73. The last comes in a dozen draws, gyros by
    /// thirds, so that it is 0.93 at three sigma; what is hidden on one gyro, told by one third to 2.5 arcsec/h, adds 1.1 at three
    /// sigma: 1.42. 0.58 to 1.15 were measured.
    const HELD_OUT_ARCSEC: f64 = 1.5;
    let Some(shared) = recordings("") else { return };
    let text = fs::read_to_string(shared.join("answers.toml")).expect("answers");
    for number in 1..=10 {
        let name = format!("{number:02}");
        let [link, reference] = ["link.log.gz", "reference.csv.gz"].map(|file| shared.join(&name).join(file));
        let recording = Recording::read(&link, &reference);
        let diagnosis = diagnosed(&recording, &recording.reference, &Configuration::reference());
        let [before, after] = [&diagnosis.before, &diagnosis.after];
        let [before, after, held_out] = [before.fitted, after.fitted, after.held_out].map(|gap| gap.rms_arcsec);
        println!("== {name}: {}; gap {before:.2}, after {after:.2}, held out {held_out:.2}", diagnosis.verdict.name());
        missing(&diagnosis).for_each(|entry| {
            println!("   {}\n{}", report::heading(entry), report::labelled(6, &report::facts(entry)))
        });
        let hidden = answers(&text, &name);
        assert_eq!(missing(&diagnosis).count(), hidden.len(), "{name}");
        assert_eq!(diagnosis.verdict == Verdict::Consistent, hidden.is_empty(), "{name}");
        assert!(held_out < HELD_OUT_ARCSEC, "{name}: {held_out}");
        for hidden in &hidden {
            if hidden.code == "rate-squared-coupling" {
                let formula = missing(&diagnosis).find_map(|entry| entry.formula.as_ref());
                assert_eq!(formula.map(String::as_str), Some("rate_y^2"), "{name}");
                continue;
            }
            let entry = missing(&diagnosis).find(|entry| entry.code == hidden.code && entry.gyros == gyros(hidden));
            let entry = entry.unwrap_or_else(|| panic!("{name}: {hidden:?} is not named"));
            for (number, value) in &hidden.parameters {
                let found = entry.parameters.iter().find(|found| found.name == *number).expect("a number");
                let (off, sigma) = ((found.value - value).abs(), found.sigma.expect("a sigma"));
                // Of a dozen numbers one is farther off in one of thirty sets of recordings; these are always the same.
                assert!(off < 3.0 * sigma, "{name} {number}: {} ± {sigma}, not {value}", found.value);
            }
        }
    }
}
