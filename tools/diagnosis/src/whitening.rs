//! Whitening of an accumulated angle: what is left of it is white, of variance 1, where it is only noise.
//!
//! A Kalman filter of angle and drift rate predicts each block from those before it; the innovation over its own deviation is
//! white. The filter is linear and knows no data, so it is the same for a residual and for every signature that is looked
//! for in it (Willsky and Jones). Where a sum begins anew the angle is taken from the first block after it, which tells nothing else.

use crate::measured::{BLOCK_S, Block};

/// Variance of a rounded number, even between two whole ones.
pub const ROUNDING: f64 = 1.0 / 12.0;

/// Noise of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Variance of a block's average: rounding and the reference.
    pub white: f64,
    /// Growth of the angle's deviation with the root of time, per √s.
    pub angle_walk: f64,
    /// Growth of the rate's deviation with the root of time, per s and √s.
    pub rate_walk: f64,
}

/// The filter for one channel.
#[derive(Debug, Clone)]
pub struct Whitening {
    /// For each block the gains on angle and rate, and one over the deviation of the innovation: 0 where a block tells nothing.
    steps: Vec<([f64; 2], f64)>,
    /// Σ ln of the innovations' variances.
    pub log_determinant: f64,
    /// Blocks that tell something.
    pub count: usize,
}

impl Whitening {
    /// The filter of this noise over these blocks.
    pub fn new(noise: &Noise, blocks: &[Block]) -> Whitening {
        let (angle, drift, t) = (noise.angle_walk.powi(2), noise.rate_walk.powi(2), BLOCK_S);
        // At the start the angle is free, since a common shift of time moves what was before. The rate of then is no noise: it is
        // one of the sixteen.
        let (mut aa, mut ad, mut dd) = (0.0, 0.0, 0.0);
        let (mut anew, mut log_determinant, mut count) = (true, 0.0, 0);
        let step = |block: &Block| {
            aa += 2.0 * ad * t + dd * t * t + angle * t + drift * t.powi(3) / 3.0;
            ad += dd * t + drift * t * t / 2.0;
            dd += drift * t;
            anew |= block.restarts;
            if !block.is_good {
                return ([0.0; 2], 0.0);
            }
            if std::mem::take(&mut anew) {
                (aa, ad) = (noise.white, 0.0);
                return ([1.0, 0.0], 0.0);
            }
            let innovation = aa + noise.white;
            let gains = [aa / innovation, ad / innovation];
            dd -= gains[1] * ad;
            ad -= gains[0] * ad;
            aa -= gains[0] * aa;
            log_determinant += innovation.ln();
            count += 1;
            (gains, 1.0 / innovation.sqrt())
        };
        let steps = blocks.iter().map(step).collect();
        Whitening { steps, log_determinant, count }
    }

    /// Innovations of a series, each over its deviation.
    pub fn apply(&self, series: &[f64]) -> Vec<f64> {
        self.apply_from(0, series)
    }

    /// The same of a series that is 0 before the block `from`, of which it tells the rest or some of it.
    pub fn apply_from(&self, from: usize, series: &[f64]) -> Vec<f64> {
        let (mut angle, mut rate) = (0.0, 0.0);
        let innovations = self.steps[from..].iter().zip(series).map(|((gains, weight), measured)| {
            angle += rate * BLOCK_S;
            let innovation = measured - angle;
            angle += gains[0] * innovation;
            rate += gains[1] * innovation;
            innovation * weight
        });
        innovations.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws that need no generator: a quadratic residue sequence, of variance 1/12 about 0.
    fn draw(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    #[test]
    fn noise_of_the_model_comes_out_white_across_a_break() {
        let noise = Noise { white: 1.0 / 120.0, angle_walk: 0.01, rate_walk: 8e-6 };
        let mut blocks = vec![Block { is_good: true, restarts: false }; 20_000];
        blocks[9_000] = Block { is_good: false, restarts: true };
        let (mut state, mut angle, mut rate) = (1u64, 0.0, 0.0);
        let mut normal = || (0..12).map(|_| draw(&mut state)).sum::<f64>();
        let series: Vec<f64> = (0..blocks.len())
            .map(|block| {
                let kick = noise.rate_walk * BLOCK_S.sqrt() * normal();
                angle += (rate + 0.5 * kick) * BLOCK_S + noise.angle_walk * BLOCK_S.sqrt() * normal();
                rate += kick;
                let jump = if block > 9_000 { 1e6 } else { 0.0 };
                angle + jump + noise.white.sqrt() * normal()
            })
            .collect();
        let white = Whitening::new(&noise, &blocks).apply(&series);
        let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_998.0;
        let neighbours = white.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 19_998.0;
        // Four deviations: √(2/20 000) and √(1/20 000).
        assert!((variance - 1.0).abs() < 0.04 && neighbours.abs() < 0.029, "{variance} {neighbours}");
        assert_eq!(white[9_001], 0.0);
    }
}
