//! Correlation of counts with the motion, and the factor between them.

use geu_protocol::Gyro;

use super::compared::CountComparison;
use super::findings::FindingCollector;
use super::moments::Moments;
use super::wiring_hypothesis::apply;
use crate::Finding;

/// Largest scale error of a factor; effects reach 5 %.
const MAX_SCALE_ERROR: f64 = 0.1;
/// Largest unexplained share of the variance of counts in a wrong unit, relative to the error of the factor. A gyro that follows the
/// motion half of the time has a factor of a half, with half of its variance unexplained.
const MAX_UNEXPLAINED: f64 = 0.2;
/// Samples in a sum: coarse counts contain little of one sample, short recordings few sums.
const SUMMED: [usize; 2] = [1, 600];
/// Minimum number of sums.
const MIN_SUMS: f64 = 16.0;
/// Minimum correlation of counts with a predicted motion of this rms.
const MIN_CORRELATION: f64 = 0.5;
const MIN_MOTION_COUNTS: f64 = 5.0;
/// Relative tolerance of a known factor.
const TOLERANCE: f64 = 0.06;

/// Causes of a factor.
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
    (57.295_780, "degrees in place of radians"),
    (1.0 / 57.295_780, "radians in place of degrees"),
    (4.848_137, "a count of 1 microradian"),
    (2.0, "counts per second instead of per sample interval"),
    (0.5, "a reference of double rates"),
];

/// The nearest known factor, and its cause.
pub fn known_factor(factor: f64) -> Option<(f64, &'static str)> {
    let off = |known: f64| (factor / known - 1.0).abs();
    let nearest = FACTORS.iter().min_by(|one, other| off(one.0).total_cmp(&off(other.0)))?;
    (off(nearest.0) < TOLERANCE).then_some(*nearest)
}

/// Variances and covariance of a gyro's predicted and measured counts.
struct Covariance {
    count: f64,
    predicted: f64,
    measured: f64,
    both: f64,
}

impl Covariance {
    /// With sums over `summed` samples.
    fn new(compared: &CountComparison, gyro: usize, summed: usize) -> Covariance {
        let mut states = Default::default();
        let pairs = compared.on_gyro(gyro).map(|sample| {
            let mut predicted = sample.predicted;
            apply(&sample.wiring, &mut states, &mut predicted);
            (predicted[gyro], sample.measured[gyro])
        });
        let Moments { count, x, y, xx, xy, yy } = Moments::of_sums(pairs, summed);
        let [p, m, pp, pm, mm] = [x, y, xx, xy, yy].map(|sum| sum / count.max(1.0));
        Covariance { count, predicted: (pp - p * p).max(0.0), measured: (mm - m * m).max(0.0), both: pm - p * m }
    }

    fn factor(&self) -> f64 {
        self.both / self.predicted
    }

    /// Share of the measured variance that follows the prediction.
    fn explained(&self) -> f64 {
        let both = self.both * self.both / (self.predicted * self.measured);
        if both.is_finite() { both } else { 0.0 }
    }

    fn is_of_another_unit(&self) -> bool {
        let error = (self.factor().abs() - 1.0).abs().min(1.0);
        self.is_determined() && error > MAX_SCALE_ERROR && 1.0 - self.explained() < MAX_UNEXPLAINED * error
    }

    fn is_determined(&self) -> bool {
        self.count >= MIN_SUMS && self.predicted > 0.0
    }
}

/// Number of gyros against which a motion is of opposite sign: fewer may be wrong themselves, or be all of one axis.
const MIN_REVERSED: usize = 3;

/// Relation of a gyro to the motion.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Sense {
    Follows,
    Against,
}

/// Finds that the gyros turn against the motion, which is then of opposite sign.
pub fn reversed(compared: &CountComparison) -> Option<String> {
    opposite(Gyro::ALL.into_iter().filter_map(|gyro| {
        let own = Covariance::new(compared, gyro.index(), 1);
        let is_moved = own.predicted > MIN_MOTION_COUNTS.powi(2);
        let is_against = (own.factor() + 1.0).abs() < MAX_SCALE_ERROR && 1.0 - own.explained() < MAX_UNEXPLAINED;
        let follows = own.both > 0.0 && own.explained().sqrt() > MIN_CORRELATION;
        let sense = if follows { Some(Sense::Follows) } else { (is_moved && is_against).then_some(Sense::Against) };
        Some((gyro.name(), sense.filter(|_| own.is_determined())?))
    }))
}

/// Reason to refuse a motion: several gyros turn against it and none follows.
pub fn opposite<'a>(gyros: impl Iterator<Item = (&'a str, Sense)>) -> Option<String> {
    let (names, senses): (Vec<&str>, Vec<Sense>) = gyros.unzip();
    (names.len() >= MIN_REVERSED && !senses.contains(&Sense::Follows)).then(|| {
        format!(
            "got the opposite: {} turn against it; reverse the signs of its rates or invert its quaternions, also if it is the harness that inverts \
             these gyros",
            names.join(", ")
        )
    })
}

/// Reports gyros with counts in a wrong unit and excludes them from the further checks. If two gyros are in a wrong unit, all are, even if a
/// gyro that turns little does not show it: returns the factor of the first and its cause.
pub fn wrong_units(compared: &mut CountComparison, findings: &mut FindingCollector) -> Option<String> {
    let mut wrong = Vec::new();
    for gyro in Gyro::ALL {
        let covariances = SUMMED.map(|summed| Covariance::new(compared, gyro.index(), summed));
        let Some(factor) = covariances.iter().find(|own| own.is_of_another_unit()).map(Covariance::factor) else {
            continue;
        };
        let likely = known_factor(factor.abs()).map_or(String::new(), |(_, name)| format!(", as by {name}"));
        let text = format!("counts are {factor:.6} times what the motion predicts{likely}");
        wrong.push(format!("got one in another unit: of {} the {text}; give both in the same unit", gyro.name()));
        findings.whole(Finding::UNIT_FACTOR, Some(gyro), text);
        compared.samples.iter_mut().for_each(|sample| sample.is_used[gyro.index()] = false);
    }
    (wrong.len() >= 2).then(|| wrong.swap_remove(0))
}

/// Reports gyros with counts that do not follow the motion, with the known wiring faults applied.
pub fn uncorrelated_gyros(compared: &CountComparison, findings: &mut FindingCollector) {
    for gyro in Gyro::ALL {
        let own = Covariance::new(compared, gyro.index(), 1);
        let correlation = own.explained().sqrt() * own.both.signum();
        if own.is_determined() && own.predicted > MIN_MOTION_COUNTS.powi(2) && correlation < MIN_CORRELATION {
            let text = format!("counts do not follow the motion: their correlation with it is {correlation:.2}");
            findings.whole("not-following", Some(gyro), text);
        }
    }
}
