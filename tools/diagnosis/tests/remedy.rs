//! What would tell two effects apart, against the recording with that flight in it.

mod flown;

use geu_diagnosis::amplitude::AmplitudeRef;
use geu_diagnosis::bank::Column;
use geu_diagnosis::hypothesis::Hypothesis;
use geu_diagnosis::measured::CHANNELS;
use geu_diagnosis::normal::{NormalEquations, Products};
use geu_diagnosis::remedy::DiscriminatingTests;
use geu_diagnosis::rivals::{APART_CHI2, similar_hypotheses};
use geu_diagnosis::state::{FittedHypothesis, ModelState};
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisCase, SignatureBank};
use geu_model::Configuration;

use flown::{manoeuvre, recorded};

const NOISE: NoiseModel = NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5 };

fn change(code: &str, gyro: usize, value: f64) -> Hypothesis {
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

/// Cosine of two changes beside the nuisances, both run over the whole recording.
fn cosine(case: &DiagnosisCase, one: &Hypothesis, other: &Hypothesis) -> f64 {
    let state = case.start([NOISE; CHANNELS]);
    let (residual, nuisances) = case.linearised(&mut state.clone());
    let normal = NormalEquations::new(case.whitenings(&state.noise), &residual, &nuisances);
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
fn what_is_alike_in_turns_one_way_at_one_speed_is_told_apart_as_foretold() {
    let mut believed = Configuration::reference();
    (believed.scenario.theta_deg, believed.scenario.psi_deg) = (90.0, 0.0);
    let rest = manoeuvre("pointing", &[("duration_s", 1500.0)]);
    let scan = manoeuvre("z-scan", &[("angle_deg", 200.0)]);
    let flown = [rest.clone(), scan, rest];
    let measured = recorded(&believed, &flown, None);
    let found = change("scale-factor-asymmetry-ramp", 2, 4000.0);
    let case = DiagnosisCase::new(&measured, &believed);
    let mut all = similar_hypotheses(&case, &SignatureBank::new(&measured, &believed), &holding(&case, &found), 0);
    all.retain(|rival| rival.behind_chi2 < APART_CHI2);
    all.truncate(3);
    let told = DiscriminatingTests::new(&case).of(&holding(&case, &found), 0, &all);
    assert!(all.iter().any(|rival| rival.hypothesis.amplitude.code() == "scale-factor-ramp"));
    for (rival, told) in all.iter().zip(told) {
        let told = told.expect("a remedy");
        let code = rival.hypothesis.amplitude.code();
        assert!(rival.cosine > 0.99, "{code}: {}", rival.cosine);
        let (name, numbers) = told.split_once(" would bring the cosine from 1.00 to ").expect(&told);
        let foretold: f64 = numbers.split_once(',').and_then(|(cosine, _)| cosine.parse().ok()).expect(&told);
        let (next, after_s) = match name {
            "a Z-scan with angle_deg = -360" => (manoeuvre("z-scan", &[("angle_deg", -360.0)]), None),
            "an orbit of survey" => (manoeuvre("survey", &[]), Some(6180.0)),
            _ => panic!("{told}"),
        };
        let longer = recorded(&believed, &[&flown[..], &[next]].concat(), after_s);
        let cosine = cosine(&DiagnosisCase::new(&longer, &believed), &found, &rival.hypothesis);
        assert!(foretold < 0.9 && (cosine - foretold).abs() < 0.1, "{code}: {told}: {cosine}");
    }
}
