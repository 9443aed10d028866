//! The model's wiring faults, each as one number set at one gyro; no fault is named here.

use geu_model::effect::{Effects, WiringEffects, WiringStates};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::parameter_spec::ValueFormat;
use geu_protocol::{Gyro, Gyros};

use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, STEP};

/// Wiring of the four gyros.
pub type Wiring = [WiringEffects; 4];

/// Applies wiring to the counts of a sample.
pub fn apply(wiring: &Wiring, states: &mut WiringStates, counts: &mut [f64; 4]) {
    WiringEffects::apply(wiring, states, counts, &mut [(); 4]);
}

/// One number of one fault, set at one gyro.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WiringHypothesis {
    /// The gyro at which the configuration states it.
    bearer: Gyro,
    effect: usize,
    amplitude: usize,
    value: f64,
}

impl WiringHypothesis {
    /// Every fault at every gyro, switched on or with each other gyro.
    pub fn all() -> Vec<WiringHypothesis> {
        let blank = WiringEffects::default();
        let mut all = Vec::new();
        for (effect, spec) in WiringEffects::SPECS.iter().enumerate() {
            for (amplitude, number) in blank.numbers(effect).specs().iter().enumerate().take(spec.amplitudes.len()) {
                for bearer in Gyro::ALL {
                    let values = match number.form {
                        ValueFormat::Flag => vec![1.0],
                        ValueFormat::Gyro => {
                            (1..=4).filter(|&other| other != bearer.index() + 1).map(|other| other as f64).collect()
                        }
                        ValueFormat::Whole | ValueFormat::Choice(_) | ValueFormat::Real => Vec::new(),
                    };
                    all.extend(values.into_iter().map(|value| WiringHypothesis { bearer, effect, amplitude, value }));
                }
            }
        }
        all
    }

    /// The hypothesis with an onset, or for the whole recording.
    pub fn hypothesis(&self, onset_s: Option<f64>) -> Hypothesis {
        let target = ParameterRef { list: EffectList::Wiring, effect: self.effect, number: self.amplitude };
        let gyros = Gyros::ALL.only(self.bearer.index());
        Hypothesis {
            course_shapes: onset_s.into_iter().collect(),
            ..Hypothesis::constant(AmplitudeRef::new(target, onset_s.map(|_| STEP)), self.value, gyros)
        }
    }

    /// Place of the fault in the physical order.
    pub fn order(&self) -> usize {
        self.effect
    }

    /// Adds it to a wiring.
    pub fn set(&self, wiring: &mut Wiring) {
        *wiring[self.bearer.index()].numbers_mut(self.effect).value_mut(self.amplitude) = self.value;
    }

    /// The wiring with it.
    pub fn with(&self, wiring: &Wiring) -> Wiring {
        let mut with = *wiring;
        self.set(&mut with);
        with
    }

    /// Source of each gyro's counts as 1, 2, 3, 4, with the sign.
    pub fn sources(&self) -> [f64; 4] {
        let mut counts = [1.0, 2.0, 3.0, 4.0];
        apply(&self.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
        counts
    }

    /// True if applying it twice restores the counts; otherwise they are lost.
    pub fn undoes_itself(&self) -> bool {
        let mut counts = self.sources();
        apply(&self.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
        counts == [1.0, 2.0, 3.0, 4.0]
    }
}

/// A wiring fault detected by comparing counts with the motion.
#[derive(Debug, Clone, PartialEq)]
pub struct WiringFault {
    /// The hypothesis, at one gyro.
    pub hypothesis: Hypothesis,
    /// Gyros with changed counts, in wire order.
    pub gyros: Vec<Gyro>,
    /// Onset, s since the start of the first sample interval; `None` if it exists from the start.
    pub onset_s: Option<f64>,
    /// Interval of the onset, s.
    pub onset_between_s: [f64; 2],
    /// End, s; `None` if it lasts to the end.
    pub end_s: Option<f64>,
    /// Number of samples with the fault.
    pub samples: usize,
    /// Rms of measured minus predicted counts of these samples and gyros without the fault.
    pub without_rms_counts: f64,
    /// Rms with the fault.
    pub with_rms_counts: f64,
}

impl WiringFault {
    /// `axis-swap`, or `axis-swap-step` with an onset.
    pub fn code(&self) -> String {
        self.hypothesis.amplitude.code()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypotheses_cover_every_fault_at_every_gyro() {
        let all = WiringHypothesis::all();
        for (effect, spec) in WiringEffects::SPECS.iter().enumerate() {
            for bearer in Gyro::ALL {
                assert!(all.iter().any(|own| own.effect == effect && own.bearer == bearer), "{}", spec.code);
            }
        }
        // 4 negated, 12 exchanged, 4 stuck.
        assert_eq!((all.len(), all.iter().filter(|own| own.undoes_itself()).count()), (20, 16));
    }
}
