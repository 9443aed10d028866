//! The blind trial: keys, scores, and campaigns that do not depend on the number of threads.

use geu_blind::{
    AnswerKey, CampaignPlan, InjectedEffect, IsolationResult, Origin, ReportedDiagnosis, SURVEY_S, Shard, ShardFile,
    SimulatedRecording, TrialMotion, campaign, generate_trial, merged, score, simulate,
};
use geu_diagnosis::outcome::{Class, EstimatedValue};
use geu_diagnosis::{DiagnosisOptions, diagnose_rows};
use geu_hypothesis::Hypothesis;
use geu_model::Configuration;
use geu_protocol::Gyros;
use geu_recording::{DecoderOptions, Defect, InputReader, ReceivedSample, ReferenceAttitude, Sink, Stop};
use serde_json::{Value, json};

const SHORT_S: f64 = 1500.0;

fn motion() -> TrialMotion {
    TrialMotion::new(Configuration::reference(), SHORT_S).expect("long enough")
}

#[derive(Default)]
struct Rows(Vec<ReceivedSample>, usize);

impl Sink for Rows {
    fn row(&mut self, row: &ReceivedSample) {
        self.0.push(*row);
    }

    fn defect(&mut self, _: &Defect) {
        self.1 += 1;
    }
}

#[test]
fn same_seed_injects_the_same_effects_and_files_read_back() {
    let motion = motion();
    let mut kinds = [0; 4];
    for seed in 0..40 {
        let (key, recording) = generate_trial(&motion, seed);
        assert_eq!(AnswerKey::parse(&key.to_toml()).expect("a key"), key, "seed {seed}");
        key.injected.iter().for_each(|own| kinds[own.origin as usize] += 1);
        if seed < 3 {
            let (again, other) = generate_trial(&motion, seed);
            assert_eq!((&again, &other.rows), (&key, &recording.rows), "seed {seed}");
        }
    }
    assert!(kinds.iter().all(|&count| count > 0), "{kinds:?}");

    let (_, recording) = generate_trial(&motion, 1);
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("link.log");
    std::fs::write(&path, recording.link_log()).expect("written");
    let (mut reader, mut read) = (InputReader::new(DecoderOptions::default(), Stop::default()), Rows::default());
    reader.read(path.to_str().expect("text"), &mut read).expect("a recording");
    reader.finish(&mut read).1.expect("its end");
    assert_eq!((&read.0, read.1), (&recording.rows, 0));
    let reference = ReferenceAttitude::parse("reference.csv", &recording.reference_csv()).expect("a reference");
    assert_eq!(reference.start_ns, recording.reference.start_ns);
    assert!((reference.truth.end_s() - recording.reference.truth.end_s()).abs() < 1e-6);
}

fn hypothesis(code: &str, numbers: &[(&str, f64)]) -> Hypothesis {
    let number = |name: &str| numbers.iter().find(|(own, _)| *own == name).map(|(_, value)| *value);
    Hypothesis::from_numbers(code, None, Gyros::ALL.only(0), number).expect("a hypothesis")
}

fn step(size: f64) -> InjectedEffect {
    InjectedEffect {
        hypothesis: hypothesis("drift-step", &[("arcsec_per_h", size), ("time_s", 700.0)]),
        origin: Origin::Catalogue,
        sigma: Some(2.0),
        strength: Some(0.5 * size),
        nearest: None,
        assignments: Vec::new(),
    }
}

fn entry(code: &str, gyro: &str, alternatives: Value) -> Value {
    let parameters = json!({ "arcsec_per_h": { "value": 25.0, "sigma": 3.0 }, "on": { "value": true, "sigma": null } });
    json!({ "code": code, "class": "missing-effect", "gyros": [gyro], "parameters": parameters, "rivals": alternatives })
}

fn result(verdict: &str, effects: &[Value]) -> ReportedDiagnosis {
    ReportedDiagnosis::from_json(&json!({ "verdict": verdict, "effects": effects })).expect("a result")
}

