//! Effects beyond the paper, by the laws of the model's page (IEEE Std 528, 647, 952, 1431).

use geu_model::units::{FULL_SCALE_ARCSEC_S, PPM, S_PER_DAY, S_PER_H};
use geu_protocol::Gyro;

use super::estimate::{Fit, LineFit, ROUNDING_VARIANCE, allan_variance, freedom_of_flicker_rate};
use super::receiver::{Row, between};
use super::scale_factor::transfer_function;
use super::{Estimate, Measurement};

pub const MEASUREMENTS: &[Measurement] = &[
    ("quadratic scale factor", |receiver| {
        let points = transfer_function(&receiver.listen(1850.0), Gyro::Y, 1);
        let sigma = points.iter().map(|(_, departure)| departure.sigma).fold(0.0, f64::max);
        let squares: Vec<_> = points
            .iter()
            .map(|(rate, departure)| (rate / FULL_SCALE_ARCSEC_S, departure.value))
            .map(|(share, departure)| ([share, share * share], departure))
            .collect();
        let square = Fit::new(&squares).estimate(1);
        // As of the cubic: the departures have their own sigma.
        let square = Estimate::new(square.value, square.sigma * sigma / ROUNDING_VARIANCE.sqrt());
        vec![square.times(-1.0 / FULL_SCALE_ARCSEC_S / PPM)]
    }),
    ("dead zone", |receiver| {
        let points = transfer_function(&receiver.listen(960.0), Gyro::Y, 1);
        let shares = points.iter().map(|(rate, excess)| (rate.abs(), excess.times(1.0 / rate)));
        let (sensed, lost): (Vec<_>, Vec<_>) = shares.partition(|(_, excess)| excess.value > -0.5);
        let slowest = sensed.iter().map(|(rate, _)| *rate).fold(f64::INFINITY, f64::min);
        let fastest = lost.iter().map(|(rate, _)| *rate).fold(0.0, f64::max);
        let excess = sensed.iter().map(|(_, excess)| *excess).next().unwrap_or(Estimate::new(f64::NAN, 0.0));
        vec![
            Estimate::new(0.5 * (slowest + fastest), (slowest - fastest) / 12f64.sqrt()),
            Estimate::new(1.0 + excess.value, excess.sigma),
        ]
    }),
    ("sensor lag", |receiver| {
        let rows = receiver.listen(300.0);
        let held = between(&rows, 100.0, 300.0);
        let behind = held.iter().map(|row| -row.residual(Gyro::Y)).sum::<f64>() / held.len() as f64;
        // At 360 counts in a sample interval all roundings are equal.
        vec![Estimate::new(behind, ROUNDING_VARIANCE.sqrt()).times(1.0 / FULL_SCALE_ARCSEC_S)]
    }),
    ("scale-factor noise", |receiver| {
        receiver.listen_every(u64::MAX, 60.0);
        let rows = receiver.listen_every(20, 43_200.0);
        vec![relative_noise_ppm(&rows, Gyro::X, 0), relative_noise_ppm(&rows, Gyro::ZA, 2)]
    }),
    ("bias instability", |receiver| {
        let spacing_s = 5.0;
        let rows = receiver.listen_every(10, 2.0 * S_PER_DAY);
        let phases = Gyro::ALL.map(|gyro| rows.iter().map(|row| row.residual(gyro)).collect::<Vec<f64>>());
        let deviation = |m: usize| {
            let tau_s = spacing_s * m as f64;
            let variance = phases.iter().map(|phase| allan_variance(phase, spacing_s, m)).sum::<f64>() / 4.0;
            let freedom = 4.0 * freedom_of_flicker_rate(rows.len(), m);
            let value = (variance - 3.0 * ROUNDING_VARIANCE / (tau_s * tau_s)).sqrt();
            Estimate::new(value, value / (2.0 * freedom).sqrt())
        };
        [2, 20, 200, 2000].map(deviation).to_vec()
    }),
    ("drift hysteresis", |receiver| {
        let rows = receiver.listen(14_400.0);
        let line = |from_s, to_s| {
            LineFit::new(between(&rows, from_s, to_s).iter().map(|row| (row.t_s - 7200.0, row.residual(Gyro::X))))
        };
        let (rising, falling) = (line(600.0, 7200.0), line(7800.0, 14_400.0));
        // Without drift on average over the play, the lines meet in its middle.
        let turn = rising.slope.minus(falling.slope);
        let at_0 = |line: &LineFit| line.level.minus(line.slope.times(line.centre));
        let middle_s = at_0(&falling).minus(at_0(&rising)).over(turn);
        vec![rising.slope.times(-S_PER_H), falling.slope.times(-S_PER_H), middle_s.times(2.0 * 2.0 / S_PER_H)]
    }),
];

/// White noise of the rate over the rate, from rows that are evenly spaced.
fn relative_noise_ppm(rows: &[Row], gyro: Gyro, axis: usize) -> Estimate {
    let of_pair = |pair: &[Row]| {
        let [before, after] = [&pair[0], &pair[1]];
        let (length_s, turned) = (after.t_s - before.t_s, after.reference_arcsec[axis] - before.reference_arcsec[axis]);
        let noise = (after.residual(gyro) - before.residual(gyro)).powi(2) - 2.0 * ROUNDING_VARIANCE;
        noise * length_s / (turned * turned)
    };
    let count = (rows.len() - 1) as f64;
    let density = (rows.windows(2).map(of_pair).sum::<f64>() / count).sqrt() / PPM;
    Estimate::new(density, density / (2.0 * count).sqrt())
}
