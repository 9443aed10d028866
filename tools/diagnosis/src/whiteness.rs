//! Tests of a whitened residual for noise.

use crate::measured::{CHANNELS, Series, TIMING};

/// Distance of a whitened residual from noise: the largest, and that of each channel.
///
/// Compares χ² of averages over half a minute to half an hour with their number, in sigmas, since unexplained effects are slow.
pub fn whiteness_statistic(left: &Series) -> (f64, [f64; CHANNELS]) {
    const SCALES: [usize; 4] = [6, 24, 96, 384];
    let of_channel = |channel: usize| {
        if left[channel].is_empty() {
            return f64::NEG_INFINITY;
        }
        let of_scale = |scale: &usize| {
            // Blocks without data are exactly 0; a window with more than half of them is ignored.
            let of_window = |window: &[f64]| {
                let known = window.iter().filter(|value| **value != 0.0).count();
                (2 * known >= *scale).then(|| window.iter().sum::<f64>().powi(2) / known as f64)
            };
            let windows: Vec<f64> = left[channel].chunks_exact(*scale).filter_map(of_window).collect();
            let count = windows.len() as f64;
            // The distribution is skewed with few windows: the cube root of χ² is closer to a normal variable (Wilson and Hilferty).
            let mean = windows.iter().sum::<f64>() / count.max(1.0);
            if windows.len() < 4 {
                return 0.0;
            }
            let spread = 2.0 / (9.0 * count);
            (mean.cbrt() - (1.0 - spread)) / spread.sqrt()
        };
        SCALES.iter().map(of_scale).fold(f64::NEG_INFINITY, f64::max)
    };
    let channels: [f64; CHANNELS] = std::array::from_fn(of_channel);
    (channels[..TIMING].iter().copied().fold(f64::NEG_INFINITY, f64::max), channels)
}

/// Fourth moment over the square of the second; 3 of normal values.
pub fn kurtosis(values: &[f64]) -> f64 {
    let variance = moment(values, 2);
    if variance > 0.0 { moment(values, 4) / variance.powi(2) } else { 0.0 }
}

/// Mean of a power. Blocks without data, exactly 0, are ignored.
pub fn moment(values: &[f64], power: i32) -> f64 {
    let known = || values.iter().filter(|value| **value != 0.0);
    known().map(|value| value.powi(power)).sum::<f64>() / known().count().max(1) as f64
}
