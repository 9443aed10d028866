//! Estimators over accumulated counts, each with its sigma.
//!
//! Angles are in units of the quantum: rounding adds a uniform error of variance 1/12 to each. That error is not white
//! where the angle moves slowly, so the sigma of a fit has two parts, in squares: that of white rounding, and that of the
//! sums of the fit's residuals over intervals, which keeps the correlation of neighbours.

use nalgebra::{SMatrix, SVector};

/// Variance of a rounding to whole numbers.
pub const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;
/// Intervals over which the residuals of a fit are summed.
const INTERVALS: usize = 24;

/// A number with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    pub value: f64,
    pub sigma: f64,
}

impl Estimate {
    pub fn new(value: f64, sigma: f64) -> Estimate {
        Estimate { value, sigma }
    }

    #[must_use]
    pub fn times(self, factor: f64) -> Estimate {
        Estimate { value: self.value * factor, sigma: self.sigma * factor.abs() }
    }

    #[must_use]
    pub fn minus(self, other: Estimate) -> Estimate {
        Estimate { value: self.value - other.value, sigma: self.sigma.hypot(other.sigma) }
    }

    #[must_use]
    pub fn over(self, other: Estimate) -> Estimate {
        let value = self.value / other.value;
        Estimate { value, sigma: (self.sigma / other.value).hypot(value * other.sigma / other.value) }
    }

    /// `whole` divided by the estimate, with the same relative error.
    #[must_use]
    pub fn relative_to(self, whole: f64) -> Estimate {
        let value = whole / self.value;
        Estimate { value, sigma: (value * self.sigma / self.value).abs() }
    }
}

/// Least squares of y on P regressors.
pub struct Fit<const P: usize> {
    values: [f64; P],
    variances: [f64; P],
}

impl<const P: usize> Fit<P> {
    /// Fits points (regressors, y), y in quanta.
    pub fn new(points: &[([f64; P], f64)]) -> Fit<P> {
        // Columns are scaled to their largest element, so that powers of time do not spoil the elimination.
        let mut scale = [f64::MIN_POSITIVE; P];
        for (x, _) in points {
            for (scale, x) in scale.iter_mut().zip(x) {
                *scale = scale.max(x.abs());
            }
        }
        let scaled = |x: &[f64; P]| SVector::<f64, P>::from_fn(|i, _| x[i] / scale[i]);
        let (mut normal, mut right) = (SMatrix::<f64, P, P>::zeros(), SVector::<f64, P>::zeros());
        for (x, y) in points {
            let x = scaled(x);
            right += x * *y;
            normal += x * x.transpose();
        }
        let inverse = normal.try_inverse().unwrap_or_else(|| SMatrix::repeat(f64::NAN));
        let values = inverse * right;
        let mut variances = inverse.diagonal() * ROUNDING_VARIANCE;
        for points in points.chunks(points.len().div_ceil(INTERVALS).max(1)) {
            let mut score = SVector::<f64, P>::zeros();
            for (x, y) in points {
                let x = scaled(x);
                score += x * (y - x.dot(&values));
            }
            variances += (inverse * score).map(|part| part * part);
        }
        Fit {
            values: std::array::from_fn(|i| values[i] / scale[i]),
            variances: std::array::from_fn(|i| variances[i] / (scale[i] * scale[i])),
        }
    }

    pub fn estimate(&self, index: usize) -> Estimate {
        Estimate { value: self.values[index], sigma: self.variances[index].sqrt() }
    }
}

pub struct LineFit {
    /// The middle of the points, x of `level`.
    pub centre: f64,
    pub level: Estimate,
    pub slope: Estimate,
}

impl LineFit {
    /// Fits points (x, y), y in quanta.
    pub fn new(points: impl Iterator<Item = (f64, f64)> + Clone) -> LineFit {
        let (count, sum) = points.clone().fold((0.0, 0.0), |(count, sum), (x, _)| (count + 1.0, sum + x));
        let centre = sum / count;
        let points: Vec<_> = points.map(|(x, y)| ([1.0, x - centre], y)).collect();
        let fit = Fit::new(&points);
        LineFit { centre, level: fit.estimate(0), slope: fit.estimate(1) }
    }

    pub fn reaches(&self, level: Estimate) -> Estimate {
        let from_centre = level.minus(self.level).over(self.slope);
        Estimate { value: self.centre + from_centre.value, ..from_centre }
    }
}

