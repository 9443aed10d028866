//! Send times of a recording: by time stamps, or by the unit's clock without time stamps.

use geu_protocol::Sample;
use geu_protocol::field::CLOCK_PER_SAMPLE;

/// Time stamps that step back by less than this are records in another order.
const DISORDER_NS: i64 = 1_000_000_000;
/// Largest time of a recording, which leaves range for sums: a century and a half.
const LATEST_NS: i64 = i64::MAX / 2;
/// Largest number of jumps and gaps that are reported one by one.
const MAX_REPORTED: u64 = 20;

/// Anomalies in the times of a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TimestampAnomalies {
    /// Gaps that were shortened.
    pub gaps: u64,
    /// The longest of them, ns.
    pub longest_ns: i64,
    /// Jumps back in time.
    pub jumps: u64,
}

/// Times of a recording.
#[derive(Debug)]
pub struct ReplayClock {
    /// Time since the start of the recording, ns.
    pub recorded_ns: i64,
    /// Time since the first sent item, with gaps shortened, ns.
    pub played_ns: i64,
    pub anomalies: TimestampAnomalies,
    /// True if `played_ns` advances.
    pub is_playing: bool,
    longest_gap_ns: i64,
    /// The latest time stamp.
    stamp_ns: Option<i64>,
    /// Sample interval of the unit, ns.
    interval_ns: i64,
    /// Sequence and clock count reported last.
    clock: Option<(u16, u64)>,
}

impl ReplayClock {
    pub fn new(interval_ns: i64, longest_gap_ns: i64) -> ReplayClock {
        ReplayClock {
            recorded_ns: 0,
            played_ns: 0,
            anomalies: TimestampAnomalies::default(),
            is_playing: false,
            interval_ns,
            longest_gap_ns,
            stamp_ns: None,
            clock: None,
        }
    }

    /// Starts the recording again.
    pub fn rewind(&mut self) {
        (self.recorded_ns, self.is_playing, self.stamp_ns, self.clock) = (0, false, None, None);
    }

    /// Advances to a time stamp; returns a message on a gap or jump.
    pub fn stamp(&mut self, t_ns: i64) -> Option<String> {
        let before_ns = *self.stamp_ns.get_or_insert(t_ns);
        let step_ns = t_ns.saturating_sub(before_ns);
        if step_ns < 0 && step_ns > -DISORDER_NS {
            return None;
        }
        self.stamp_ns = Some(t_ns);
        if step_ns < 0 {
            self.anomalies.jumps += 1;
            let (at_s, by_s) = (self.recorded_ns as f64 * 1e-9, -step_ns as f64 * 1e-9);
            let is_reported = self.is_playing && self.anomalies.jumps <= MAX_REPORTED;
            return is_reported.then(|| {
                format!("time stamps jump back by {by_s:.3} s, {at_s:.3} s into the recording: sent without a pause")
            });
        }
        self.step(step_ns)
    }

    /// Time since the last sample by the unit's clock, ns.
    pub fn by_clock(&self, sample: &Sample) -> i64 {
        let Some((sequence, clock_count)) = self.clock else { return 0 };
        let steps = sample.sequence.wrapping_sub(sequence);
        match sample.clock_count.checked_sub(clock_count) {
            Some(0) if steps == 0 => 0,
            Some(cycles) if cycles.is_multiple_of(CLOCK_PER_SAMPLE) && (cycles / CLOCK_PER_SAMPLE) as u16 == steps => {
                i64::try_from(cycles / CLOCK_PER_SAMPLE).unwrap_or(i64::MAX).saturating_mul(self.interval_ns)
            }
            // A restart, or an invalid clock.
            _ => self.interval_ns,
        }
    }

    /// Stores sequence and clock of a sample.
    pub fn update(&mut self, sample: &Sample) {
        self.clock = Some((sample.sequence, sample.clock_count));
    }

    /// Advances by `step_ns`; returns a message on a gap.
    pub fn step(&mut self, step_ns: i64) -> Option<String> {
        let before_s = self.recorded_ns as f64 * 1e-9;
        self.recorded_ns = self.recorded_ns.saturating_add(step_ns).min(LATEST_NS);
        if !self.is_playing {
            return None;
        }
        self.played_ns = self.played_ns.saturating_add(step_ns.min(self.longest_gap_ns)).min(LATEST_NS);
        if step_ns <= self.longest_gap_ns {
            return None;
        }
        let anomalies = &mut self.anomalies;
        anomalies.gaps += 1;
        anomalies.longest_ns = anomalies.longest_ns.max(step_ns);
        let (gap_s, longest_s) = (step_ns as f64 * 1e-9, self.longest_gap_ns as f64 * 1e-9);
        (anomalies.gaps <= MAX_REPORTED).then(|| {
            format!("a gap of {gap_s:.3} s, {before_s:.3} s into the recording, is shortened to {longest_s} s")
        })
    }
}

#[cfg(test)]
mod tests {
    use geu_model::units::SAMPLE_INTERVAL_NS;

    use super::*;

    #[test]
    fn time_advances_by_any_time_stamps() {
        let mut clock = ReplayClock::new(SAMPLE_INTERVAL_NS, 10_000_000_000);
        clock.is_playing = true;
        let mut played = |t_s: f64| {
            let reported = clock.stamp((t_s * 1e9) as i64).is_some();
            ((clock.played_ns as f64 * 1e-9).round(), reported)
        };
        assert_eq!(played(1000.0), (0.0, false));
        assert_eq!(played(1002.0), (2.0, false));
        assert_eq!(played(1001.5), (2.0, false), "out of order");
        assert_eq!(played(1003.0), (3.0, false));
        assert_eq!(played(8203.0), (13.0, true), "two hours");
        assert_eq!(played(5.0), (13.0, true), "back");
        assert_eq!(played(6.0), (14.0, false));
        assert_eq!(played(9e9), (24.0, true), "the end of time");
        assert_eq!(clock.anomalies.gaps, 2);
        assert_eq!(clock.anomalies.jumps, 1);
    }

    #[test]
    fn time_stamps_do_not_exceed_the_largest_time() {
        let mut clock = ReplayClock::new(SAMPLE_INTERVAL_NS, i64::MAX);
        clock.is_playing = true;
        for t_s in [0.0, 9.2e9, 0.0, 23_372_036.8, 9.2e9] {
            clock.stamp((t_s * 1e9) as i64);
        }
        assert_eq!((clock.recorded_ns, clock.played_ns), (LATEST_NS, LATEST_NS));
    }

    #[test]
    fn time_advances_by_a_valid_clock() {
        let sample = |sequence: u16, samples: u64| Sample {
            sequence,
            clock_count: samples * CLOCK_PER_SAMPLE,
            ..Sample::default()
        };
        let mut clock = ReplayClock::new(SAMPLE_INTERVAL_NS, i64::MAX);
        let mut step = |sequence, samples| {
            let sample = sample(sequence, samples);
            let step_ns = clock.by_clock(&sample);
            clock.update(&sample);
            step_ns / SAMPLE_INTERVAL_NS
        };
        assert_eq!(step(65_534, 10), 0);
        assert_eq!(step(65_535, 11), 1);
        assert_eq!(step(2, 14), 3);
        assert_eq!(step(2, 14), 0, "polled twice");
        assert_eq!(step(0, 1), 1, "a restart");
        assert_eq!(step(1, 900), 1, "an invalid clock");
        assert_eq!(step(2, 901 + 65_536), 65_537, "more than a turn of the sequence");
    }
}
