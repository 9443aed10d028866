//! The count is negated.

use super::WiringEffect;

effect! {
    /// The count is negated.
    pub struct SignInversion ("sign-inversion", "sign inversion") {
        /// Whether it does.
        on: 0.0, 0.0..=1.0, "", Flag;
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "off",
    source: "bench",
}

impl WiringEffect for SignInversion {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), gyro: usize, counts: &mut [f64]) {
        if self.on >= 0.5 {
            counts[gyro] = -counts[gyro];
        }
    }
}
