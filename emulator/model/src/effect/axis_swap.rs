//! Two gyros are exchanged.

use geu_protocol::Gyro;

use super::WiringEffect;
use crate::parameter_spec::named_gyro;

effect! {
    /// The counts of two gyros stand in each other's place.
    pub struct AxisSwap ("axis-swap", "axis swap") {
        /// The other gyro. Named at one of the two: at both, they are exchanged twice.
        with: 0.0, 0.0..=4.0, "", Gyro;
    }
    amplitudes: [{ per_day: 4.0, per_k: 4.0 }],
    paper: "off",
    source: "bench",
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
