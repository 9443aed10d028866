//! Whether counts follow the motion at all, and by which factor.

use geu_protocol::Gyro;

use super::compared::CountComparison;
use super::told::FindingCollector;

/// Factors beyond this are none of a scale factor, whose effects go to 5 %.
const ORDINARY: f64 = 0.1;
/// What is left of the counts' variance beside a factor, as a part of how far it is from 1. A gyro that follows half of the
/// time has a factor of a half, and half of its variance is left.
const LEFT: f64 = 0.2;
/// Samples over which counts are summed: coarse counts show little of a sample, short recordings have few sums.
const SUMMED: [usize; 2] = [1, 600];
/// Sums that must be compared.
const FEWEST: usize = 16;
/// Counts that follow have at least this correlation, if the prediction moves by so many counts rms.
const FOLLOWS: f64 = 0.5;
const MOVES_COUNTS: f64 = 5.0;
/// A factor is called by a name within this.
const NAMED: f64 = 0.06;

/// What makes counts so many times too large.
const FACTORS: &[(f64, &str)] = &[
    (0.1, "a count of 10 arcsec"),
    (10.0, "a count of 0.1 arcsec"),
    (0.01, "a count of 100 arcsec"),
    (100.0, "a count of 0.01 arcsec"),
    (1e-3, "a reference in milliarcsec"),
    (1000.0, "a count of 1 mas"),
    (1.0 / 60.0, "counts in arcmin"),
    (60.0, "a reference in arcmin/s"),
    (1.0 / 3600.0, "counts in degrees"),
    (3600.0, "a reference in degrees/s"),
    (1.0 / 206_264.806, "counts in radians"),
    (206_264.806, "a reference in rad/s"),
    (206.264_806, "a reference in mrad/s"),
    (4.848_137, "a count of 1 microradian"),
    (2.0, "counts per second instead of per sample interval"),
    (0.5, "a reference of double rates"),
];

/// Moments of a gyro's counts and their prediction about their means.
struct Moments {
    count: usize,
    predicted: f64,
    measured: f64,
    both: f64,
}

impl Moments {
    /// By sums of so many samples.
    fn of(compared: &CountComparison, gyro: usize, summed: usize) -> Moments {
        let mut states = Default::default();
        let (mut count, mut sums) = (0, [0.0; 5]);
        let (mut halves, mut p, mut m) = (0, 0.0, 0.0);
        for half in compared.of_gyro(gyro) {
            let mut predicted = half.predicted;
            super::law::apply(&half.wiring, &mut states, &mut predicted);
            (halves, p, m) = (halves + 1, p + predicted[gyro], m + half.measured[gyro]);
            if halves < summed {
                continue;
            }
            count += 1;
            for (sum, term) in sums.iter_mut().zip([p, m, p * p, m * m, p * m]) {
                *sum += term;
            }
            (halves, p, m) = (0, 0.0, 0.0);
        }
        let n = (count as f64).max(1.0);
        let [p, m, pp, mm, pm] = sums.map(|sum| sum / n);
        Moments { count, predicted: (pp - p * p).max(0.0), measured: (mm - m * m).max(0.0), both: pm - p * m }
    }

    fn factor(&self) -> f64 {
        self.both / self.predicted
    }

    /// Part of the counts' variance that follows the prediction.
    fn explained(&self) -> f64 {
        let both = self.both * self.both / (self.predicted * self.measured);
        if both.is_finite() { both } else { 0.0 }
    }

    fn is_of_another_unit(&self) -> bool {
        let off = (self.factor().abs() - 1.0).abs().min(1.0);
        self.is_moved() && off > ORDINARY && 1.0 - self.explained() < LEFT * off
    }

    fn is_moved(&self) -> bool {
        self.count >= FEWEST && self.predicted > 0.0
    }
}

/// Tells gyros whose counts are in a wrong unit, and leaves them out of what follows. Whether the others can be judged:
/// where two gyros are in a wrong unit, all are, and those that turn little do not show it.
pub fn wrong_units(compared: &mut CountComparison, told: &mut FindingCollector) -> bool {
    let wrong: Vec<(Gyro, f64)> = Gyro::ALL
        .into_iter()
        .filter_map(|gyro| {
            let moments = SUMMED.map(|summed| Moments::of(compared, gyro as usize, summed));
            moments.iter().find(|moments| moments.is_of_another_unit()).map(|moments| (gyro, moments.factor()))
        })
        .collect();
    for &(gyro, factor) in &wrong {
        let name = FACTORS.iter().find(|(known, _)| (factor.abs() / known - 1.0).abs() < NAMED);
        let likely = name.map_or(String::new(), |(_, name)| format!(", as by {name}"));
        let text = format!("counts are {factor:.6} times what the motion predicts{likely}");
        told.whole("unit-factor", Some(gyro), text);
        compared.halves.iter_mut().for_each(|half| half.is_used[gyro as usize] = false);
    }
    wrong.len() < 2
}

/// Tells gyros that do not follow the motion, once wiring that is known for it is taken into account.
pub fn uncorrelated_gyros(compared: &CountComparison, told: &mut FindingCollector) {
    for gyro in Gyro::ALL {
        let moments = Moments::of(compared, gyro as usize, 1);
        let correlation = moments.explained().sqrt() * moments.both.signum();
        if moments.is_moved() && moments.predicted > MOVES_COUNTS * MOVES_COUNTS && correlation < FOLLOWS {
            let text = format!("counts do not follow the motion: their correlation with it is {correlation:.2}");
            told.whole("not-following", Some(gyro), text);
        }
    }
}
