//! The model along the reference, sample by sample.

use geu_model::attitude::RecordedAttitude;
use geu_model::{Configuration, GyroUnit, Truth};

use crate::filter::CLEARANCES_ARCSEC;

/// Mean distance of a reference's rows, in samples, from which they are sparse.
const SPARSE: f64 = 1.5;

/// The model along the reference.
#[derive(Debug)]
pub struct Model {
    pub unit: GyroUnit,
    /// Units with wider pivots, by each of [`CLEARANCES_ARCSEC`]; empty for a described unit.
    pub wider: Vec<GyroUnit>,
    pub truth: RecordedAttitude,
    pub near: usize,
    /// Sample interval, s.
    interval_s: f64,
    /// Gaps of the reference that are not yet over, the next one last.
    gaps_s: Vec<[f64; 2]>,
    /// Times of its rows that are not yet over, the next one last; empty if they are as dense as samples.
    rows_s: Vec<f64>,
}

impl Model {
    pub fn new(configuration: &Configuration, truth: RecordedAttitude) -> Model {
        let nominal = configuration.without_noise();
        let recorded = Truth::Recorded(truth.clone().into());
        let unit = GyroUnit::on(&nominal, &recorded);
        let interval_s = configuration.device.interval_s;
        let wider = CLEARANCES_ARCSEC.into_iter().filter(|_| configuration.device.is_iras()).map(|by_arcsec| {
            let mut wider = nominal.clone();
            for gyro in &mut wider.gyros {
                gyro.effects.constant.pivot_clearance.clearance_arcsec += by_arcsec;
            }
            GyroUnit::on(&wider, &recorded)
        });
        let wider = wider.collect();
        let gaps_s = truth.gaps_s().into_iter().rev().collect();
        let mut rows_s: Vec<f64> = truth.rows().map(|(t_s, _)| t_s).collect();
        rows_s.reverse();
        if rows_s[0] - rows_s[rows_s.len() - 1] < SPARSE * interval_s * rows_s.len() as f64 {
            rows_s.clear();
        }
        Model { unit, wider, truth, near: 0, interval_s, gaps_s, rows_s }
    }

    /// Ends samples; none beyond the reference, so that no link can ask for more.
    pub fn end_samples(&mut self, samples: u64) {
        let left = (self.truth.end_s() / self.interval_s) as u64 + 1;
        for _ in 0..samples.min(left.saturating_sub(self.unit.ended())) {
            self.unit.end_sample();
            self.wider.iter_mut().for_each(|wider| {
                wider.end_sample();
            });
        }
    }

    /// Widens the pivots of a gyro.
    pub fn widen(&mut self, gyro: usize, by_arcsec: f64) {
        for unit in std::iter::once(&mut self.unit).chain(&mut self.wider) {
            unit.reconfigure(|configuration| {
                let own = &mut configuration.gyros[gyro].effects.constant.pivot_clearance.clearance_arcsec;
                *own = (*own + by_arcsec).max(0.0);
            });
        }
    }

    /// True if the reference has the motion of the sample that ends then.
    pub fn covers(&mut self, end_s: f64) -> bool {
        let start_s = end_s - self.interval_s;
        while self.gaps_s.last().is_some_and(|gap| gap[1] <= start_s) {
            self.gaps_s.pop();
        }
        start_s >= self.truth.start_s()
            && end_s <= self.truth.end_s()
            && self.gaps_s.last().is_none_or(|gap| end_s <= gap[0])
    }

    /// True if the sample that ends then is the nearest to a row, where rows are sparse: each counts once, for its errors reach to its
    /// neighbours.
    pub fn is_at_row(&mut self, end_s: f64) -> bool {
        let interval_s = self.interval_s;
        let is_over = |row_s: &f64| *row_s < end_s - 0.5 * interval_s;
        while self.rows_s.len() > 1 && self.rows_s.last().is_some_and(is_over) {
            self.rows_s.pop();
        }
        self.rows_s.last().is_none_or(|row_s| *row_s < end_s + 0.5 * self.interval_s)
    }
}
