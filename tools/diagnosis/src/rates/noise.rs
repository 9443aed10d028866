//! Noise of the residual: within groups, correlated from window to window, and a part common to a group.
//!
//! The residual of a channel within a group is taken as a first-order autoregression: standard deviation and correlation
//! of neighbours are those of greatest restricted likelihood once the mean of every group and every error, linearised,
//! are taken off; the correlation time is at most a quarter of the longest group. So an offset of a group is never noise, and an error that varies within a group is none either.

use nalgebra::{DMatrix, DVector};

use crate::rates::windows::Windows;

/// Correlation times in the longest group, at least. What lasts longer is an offset of its group, and those are not noise
/// but for the errors to explain: were it noise, no group could speak against any other.
const TIMES_IN_GROUP: f64 = 4.0;

/// Noise of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChannelNoise {
    /// Standard deviation of a window within its group.
    pub sigma_arcsec_s: f64,
    /// Correlation of a window with the next of its group.
    pub correlation: f64,
    /// Standard deviation of what all windows of a group have in common.
    pub between_arcsec_s: f64,
}

/// Noise of all channels: one where the reference is a magnitude, else one for each gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// The channels.
    pub channels: Vec<ChannelNoise>,
}

/// Greatest correlation of a window with the next that is taken for noise.
pub(crate) fn greatest_correlation(windows: &Windows) -> f64 {
    let count = |group: usize| windows.all().iter().filter(|window| window.group == group).count();
    let longest = (0..windows.groups.len()).map(count).max().unwrap_or(0);
    (-TIMES_IN_GROUP / longest.max(1) as f64).exp()
}

/// Rows of a channel and group, in order.
pub(crate) struct Segment {
    pub(crate) channel: usize,
    pub(crate) rows: Vec<usize>,
}

pub(crate) fn segments(windows: &Windows) -> Vec<Segment> {
    let count = windows.all().len();
    let of = |channel: usize, group: usize| {
        let rows = windows.all().iter().enumerate().filter(move |(_, window)| window.group == group);
        Segment { channel, rows: rows.map(|(index, _)| channel * count + index).collect() }
    };
    let all = (0..windows.channels()).flat_map(|channel| (0..windows.groups.len()).map(move |group| (channel, group)));
    all.map(|(channel, group)| of(channel, group)).filter(|segment| !segment.rows.is_empty()).collect()
}

/// Neighbours made independent, the first left as it is.
pub(crate) fn decorrelated(values: &[f64], correlation: f64) -> impl Iterator<Item = f64> + '_ {
    let size = (1.0 - correlation * correlation).sqrt();
    values.iter().enumerate().map(move |(index, value)| match index {
        0 => *value,
        _ => (value - correlation * values[index - 1]) / size,
    })
}

impl Noise {
    /// The same, as slow as noise may be.
    pub(crate) fn slowest(&self, windows: &Windows) -> Noise {
        let correlation = greatest_correlation(windows);
        Noise { channels: self.channels.iter().map(|channel| ChannelNoise { correlation, ..*channel }).collect() }
    }

    /// Divides rows by the noise: what is left has variance 1 and no correlation.
    pub(crate) fn whiten(&self, windows: &Windows, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let mut white = matrix.clone();
        for Segment { channel, rows } in segments(windows) {
            let ChannelNoise { sigma_arcsec_s, correlation, between_arcsec_s } = self.channels[channel];
            let within = |values: &[f64]| {
                let white = decorrelated(values, correlation).map(|value| value / sigma_arcsec_s);
                DVector::from_iterator(values.len(), white)
            };
            let common = within(&vec![1.0; rows.len()]);
            let squared = common.norm_squared();
            let share = (1.0 - (1.0 + between_arcsec_s.powi(2) * squared).sqrt().recip()) / squared;
            for column in 0..matrix.ncols() {
                let values: Vec<f64> = rows.iter().map(|row| matrix[(*row, column)]).collect();
                let values = within(&values);
                let values = &values - &common * (share * common.dot(&values));
                rows.iter().zip(values.iter()).for_each(|(row, value)| white[(*row, column)] = *value);
            }
        }
        white
    }

    /// Means of the groups as columns: an offset of each channel and group.
    pub(crate) fn offsets(windows: &Windows) -> DMatrix<f64> {
        let segments = segments(windows);
        let mut columns = DMatrix::zeros(windows.channels() * windows.all().len(), segments.len());
        for (column, segment) in segments.iter().enumerate() {
            segment.rows.iter().for_each(|row| columns[(*row, column)] = 1.0);
        }
        columns
    }

    /// One residual that is nothing but noise, of independent standard normal numbers.
    pub(crate) fn draw(&self, windows: &Windows, mut normal: impl FnMut() -> f64) -> DVector<f64> {
        let mut drawn = DVector::zeros(windows.channels() * windows.all().len());
        for Segment { channel, rows } in segments(windows) {
            let ChannelNoise { sigma_arcsec_s, correlation, between_arcsec_s } = self.channels[channel];
            let common = if between_arcsec_s > 0.0 { between_arcsec_s * normal() } else { 0.0 };
            let mut state = normal();
            for row in rows {
                drawn[row] = common + sigma_arcsec_s * state;
                state = correlation * state + (1.0 - correlation * correlation).sqrt() * normal();
            }
        }
        drawn
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::rates::{Gyro, Reference};
    use geu_model::noise::NoiseStream;

    /// Windows of three gyros, `each` in a group, at a rate that grows from group to group.
    pub(crate) fn windows(groups: usize, each: usize) -> Windows {
        let gyros = (0..3).map(|axis| Gyro { name: "XYZ"[axis..=axis].to_owned(), axis }).collect();
        let mut windows = Windows::new(gyros, (0..groups).map(|group| group.to_string()).collect());
        for index in 0..groups * each {
            let speed = 100.0 * (1 + index / each) as f64;
            windows.push(index / each, &[0.2 * speed, speed, 5.0], Reference::Magnitude(speed)).expect("a window");
        }
        windows
    }

    #[test]
    fn what_is_whitened_has_variance_one_and_no_correlation() {
        let windows = windows(50, 20);
        let noise =
            Noise { channels: vec![ChannelNoise { sigma_arcsec_s: 3.0, correlation: 0.6, between_arcsec_s: 2.0 }] };
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
