//! The scale factor: launch, ageing, temperature, bend, clock (Casteren §3.2, §5, table 1, figure 7).

use geu_protocol::Gyro;

use super::estimate::{Fit, LineFit, curvature};
use super::receiver::{Row, between, reference_rates};
use super::{Estimate, Measurement};
use geu_model::units::{FULL_SCALE_ARCSEC_S, PPM, S_PER_DAY};

/// Days in a month, a twelfth of 365.25.
const DAYS_PER_MONTH: f64 = 30.4375;

pub const MEASUREMENTS: &[Measurement] = &[
    ("launch", |receiver| {
        let rows = receiver.listen(6180.0);
        vec![scale_factor_ppm(&rows, Gyro::ZA, 2), scale_factor_ppm(&rows, Gyro::ZB, 2)]
    }),
    ("ageing", |receiver| {
        receiver.listen(20.0);
        let rows = receiver.listen_every(20, S_PER_DAY);
        let points = rows.iter().map(|row| (row.t_s / S_PER_DAY - 0.5, row.residual(Gyro::ZA)));
        let scanned = LineFit::new(rows.iter().map(|row| (row.t_s / S_PER_DAY, row.counts[Gyro::ZA.index()])));
        let change_per_day = curvature(points).times(-2.0).over(scanned.slope);
        vec![change_per_day.times(DAYS_PER_MONTH / PPM)]
    }),
    ("temperature", |receiver| {
        let rows = receiver.listen(7200.0);
        let (cold, warm) = (between(&rows, 20.0, 3600.0), between(&rows, 3602.0, 7200.0));
        let change = scale_factor_ppm(warm, Gyro::ZA, 2).minus(scale_factor_ppm(cold, Gyro::ZA, 2));
        let kelvin = |rows: &[Row]| Estimate {
            value: f64::from(rows[rows.len() / 2].sample.electronics_centi_c) * 0.01,
            // The sample's value is rounded to 0.01 K, and the temperature is constant.
            sigma: 0.0,
        };
        let per_k = change.over(kelvin(warm).minus(kelvin(cold)));
        vec![per_k, per_k.times(2.0 * PPM * 100.0)]
    }),
    ("nonlinearity", |receiver| {
        let points = transfer_function(&receiver.listen(5300.0), Gyro::Y, 1);
        let cubes: Vec<_> = points
            .iter()
            .map(|(rate, departure)| {
                let share = rate / FULL_SCALE_ARCSEC_S;
                ([share, share * share * share], departure.value)
            })
            .collect();
        // The departures have their own sigma; the sigma of the fit is that of rounded counts.
        let sigma = points.iter().map(|(_, departure)| departure.sigma).fold(0.0, f64::max);
        let cubic = Fit::new(&cubes).estimate(1);
        let cubic = Estimate::new(cubic.value, cubic.sigma * sigma * 12f64.sqrt());
        let straight: Vec<_> = points.iter().map(|(rate, departure)| (*rate, departure.value)).collect();
        vec![
            cubic.times(-1.0 / FULL_SCALE_ARCSEC_S / PPM),
            Estimate::new(BestLine::new(&straight).departure, sigma).times(100.0 / FULL_SCALE_ARCSEC_S),
        ]
    }),
    ("asymmetry", |receiver| {
        let rows = receiver.listen(640.0);
        let forward = scale_factor_ppm(between(&rows, 20.0, 300.0), Gyro::Y, 1);
        vec![forward.minus(scale_factor_ppm(between(&rows, 340.0, 620.0), Gyro::Y, 1))]
    }),
    ("clock and scale factor", |receiver| {
        let rows = receiver.listen(12_000.0);
        let (nominal, fast) = (between(&rows, 20.0, 6000.0), between(&rows, 6001.0, 12_000.0));
        let change = scale_factor_ppm(fast, Gyro::ZA, 2).minus(scale_factor_ppm(nominal, Gyro::ZA, 2));
        vec![sample_s(fast), change.over(clock_ppm(fast))]
    }),
    ("clock and drift", |receiver| {
        let rows = receiver.listen(14_400.0);
        let (nominal, fast) = (between(&rows, 20.0, 7200.0), between(&rows, 7201.0, 14_400.0));
        // D in arcsec per on-board sample interval is −N·SF, with SF as in the previous experiment.
        let drift = |rows: &[Row], scale_factor: f64| {
            LineFit::new(rows.iter().enumerate().map(|(index, row)| {
                (index as f64, -row.counts[Gyro::X.index()] * scale_factor + row.reference_arcsec[0])
            }))
            .slope
        };
        let clock_ppm = clock_ppm(fast);
        let nominal = drift(nominal, 1.0);
        let change = drift(fast, 1.0 - clock_ppm.value * PPM).minus(nominal).over(nominal).times(1.0 / PPM);
        vec![change.over(clock_ppm)]
    }),
    ("stability", |receiver| {
        // Three half hours of the Z-scan.
        receiver.listen_every(u64::MAX, 1300.0);
        let rows = receiver.listen(6700.0);
        let halves = [0.0, 1800.0, 3600.0]
            .map(|from_s| scale_factor_ppm(between(&rows, 1300.0 + from_s, 3100.0 + from_s), Gyro::ZA, 2));
        let changes = [halves[1].minus(halves[0]), halves[2].minus(halves[1])];
        let larger = if changes[0].value.abs() > changes[1].value.abs() { changes[0] } else { changes[1] };
        vec![Estimate::new(larger.value.abs(), larger.sigma)]
    }),
];

