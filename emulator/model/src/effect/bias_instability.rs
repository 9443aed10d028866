//! Flicker of the drift: bias instability (IEEE Std 528; Allan deviation as in IEEE Std 952, annex).
//!
//! Flicker B has the spectrum B²/(πf), one-sided, and the Allan deviation B·√(2 ln 2/π) = 0.664 B at any time. First-order
//! Gauss–Markov processes of variance s² with correlation times spaced by a factor q have together the spectrum
//! s²/(f ln q), so s = B·√(ln q/π). With one a decade, and one beyond each end, the Allan deviation is flat from 10 s to
//! 10⁴ s within 2.5 %.

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep, Temperatures};
use crate::noise::{GaussMarkov, NoiseStream};

/// Correlation times of the processes.
const CORRELATION_TIMES_S: [f64; 6] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5];
/// Deviation of each process of a flicker of 1: √(ln 10/π).
const SIGMA: f64 = 0.856_116_580_191_873_1;

effect! {
    /// Flicker of the drift rate.
    pub struct BiasInstability ("bias-instability", "bias instability") {
        /// Flicker of the drift; the Allan deviation is 0.664 times this from 10 s to 10⁴ s.
        arcsec_per_h: 0.0, 0.0..=3600.0, "arcsec/h";
    }
    amplitudes: [{ per_day: 3600.0, per_k: 3600.0 }],
    paper: "0",
    source: "IEEE Std 528, 952",
    {
        const IS_NOISE: bool = true;
    }
}

/// The processes of a flicker of 1, from the first sample interval with the effect on.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    processes: Option<[GaussMarkov; CORRELATION_TIMES_S.len()]>,
    /// Mean drift over the sample interval now running.
    arcsec_per_s: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), processes: None, arcsec_per_s: 0.0 }
    }
}

impl GyroEffect for BiasInstability {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, _temperatures: &Temperatures, length_s: f64) {
        let State { stream, processes, arcsec_per_s } = state;
        if self.arcsec_per_h == 0.0 && processes.is_none() {
            return;
        }
        // They start in their stationary state.
        let processes =
            processes.get_or_insert_with(|| CORRELATION_TIMES_S.map(|_| GaussMarkov(SIGMA * stream.standard_normal())));
        let advance = |(process, time_s): (&mut GaussMarkov, f64)| {
            process.advance(SIGMA * (2.0 / time_s).sqrt(), time_s, length_s, stream)
        };
        let sum: f64 = processes.iter_mut().zip(CORRELATION_TIMES_S).map(advance).sum();
        *arcsec_per_s = self.arcsec_per_h / 3600.0 * sum;
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += state.arcsec_per_s * surroundings.step.length_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_allan_deviation_is_flat_from_10_s_to_10_000_s() {
        let floor = (2.0 * 2f64.ln() / std::f64::consts::PI).sqrt();
        assert!((floor - 0.664).abs() < 5e-4);
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
