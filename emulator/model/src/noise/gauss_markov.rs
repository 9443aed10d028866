//! A first-order Gauss–Markov process, or a pure walk, of a rate.
//!
//! Drawn for any length T of the sample interval from the joint distribution of the rate at its end and the rate's integral
//! over it. A walk changes by σ√T·z₁, and its mean by half of that and σ√(T/12)·z₂. With a correlation time τ the rate
//! before counts with exp(−t/τ); x = T/τ, and the three variances become
//!
//! ```text
//! of the rate at the end   σ² τ (1 − e⁻²ˣ)/2
//! of both                  σ² τ² (1 − e⁻ˣ)²/2
//! of the integral          σ² τ³ (x − 2(1 − e⁻ˣ) + (1 − e⁻²ˣ)/2)
//! ```
//!
//! so that the change of the rate enters the integral times τ tanh(x/2), and z₂ with the root of σ²τ³(x − 2 tanh(x/2)). The
//! difference is taken by its series, T³/12·(1 − x²/10), up to x = 0.6, where its relative error is 0.0013, and as it is beyond.

use super::NoiseStream;

/// Largest x of the series.
const SERIES_X: f64 = 0.6;

/// The rate now.
#[derive(Debug, Clone, Copy)]
pub struct GaussMarkov(pub f64);

impl GaussMarkov {
    /// Moves the rate over a sample interval; returns its mean over it. The deviation grows by `density` per √s; an infinite
    /// correlation time is a pure walk.
    #[inline]
    pub fn advance(&mut self, density: f64, correlation_time_s: f64, length_s: f64, stream: &mut NoiseStream) -> f64 {
        let x = length_s / correlation_time_s;
        // (1 − e⁻ˣ)/x, the mean of the decay over the sample interval; 1 of a pure walk.
        let mean_decay = if x == 0.0 { 1.0 } else { -libm::expm1(-x) / x };
        let decay = 1.0 - x * mean_decay;
        let sigma = density * length_s.sqrt();
        let end = sigma * (mean_decay * (1.0 + decay) / 2.0).sqrt() * stream.standard_normal();
        // (x − 2 tanh(x/2))/x³.
        let variance = match x <= SERIES_X {
            true => (1.0 - 0.1 * x * x) / 12.0,
            false => (x - 2.0 * libm::tanh(0.5 * x)) / (x * x * x),
        };
        let between = sigma * variance.sqrt() * stream.standard_normal();
        let before = self.0;
        self.0 = before * decay + end;
        mean_decay * (before + end / (1.0 + decay)) + between
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_protocol::Gyro;

    #[test]
    fn rate_and_angle_of_a_sample_have_the_variances_of_the_process() {
        let count = 40_000;
        for (t_s, tau_s) in [
            (0.5, 1.0),
            (0.5, 5.0),
            (0.5, f64::INFINITY),
            (0.0005, 1.0),
            (0.7, 1.0),
            (3.0, 1.0),
            (10.0, 1.0),
            (1e4f64, 1.0),
        ] {
            let [mut rate, mut both, mut angle] = [0.0; 3];
            for seed in 0..count {
                let (mut process, mut stream) = (GaussMarkov(0.0), NoiseStream::new(seed, Gyro::X, "test"));
                let gained = process.advance(1.0, tau_s, t_s, &mut stream) * t_s;
                let end = process.0;
                rate += end * end / count as f64;
                both += end * gained / count as f64;
                angle += gained * gained / count as f64;
            }
            let x: f64 = t_s / tau_s;
            let (left, left_twice) = ((-x).exp(), (-2.0 * x).exp());
            let expected = if x == 0.0 {
                [t_s, t_s.powi(2) / 2.0, t_s.powi(3) / 3.0]
            } else {
                let angle = x - 2.0 * (1.0 - left) + (1.0 - left_twice) / 2.0;
                [tau_s * (1.0 - left_twice) / 2.0, (tau_s * (1.0 - left)).powi(2) / 2.0, tau_s.powi(3) * angle]
            };
            // Five deviations of variances and a covariance from this number of draws.
            let variances =
                [2.0 * expected[0].powi(2), expected[0] * expected[2] + expected[1].powi(2), 2.0 * expected[2].powi(2)];
            for ((got, expected), variance) in [rate, both, angle].into_iter().zip(expected).zip(variances) {
                assert!(
                    (got - expected).abs() < 5.0 * (variance / count as f64).sqrt(),
                    "{t_s} s of {tau_s} s: {got}, not {expected}"
                );
            }
        }
    }
}
