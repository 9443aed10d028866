//! The count is negated.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectSpec, WiringEffect};
use crate::parameter_spec::numbers;

numbers! {
    /// The count is negated.
    pub struct SignInversion {
        /// Whether it does.
        on: 0.0, 0.0..=1.0, "", Flag;
    }
}

impl Effect for SignInversion {
    const SPEC: EffectSpec = EffectSpec {
        code: "sign-inversion",
        title: "sign inversion",
        amplitudes: &[Amplitude { per_day: 1.0, per_k: 1.0 }],
        paper: "off",
        source: "bench",
    };
}

impl WiringEffect for SignInversion {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), gyro: Gyro, counts: &mut [f64; 4]) {
        if self.on >= 0.5 {
            counts[gyro as usize] = -counts[gyro as usize];
        }
    }
}
