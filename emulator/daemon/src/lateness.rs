//! Lateness as a histogram of logarithmic buckets, eight per octave, for percentiles accurate to 9 %.

use std::fmt;
use std::sync::{Mutex, MutexGuard};

use crate::host;

/// Binary logarithm of the buckets per octave.
const SUB_BITS: u32 = 3;
const BUCKETS: usize = (64 - SUB_BITS as usize + 1) << SUB_BITS;

/// A histogram of times, ns.
#[derive(Clone)]
pub struct Histogram {
    buckets: Box<[u32; BUCKETS]>,
    count: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Histogram {
        Histogram { buckets: Box::new([0; BUCKETS]), count: 0, max_ns: 0 }
    }
}

fn bucket(ns: u64) -> usize {
    let octave = (64 - ns.leading_zeros()).saturating_sub(SUB_BITS + 1);
    ((octave as usize) << SUB_BITS) + (ns >> octave) as usize
}

/// The largest time in a bucket, ns.
fn upper_ns(index: usize) -> u64 {
    let octave = (index >> SUB_BITS).saturating_sub(1) as u32;
    let mantissa = index as u64 - (u64::from(octave) << SUB_BITS);
    (u128::from(mantissa + 1) << octave).saturating_sub(1).min(u64::MAX.into()) as u64
}

impl Histogram {
    /// Adds a time; a negative one counts as 0.
    pub fn record(&mut self, ns: i64) {
        let ns = ns.max(0) as u64;
        self.buckets[bucket(ns)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// Number of times.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The largest, ns.
    pub fn max_ns(&self) -> u64 {
        self.max_ns
    }

    /// The time that `share` of all do not exceed, ns; 0 without times.
    pub fn percentile_ns(&self, share: f64) -> u64 {
        let wanted = ((share * self.count as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (index, &count) in self.buckets.iter().enumerate() {
            seen += u64::from(count);
            if seen >= wanted {
                return upper_ns(index).min(self.max_ns);
            }
        }
        0
    }
}

/// `p50 61 µs  p90 … p99 … p99.9 … max …`.
impl fmt::Display for Histogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, share) in [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p99.9", 0.999)] {
            write!(f, "{name} {}  ", DurationNs(self.percentile_ns(share)))?;
        }
        write!(f, "max {}", DurationNs(self.max_ns))
    }
}

/// A short duration, ns, printed with a suitable unit.
#[derive(Debug, Clone, Copy)]
pub struct DurationNs(pub u64);

impl fmt::Display for DurationNs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ns = self.0 as f64;
        match self.0 {
            0..10_000 => write!(f, "{:.2} µs", ns / 1e3),
            10_000..1_000_000 => write!(f, "{:.0} µs", ns / 1e3),
            1_000_000..1_000_000_000 => write!(f, "{:.2} ms", ns / 1e6),
            _ => write!(f, "{:.2} s", ns / 1e9),
        }
    }
}

/// Limit of lateness: the constant delay that the interface control document permits.
const LATE_NS: i64 = 5_000_000;

/// Lateness of a run, shared by its threads.
#[derive(Default)]
pub(crate) struct CadenceMonitor(Mutex<CadenceCounts>);

/// Number of samples that were late or not sent, and the lateness of samples with a deadline.
#[derive(Default, Clone)]
pub(crate) struct CadenceCounts {
    pub late: u64,
    pub missed: u64,
    pub lateness: Histogram,
}

impl CadenceMonitor {
    pub fn counts(&self) -> CadenceCounts {
        self.lock().clone()
    }

    /// Counts a sample that was sent.
    pub fn record(&self, late_ns: i64) {
        let mut counts = self.lock();
        counts.lateness.record(late_ns);
        counts.late += u64::from(late_ns > LATE_NS);
    }

    /// Counts samples that were not sent.
    pub fn record_missed(&self, missed: u64) {
        self.lock().missed += missed;
    }

    fn lock(&self) -> MutexGuard<'_, CadenceCounts> {
        host::lock(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_time_is_in_a_bucket_of_one_eighth_of_its_value() {
        let mut ns = 1u64;
        while ns < u64::MAX / 2 {
            for near in [ns - 1, ns, ns + 1] {
                let upper = upper_ns(bucket(near));
                assert!(upper >= near && upper as f64 <= near as f64 * 1.125, "{near} {upper}");
                assert!(bucket(near) == 0 || upper_ns(bucket(near) - 1) < near);
            }
            ns += ns / 8 + 1;
        }
        assert!(bucket(u64::MAX) < BUCKETS);
    }

    #[test]
    fn percentiles_follow_the_recorded_times() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.percentile_ns(0.5), 0);
        (1..=1000).for_each(|us| histogram.record(us * 1000));
        let median = histogram.percentile_ns(0.5);
        assert!((500_000..570_000).contains(&median), "{median}");
        assert_eq!(histogram.percentile_ns(1.0), 1_000_000);
        histogram.record(-5);
        assert_eq!((histogram.count(), histogram.max_ns()), (1001, 1_000_000));
    }
}
