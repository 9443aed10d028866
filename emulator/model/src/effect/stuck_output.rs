//! The last increment is repeated.

use super::WiringEffect;

effect! {
    /// The last increment is repeated.
    pub struct StuckOutput ("stuck-output", "stuck output") {
        /// Whether it does.
        on: 0.0, 0.0..=1.0, "", Flag;
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "off",
    source: "bench",
}

impl WiringEffect for StuckOutput {
    type State = f64;

    #[inline]
    fn apply(&self, state: &mut f64, gyro: usize, counts: &mut [f64]) {
        if self.on >= 0.5 {
            counts[gyro] = *state;
        }
        *state = counts[gyro];
    }
}
