//! The last increment is repeated.

use geu_protocol::Gyro;

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
    fn apply(&self, state: &mut f64, gyro: Gyro, counts: &mut [f64; 4]) {
        if self.on >= 0.5 {
            counts[gyro as usize] = *state;
        }
        *state = counts[gyro as usize];
    }
}