/// Half the second derivative of y(x), from points (x, y).
pub fn curvature(points: impl Iterator<Item = (f64, f64)>) -> Estimate {
    Fit::new(&points.map(|(x, y)| ([1.0, x, x * x], y)).collect::<Vec<_>>()).estimate(2)
}

/// Amplitude of an oscillation from its two parts.
pub fn amplitude_of(sin: Estimate, cos: Estimate) -> Estimate {
    Estimate::new(sin.value.hypot(cos.value), sin.sigma.max(cos.sigma))
}

pub fn level(levels: impl Iterator<Item = f64>) -> Estimate {
    Fit::new(&levels.map(|y| ([1.0], y)).collect::<Vec<_>>()).estimate(0)
}

/// First-order settling y = level − drop · exp(−x/time constant): (level, drop, time constant), by Gauss-Newton from a
/// first time constant.
pub fn settling(points: &[(f64, f64)], first: f64) -> [Estimate; 3] {
    let (mut time_constant, mut drop) = (first, 0.0);
    let mut fit = Fit { values: [0.0; 3], variances: [0.0; 3] };
    for _ in 0..12 {
        // The time constant's column is that of the first guess until there is a drop.
        let size: f64 = if drop == 0.0 { 1.0 } else { drop };
        let rows: Vec<_> = points
            .iter()
            .map(|&(x, y)| {
                let left = libm::exp(-x / time_constant);
                ([1.0, -left, -size * left * x / (time_constant * time_constant)], y)
            })
            .collect();
        fit = Fit::new(&rows);
        let step = fit.values[2] * size / fit.values[1];
        drop = fit.values[1];
        time_constant += step.clamp(-0.5 * time_constant, time_constant);
    }
    let [level, drop] = [0, 1].map(|index| fit.estimate(index));
    [level, drop, Estimate { value: time_constant, sigma: fit.estimate(2).sigma }]
}

/// Overlapping Allan variance of phases at intervals of `spacing`, over `m` intervals.
pub fn allan_variance(phase: &[f64], spacing: f64, m: usize) -> f64 {
    let tau = spacing * m as f64;
    let differences = phase.windows(2 * m + 1).map(|window| window[2 * m] - 2.0 * window[m] + window[0]);
    let count = phase.len() - 2 * m;
    differences.map(|difference| difference * difference).sum::<f64>() / (2.0 * tau * tau * count as f64)
}

/// Degrees of freedom of an overlapping Allan variance of white rate noise (Riley, NIST SP 1065, table 5).
pub fn freedom_of_white_rate(count: usize, m: usize) -> f64 {
    let (n, m) = (count as f64, m as f64);
    (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0)
}

/// Degrees of freedom of an overlapping Allan variance of a walking rate (Riley, NIST SP 1065, table 5).
pub fn freedom_of_walking_rate(count: usize, m: usize) -> f64 {
    let (n, m) = (count as f64, m as f64);
    (n - 2.0) / m * ((n - 1.0).powi(2) - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0).powi(2)
}

/// Degrees of freedom of an overlapping Allan variance of a flickering rate over two or more intervals (Riley, NIST SP 1065,
/// table 5).
pub fn freedom_of_flicker_rate(count: usize, m: usize) -> f64 {
    let (n, m) = (count as f64, m as f64);
    5.0 * n * n / (4.0 * m * (n + 3.0 * m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rounded_line_is_found_within_its_sigma() {
        for rate in [0.013, 0.37, 104.854_368] {
            let line = LineFit::new((0..5000).map(|k| (f64::from(k), (rate * f64::from(k)).round())));
            assert!((line.slope.value - rate).abs() < 5.0 * line.slope.sigma, "{rate}: {:?}", line.slope);
            assert!(line.slope.sigma < 1e-4);
        }
    }

    #[test]
    fn settling_is_found_from_a_poor_guess() {
        let points: Vec<_> =
            (0..4000).map(|k| (f64::from(k), (900.0 - 500.0 * (-f64::from(k) / 310.0).exp()).round())).collect();
        let [level, drop, time_constant] = settling(&points, 150.0);
        for (got, expected) in [(level, 900.0), (drop, 500.0), (time_constant, 310.0)] {
            assert!((got.value - expected).abs() < 5.0 * got.sigma + 1e-9, "{got:?} {expected}");
        }
    }
}
