//! The predicted separation of two effects, compared with a recording that contains the manoeuvre.

use geu_diagnosis::alternatives::{AMBIGUITY_CHI2, similar_hypotheses};
use geu_diagnosis::amplitude::AmplitudeRef;
use geu_diagnosis::discriminating_test::DiscriminatingTests;
use geu_diagnosis::hypothesis::Hypothesis;
use geu_diagnosis::measured::CHANNELS;
use geu_diagnosis::model_state::{FittedHypothesis, ModelState};
use geu_diagnosis::normal_equations::{NormalEquations, Products};
use geu_diagnosis::signature_bank::Column;
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisCase, SignatureBank};
use geu_model::Configuration;

use crate::recorded::{manoeuvre, recorded};

const NOISE: NoiseModel = NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5, scale_walk: 0.0 };

fn hypothesis(code: &str, gyro: usize, value: f64) -> Hypothesis {
    let kinds = AmplitudeRef::all().into_iter().flat_map(|one| [Some(one), one.with(1), one.with(2)]).flatten();
    let amplitude = kinds.into_iter().find(|amplitude| amplitude.code() == code).expect("a code");
    let own_shapes = amplitude.own_shapes().iter().map(|number| number.default.initial()).collect();
    let gyros = std::array::from_fn(|other| other == gyro);
    Hypothesis { own_shapes, ..Hypothesis::constant(amplitude, value, gyros) }
}

fn holding(case: &DiagnosisCase, found: &Hypothesis) -> ModelState {
    let mut state = case.start([NOISE; CHANNELS]);
    state.held.push(FittedHypothesis::fixed(found.clone()));
    state
}

/// Cosine of two hypotheses over the whole recording, with the nuisance parameters projected out.
fn cosine(case: &DiagnosisCase, one: &Hypothesis, other: &Hypothesis) -> f64 {
    let state = case.start([NOISE; CHANNELS]);
    let (residual, nuisances) = case.linearised(&mut state.clone());
    let normal = NormalEquations::new(case.whitenings(&state.noise), &residual, &nuisances, &[]);
    let white = |change: &Hypothesis| {
        let signature = case.signature(&holding(case, change), 0);
        signature
            .into_iter()
            .enumerate()
            .filter_map(|(channel, values)| {
                let white = normal.white(channel, &Column { from: 0, values: values? });
                Some((channel, normal.products(channel, &white), white.values))
            })
            .collect::<Vec<_>>()
    };
    let (one, other) = (white(one), white(other));
    let products = |parts: &[(usize, Products, Vec<f64>)]| {
        parts.iter().fold(Products::none(normal.nuisances()), |sum, (_, part, _)| sum.plus(part))
    };
    let pairs =
        one.iter().flat_map(|one| other.iter().filter(move |other| other.0 == one.0).map(move |other| (one, other)));
    let both = pairs.flat_map(|(one, other)| one.2.iter().zip(&other.2)).map(|(a, b)| a * b).sum();
    normal.cosine(&products(&one), &products(&other), both).abs()
}

#[test]
fn effects_similar_in_one_turn_are_separated_as_predicted() {
    let mut nominal = Configuration::reference();
    (nominal.scenario.theta_deg, nominal.scenario.psi_deg) = (90.0, 0.0);
    let rest = manoeuvre("pointing", &[("duration_s", 1500.0)]);
    let scan = manoeuvre("z-scan", &[("angle_deg", 200.0)]);
    let motion = [rest.clone(), scan, rest];
    let measured = recorded(&nominal, &motion, None);
    let found = hypothesis("scale-factor-asymmetry-ramp", 2, 4000.0);
    let case = DiagnosisCase::new(&measured, &nominal);
    let mut all = similar_hypotheses(&case, &SignatureBank::new(&measured, &nominal), &holding(&case, &found), 0);
    all.retain(|other| other.delta_chi2 < AMBIGUITY_CHI2);
    all.truncate(3);
    let tests = DiscriminatingTests::new(&case).select(&holding(&case, &found), 0, &all);
    assert!(all.iter().any(|other| other.hypothesis.amplitude.code() == "scale-factor-ramp"));
    for (alternative, test) in all.iter().zip(tests) {
        let test = test.expect("a manoeuvre");
        let code = alternative.hypothesis.amplitude.code();
        assert!(alternative.cosine > 0.99, "{code}: {}", alternative.cosine);
        let (name, numbers) = test.split_once(" would bring the cosine from 1.00 to ").expect(&test);
        let predicted: f64 = numbers.split_once(',').and_then(|(cosine, _)| cosine.parse().ok()).expect(&test);
        let (next, after_s) = match name {
            "a Z-scan with angle_deg = -360" => (manoeuvre("z-scan", &[("angle_deg", -360.0)]), None),
            "an orbit of survey" => (manoeuvre("survey", &[]), Some(6180.0)),
            _ => panic!("{test}"),
        };
        let longer = recorded(&nominal, &[&motion[..], &[next]].concat(), after_s);
        let cosine = cosine(&DiagnosisCase::new(&longer, &nominal), &found, &alternative.hypothesis);
        assert!(predicted < 0.9 && (cosine - predicted).abs() < 0.1, "{code}: {test}: {cosine}");
    }
}
