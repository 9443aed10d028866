//! Effects beyond the paper, by the laws of the model's page (IEEE Std 528, 647, 952, 1431).

use geu_model::units::{FULL_SCALE_ARCSEC_S, PPM, S_PER_DAY, S_PER_H};
use geu_protocol::Gyro;

use super::Expected::Value;
use super::estimate::{Fit, LineFit, ROUNDING_VARIANCE, allan_variance, freedom_of_flicker_rate};
use super::receiver::{Row, between};
use super::scale_factor::transfer_function;
use super::{Estimate, Experiment, claim};

/// Allan deviation of a flicker of 1, √(2 ln 2/π), and the flatness that is demanded.
const FLICKER_FLOOR: f64 = 0.664;
const FLATNESS: f64 = 0.025 * FLICKER_FLOOR;

pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "quadratic scale factor",
        noise: false,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [
                { kind = \"y-scan\", to_theta_deg = 120, rate_arcmin_s = 12 },
                { kind = \"y-scan\", to_theta_deg = 60, rate_arcmin_s = 12 },
                { kind = \"y-scan\", to_theta_deg = 120, rate_arcmin_s = 6 },
                { kind = \"y-scan\", to_theta_deg = 60, rate_arcmin_s = 6 },
            ]
            gyro.GYRY.scale-factor-quadratic.ppm = 400
        ",
        claims: &[claim("square of the transfer function", "model", Value(400.0, 0.0), "ppm")],
        measure: |receiver| {
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
        },
    },
    Experiment {
        name: "dead zone",
        noise: false,
        // 3 and 3.6″/s, and near 3.2″/s, both ways.
        configuration: "
            manoeuvre = [
                { kind = \"y-scan\", to_theta_deg = 90.2, rate_arcmin_s = 0.05 },
                { kind = \"y-scan\", to_theta_deg = 90.0, rate_arcmin_s = 0.053 },
                { kind = \"y-scan\", to_theta_deg = 90.2, rate_arcmin_s = 0.0537 },
                { kind = \"y-scan\", to_theta_deg = 90.0, rate_arcmin_s = 0.06 },
            ]
            gyro.GYRY.dead-zone.arcsec_per_s = 3.2
        ",
        claims: &[
            claim("slowest sensed rate", "model", Value(3.2, 0.0), "″/s"),
            claim("part sensed of a faster rate", "model", Value(1.0, 0.0), ""),
        ],
        measure: |receiver| {
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
        },
    },
    Experiment {
        name: "sensor lag",
        noise: false,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [{ kind = \"pointing\", duration_s = 20 }, { kind = \"y-scan\", to_theta_deg = 120 }]
            gyro.GYRY.sensor-lag.time_constant_s = 2
        ",
        claims: &[claim("angle not yet sensed over the rate", "model", Value(2.0, 0.0), "s")],
        measure: |receiver| {
            let rows = receiver.listen(300.0);
            let held = between(&rows, 100.0, 300.0);
            let behind = held.iter().map(|row| -row.residual(Gyro::Y)).sum::<f64>() / held.len() as f64;
            // At 360 counts in a sample interval all roundings are equal.
            vec![Estimate::new(behind, ROUNDING_VARIANCE.sqrt()).times(1.0 / FULL_SCALE_ARCSEC_S)]
        },
    },
    Experiment {
        name: "scale-factor noise",
        noise: true,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [{ kind = \"x-scan\", angle_deg = 36000 }]
            gyro.GYRX.scale-factor-noise.ppm_sqrt_s = 10000
            gyro.GYRZA.scale-factor-noise.ppm_sqrt_s = 10000
        ",
        claims: &[
            claim("white noise over the rate, 105 ″/s", "model", Value(10_000.0, 0.0), "ppm √s"),
            claim("white noise over the rate, 182 ″/s", "model", Value(10_000.0, 0.0), "ppm √s"),
        ],
        measure: |receiver| {
            receiver.listen_every(u64::MAX, 60.0);
            let rows = receiver.listen_every(20, 43_200.0);
            vec![relative_noise_ppm(&rows, Gyro::X, 0), relative_noise_ppm(&rows, Gyro::ZA, 2)]
        },
    },
    Experiment {
        name: "bias instability",
        noise: true,
        configuration: "
            scenario = { theta_deg = 60, limit_cycle = { rate_arcsec_s = 4, period_s = 4.7183 } }
            manoeuvre = [{ kind = \"x-scan\", angle_deg = 36000 }]
            [gyro]
            GYRX.bias-instability.arcsec_per_h = 3600
            GYRY.bias-instability.arcsec_per_h = 3600
            GYRZA.bias-instability.arcsec_per_h = 3600
            GYRZB.bias-instability.arcsec_per_h = 3600
        ",
        claims: &[
            claim("Allan deviation over flicker, 10 s", "IEEE Std 952", Value(FLICKER_FLOOR, FLATNESS), ""),
            claim("Allan deviation over flicker, 100 s", "IEEE Std 952", Value(FLICKER_FLOOR, FLATNESS), ""),
            claim("Allan deviation over flicker, 1000 s", "IEEE Std 952", Value(FLICKER_FLOOR, FLATNESS), ""),
            claim("Allan deviation over flicker, 10 000 s", "IEEE Std 952", Value(FLICKER_FLOOR, FLATNESS), ""),
        ],
        measure: |receiver| {
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
        },
    },
    Experiment {
        name: "drift hysteresis",
        noise: false,
        // Rises and falls at 2 K/h: a play of 0.2 K takes 360 s.
        configuration: "
            temperature.electronics_table = [[0, 20], [7200, 24], [14400, 20]]
            gyro.GYRX.drift-temperature-hysteresis = { arcsec_per_h = 360, width_k = 0.2 }
        ",
        claims: &[
            claim("drift while the temperature rises", "model", Value(360.0, 0.0), "″/h"),
            claim("drift while it falls", "model", Value(-360.0, 0.0), "″/h"),
            // To half a sample interval, 0.0003 K, over which drift and temperature are held.
            claim("width of the play", "model", Value(0.2, 0.0005), "K"),
        ],
        measure: |receiver| {
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
        },
    },
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
