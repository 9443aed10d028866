//! Speeds of the mission, the sun and the limit cycle, as a perfect gyro counts them (Casteren §3.3, §5, §6).

use geu_protocol::Gyro;

use super::estimate::{Fit, LineFit, amplitude_of};
use super::receiver::{Row, between};
use super::{Estimate, Measurement};
use geu_model::units::{ARCSEC_PER_DEG, S_PER_DAY};

const ARCSEC_PER_TURN: f64 = 360.0 * ARCSEC_PER_DEG;

pub const MEASUREMENTS: &[Measurement] = &[
    ("survey", |receiver| vec![rate_arcmin_s(&receiver.listen(450.0), Gyro::ZA, 20.0, 450.0)]),
    ("orbital speed", |receiver| {
        let speed = rate_arcmin_s(&receiver.listen(6180.0), Gyro::ZA, 20.0, 6180.0);
        vec![speed, speed.relative_to(ARCSEC_PER_TURN / 60.0), speed.times(100.0 / 3.85)]
    }),
    ("Y-scan", |receiver| {
        let rows = receiver.listen(640.0);
        vec![rate_arcmin_s(&rows, Gyro::Y, 20.5, 300.0), rate_arcmin_s(&rows, Gyro::Y, 340.5, 620.0)]
    }),
    ("X rates in survey", |receiver| {
        let rows = receiver.listen(1130.0);
        vec![rate_arcmin_s(&rows, Gyro::X, 20.0, 395.0), rate_arcmin_s(&rows, Gyro::X, 760.0, 1130.0)]
    }),
    ("sun", |receiver| {
        let rows = receiver.listen(21_600.0);
        vec![rate_arcmin_s(&rows, Gyro::X, 0.0, 21_600.0).relative_to(ARCSEC_PER_TURN / 60.0 / S_PER_DAY)]
    }),
    ("limit cycle", |receiver| {
        let rows = receiver.listen(3600.0);
        let (early, late) = (swing(between(&rows, 0.0, 1800.0)), swing(between(&rows, 1800.0, 3600.0)));
        let amplitude = Estimate::new(0.5 * (early.0.value + late.0.value), 0.5 * early.0.sigma.hypot(late.0.sigma));
        // The phase shift in half an hour gives the difference of the period from 5 s.
        let advance = late.1.minus(early.1).times(1.0 / std::f64::consts::TAU / 1800.0);
        let period = Estimate::new(1.0 / 5.0 + advance.value, advance.sigma).relative_to(1.0);
        let rate = amplitude.times(std::f64::consts::TAU).over(period);
        vec![rate, period, amplitude]
    }),
];

/// Mean rate of a gyro's counts between two instants.
fn rate_arcmin_s(rows: &[Row], gyro: Gyro, from_s: f64, to_s: f64) -> Estimate {
    let rows = between(rows, from_s, to_s);
    LineFit::new(rows.iter().map(|row| (row.t_s, row.counts[gyro.index()]))).slope.times(1.0 / 60.0)
}

/// Amplitude of GYRX's angle at a period of 5 s, and its phase in radians.
fn swing(rows: &[Row]) -> (Estimate, Estimate) {
    let middle_s = 0.5 * (rows[0].t_s + rows[rows.len() - 1].t_s);
    let points: Vec<_> = rows
        .iter()
        .map(|row| {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * row.t_s / 5.0);
            ([1.0, row.t_s - middle_s, sin, cos], row.counts[Gyro::X.index()])
        })
        .collect();
    let fit = Fit::new(&points);
    let (sin, cos) = (fit.estimate(2), fit.estimate(3));
    let amplitude = amplitude_of(sin, cos);
    (amplitude, Estimate::new(libm::atan2(cos.value, sin.value), amplitude.sigma / amplitude.value))
}
