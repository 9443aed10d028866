//! Errors of a sum of counts: the random walks of angle and drift rate between two instants, and error sources with a
//! variance, which rows may share.

use std::hash::{DefaultHasher, Hash, Hasher};

use geu_model::Configuration;
use geu_model::configuration::GyroConfiguration;
use geu_model::device::MAX_HEADS;

/// Variance of one rounding of an accumulated angle, count²: uniform over a count.
pub const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;

/// Configured random walks of one gyro (table 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RandomWalks {
    /// Angle random walk, arcsec/√s.
    pub angle_arcsec_per_sqrt_s: f64,
    /// Drift random walk, arcsec/s/√s.
    pub drift_arcsec_per_s_per_sqrt_s: f64,
    /// Correlation time of the drift random walk, s; infinite for a pure walk.
    pub correlation_time_s: f64,
}

impl From<&GyroConfiguration> for RandomWalks {
    fn from(gyro: &GyroConfiguration) -> RandomWalks {
        let effects = &gyro.effects.constant;
        RandomWalks {
            angle_arcsec_per_sqrt_s: effects.angle_random_walk.arcsec_per_sqrt_s,
            drift_arcsec_per_s_per_sqrt_s: effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
            correlation_time_s: effects.drift_random_walk.correlation_time_s,
        }
    }
}

impl RandomWalks {
    /// Configured walks of the default unit.
    pub fn configured(configuration: &Configuration) -> [RandomWalks; 4] {
        std::array::from_fn(|gyro| RandomWalks::from(&configuration.gyros[gyro]))
    }

    /// Covariance of the angle that the angle walk gains over two intervals, arcsec².
    pub fn angle_covariance(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        let together_s = (a.1.min(b.1) - a.0.max(b.0)).max(0.0);
        self.angle_arcsec_per_sqrt_s.powi(2) * together_s
    }

    /// Covariance of the angle that the drift walk gains over two intervals, arcsec²; the walk is 0 at time 0.
    pub fn drift_covariance(&self, a: (f64, f64), b: (f64, f64)) -> f64 {
        let integral = |x: f64, y: f64| self.integral_covariance(x.min(y), x.max(y));
        integral(a.1, b.1) - integral(a.0, b.1) - integral(a.1, b.0) + integral(a.0, b.0)
    }

    /// Standard deviation of the drift walk after a time, arcsec/s; it is 0 at time 0.
    pub fn drift_sigma_arcsec_s(&self, t_s: f64) -> f64 {
        let tau = self.correlation_time_s;
        let effective_s = if t_s < 1e-6 * tau { t_s } else { -tau / 2.0 * libm::expm1(-2.0 * t_s / tau) };
        self.drift_arcsec_per_s_per_sqrt_s * effective_s.sqrt()
    }

    /// Covariance of the walk's integrals up to x and up to y, x ≤ y: ∫₀ˣ∫₀ʸ of its covariance function, which is
    /// σ² min(s, t) for the pure walk and σ²τ/2 (e^(−|t−s|/τ) − e^(−(s+t)/τ)) with a correlation time.
    fn integral_covariance(&self, x: f64, y: f64) -> f64 {
        let variance = self.drift_arcsec_per_s_per_sqrt_s.powi(2);
        let tau = self.correlation_time_s;
        // Below a thousandth of τ the two agree to that, and the second would cancel.
        if y < 1e-3 * tau {
            return variance * x * x * (3.0 * y - x) / 6.0;
        }
        let gone = |t: f64| -libm::expm1(-t / tau);
        let stationary = tau * (2.0 * x - tau * gone(x) - tau * (gone(y) - gone(y - x)));
        variance * tau / 2.0 * (stationary - tau * tau * gone(x) * gone(y))
    }
}

