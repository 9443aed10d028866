//! A rounded value as an interval that contains the angle.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Distance of an edge, in sigmas, from which the tail of the normal distribution is its asymptote.
const FAR: f64 = 25.0;
/// Width of the interval, in sigmas, below which it is a point.
const NARROW: f64 = 1e-4;

/// The likelihood of an interval for a normally distributed value, as a function of the value's mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likelihood {
    /// Logarithm of the probability.
    pub log: f64,
    /// First derivative of the logarithm: the innovation over its variance, if the interval is narrow.
    pub score: f64,
    /// Second derivative with the opposite sign, positive: the inverse of that variance.
    pub information: f64,
}

impl Likelihood {
    /// The likelihood of the interval `centre` ± `half`, for a value of this mean and variance.
    pub fn new(centre: f64, half: f64, mean: f64, variance: f64) -> Likelihood {
        let sigma = variance.sqrt();
        let distance = (centre - mean) / sigma;
        let width = 2.0 * half / sigma;
        if width < NARROW {
            let log = width.ln() - 0.5 * distance * distance - 0.5 * (2.0 * PI).ln();
            return Likelihood { log, score: distance / sigma, information: 1.0 / variance };
        }
        // The interval on the positive side: from the nearer edge to the farther one.
        let (from, to) = (distance.abs() - 0.5 * width, distance.abs() + 0.5 * width);
        let (log, score, curvature) = if from > FAR {
            let hazard = from + 1.0 / from;
            (-0.5 * from * from - (hazard * (2.0 * PI).sqrt()).ln(), hazard, 1.0 - 1.0 / (from * from))
        } else {
            let density = |x: f64| (-0.5 * x * x).exp() / (2.0 * PI).sqrt();
            let beyond = |x: f64| 0.5 * libm::erfc(x * FRAC_1_SQRT_2);
            let probability = beyond(from) - beyond(to);
            let score = (density(from) - density(to)) / probability;
            let moment = (from * density(from) - to * density(to)) / probability;
            (probability.ln(), score, (score * score - moment).clamp(0.0, 1.0))
        };
        Likelihood { log, score: score.copysign(distance) / sigma, information: curvature / variance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_logarithm_near_and_far() {
        for (mean, variance) in
            [(0.1, 0.01), (0.48, 1e-3), (-3.0, 0.02), (0.7, 1e-4), (40.0, 2.0), (0.3, 50.0), (-1.0, 1e9)]
        {
            let at = |mean: f64| Likelihood::new(0.0, 0.5, mean, variance);
            let step = 1e-3 * f64::sqrt(variance);
            let (below, here, above) = (at(mean - step), at(mean), at(mean + step));
            let score = (above.log - below.log) / (2.0 * step);
            let information = (below.score - above.score) / (2.0 * step);
            let scale = 1.0 / f64::sqrt(variance);
            assert!((here.score - score).abs() < 2e-3 * (scale + score.abs()), "{mean} {variance}: {here:?}, {score}");
            assert!(
                (here.information - information).abs() < 5e-3 * scale * scale,
                "{mean} {variance}: {here:?}, {information}"
            );
        }
    }

    #[test]
    fn any_distance_gives_finite_values() {
        for exponent in 0..300 {
            let far = Likelihood::new(10.0_f64.powi(exponent / 2), 0.5, 0.0, 1e-4);
            assert!(far.score.is_finite() && far.information >= 0.0 && !far.log.is_nan(), "{exponent}: {far:?}");
        }
    }
}