#[test]
fn diagnoses_are_scored_against_injected_effects() {
    let alternative = |cosine: f64, behind: f64| json!([{ "code": "drift-step", "gyros": ["GYRX"], "cosine": cosine, "behind_chi2": behind }]);
    let recalibrated = json!({ "code": "scale-factor", "class": "recalibration", "gyros": ["GYRZA"] });
    for (name, result, isolation, false_alarms) in [
        (
            "right",
            result("explained", &[entry("drift-step", "GYRX", json!([])), recalibrated]),
            IsolationResult::Right,
            0,
        ),
        (
            "with a false alarm",
            result("explained", &[entry("drift-step", "GYRX", json!([])), entry("drift", "GYRY", json!([]))]),
            IsolationResult::Right,
            1,
        ),
        (
            "similar, yet distinguishable",
            result("explained", &[entry("drift-ramp", "GYRX", alternative(0.96, 40.0))]),
            IsolationResult::Wrong,
            1,
        ),
        (
            "not distinguishable",
            result("explained", &[entry("drift-ramp", "GYRX", alternative(0.90, 15.9))]),
            IsolationResult::Group,
            0,
        ),
        (
            "distinguishable",
            result("explained", &[entry("drift-ramp", "GYRX", alternative(0.90, 16.1))]),
            IsolationResult::Wrong,
            1,
        ),
        ("another gyro", result("explained", &[entry("drift-step", "GYRY", json!([]))]), IsolationResult::Missed, 1),
        ("no effect", result("unexplained", &[]), IsolationResult::Unnamed, 0),
        ("consistent", result("consistent", &[]), IsolationResult::Missed, 0),
    ] {
        let score = score(&[step(24.0)], &result, &|_, _| 0.0);
        assert_eq!((score.outcomes[0].isolation, score.false_alarms.len()), (isolation, false_alarms), "{name}");
        let size = score.outcomes[0].size.map(|size| (size.error, size.sigma, size.bound));
        assert_eq!(size, (isolation == IsolationResult::Right).then_some((1.0, 3.0, 2.0)), "{name}");
        let is_right = isolation >= IsolationResult::Group && false_alarms == 0;
        assert_eq!(score.is_right(&[step(24.0)], &result), is_right, "{name}");
    }
    // Another code with the same signature.
    let other = result("explained", &[entry("drift-periodic", "GYRX", json!([]))]);
    assert_eq!(score(&[step(24.0)], &other, &|_, _| 0.9995).outcomes[0].isolation, IsolationResult::Group);
    let broken = ReportedDiagnosis::from_json(&json!({ "verdict": "explained", "effects": 1 })).expect_err("no list");
    assert_eq!(broken.to_string(), "effects: expected a list, as `geu diagnose --json` writes it");
    let broken = ReportedDiagnosis::from_json(&json!({ "verdict": "sure", "effects": [] })).expect_err("no verdict");
    assert!(broken.to_string().starts_with("verdict: expected consistent, explained or unexplained"), "{broken}");
    let elsewhere = entry("drift-step", "GYRQ", json!([]));
    assert!(ReportedDiagnosis::from_json(&json!({ "verdict": "explained", "effects": [elsewhere] })).is_err());
    let key = AnswerKey { seed: 1, duration_s: 100.0, injected: vec![step(24.0)] }.to_toml();
    let broken = AnswerKey::parse(&key.replace("\"GYRX\"", "\"GYRQ\"")).expect_err("no gyro");
    assert!(broken.to_string().contains("expected one or more of GYRX, GYRY, GYRZA, GYRZB"), "{broken}");
}

#[test]
fn cosine_is_one_with_itself_and_small_with_another_effect() {
    let motion = motion();
    let cosine = |code: &str, gyro: &str| {
        let mut found = result("explained", &[entry(code, gyro, json!([]))]).missing.remove(0);
        found.parameters.push(EstimatedValue::new("time_s".to_owned(), 700.0, f64::NAN));
        motion.signature_cosine(&step(24.0), &found, 0.0)
    };
    assert!((cosine("drift-step", "GYRX") - 1.0).abs() < 1e-3, "{}", cosine("drift-step", "GYRX"));
    assert!(cosine("drift-step", "GYRY") < 1e-3);
    assert_eq!(cosine("stuck-output", "GYRX"), 0.0);
}

