//! Intervals between the receive times of neighbouring samples.

/// Width of a bin of the histogram, ns.
const BIN_NS: i64 = 1_000;
const BINS: usize = 1_000_000;

/// Statistics of intervals, in flat memory: the median is exact to a microsecond below one second.
#[derive(Debug, Clone, Default)]
pub struct IntervalStatistics {
    bins: Vec<u32>,
    below: u64,
    count: u64,
    min_ns: i64,
    max_ns: i64,
    mean_ns: f64,
    /// Sum of squares about the mean.
    squares: f64,
}

impl IntervalStatistics {
    #[inline]
    pub fn add(&mut self, interval_ns: i64) {
        if self.count == 0 {
            self.bins = vec![0; BINS];
            (self.min_ns, self.max_ns) = (interval_ns, interval_ns);
        }
        self.count += 1;
        self.min_ns = self.min_ns.min(interval_ns);
        self.max_ns = self.max_ns.max(interval_ns);
        let deviation = interval_ns as f64 - self.mean_ns;
        self.mean_ns += deviation / self.count as f64;
        self.squares += deviation * (interval_ns as f64 - self.mean_ns);
        match usize::try_from(interval_ns / BIN_NS) {
            Ok(bin) if bin < BINS => self.bins[bin] += 1,
            Ok(_) => {}
            Err(_) => self.below += 1,
        }
    }

    pub fn count(&self) -> u64 {
        self.count
    }

    /// Shortest, s.
    pub fn min_s(&self) -> f64 {
        self.min_ns as f64 * 1e-9
    }

    /// Longest, s.
    pub fn max_s(&self) -> f64 {
        self.max_ns as f64 * 1e-9
    }

    /// Standard deviation, s.
    pub fn sigma_s(&self) -> f64 {
        if self.count < 2 { 0.0 } else { (self.squares / (self.count - 1) as f64).sqrt() * 1e-9 }
    }

    /// Median, s; `None` from one second on.
    pub fn median_s(&self) -> Option<f64> {
        let mut left = (self.count.div_ceil(2)).checked_sub(self.below)?;
        for (bin, &count) in self.bins.iter().enumerate() {
            left = left.saturating_sub(count.into());
            if left == 0 {
                return Some(bin as f64 * BIN_NS as f64 * 1e-9);
            }
        }
        None
    }
}
