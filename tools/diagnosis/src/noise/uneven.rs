//! Noise that changes in the course of a recording.

use geu_checks::median;

use crate::significance::MEDIAN_OF_NORMAL;

/// Blocks before or after a block over which its noise is estimated: the sigma of the estimate is a quarter.
const REACH: usize = 15;
/// Minimum number of blocks of an estimate.
const MIN_BLOCKS: usize = 8;
/// Smallest variance of a block, as a multiple of the mean one.
const MIN_SCALE: f64 = 1e-3;

/// Variance of each block of a whitened residual: from the median of the squares before or after it, the larger one, since noise changes
/// where a motion begins. Neither an outlier nor a short effect changes a median.
pub fn scales(white: &[f64]) -> Vec<f64> {
    // Blocks without data are 0.
    let of_side = |near: &[f64]| {
        let mut sizes: Vec<f64> = near.iter().filter(|value| **value != 0.0).map(|value| value.abs()).collect();
        (sizes.len() >= MIN_BLOCKS).then(|| (median(&mut sizes) / MEDIAN_OF_NORMAL).powi(2))
    };
    let of_block = |block: usize| {
        let before = of_side(&white[(block + 1).saturating_sub(REACH)..=block]);
        let after = of_side(&white[block..(block + REACH).min(white.len())]);
        let larger = before.into_iter().chain(after).reduce(f64::max);
        larger.map_or(1.0, |scale| scale.max(MIN_SCALE))
    };
    (0..white.len()).map(of_block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::noise::NoiseStream;

    #[test]
    fn the_scale_follows_the_noise_and_no_outlier() {
        let mut stream = NoiseStream::of_sensor(1, "uneven");
        let deviation = |block: usize| if (100..200).contains(&block) { 5.0 } else { 0.5 };
        let mut white: Vec<f64> = (0..300).map(|block| deviation(block) * stream.standard_normal()).collect();
        (white[50], white[250]) = (80.0, 0.0);
        let scales = scales(&white);
        // The blocks of a motion have its noise, those beside them may have it. The larger of two medians of 15 is mostly up to twice too large.
        for block in (0..85).chain(100..200).chain(215..300) {
            let ratio = scales[block].sqrt() / deviation(block);
            assert!((0.5..2.6).contains(&ratio), "{block}: {ratio}");
        }
    }
}