#[test]
fn lagged_temperature_changes_the_signature() {
    let motion = motion();
    let follows = json!({ "code": "drift-temperature", "class": "missing-effect", "gyros": ["GYRX"],
        "parameters": { "arcsec_per_h_per_k": { "value": 5.0, "sigma": 0.1 } }, "rivals": [] });
    let result = json!({ "verdict": "explained", "effects": [follows], "temperature_late_s": 600.0 });
    let reported = ReportedDiagnosis::from_json(&result).expect("a result");
    let injected = InjectedEffect {
        hypothesis: hypothesis("drift-temperature", &[("arcsec_per_h_per_k", 5.0)]),
        origin: Origin::Unknown,
        ..step(0.0)
    };
    let cosine = |late_s: f64| motion.signature_cosine(&injected, &reported.missing[0], late_s);
    assert!(cosine(0.0) > 0.999, "{}", cosine(0.0));
    assert_eq!(reported.temperature_late_s, 600.0);
    assert!(cosine(reported.temperature_late_s) < cosine(0.0));
    // The lag changes the cosine with another code, too.
    let numbers = [("amplitude_arcsec_per_h", 20.0), ("period_s", 6180.0), ("phase_rad", 0.0)];
    let wave =
        InjectedEffect { hypothesis: hypothesis("drift-periodic", &numbers), origin: Origin::Unknown, ..step(0.0) };
    let [now, quarter_turn_late] =
        [0.0, 1545.0].map(|late_s| motion.signature_cosine(&wave, &reported.missing[0], late_s));
    assert!((now - quarter_turn_late).abs() > 0.01, "{now} {quarter_turn_late}");
}

#[test]
fn campaign_does_not_depend_on_threads_and_parts() {
    let motion = motion();
    let plan = CampaignPlan { seed: 3, runs: 3, strengths: vec![12.0], threads: 2, shard: Shard::WHOLE };
    let all = campaign(&motion, &plan, &|| ()).expect("a campaign");
    assert_eq!(all.groups.iter().map(|group| group.runs.len()).collect::<Vec<_>>(), [3, 3, 1]);
    let part = |index: usize| {
        let plan = CampaignPlan { threads: 1, shard: Shard { index, count: 2 }, ..plan.clone() };
        ShardFile::new(&plan, String::new(), SURVEY_S, campaign(&motion, &plan, &|| ()).expect("a part"))
    };
    assert_eq!(merged(&[part(1), part(0)]).expect("the whole").json(), all.json());
    let strength = &all.groups[0].runs[0].injected[0].effect["strength"];
    assert!((strength.as_f64().expect("an amplitude has one") - 12.0).abs() < 0.1);
    let tables = all.tables();
    assert!(
        tables.contains("| effect, 12× | ") && tables.contains("| nothing | ") && tables.contains("| outside"),
        "{tables}"
    );
}

/// The other gyros hardly turn about their axes.
#[test]
fn an_effect_is_named_on_the_gyro_that_shows_it() {
    let injected = ["gyro.GYRY.scale-factor-nonlinearity.cubic_ppm=180".to_owned()];
    for seed in [1, 2] {
        let unit = Configuration { seed, ..Configuration::reference_with(&injected).expect("valid") };
        let SimulatedRecording { rows, reference, .. } = simulate(&unit, SURVEY_S);
        let options = DiagnosisOptions::new(reference.start_ns);
        let diagnosis =
            diagnose_rows(&rows, &[], &Configuration::reference(), &reference, &options).expect("a recording");
        let [found] = &diagnosis.entries.iter().filter(|own| own.class == Class::MissingEffect).collect::<Vec<_>>()[..]
        else {
            panic!("seed {seed}: {:?}", diagnosis.entries)
        };
        assert_eq!(
            (found.code.as_str(), found.gyros),
            ("scale-factor-nonlinearity", Gyros::ALL.only(1)),
            "seed {seed}"
        );
        let on_all = found.alternatives.iter().find(|other| other.code == found.code && other.gyros.is_all());
        assert!(on_all.is_some_and(|other| other.is_indistinguishable()), "seed {seed}");
    }
}
