//! Noise of the residual: within groups, correlated from window to window, and a part common to a group.
//!
//! Within a group, the residual is a first-order autoregression. Its standard deviation and correlation maximise the
//! restricted likelihood after the group means and all linearised errors are projected out; the correlation time is limited to a
//! quarter of the longest group. Therefore neither an offset of a group nor an error that varies within a group counts as noise.

use nalgebra::{DMatrix, DVector};

use crate::windows::Windows;

/// Minimum number of correlation times in the longest group. Slower noise is an offset of its group, which the errors have to
/// explain: as noise it would make every group consistent with any other.
const MIN_TIMES_IN_GROUP: f64 = 4.0;

/// Noise of the residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of a window within its group.
    pub sigma_arcsec_s: f64,
    /// Correlation of a window with the next of its group.
    pub correlation: f64,
    /// Standard deviation of the part common to all windows of a group.
    pub between_arcsec_s: f64,
}

/// Largest correlation of a window with the next that counts as noise.
pub(crate) fn max_correlation(windows: &Windows) -> f64 {
    let longest = windows.by_group().iter().map(Vec::len).max().unwrap_or(1);
    (-MIN_TIMES_IN_GROUP / longest as f64).exp()
}

/// Removes the correlation of neighbours; the first value stays as it is.
pub(crate) fn decorrelated(values: &[f64], correlation: f64) -> impl Iterator<Item = f64> + '_ {
    let size = (1.0 - correlation * correlation).sqrt();
    values.iter().enumerate().map(move |(index, value)| match index {
        0 => *value,
        _ => (value - correlation * values[index - 1]) / size,
    })
}

impl Noise {
    /// With the largest correlation allowed.
    pub(crate) fn slowest(&self, windows: &Windows) -> Noise {
        Noise { correlation: max_correlation(windows), ..*self }
    }

    /// Whitens columns: noise becomes uncorrelated with variance 1.
    pub(crate) fn whiten(&self, windows: &Windows, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let mut white = matrix.clone();
        for rows in windows.by_group() {
            let within = |values: &[f64]| {
                let white = decorrelated(values, self.correlation).map(|value| value / self.sigma_arcsec_s);
                DVector::from_iterator(values.len(), white)
            };
            let common = within(&vec![1.0; rows.len()]);
            let squared = common.norm_squared();
            let share = (1.0 - (1.0 + self.between_arcsec_s.powi(2) * squared).sqrt().recip()) / squared;
            for column in 0..matrix.ncols() {
                let values: Vec<f64> = rows.iter().map(|row| matrix[(*row, column)]).collect();
                let values = within(&values);
                let values = &values - &common * (share * common.dot(&values));
                rows.iter().zip(values.iter()).for_each(|(row, value)| white[(*row, column)] = *value);
            }
        }
        white
    }

    /// An offset of each group, as columns.
    pub(crate) fn offsets(windows: &Windows) -> DMatrix<f64> {
        let groups = windows.by_group();
        let mut columns = DMatrix::zeros(windows.all().len(), groups.len());
        for (column, rows) in groups.iter().enumerate() {
            rows.iter().for_each(|row| columns[(*row, column)] = 1.0);
        }
        columns
    }

    /// A residual of noise alone; `normal` yields independent standard normal numbers.
    pub(crate) fn draw(&self, windows: &Windows, mut normal: impl FnMut() -> f64) -> DVector<f64> {
        let mut drawn = DVector::zeros(windows.all().len());
        for rows in windows.by_group() {
            let common = if self.between_arcsec_s > 0.0 { self.between_arcsec_s * normal() } else { 0.0 };
            let mut state = normal();
            for row in rows {
                drawn[row] = common + self.sigma_arcsec_s * state;
                state = self.correlation * state + (1.0 - self.correlation * self.correlation).sqrt() * normal();
            }
        }
        drawn
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Gyro;
    use geu_model::noise::NoiseStream;

    /// Windows of three gyros, `each` windows in a group, at a rate that increases from group to group.
    pub(crate) fn windows(groups: usize, each: usize) -> Windows {
        let gyros = ["X", "Y", "Z"].into_iter().zip([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let gyros = gyros.map(|(name, input)| Gyro { name: name.to_owned(), input });
        let mut windows = Windows::new(gyros.collect()).expect("perpendicular");
        for index in 0..groups * each {
            let speed = 100.0 * (1 + index / each) as f64;
            windows.push(&(index / each).to_string(), &[0.2 * speed, speed, 5.0], speed);
        }
        windows
    }

    #[test]
    fn whitened_noise_has_variance_one_and_no_correlation() {
        let windows = windows(50, 20);
        let noise = Noise { sigma_arcsec_s: 3.0, correlation: 0.6, between_arcsec_s: 2.0 };
        let mut stream = NoiseStream::of_sensor(1, "test");
        let drawn = noise.draw(&windows, || stream.standard_normal());
        let white = noise.whiten(&windows, &DMatrix::from_columns(&[drawn]));
        let white = white.column(0);
        // 1000 values: one sigma of the variance is 0.045, of the correlation 0.03.
        assert!((white.norm_squared() / 1000.0 - 1.0).abs() < 0.14, "{}", white.norm_squared());
        let pairs = (1..1000).map(|index| white[index] * white[index - 1]).sum::<f64>() / 1000.0;
        assert!(pairs.abs() < 0.1, "{pairs}");
    }
}
