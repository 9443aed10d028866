//! The wiring faults that the model has, each as one number set at one gyro; no fault is known here by name.

use geu_model::effect::{Effects, WiringEffects, WiringStates};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::number::ValueFormat;
use geu_protocol::Gyro;

use crate::amplitude::{AmplitudeRef, STEP};
use crate::hypothesis::Hypothesis;

/// Wiring of the four gyros.
pub type Wiring = [WiringEffects; 4];

/// Lets wiring act on the counts of a sample.
pub fn apply(wiring: &Wiring, states: &mut WiringStates, counts: &mut [f64; 4]) {
    WiringEffects::apply(wiring, states, counts, &mut [(); 4]);
}

/// One number of one fault, set at one gyro.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WiringHypothesis {
    /// The gyro.
    bearer: Gyro,
    effect: usize,
    amplitude: usize,
    value: f64,
}

impl WiringHypothesis {
    /// Every fault at every gyro, switched on or with each other gyro.
    pub fn all() -> Vec<WiringHypothesis> {
        let blank = WiringEffects::default();
        let mut laws = Vec::new();
        for (effect, spec) in WiringEffects::SPECS.iter().enumerate() {
            for (amplitude, number) in blank.numbers(effect).specs().iter().enumerate().take(spec.amplitudes.len()) {
                for bearer in Gyro::ALL {
                    let values = match number.form {
                        ValueFormat::Flag => vec![1.0],
                        ValueFormat::Whole | ValueFormat::Choice(_) => vec![],
                        ValueFormat::Gyro => {
                            (1..=4).filter(|&named| named != bearer as usize + 1).map(|n| n as f64).collect()
                        }
                        ValueFormat::Real => Vec::new(),
                    };
                    laws.extend(values.into_iter().map(|value| WiringHypothesis { bearer, effect, amplitude, value }));
                }
            }
        }
        laws
    }

    /// As a hypothesis, from its onset on or all through.
    pub fn hypothesis(&self, onset_s: Option<f64>) -> Hypothesis {
        let target = ParameterRef { list: EffectList::Wiring, effect: self.effect, number: self.amplitude };
        let gyros = Gyro::ALL.map(|gyro| gyro == self.bearer);
        Hypothesis {
            course_shapes: onset_s.into_iter().collect(),
            ..Hypothesis::constant(AmplitudeRef::of(target, onset_s.map(|_| STEP)), self.value, gyros)
        }
    }

    /// Place of the fault in the physical order.
    pub fn order(&self) -> usize {
        self.effect
    }

    /// Sets it.
    pub fn set(&self, wiring: &mut Wiring) {
        *wiring[self.bearer as usize].numbers_mut(self.effect).value_mut(self.amplitude) = self.value;
    }

    /// The wiring with it.
    pub fn with(&self, wiring: &Wiring) -> Wiring {
        let mut with = *wiring;
        self.set(&mut with);
        with
    }

    /// What it makes of 1, 2, 3, 4: where each gyro's counts come from, and their sign.
    pub fn sources(&self) -> [f64; 4] {
        let mut counts = [1.0, 2.0, 3.0, 4.0];
        apply(&self.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
        counts
    }

    /// Whether it undoes itself; else the counts are lost.
    pub fn undoes_itself(&self) -> bool {
        let mut counts = self.sources();
        apply(&self.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
        counts == [1.0, 2.0, 3.0, 4.0]
    }
}

/// A fault of [`geu_model::effect::WiringEffects`] that the counts show against the motion.
#[derive(Debug, Clone, PartialEq)]
pub struct WiringFault {
    /// What puts it into a configuration: of the gyro at which that names it.
    pub hypothesis: Hypothesis,
    /// The gyros whose counts it changes, in wire order.
    pub gyros: Vec<Gyro>,
    /// Where it begins, s since the start of the first sample interval; nothing where it was there from the start.
    pub onset_s: Option<f64>,
    /// Between which times it may as well have begun, s.
    pub onset_between_s: [f64; 2],
    /// Where it ends, s; nothing where it lasts to the end.
    pub end_s: Option<f64>,
    /// Samples of the recording over which it holds.
    pub samples: usize,
    /// Rms of measured less predicted counts over them, without the fault, over the gyros concerned.
    pub without_rms_counts: f64,
    /// The same with the fault.
    pub with_rms_counts: f64,
}

impl WiringFault {
    /// `axis-swap`; `axis-swap-step` where it begins after the start.
    pub fn code(&self) -> String {
        self.hypothesis.amplitude.code()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_of_the_model_is_there_at_every_gyro() {
        let laws = WiringHypothesis::all();
        for (effect, spec) in WiringEffects::SPECS.iter().enumerate() {
            for bearer in Gyro::ALL {
                assert!(laws.iter().any(|law| law.effect == effect && law.bearer == bearer), "{}", spec.code);
            }
        }
        // 4 negated, 12 exchanged, 4 stuck.
        assert_eq!((laws.len(), laws.iter().filter(|law| law.undoes_itself()).count()), (20, 16));
    }
}
