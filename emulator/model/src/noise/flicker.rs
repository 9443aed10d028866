//! Flicker of a rate: a sum of first-order Gauss–Markov processes.
//!
//! Flicker B has the spectrum B²/(πf), one-sided, and the Allan deviation B·√(2 ln 2/π) = 0.664 B at any time. First-order
//! Gauss–Markov processes of variance s² with correlation times spaced by a factor q have together the spectrum
//! s²/(f ln q), so s = B·√(ln q/π). With one a decade, and one beyond each end, the Allan deviation is flat from 10 s to
//! 10⁴ s within 2.5 %.

use super::{GaussMarkov, NoiseStream};

/// Correlation times of the processes.
pub const CORRELATION_TIMES_S: [f64; 6] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5];
/// Deviation of each process of a flicker of 1: √(ln 10/π).
pub const SIGMA: f64 = 0.856_116_580_191_873_1;
/// Allan deviation of a flicker of 1: √(2 ln 2/π).
pub const FLICKER_FLOOR: f64 = 0.664_282_470_267_960_1;

/// The processes of a flicker of 1.
#[derive(Debug, Clone)]
pub struct Flicker([GaussMarkov; CORRELATION_TIMES_S.len()]);

impl Flicker {
    /// In its stationary state.
    pub fn stationary(stream: &mut NoiseStream) -> Flicker {
        Flicker(CORRELATION_TIMES_S.map(|_| GaussMarkov(SIGMA * stream.standard_normal())))
    }

    /// The mean over the next interval.
    pub fn advance(&mut self, length_s: f64, stream: &mut NoiseStream) -> f64 {
        let advance = |(process, time_s): (&mut GaussMarkov, f64)| {
            process.advance(SIGMA * (2.0 / time_s).sqrt(), time_s, length_s, stream)
        };
        self.0.iter_mut().zip(CORRELATION_TIMES_S).map(advance).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_allan_deviation_is_flat_from_10_s_to_10_000_s() {
        let floor = (2.0 * 2f64.ln() / std::f64::consts::PI).sqrt();
        assert!((floor - FLICKER_FLOOR).abs() < 1e-15);
        // Of a process of variance 1 and correlation time 1, over x.
        let of_process = |x: f64| 2.0 / x * (1.0 - (3.0 - 4.0 * (-x).exp() + (-2.0 * x).exp()) / (2.0 * x));
        for step in 0..=60 {
            let tau_s = 10f64.powf(1.0 + f64::from(step) / 20.0);
            let variance: f64 =
                CORRELATION_TIMES_S.iter().map(|time_s| SIGMA * SIGMA * of_process(tau_s / time_s)).sum();
            let relative = variance.sqrt() / floor;
            assert!((relative - 1.0).abs() < 0.025, "{tau_s} s: {relative}");
        }
    }
}
