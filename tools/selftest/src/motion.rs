//! Speeds of the mission, the sun and the limit cycle, as a perfect gyro counts them (Casteren §3.3, §5, §6).

use geu_protocol::Gyro;

use super::estimate::{Fit, LineFit};
use super::receiver::{Row, between};
use super::{Estimate, Expected, Experiment, PublishedValue};
use geu_model::units::{ARCSEC_PER_DEG, S_PER_DAY};

const ARCSEC_PER_TURN: f64 = 360.0 * ARCSEC_PER_DEG;

pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "survey",
        noise: false,
        configuration: "manoeuvre = [{ kind = \"survey\", scans = 1 }]",
        claims: &[PublishedValue {
            what: "survey about Z",
            source: "§5",
            expected: Expected::Value(3.85, 0.005),
            unit: "′/s",
        }],
        measure: |receiver| vec![rate_arcmin_s(&receiver.listen(450.0), Gyro::Za, 20.0, 450.0)],
    },
    Experiment {
        name: "orbital speed",
        noise: false,
        configuration: "manoeuvre = [{ kind = \"z-scan\" }]",
        claims: &[
            PublishedValue {
                what: "orbital speed",
                source: "model",
                expected: Expected::Value(3.495, 0.0005),
                unit: "′/s",
            },
            PublishedValue { what: "orbit", source: "model", expected: Expected::Value(6180.0, 0.0), unit: "s" },
            PublishedValue {
                what: "orbital speed over survey's 3.85′/s, about 90 %",
                source: "§5",
                expected: Expected::Between(88.0, 92.0),
                unit: "%",
            },
        ],
        measure: |receiver| {
            let speed = rate_arcmin_s(&receiver.listen(6180.0), Gyro::Za, 20.0, 6180.0);
            vec![speed, speed.relative_to(ARCSEC_PER_TURN / 60.0), speed.times(100.0 / 3.85)]
        },
    },
    Experiment {
        name: "Y-scan",
        noise: false,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [{ kind = \"y-scan\", to_theta_deg = 120 }, { kind = \"y-scan\", to_theta_deg = 60 }]
        ",
        claims: &[
            PublishedValue {
                what: "Y-scan forward",
                source: "§5, §5.3",
                expected: Expected::Value(12.0, 0.0),
                unit: "′/s",
            },
            PublishedValue {
                what: "Y-scan back",
                source: "§5, §5.3",
                expected: Expected::Value(-12.0, 0.0),
                unit: "′/s",
            },
        ],
        measure: |receiver| {
            let rows = receiver.listen(640.0);
            vec![rate_arcmin_s(&rows, Gyro::Y, 20.5, 300.0), rate_arcmin_s(&rows, Gyro::Y, 340.5, 620.0)]
        },
    },
    Experiment {
        name: "X rates in survey",
        noise: false,
        configuration: "
            scenario.theta_deg = 60
            manoeuvre = [
                { kind = \"survey\", scans = 1 },
                { kind = \"y-scan\", to_theta_deg = 120 },
                { kind = \"survey\", scans = 1 },
            ]
        ",
        claims: &[
            PublishedValue {
                what: "X rate, survey at θ = 60°",
                source: "§5",
                expected: Expected::Value(2.22, 0.005),
                unit: "′/s",
            },
            PublishedValue {
                what: "X rate, survey at θ = 120°",
                source: "§5",
                expected: Expected::Value(-2.22, 0.005),
                unit: "′/s",
            },
        ],
        measure: |receiver| {
            let rows = receiver.listen(1130.0);
            vec![rate_arcmin_s(&rows, Gyro::X, 20.0, 395.0), rate_arcmin_s(&rows, Gyro::X, 760.0, 1130.0)]
        },
    },
    Experiment {
        name: "sun",
        noise: false,
        configuration: "",
        claims: &[PublishedValue {
            what: "a turn of the sun, seen in a pointing",
            source: "§5.1, §6",
            expected: Expected::Value(365.25, 0.0),
            unit: "d",
        }],
        measure: |receiver| {
            let rows = receiver.listen(21_600.0);
            vec![rate_arcmin_s(&rows, Gyro::X, 0.0, 21_600.0).relative_to(ARCSEC_PER_TURN / 60.0 / S_PER_DAY)]
        },
    },
    Experiment {
        name: "limit cycle",
        noise: false,
        configuration: "scenario.limit_cycle = { rate_arcsec_s = 5 }",
        claims: &[
            PublishedValue {
                what: "limit cycle's largest rate",
                source: "§3.3",
                expected: Expected::Value(5.0, 0.0),
                unit: "″/s",
            },
            PublishedValue {
                what: "limit cycle's period",
                source: "§3.3",
                expected: Expected::Value(5.0, 0.0),
                unit: "s",
            },
            PublishedValue {
                what: "limit cycle's amplitude",
                source: "model",
                expected: Expected::AtMost(5.0),
                unit: "″",
            },
        ],
        measure: |receiver| {
            let rows = receiver.listen(3600.0);
            let (early, late) = (swing(between(&rows, 0.0, 1800.0)), swing(between(&rows, 1800.0, 3600.0)));
            let amplitude =
                Estimate::new(0.5 * (early.0.value + late.0.value), 0.5 * early.0.sigma.hypot(late.0.sigma));
            // What the phase moves in half an hour is what the period differs from 5 s.
            let advance = late.1.minus(early.1).times(1.0 / std::f64::consts::TAU / 1800.0);
            let period = Estimate::new(1.0 / 5.0 + advance.value, advance.sigma).relative_to(1.0);
            let rate = amplitude.times(std::f64::consts::TAU).over(period);
            vec![rate, period, amplitude]
        },
    },
];

/// Mean rate of a gyro's counts between two instants.
fn rate_arcmin_s(rows: &[Row], gyro: Gyro, from_s: f64, to_s: f64) -> Estimate {
    let rows = between(rows, from_s, to_s);
    LineFit::of(rows.iter().map(|row| (row.t_s, row.counts[gyro as usize]))).slope.times(1.0 / 60.0)
}

/// Amplitude of GYRX's angle at a period of 5 s, and its phase in radians.
fn swing(rows: &[Row]) -> (Estimate, Estimate) {
    let middle_s = 0.5 * (rows[0].t_s + rows[rows.len() - 1].t_s);
    let points: Vec<_> = rows
        .iter()
        .map(|row| {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * row.t_s / 5.0);
            ([1.0, row.t_s - middle_s, sin, cos], row.counts[Gyro::X as usize])
        })
        .collect();
    let fit = Fit::of(&points);
    let (sin, cos) = (fit.estimate(2), fit.estimate(3));
    let (amplitude, sigma) = (sin.value.hypot(cos.value), sin.sigma.max(cos.sigma));
    (Estimate::new(amplitude, sigma), Estimate::new(libm::atan2(cos.value, sin.value), sigma / amplitude))
}
