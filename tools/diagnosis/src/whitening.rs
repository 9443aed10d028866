//! Whitening filter of an accumulated angle: noise becomes white, of variance 1.
//!
//! A Kalman filter of angle and drift rate predicts each block from those before it; the innovation over its own deviation is
//! white. The filter is linear and independent of the data, thus the same for a residual and for every signature (Willsky and Jones).
//! After a restart of the sum the first block only initialises the angle.

use crate::measured::{BLOCK, BLOCK_S, Block};

/// Variance of a rounded number, even between two whole ones.
pub const ROUNDING: f64 = 1.0 / 12.0;

/// Noise of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseModel {
    /// Variance of a block's average: rounding and the reference.
    pub white: f64,
    /// Growth of the angle's deviation with the root of time, per √s.
    pub angle_walk: f64,
    /// Growth of the rate's deviation with the root of time, per s and √s.
    pub rate_walk: f64,
}

/// Mean time of a block's average of a walk that starts at 0, as a share of the block.
const MEAN: f64 = (BLOCK as f64 + 1.0) / (2.0 * BLOCK as f64);
/// Variance of that average, as a share of the walk's variance at the end of the block.
const VARIANCE: f64 = (BLOCK as f64 + 1.0) * (2.0 * BLOCK as f64 + 1.0) / (6.0 * BLOCK as f64 * BLOCK as f64);

/// The filter for one channel.
#[derive(Debug, Clone)]
pub struct Whitening {
    /// For each block the gains on angle and rate at its end, and the inverse sigma of the innovation: 0 for a block without data.
    steps: Vec<([f64; 2], f64)>,
    /// Σ ln of the innovations' variances.
    pub log_determinant: f64,
}

impl Whitening {
    /// The filter of this noise over these blocks.
    pub fn new(noise: &NoiseModel, blocks: &[Block]) -> Whitening {
        let (angle, drift, t) = (noise.angle_walk.powi(2) * BLOCK_S, noise.rate_walk.powi(2), BLOCK_S);
        let mean_s = MEAN * t;
        // At the start the angle is free, since a common time shift changes the angle before. The initial rate is a calibration
        // parameter, not noise.
        let (mut aa, mut ad, mut dd) = (0.0, 0.0, 0.0);
        let (mut anew, mut log_determinant) = (true, 0.0);
        let step = |block: &Block| {
            // Of the average with itself, and with angle and rate at the block's end.
            let innovation = aa + 2.0 * mean_s * ad + mean_s * mean_s * dd + VARIANCE * angle + noise.white;
            let with_angle = aa + (mean_s + t) * ad + mean_s * t * dd + MEAN * angle;
            let with_rate = ad + mean_s * dd;
            aa += 2.0 * t * ad + t * t * dd + angle + drift * t.powi(3) / 3.0;
            ad += t * dd + drift * t * t / 2.0;
            dd += drift * t;
            anew |= block.restarts;
            if !block.is_good {
                return ([0.0; 2], 0.0);
            }
            if std::mem::take(&mut anew) {
                // The angle at the end is the average and what came after its mean time.
                let left_s = t - mean_s;
                (aa, ad) = (noise.white + (1.0 - 2.0 * MEAN + VARIANCE) * angle + left_s * left_s * dd, left_s * dd);
                return ([1.0, 0.0], 0.0);
            }
            let gains = [with_angle / innovation, with_rate / innovation];
            aa -= gains[0] * with_angle;
            ad -= gains[0] * with_rate;
            dd -= gains[1] * with_rate;
            log_determinant += innovation.ln();
            (gains, 1.0 / innovation.sqrt())
        };
        let steps = blocks.iter().map(step).collect();
        Whitening { steps, log_determinant }
    }

    /// Innovations of a series, each over its deviation.
    pub fn apply(&self, series: &[f64]) -> Vec<f64> {
        self.apply_from(0, series)
    }

    /// Whitens a series that is 0 before the block `from`; `series` contains the blocks from there on.
    pub fn apply_from(&self, from: usize, series: &[f64]) -> Vec<f64> {
        const MEAN_S: f64 = MEAN * BLOCK_S;
        let (mut angle, mut rate) = (0.0, 0.0);
        let innovations = self.steps[from..].iter().zip(series).map(|((gains, weight), measured)| {
            let innovation = measured - angle - rate * MEAN_S;
            angle += rate * BLOCK_S + gains[0] * innovation;
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
    fn whitened_walks_are_white_across_a_break() {
        for angle_walk in [0.01, 0.3] {
            let noise = NoiseModel { white: 1.0 / 120.0, angle_walk, rate_walk: 8e-6 };
            let mut blocks = vec![Block { is_good: true, restarts: false }; 20_000];
            blocks[9_000] = Block { is_good: false, restarts: true };
            let (mut state, mut angle, mut rate) = (1u64, 0.0, 0.0);
            let mut normal = || (0..12).map(|_| draw(&mut state)).sum::<f64>();
            let step_s = BLOCK_S / BLOCK as f64;
            let series: Vec<f64> = (0..blocks.len())
                .map(|block| {
                    let of_node = |_| {
                        rate += noise.rate_walk * step_s.sqrt() * normal();
                        angle += rate * step_s + noise.angle_walk * step_s.sqrt() * normal();
                        angle
                    };
                    let average = (0..BLOCK).map(of_node).sum::<f64>() / BLOCK as f64;
                    let jump = if block > 9_000 { 1e6 } else { 0.0 };
                    average + jump + noise.white.sqrt() * normal()
                })
                .collect();
            let white = Whitening::new(&noise, &blocks).apply(&series);
            let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_997.0;
            let neighbours = white.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 19_997.0;
            // Four deviations: √(2/20 000) and √(1/20 000).
            assert!((variance - 1.0).abs() < 0.04 && neighbours.abs() < 0.029, "{variance} {neighbours}");
            assert_eq!(white[9_001], 0.0);
        }
    }
}