/// The origin of an error; rows with the same source share it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ErrorSource {
    /// Rounding of a gyro's accumulated angle at a node.
    Rounding { gyro: usize, node: usize },
    /// The reference attitude about an axis at a node.
    Reference { axis: usize, node: usize },
    /// The limit cycle about an axis at an instant, in µs.
    LimitCycle { axis: usize, at_us: i64 },
    /// The turn of a row of the reference about an axis.
    Turn { axis: usize, row: usize },
    /// A star crossing a slit at an instant, in µs: its random error of ψ (0) or θ (1).
    SlitCrossing {
        at_us: i64,
        /// The [`source_id`] of the slit.
        slit: u64,
        angle: usize,
    },
    /// Systematic error of a slit or a star.
    Systematic {
        /// The [`source_id`] of the slit or star.
        name: u64,
        angle: usize,
    },
    /// The level of θ over a manoeuvre that starts at an instant, in µs.
    Level { at_us: i64 },
    /// Error of the known clearance of a gyro's pivots.
    Clearance { gyro: usize },
}

/// The identifier of a named source; the same in every run.
pub fn source_id(kind: &str, name: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    (kind, name).hash(&mut hasher);
    hasher.finish()
}

/// An error of one manoeuvre's sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorTerm {
    pub source: ErrorSource,
    pub variance: f64,
    /// Counts of each gyro per unit of the error.
    pub counts: [f64; MAX_HEADS],
    /// Rotation about the control axes per unit of the error, arcsec.
    pub rotation_control_arcsec: [f64; 3],
}

impl ErrorTerm {
    /// An error of one gyro's counts.
    pub(crate) fn of_count(source: ErrorSource, variance: f64, gyro: usize, count: f64) -> ErrorTerm {
        let mut counts = [0.0; MAX_HEADS];
        counts[gyro] = count;
        ErrorTerm { source, variance, counts, rotation_control_arcsec: [0.0; 3] }
    }

    /// An error of the rotation about the control axes.
    pub(crate) fn of_rotation(source: ErrorSource, variance: f64, rotation_control_arcsec: [f64; 3]) -> ErrorTerm {
        ErrorTerm { source, variance, counts: [0.0; MAX_HEADS], rotation_control_arcsec }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_sums(walks: &RandomWalks, a: (f64, f64), b: (f64, f64)) -> f64 {
        let (variance, tau) = (walks.drift_arcsec_per_s_per_sqrt_s.powi(2), walks.correlation_time_s);
        let points = 400;
        let at =
            |(from, to): (f64, f64), index: usize| from + (to - from) * (index as f64 + 0.5) / f64::from(points as u16);
        let mut sum = 0.0;
        for i in 0..points {
            for j in 0..points {
                let (s, t) = (at(a, i), at(b, j));
                sum += if tau.is_finite() {
                    tau / 2.0 * ((-(t - s).abs() / tau).exp() - (-(s + t) / tau).exp())
                } else {
                    s.min(t)
                };
            }
        }
        variance * sum * (a.1 - a.0) * (b.1 - b.0) / (points * points) as f64
    }

    #[test]
    fn covariances_of_the_drift_walk_are_those_of_its_double_integral() {
        for correlation_time_s in [f64::INFINITY, 10_000.0, 500.0] {
            let walks =
                RandomWalks { angle_arcsec_per_sqrt_s: 0.0, drift_arcsec_per_s_per_sqrt_s: 8e-6, correlation_time_s };
            for (a, b) in
                [((0.0, 600.0), (0.0, 600.0)), ((100.0, 700.0), (6000.0, 12_000.0)), ((10.0, 900.0), (500.0, 600.0))]
            {
                let (closed, summed) = (walks.drift_covariance(a, b), by_sums(&walks, a, b));
                assert!((closed / summed - 1.0).abs() < 1e-3, "{correlation_time_s} {a:?} {b:?}: {closed} {summed}");
                assert!((closed - walks.drift_covariance(b, a)).abs() <= 1e-9 * closed);
            }
            // The average over a second is close to the value.
            let second = (4000.0, 4001.0);
            let ratio = walks.drift_sigma_arcsec_s(4000.5) / walks.drift_covariance(second, second).sqrt();
            assert!((ratio - 1.0).abs() < 1e-3, "{correlation_time_s}: {ratio}");
        }
    }
}
