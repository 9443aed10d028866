//! Two gyros are exchanged.

use super::WiringEffect;

effect! {
    /// The counts of two gyros stand in each other's place.
    pub struct AxisSwap ("axis-swap", "axis swap") {
        /// The other gyro. Named at one of the two: at both, they are exchanged twice.
        with: 0.0, 0.0..=8.0, "", Gyro;
    }
    amplitudes: [{ per_day: 8.0, per_k: 8.0 }],
    paper: "off",
    source: "bench",
}

impl WiringEffect for AxisSwap {
    type State = ();

    #[inline]
    fn apply(&self, _state: &mut (), gyro: usize, counts: &mut [f64]) {
        if let Some(other) = (self.with as usize).checked_sub(1).filter(|other| *other < counts.len()) {
            counts.swap(gyro, other);
        }
    }
}
