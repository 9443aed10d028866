//! The axis of the reference that the output of a head follows, and by which factor.

use geu_calibration::counts::{AccumulatedCounts, ConstantRun};
use geu_model::Configuration;
use nalgebra::{MatrixXx3, Vector3};

use crate::median;

/// Nodes of a window, and the minimum number of windows.
const WINDOW: usize = 10;
pub const MIN_WINDOWS: usize = 16;
/// Share of a head's variance that another head's axis must explain, and more than its own axis by that.
pub const EXPLAINED: f64 = 0.7;
const BETTER: f64 = 0.3;
/// Share of its variance below which a head does not follow the motion: a correlation of a half.
pub const FOLLOWS: f64 = 0.25;
/// Error of a factor from which a unit is wrong: scale factors are off by less.
const FACTOR_ERROR: f64 = 0.25;

/// The axis that a head follows.
#[derive(Debug, Clone, Copy)]
pub struct Follows {
    /// The head with this nominal axis.
    pub axis: usize,
    /// Output per turn about it.
    pub factor: f64,
    /// Share of the variance that it explains.
    pub explained: f64,
}

impl Follows {
    /// The nominal axis.
    pub fn nominal(head: usize) -> Follows {
        Follows { axis: head, factor: 1.0, explained: 1.0 }
    }

    /// The axis that explains the output of a head best, outside its breaks and `without` these gyros and nodes; its own unless another is better by far. `None` if the recording does not show it.
    pub fn find(
        head: usize,
        counts: &AccumulatedCounts,
        without: &[ConstantRun],
        turned: &[Option<Vector3<f64>>],
        matrix: &MatrixXx3<f64>,
        configuration: &Configuration,
    ) -> Option<Follows> {
        let mut is_broken = vec![false; turned.len()];
        let breaks = counts.breaks.iter().filter(|found| found.gyros[head]).map(|found| found.from..found.to);
        let without = without.iter().filter(|run| run.gyro == head).map(|run| run.from..run.to);
        breaks.chain(without).for_each(|nodes| is_broken[nodes].fill(true));
        let scale_factor = configuration.gyros[head].calibration.scale_factor;
        let mut windows: Vec<(f64, Vector3<f64>)> = Vec::new();
        for from in (0..turned.len().saturating_sub(WINDOW)).step_by(WINDOW) {
            let to = from + WINDOW;
            let (Some(before), Some(after)) = (turned[from], turned[to]) else { continue };
            if !is_broken[from..to].contains(&true) {
                let measured = counts.accumulated[head][to] - counts.accumulated[head][from];
                windows.push((measured * scale_factor, after - before));
            }
        }
        if windows.len() < MIN_WINDOWS {
            return None;
        }
        let count = windows.len() as f64;
        let mean =
            windows.iter().fold((0.0, Vector3::zeros()), |sum, own| (sum.0 + own.0 / count, sum.1 + own.1 / count));
        let about = |axis: usize| {
            let axis = matrix.row(axis).transpose();
            let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
            for (measured, turn) in &windows {
                let (x, y) = (axis.dot(&(turn - mean.1)), measured - mean.0);
                (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
            }
            let explained = if xx > 0.0 && yy > 0.0 { xy * xy / (xx * yy) } else { 0.0 };
            (xx / count, Follows { axis: 0, factor: xy / xx, explained })
        };
        let all: Vec<(f64, Follows)> = (0..matrix.nrows())
            .map(|axis| {
                let (variance, own) = about(axis);
                (variance, Follows { axis, ..own })
            })
            .collect();
        // A motion below the noise of the reference does not show an axis.
        let noise = {
            let mut steps: Vec<f64> =
                windows.windows(3).map(|own| (own[0].1 - 2.0 * own[1].1 + own[2].1).norm()).collect();
            median(&mut steps).powi(2) / 6.0
        };
        let largest = all.iter().map(|own| own.0).fold(0.0, f64::max);
        if all[head].0 <= noise.max(1e-3 * largest) && largest > 0.0 && all[head].1.explained < FOLLOWS {
            let other = all.iter().map(|own| own.1).max_by(|one, other| one.explained.total_cmp(&other.explained))?;
            return (other.explained > EXPLAINED && other.axis != head).then_some(other);
        }
        let own = all[head].1;
        let best = all.iter().map(|own| own.1).max_by(|one, other| one.explained.total_cmp(&other.explained))?;
        let is_other = best.explained > EXPLAINED && best.explained > own.explained + BETTER;
        Some(if is_other { best } else { own })
    }

    /// The factor of a wrong unit, larger than scale factors have; else 1.
    pub fn unit(&self) -> f64 {
        let factor = self.factor.abs();
        let is_wrong = (factor - 1.0).abs() > FACTOR_ERROR || factor < 1.0 / (1.0 + FACTOR_ERROR);
        if is_wrong { factor } else { 1.0 }
    }
}
