//! Two gyros are exchanged.

use geu_protocol::Gyro;

use super::{Amplitude, Effect, EffectSpec, WiringEffect};
use crate::parameter_spec::{named_gyro, numbers};

numbers! {
    /// The counts of two gyros stand in each other's place.
    pub struct AxisSwap {
        /// The other gyro. Named at one of the two: at both, they are exchanged twice.
        with: 0.0, 0.0..=4.0, "", Gyro;
    }
}

impl Effect for AxisSwap {
    const SPEC: EffectSpec = EffectSpec {
        code: "axis-swap",
        title: "axis swap",
        amplitudes: &[Amplitude { per_day: 4.0, per_k: 4.0 }],
        paper: "off",
        source: "bench",
    };
}

impl WiringEffect for AxisSwap {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), gyro: Gyro, counts: &mut [f64; 4]) {
        if let Some(other) = named_gyro(self.with) {
            counts.swap(gyro as usize, other as usize);
        }
    }
}
