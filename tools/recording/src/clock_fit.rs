//! The unit's clock against the receiver's: the slope of receive time over clock count.

use geu_protocol::CLOCK_PER_SAMPLE;
use geu_protocol::continuity::clock_follows;

/// Nanoseconds of one cycle of the nominal 1 MHz clock.
const NS_PER_COUNT: i64 = 1_000_000_000 / (2 * CLOCK_PER_SAMPLE as i64);
/// Correlation of neighbouring residuals above which the inflation of sigma is not followed.
const MAX_CORRELATION: f64 = 0.99;

/// Rate of the unit's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockRate {
    /// Parts per million by which it is fast: samples last 0.5/(1+ε) s.
    pub clock_ppm: f64,
    pub sigma_ppm: f64,
    pub residual_s: f64,
    pub correlation: f64,
    pub points: u64,
    /// Segments, each with its own intercept.
    pub segments: u64,
}

/// Linear regression, updated with each row.
///
/// x is the clock count and y the receive time less the count, both in seconds from the first point of the segment; so
/// the slope is the small deviation itself and nothing large cancels.
#[derive(Debug, Clone, Default)]
pub struct ClockFit {
    closed: Moments,
    segment: Option<Segment>,
}

/// Sums about the means of finished segments.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    points: u64,
    segments: u64,
    xx: f64,
    xy: f64,
    yy: f64,
    /// Sums over neighbours: x·x⁺, x·y⁺ + y·x⁺, y·y⁺.
    next_xx: f64,
    next_xy: f64,
    next_yy: f64,
}

/// Plain sums of the running segment.
#[derive(Debug, Clone, Copy)]
struct Segment {
    origin: (i64, u64),
    last_step: (u16, u64),
    last_t_ns: i64,
    first: (f64, f64),
    last: (f64, f64),
    points: u64,
    x: f64,
    y: f64,
    sums: Moments,
}

impl ClockFit {
    /// Takes a row's receive time, sequence and clock count. A clock that restarts or jumps, and a receive time that
    /// runs backwards, begin a segment.
    #[inline(always)]
    pub fn add(&mut self, t_ns: i64, sequence: u16, clock_count: u64) {
        let now = (sequence, clock_count);
        if let Some(segment) = &mut self.segment
            && clock_count > segment.last_step.1
            && t_ns > segment.last_t_ns
            && clock_follows(segment.last_step, now)
        {
            segment.add(t_ns, now);
            return;
        }
        self.close();
        self.segment = Some(Segment::new(t_ns, now));
    }

    fn close(&mut self) {
        if let Some(segment) = self.segment.take() {
            self.closed = self.closed.with(&segment);
        }
    }

    /// The rate; nothing with fewer points than a line and its scatter need.
    pub fn rate(&self) -> Option<ClockRate> {
        let m = self.segment.as_ref().map_or(self.closed, |segment| self.closed.with(segment));
        let freedom = m.points.checked_sub(m.segments + 1).filter(|&freedom| freedom > 0)? as f64;
        if m.xx <= 0.0 {
            return None;
        }
        let slope = m.xy / m.xx;
        let squares = (m.yy - slope * m.xy).max(0.0);
        let neighbours = m.next_yy - slope * m.next_xy + slope * slope * m.next_xx;
        let correlation = if squares > 0.0 { (neighbours / squares).clamp(-1.0, 1.0) } else { 0.0 };
        let inflation = correlation.clamp(0.0, MAX_CORRELATION);
        let variance = squares / freedom / m.xx * (1.0 + inflation) / (1.0 - inflation);
        Some(ClockRate {
            clock_ppm: (1.0 / (1.0 + slope) - 1.0) * 1e6,
            sigma_ppm: variance.sqrt() * 1e6,
            residual_s: (squares / freedom).sqrt(),
            correlation,
            points: m.points,
            segments: m.segments,
        })
    }
}

impl Segment {
    fn new(t_ns: i64, now: (u16, u64)) -> Segment {
        Segment {
            origin: (t_ns, now.1),
            last_step: now,
            last_t_ns: t_ns,
            first: (0.0, 0.0),
            last: (0.0, 0.0),
            points: 1,
            x: 0.0,
            y: 0.0,
            sums: Moments::default(),
        }
    }

