//! The proposed manoeuvre for effects that one turn does not separate.

use geu_diagnosis::alternatives::{AMBIGUITY_CHI2, similar_hypotheses};
use geu_diagnosis::discriminating_test::DiscriminatingTests;
use geu_diagnosis::fitted_hypothesis::FittedHypothesis;
use geu_diagnosis::measured::CHANNELS;
use geu_diagnosis::model_state::ModelState;
use geu_diagnosis::whitening::NoiseModel;
use geu_diagnosis::{DiagnosisCase, SignatureBank};
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_model::Configuration;
use geu_model::device::Device;
use geu_protocol::Gyros;

use crate::recorded::{manoeuvre, recorded};

const NOISE: NoiseModel = NoiseModel { white: 0.01, angle_walk: 0.02, rate_walk: 2e-5, scale_walk: 0.0, flicker: 0.0 };

fn hypothesis(code: &str, gyro: usize, value: f64) -> Hypothesis {
    let kinds =
        AmplitudeRef::all(&Device::iras()).into_iter().flat_map(|one| [Some(one), one.with(1), one.with(2)]).flatten();
    let amplitude = kinds.into_iter().find(|amplitude| amplitude.code() == code).expect("a code");
    let own_shapes = amplitude.own_shapes().iter().map(|number| number.default.initial()).collect();
    Hypothesis { own_shapes, ..Hypothesis::constant(amplitude, value, Gyros::ALL.only(gyro)) }
}

fn holding(case: &DiagnosisCase, found: &Hypothesis) -> ModelState {
    let mut state = case.start([NOISE; CHANNELS]);
    state.held.push(FittedHypothesis::fixed(found.clone()));
    state
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
        let code = alternative.hypothesis.amplitude.code();
        let test = test.expect("a test");
        let next = test.manoeuvre.expect(&test.text);
        assert!(alternative.cosine > 0.99 && next.is_sure() && next.duration_s < 6180.0, "{code}: {}", test.text);
        assert!(test.text.starts_with("a new recording of ") && test.text.ends_with(" sigma"), "{}", test.text);
        // In the other direction of turning the two differ in sign.
        let again = recorded(&nominal, &next.scenario.manoeuvres, None);
        let case = DiagnosisCase::new(&again, &nominal);
        let similar = similar_hypotheses(&case, &SignatureBank::new(&again, &nominal), &holding(&case, &found), 0);
        let other = similar.iter().find(|other| other.hypothesis.amplitude == alternative.hypothesis.amplitude);
        assert!(other.is_none_or(|other| other.delta_chi2 > 25.0), "{code}: {other:?}");
    }
}
