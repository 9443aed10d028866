//! Counts are of the motion at another time than their time stamp.

use super::{SampleTiming, UnitEffect};

effect! {
    /// Offset of the unit's time.
    pub struct TimeOffset ("time-offset", "time offset") {
        /// Counts at t tell the motion of t − seconds; negative only where truth is known ahead.
        seconds: 0.0, -0.5..=0.5, "s";
    }
    amplitudes: [{ per_day: 0.5, per_k: 0.5 }],
    paper: "0",
    source: "link",
}

impl UnitEffect for TimeOffset {
    type State = ();

    #[inline]
    fn timing(&self, timing: &mut SampleTiming) {
        timing.shift_s += self.seconds;
    }
}
