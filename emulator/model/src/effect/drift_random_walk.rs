//! Random drift: the drift rate walks (Casteren §3.1, table 1: 3.6″/h over 30 min, taken as 3 sigma).
//!
//! Drawn for any length T of the sample from the joint distribution of the rate at its end and the rate's integral
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
//! difference is taken by its series, T³/12·(1 − x²/10), with a relative error of 0.0006 at the smallest τ, 1 s.

use geu_protocol::Gyro;

use super::{EffectInputs, EffectState, GyroEffect, GyroSubStep};
use crate::noise::NoiseStream;

effect! {
    /// Random walk of the drift rate.
    pub struct DriftRandomWalk ("drift-random-walk", "drift random walk") {
        /// Growth of the drift rate's deviation with the root of time.
        arcsec_per_s_per_sqrt_s: 0.0, 0.0..=1.0, "arcsec/s/√s";
        /// Correlation time; inf is a pure walk, which is right for hours; 10 000 s keeps sigma at 2″/h.
        correlation_time_s: (f64::INFINITY), 1.0..=f64::INFINITY, "s", TimeConstant;
    }
    amplitudes: [{ per_day: 1.0, per_k: 1.0 }],
    paper: "3.6 arcsec/h (3 sigma) over 30 min: 8e-6",
    source: "Casteren §3.1, table 1",
    {
        const IS_NOISE: bool = true;
    }
}

/// Accumulated walk.
#[derive(Debug, Clone)]
pub struct State {
    stream: NoiseStream,
    rate_arcsec_s: f64,
    /// Mean rate over the sample interval now running.
    mean_arcsec_s: f64,
}

impl EffectState for State {
    fn start(seed: u64, gyro: Gyro, code: &str) -> State {
        State { stream: NoiseStream::new(seed, gyro, code), rate_arcsec_s: 0.0, mean_arcsec_s: 0.0 }
    }
}

impl GyroEffect for DriftRandomWalk {
    type State = State;

    #[inline]
    fn begin(&self, state: &mut State, length_s: f64) {
        if self.arcsec_per_s_per_sqrt_s == 0.0 && state.rate_arcsec_s == 0.0 {
            state.mean_arcsec_s = 0.0;
            return;
        }
        let x = length_s / self.correlation_time_s;
        // (1 − e⁻ˣ)/x, the mean of the decay over the sample interval; 1 of a pure walk.
        let mean_decay = if x == 0.0 { 1.0 } else { -libm::expm1(-x) / x };
        let decay = 1.0 - x * mean_decay;
        let sigma = self.arcsec_per_s_per_sqrt_s * length_s.sqrt();
        let end = sigma * (mean_decay * (1.0 + decay) / 2.0).sqrt() * state.stream.standard_normal();
        let between = sigma * ((1.0 - 0.1 * x * x) / 12.0).sqrt() * state.stream.standard_normal();
        let before = state.rate_arcsec_s;
        state.rate_arcsec_s = before * decay + end;
        state.mean_arcsec_s = mean_decay * (before + end / (1.0 + decay)) + between;
    }

    #[inline]
    fn apply(&self, state: &mut State, head: &mut GyroSubStep, surroundings: &EffectInputs) {
        head.drift_arcsec += state.mean_arcsec_s * surroundings.step.length_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::Effect;

    #[test]
    fn rate_and_angle_of_a_sample_have_the_variances_of_the_process() {
        let (t_s, count) = (0.5, 40_000);
        for tau_s in [1.0, 5.0, f64::INFINITY] {
            let law = DriftRandomWalk { arcsec_per_s_per_sqrt_s: 1.0, correlation_time_s: tau_s };
            let [mut rate, mut both, mut angle] = [0.0; 3];
            for seed in 0..count {
                let mut state = State::start(seed, Gyro::X, DriftRandomWalk::SPEC.code);
                law.begin(&mut state, t_s);
                let (end, gained) = (state.rate_arcsec_s, state.mean_arcsec_s * t_s);
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
            // Five deviations of a variance from this number of draws, √(2/40 000).
            for (got, expected) in [rate, both, angle].into_iter().zip(expected) {
                assert!((got / expected - 1.0).abs() < 0.035, "{tau_s} s: {got}, not {expected}");
            }
        }
    }
}
