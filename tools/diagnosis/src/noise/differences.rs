//! Noise of a gyro of which the configuration states none, from differences that the motion does not touch.

use geu_checks::median;

use crate::measured::Block;
use crate::rounding::BlockRounding;
use crate::significance::MEDIAN_OF_NORMAL;
use crate::whitening::NoiseModel;

/// Lengths of averages, blocks, of which second differences are taken, and the minimum number of these.
const LENGTHS: [usize; 4] = [1, 2, 4, 8];
const MIN_DIFFERENCES: usize = 12;
/// Variance of differences of a residual without noise, counts²: below that of the smallest white noise.
const NO_NOISE: f64 = 1e-9;

/// White noise and angle random walk of a residual: the variance of second differences of averages over 1 to 8 blocks, of neighbours,
/// is 6 w/n + n q for a white variance w and a growth q over a block. Medians, which no missing effect changes.
pub fn noise(residual: &[f64], blocks: &[Block], rounding: &[BlockRounding], block_s: f64) -> (f64, f64) {
    let is_known = |block: usize| blocks[block].is_compared && !blocks[block].restarts;
    let count = blocks.len().min(residual.len());
    let (mut sums, mut unknown) = (vec![0.0], vec![0usize]);
    for block in 0..count {
        sums.push(sums[block] + residual[block]);
        unknown.push(unknown[block] + usize::from(!is_known(block)));
    }
    // Of three neighbours from each block on.
    let of_length = |length: usize| {
        let difference = |from: usize| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|end| from + end * length);
            let sum = sums[b] - sums[a] - 2.0 * (sums[c] - sums[b]) + sums[d] - sums[c];
            let scale = rounding[a..d].iter().map(|own| own.walk_scale).sum::<f64>() / (3 * length) as f64;
            (unknown[d] == unknown[a]).then(|| sum.abs() / length as f64 / scale.sqrt())
        };
        let mut sizes: Vec<f64> = (0..(count + 1).saturating_sub(3 * length)).filter_map(difference).collect();
        let is_enough = sizes.len() >= MIN_DIFFERENCES * length;
        is_enough.then(|| (length as f64, (median(&mut sizes) / MEDIAN_OF_NORMAL).powi(2)))
    };
    // Rounding of slow motion is no white noise: it is subtracted.
    let rounded = rounding.iter().map(|own| own.second_difference).sum::<f64>() / rounding.len().max(1) as f64;
    let known: Vec<(f64, f64)> = LENGTHS.iter().filter_map(|&length| of_length(length)).collect();
    // Weighted fit of white noise and walk, or of one alone; relative errors grow with the length.
    let (mut aa, mut ab, mut bb, mut ay, mut by) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (length, variance) in &known {
        let variance = (variance - rounded).max(1e-3 * variance).max(NO_NOISE);
        let (a, b, weight) = (6.0 / length / variance, length / variance, 1.0 / length);
        (aa, ab, bb) = (aa + weight * a * a, ab + weight * a * b, bb + weight * b * b);
        (ay, by) = (ay + weight * a, by + weight * b);
    }
    let determinant = aa * bb - ab * ab;
    let (white, walk) = ((ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant);
    let (white, walk) = match (white > 0.0, walk > 0.0) {
        _ if known.len() < 2 => (known.first().map_or(0.0, |own| own.1 / 6.0), 0.0),
        (true, true) => (white, walk),
        (false, _) => (0.0, by / bb),
        (true, false) => (ay / aa, 0.0),
    };
    (white, (walk / block_s).sqrt())
}

/// White noise that the differences of a gyro do not show beside its walk is that of the other gyros: it is of the reference. For these gyros,
/// with the smallest white noise of each.
pub fn share_white(noise: &mut [NoiseModel], gyros: &[(usize, f64)]) {
    let (shown, others): (Vec<_>, Vec<_>) = gyros.iter().partition(|(gyro, min)| noise[*gyro].white > *min);
    let mut whites: Vec<f64> = shown.iter().map(|(gyro, _)| noise[*gyro].white).collect();
    if !whites.is_empty() {
        let white = median(&mut whites);
        others.iter().for_each(|(gyro, _)| noise[*gyro].white = white);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geu_model::noise::NoiseStream;

    #[test]
    fn white_noise_and_walk_differ_in_their_growth() {
        let blocks = vec![Block::COMPARED; 4000];
        let mut stream = NoiseStream::of_sensor(7, "test");
        // A block's average of the walk, of 100 steps each.
        let (block_s, walk, white) = (2.0f64, 0.5, 0.3);
        let step = walk * (block_s / 100.0).sqrt();
        let mut angle = 0.0;
        let mut average = || {
            let mut sum = 0.0;
            for _ in 0..100 {
                angle += step * stream.standard_normal();
                sum += angle;
            }
            sum / 100.0 + white * stream.standard_normal()
        };
        let residual: Vec<f64> = (0..4000).map(|_| average()).collect();
        let rounding = vec![BlockRounding::NONE; 4000];
        let (found_white, found_walk) = noise(&residual, &blocks, &rounding, block_s);
        // Three sigma of 4000 blocks.
        assert!((found_walk / walk - 1.0).abs() < 0.06, "{found_walk}");
        assert!((found_white.sqrt() / white - 1.0).abs() < 0.15, "{found_white}");
    }
}
