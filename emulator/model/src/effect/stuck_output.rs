//! The last increment is repeated.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectSpec, WiringEffect};
use crate::parameter_spec::numbers;

numbers! {
    /// The last increment is repeated.
    pub struct StuckOutput {
        /// Whether it does.
        on: 0.0, 0.0..=1.0, "", Flag;
    }
}

impl Effect for StuckOutput {
    const SPEC: EffectSpec = EffectSpec {
        code: "stuck-output",
        title: "stuck output",
        amplitudes: &[Amplitude { per_day: 1.0, per_k: 1.0 }],
        paper: "off",
        source: "bench",
    };
}

impl WiringEffect for StuckOutput {
    type State = f64;

    #[inline]
    fn apply(&self, state: &mut f64, gyro: Gyro, counts: &mut [f64; 4]) {
        if self.on >= 0.5 {
            counts[gyro as usize] = *state;
        }
        *state = counts[gyro as usize];
    }
}