/// Length of a sample, true time.
fn sample_s(rows: &[Row]) -> Estimate {
    let (first, last, count) = (rows[0], rows[rows.len() - 1], (rows.len() - 1) as f64);
    Estimate::new((last.t_s - first.t_s) / count, 1e-9 / 6f64.sqrt() / count)
}

/// Frequency error of the unit's clock.
fn clock_ppm(rows: &[Row]) -> Estimate {
    let frequency = sample_s(rows).relative_to(0.5);
    Estimate::new(frequency.value - 1.0, frequency.sigma).times(1.0 / PPM)
}

/// SF less 1: rotation about a control axis over counts.
fn scale_factor_ppm(rows: &[Row], gyro: Gyro, axis: usize) -> Estimate {
    // Counts less rotation, against rotation, so that small numbers are fitted.
    let excess = LineFit::new(rows.iter().map(|row| (row.reference_arcsec[axis], row.residual(gyro)))).slope;
    let counts_per_arcsec = Estimate::new(1.0 + excess.value, excess.sigma);
    let scale_factor = counts_per_arcsec.relative_to(1.0);
    Estimate::new(scale_factor.value - 1.0, scale_factor.sigma).times(1.0 / PPM)
}

/// Points of figure 7: each rate that is held for two minutes or more, and the excess of the counted rate.
pub fn transfer_function(rows: &[Row], gyro: Gyro, axis: usize) -> Vec<(f64, Estimate)> {
    let rates: Vec<(usize, f64)> = reference_rates(rows, axis).collect();
    rates
        .chunk_by(|a, b| (a.1 - b.1).abs() < 1e-6 * FULL_SCALE_ARCSEC_S)
        .filter(|held| held.len() >= 240)
        .map(|held| {
            let rows = &rows[held[0].0..=held[held.len() - 1].0];
            (held[0].1, LineFit::new(rows.iter().map(|row| (row.t_s, row.residual(gyro)))).slope)
        })
        .collect()
}

/// The straight line with the smallest maximum departure from points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BestLine {
    pub slope: f64,
    /// y at x = 0.
    pub level: f64,
    pub departure: f64,
}

impl BestLine {
    /// The best line of `points`: for each three points the line with equal departures of alternating sign; the three with
    /// the largest departure give the best line of all points.
    pub fn new(points: &[(f64, f64)]) -> BestLine {
        let mut points = points.to_vec();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = BestLine { slope: 0.0, level: 0.0, departure: 0.0 };
        for (i, a) in points.iter().enumerate() {
            for (j, b) in points.iter().enumerate().skip(i + 1) {
                for c in &points[j + 1..] {
                    let slope = (c.1 - a.1) / (c.0 - a.0);
                    let half = 0.5 * (b.1 - a.1 - slope * (b.0 - a.0));
                    if half.abs() >= best.departure {
                        best = BestLine { slope, level: a.1 - slope * a.0 + half, departure: half.abs() };
                    }
                }
            }
        }
        best
    }

    pub fn at(&self, x: f64) -> f64 {
        self.level + self.slope * x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_departs_by_a_quarter_from_its_best_line() {
        // Chebyshev: x³ − 3x/4 is at most 1/4 over −1…1.
        let points: Vec<_> = (-4..=4).map(|k| f64::from(k) / 4.0).map(|x| (x, 3.0 + 2.0 * x - x * x * x)).collect();
        let best = BestLine::new(&points);
        assert!((best.departure - 0.25).abs() < 1e-12);
        assert!((best.slope - 1.25).abs() < 1e-12 && (best.level - 3.0).abs() < 1e-12, "{best:?}");
    }
}
