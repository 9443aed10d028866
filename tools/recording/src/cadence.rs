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
    sum_ns: i128,
    /// Sum of squares, modulo 2^128: the sum about the mean is a difference of such sums, and exact below that.
    squares_ns2: i128,
}

impl IntervalStatistics {
    #[inline(always)]
    pub fn add(&mut self, interval_ns: i64) {
        if self.count == 0 {
            self.bins = vec![0; BINS];
            (self.min_ns, self.max_ns) = (interval_ns, interval_ns);
        }
        self.count += 1;
        self.min_ns = self.min_ns.min(interval_ns);
        self.max_ns = self.max_ns.max(interval_ns);
        let wide_ns = i128::from(interval_ns);
        self.sum_ns += wide_ns;
        self.squares_ns2 = self.squares_ns2.wrapping_add(wide_ns * wide_ns);
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
        if self.count < 2 {
            return 0.0;
        }
        let count = i128::from(self.count);
        let (mean_ns, rest_ns) = (self.sum_ns / count, self.sum_ns % count);
        let about_mean_ns2 = self.squares_ns2.wrapping_sub(mean_ns.wrapping_mul(self.sum_ns + rest_ns));
        let squares_ns2 = about_mean_ns2.cast_unsigned() as f64 - (rest_ns * rest_ns) as f64 / count as f64;
        (squares_ns2 / (count - 1) as f64).sqrt() * 1e-9
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
