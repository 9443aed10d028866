//! Pivot clearance (Casteren §3.3, figure 6). GYRX's output axis is Y, so a Y-scan moves its float.

use geu_protocol::Gyro;

use super::estimate::{Fit, LineFit, amplitude_of, level};
use super::receiver::{Row, between, reference_rates};
use super::{Estimate, Measurement, Receiver};

pub const MEASUREMENTS: &[Measurement] = &[
    ("clearance", |receiver| {
        let [end_to_end, stop] = ends(receiver);
        vec![end_to_end, stop]
    }),
    ("clearance above the limit", |receiver| vec![ends(receiver)[0]]),
    ("transit", |receiver| {
        let rows = receiver.listen(900.0);
        let at_rest = level(between(&rows, 1.0, 150.0).iter().map(|row| row.residual(Gyro::X)));
        // The part of the transit well away from either stop.
        let passes =
            |arcsec: f64| rows.partition_point(|row| row.t_s < 150.0 || row.residual(Gyro::X) < at_rest.value + arcsec);
        let (from, to) = (passes(2.0), passes(12.0));
        if from + 2 > to {
            return vec![Estimate::new(f64::NAN, 0.0); 2];
        }
        let transit = LineFit::new(rows[from..to].iter().map(|row| (row.reference_arcsec[1], row.residual(Gyro::X))));
        // The rate about Y where the transit's line leaves the level of rest.
        let start_arcsec = transit.reaches(at_rest);
        let rates: Vec<_> = reference_rates(&rows, 1).collect();
        let rate_at = |arcsec: f64| {
            rates.iter().find(|(index, _)| rows[*index].reference_arcsec[1] >= arcsec).map_or(f64::NAN, |rate| rate.1)
        };
        let sigma =
            0.5 * (rate_at(start_arcsec.value + start_arcsec.sigma) - rate_at(start_arcsec.value - start_arcsec.sigma));
        vec![transit.slope.times(100.0), Estimate::new(rate_at(start_arcsec.value), sigma)]
    }),
    ("creep", |receiver| {
        let rows = receiver.listen(2200.0);
        let slewing = |rate: f64| rate.abs() >= 1.5;
        let slew_end_s = reference_rates(&rows, 1)
            .filter(|(_, rate)| slewing(*rate))
            .last()
            .map_or(f64::NAN, |(index, _)| rows[index].t_s);
        let residuals =
            |from_s: f64, to_s: f64| between(&rows, from_s, to_s).iter().map(|row| (row.t_s, row.residual(Gyro::X)));
        let creep = LineFit::new(residuals(100.0, 950.0));
        let home = level(residuals(1100.0, 2200.0).map(|point| point.1));
        let arrival_s = creep.reaches(home);
        let transit_s = Estimate::new(arrival_s.value - slew_end_s, arrival_s.sigma);
        vec![creep.slope.times(-1.0), transit_s.times(1.0 / 60.0)]
    }),
    ("float in the limit cycle", |receiver| {
        let points: Vec<_> = receiver
            .listen(36_000.0)
            .iter()
            .map(|row| {
                let (sin, cos) = libm::sincos(std::f64::consts::TAU * row.t_s / 5.0);
                ([1.0, sin, cos], row.residual(Gyro::X))
            })
            .collect();
        let fit = Fit::new(&points);
        // End to end.
        vec![amplitude_of(fit.estimate(1), fit.estimate(2)).times(2.0)]
    }),
];

/// From stop to stop, and from the preferred position to a stop.
fn ends(receiver: &mut Receiver) -> [Estimate; 2] {
    let rows = receiver.listen(200.0);
    let stop =
        |from_s: f64, to_s: f64| level(between(&rows, from_s, to_s).iter().map(|row: &Row| row.residual(Gyro::X)));
    let (upper, lower) = (stop(25.0, 50.0), stop(100.0, 170.0));
    [upper.minus(lower), upper]
}