    #[inline(always)]
    fn add(&mut self, t_ns: i64, now: (u16, u64)) {
        let elapsed_ns = (now.1 - self.origin.1) as i64 * NS_PER_COUNT;
        let (x, y) = (elapsed_ns as f64 * 1e-9, (t_ns.wrapping_sub(self.origin.0) - elapsed_ns) as f64 * 1e-9);
        let (last_x, last_y) = self.last;
        self.points += 1;
        self.x += x;
        self.y += y;
        let sums = &mut self.sums;
        sums.xx += x * x;
        sums.xy += x * y;
        sums.yy += y * y;
        sums.next_xx += last_x * x;
        sums.next_xy += last_x * y + last_y * x;
        sums.next_yy += last_y * y;
        (self.last, self.last_step, self.last_t_ns) = ((x, y), now, t_ns);
    }
}

impl Moments {
    fn with(self, segment: &Segment) -> Moments {
        let n = segment.points as f64;
        let (mean_x, mean_y) = (segment.x / n, segment.y / n);
        // Each point but the ends is a neighbour twice.
        let pairs = n - 1.0;
        let (twice_x, twice_y) =
            (2.0 * segment.x - segment.first.0 - segment.last.0, 2.0 * segment.y - segment.first.1 - segment.last.1);
        let s = &segment.sums;
        Moments {
            points: self.points + segment.points,
            segments: self.segments + 1,
            xx: self.xx + s.xx - n * mean_x * mean_x,
            xy: self.xy + s.xy - n * mean_x * mean_y,
            yy: self.yy + s.yy - n * mean_y * mean_y,
            next_xx: self.next_xx + s.next_xx - mean_x * twice_x + pairs * mean_x * mean_x,
            next_xy: self.next_xy + s.next_xy - mean_x * twice_y - mean_y * twice_x + 2.0 * pairs * mean_x * mean_y,
            next_yy: self.next_yy + s.next_yy - mean_y * twice_y + pairs * mean_y * mean_y,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Receive times of a clock fast by 14 ppm with a residual of ±100 µs that repeats each ten samples.
    fn fit(segments: u64, points: u64) -> ClockRate {
        let mut fit = ClockFit::default();
        for index in 0..segments * points {
            let (segment, at) = (index / points, index % points);
            let t_s = segment as f64 * 7.3 + index as f64 * 0.5 / (1.0 + 14e-6);
            let jitter_s = 1e-4 * (at as f64 * 0.7).sin();
            let t_ns = 1_795_020_000_000_000_000 + ((t_s + jitter_s) * 1e9).round() as i64;
            fit.add(t_ns, at as u16, (at + 1) * CLOCK_PER_SAMPLE);
        }
        fit.rate().unwrap()
    }

    #[test]
    fn the_rate_is_that_of_the_clock_with_each_restart_on_its_own() {
        for (segments, points) in [(1, 2_000), (4, 500)] {
            let rate = fit(segments, points);
            assert!((rate.clock_ppm - 14.0).abs() < 3.0 * rate.sigma_ppm, "{rate:?}");
            assert_eq!((rate.segments, rate.points), (segments, segments * points));
        }
        // A sine of amplitude a has the standard deviation a/√2, and steps of 0.7 rad a correlation of cos 0.7 = 0.765.
        let rate = fit(1, 2_000);
        assert!(
            (rate.residual_s - 1e-4 / 2f64.sqrt()).abs() < 1e-7 && (rate.correlation - 0.765).abs() < 0.001,
            "{rate:?}"
        );
        // σ² / Σ(x − x̄)², with Σ = n(n² − 1)/12 · 0.25 s², inflated by (1 + ρ)/(1 − ρ).
        let n = 2_000f64;
        let sigma_ppm = rate.residual_s / (n * (n * n - 1.0) / 48.0).sqrt() * (1.765f64 / 0.235).sqrt() * 1e6;
        assert!((rate.sigma_ppm / sigma_ppm - 1.0).abs() < 0.01, "{rate:?} {sigma_ppm}");
    }

    #[test]
    fn two_points_are_no_measurement() {
        let mut fit = ClockFit::default();
        fit.add(0, 0, 500_000);
        fit.add(500_000_000, 1, 1_000_000);
        assert_eq!(fit.rate(), None);
    }
}
