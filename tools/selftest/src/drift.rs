//! Drift, fixed and random (Casteren §3.1, table 1).

use geu_protocol::Gyro;

use super::estimate::{
    LineFit, ROUNDING_VARIANCE, allan_variance, curvature, freedom_of_walking_rate, freedom_of_white_rate,
};
use super::receiver::Row;
use super::{Estimate, Measurement};
use geu_model::units::{ARCSEC_PER_DEG, S_PER_DAY};

const S_PER_H: f64 = 3600.0;
/// Table 1's half hour.
const HALF_HOUR_S: f64 = 1800.0;

pub const MEASUREMENTS: &[Measurement] = &[
    ("drift", |receiver| {
        let rows = receiver.listen(S_PER_H);
        let line = LineFit::new(rows.iter().map(|row| (row.t_s, row.residual(Gyro::Y))));
        vec![line.slope.times(-S_PER_H / ARCSEC_PER_DEG)]
    }),
    ("drift ramp", |receiver| {
        let rows = receiver.listen_every(120, 14.0 * S_PER_DAY);
        let points = rows.iter().map(|row| (row.t_s / S_PER_DAY - 7.0, row.residual(Gyro::X)));
        let ramp = curvature(points).times(-2.0 / 24.0);
        vec![ramp, ramp.times(14.0)]
    }),
    ("angle random walk", |receiver| {
        let (block_s, blocks) = (30.0, 10);
        let phases = block_means(&receiver.listen(43_200.0), block_s);
        let tau_s = block_s * blocks as f64;
        // A walk averaged over a block w has 1 − w/(2τ) of the Allan variance N²/τ of the walk itself.
        let law = (1.0 - block_s / (2.0 * tau_s)) / tau_s;
        vec![root(&phases, block_s, blocks, freedom_of_white_rate, law)]
    }),
    ("drift random walk", |receiver| {
        let (block_s, blocks) = (60.0, 30);
        let phases = block_means(&receiver.listen(1.5 * S_PER_DAY), block_s);
        let walk = root(&phases, block_s, blocks, freedom_of_walking_rate, HALF_HOUR_S / 3.0);
        vec![walk.times(1e6), walk.times(3.0 * HALF_HOUR_S.sqrt() * S_PER_H)]
    }),
    ("bounded drift walk", |receiver| {
        let (block_s, correlation_s) = (600.0, 10_000.0);
        receiver.listen_every(u64::MAX, 3.0 * correlation_s);
        let rows = receiver.listen(2.5 * S_PER_DAY);
        let length_s = rows[rows.len() - 1].t_s - rows[0].t_s;
        let (mut sum, mut count) = (0.0, 0.0);
        for phase in block_means(&rows, block_s) {
            for pair in phase.windows(2) {
                sum += ((pair[1] - pair[0]) / block_s).powi(2);
                count += 1.0;
            }
        }
        // The mean square of a Gauss-Markov process over a time T has the relative variance 2 · correlation/T.
        let deviation = (sum / count).sqrt() * S_PER_H;
        vec![Estimate::new(deviation, deviation * (correlation_s / (2.0 * 4.0 * length_s)).sqrt())]
    }),
];

/// Residual angle of each gyro, averaged over blocks; this divides the rounding variance by the samples of a block.
fn block_means(rows: &[Row], block_s: f64) -> [Vec<f64>; 4] {
    let samples = (2.0 * block_s) as usize;
    Gyro::ALL.map(|gyro| {
        rows.chunks_exact(samples)
            .map(|block| block.iter().map(|row| row.residual(gyro)).sum::<f64>() / samples as f64)
            .collect()
    })
}

/// The coefficient c with c²·`law` = Allan variance over `m` blocks, from four gyros. The variance that rounding adds,
/// 3/τ² of that of a block's mean, is subtracted.
fn root(phases: &[Vec<f64>; 4], block_s: f64, m: usize, freedom: fn(usize, usize) -> f64, law: f64) -> Estimate {
    let tau_s = block_s * m as f64;
    let variance = phases.iter().map(|phase| allan_variance(phase, block_s, m)).sum::<f64>() / 4.0;
    let freedom: f64 = phases.iter().map(|phase| freedom(phase.len(), m)).sum();
    let rounding = 3.0 * ROUNDING_VARIANCE / (2.0 * block_s) / (tau_s * tau_s);
    let value = ((variance - rounding) / law).max(0.0).sqrt();
    let sigma_of_square = variance / law * (2.0 / freedom).sqrt();
    Estimate::new(value, sigma_of_square / (2.0 * value.max(f64::MIN_POSITIVE)))
}
