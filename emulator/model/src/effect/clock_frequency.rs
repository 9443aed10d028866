//! The unit's clock runs fast or slow (Casteren §3.2).
//!
//! Rotor frequency and pulse length both come from it: a clock fast by 1 ppm lowers the scale factor by 1 ppm and D, in
//! arcsec per on-board sample interval, by 2 ppm in all; a sample takes 0.5/(1 + ppm·10⁻⁶) s of true time. The factors
//! are applied in the closing line, [`super::Head::counts`].

use super::{SampleTiming, UnitEffect};
use crate::units::PPM;

effect! {
    /// Clock frequency.
    pub struct ClockFrequency ("clock-frequency", "clock frequency") {
        /// The clock is fast by this.
        ppm: 0.0, -1000.0..=1000.0, "ppm";
    }
    amplitudes: [{ per_day: 1000.0, per_k: 1000.0 }],
    paper: "scale factor -1 ppm and drift -2 ppm per ppm",
    source: "Casteren §3.2",
}

impl UnitEffect for ClockFrequency {
    type State = ();

    #[inline]
    fn timing(&self, timing: &mut SampleTiming) {
        timing.clock_error += self.ppm * PPM;
    }
}
