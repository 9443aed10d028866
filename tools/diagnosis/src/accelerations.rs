//! Drifts in proportion to accelerations, where the reference has them: no effect of the model, since the unit does not know them.
//!
//! They are fitted before the search, which would name other effects in their place, and taken from the counts if they are evident and
//! explain more than half of what is not noise, along the axes that show them; after the search they are fitted again beside the effects.

use geu_calibration::AccumulatedCounts;
use geu_checks::Finding;
use geu_model::units::S_PER_H;
use geu_recording::ReferenceAttitude;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{BLOCK, Series};
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, Nuisance};
use crate::residual_map::SIGNIFICANT;

/// Reduction of χ² on a gyro from which the drift is evident, ten sigma, and the share of what is not noise that it explains.
const EVIDENT_CHI2: f64 = 100.0;
const EXPLAINED: f64 = 0.5;
const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Drifts per acceleration along each axis.
#[derive(Debug, Clone, Default)]
pub struct AccelerationDrifts {
    /// Integral of the acceleration along each axis up to each node, m/s; empty without accelerations.
    integrals: Vec<[f64; 3]>,
    /// Drift of each gyro per acceleration, subtracted, counts/s per m/s², with its sigma.
    drifts: Vec<[(f64, f64); 3]>,
}

impl AccelerationDrifts {
    /// None yet, for the accelerations of a reference moved by a lag.
    pub fn none(counts: &AccumulatedCounts, reference: &ReferenceAttitude, lag_s: f64) -> AccelerationDrifts {
        let (known, offset_s) = (&reference.acceleration_m_s2, counts.offset_s(reference) - lag_s);
        let drifts = vec![[(0.0, 0.0); 3]; counts.gyros.heads()];
        let (Some(first), true) = (known.first(), known.len() > 1) else { return AccelerationDrifts::default() };
        // The integral up to each row: beside attitudes by trapezoids, beside rates of means over the rows. Between rows a straight line of it.
        let (mut sum, mut before) = ([0.0; 3], *first);
        let at_row = |own: &(f64, [f64; 3])| {
            let (before_s, last) = std::mem::replace(&mut before, *own);
            let share = if reference.is_attitude { 0.5 } else { 0.0 };
            let mean = |axis: usize| share * last[axis] + (1.0 - share) * own.1[axis];
            sum = std::array::from_fn(|axis| sum[axis] + (own.0 - before_s) * mean(axis));
            (own.0, sum)
        };
        let rows: Vec<(f64, [f64; 3])> = known.iter().map(at_row).collect();
        let at = |node_s: &f64| {
            let t_s = node_s + offset_s;
            let after = rows.partition_point(|own| own.0 < t_s).clamp(1, rows.len() - 1);
            let [(from_s, from), (to_s, to)] = [rows[after - 1], rows[after]];
            let share = ((t_s - from_s) / (to_s - from_s).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]))
        };
        AccelerationDrifts { integrals: counts.node_s.iter().map(at).collect(), drifts }
    }

    /// Takes from counts and their residual the drifts that a state leaves. Before the search, `is_first`, only evident ones.
    pub fn subtract(
        &mut self,
        (counts, residual): (&mut AccumulatedCounts, &mut Series),
        case: &DiagnosisCase,
        state: &ModelState,
        is_first: bool,
    ) {
        if self.integrals.is_empty() {
            return;
        }
        let (linear, nuisances) = case.linearised(&mut state.clone());
        let averages = self.averages(case);
        let normal = |fitted: &[(usize, usize)]| {
            let column = |&(gyro, axis): &(usize, usize)| -> Nuisance {
                std::array::from_fn(|channel| (channel == gyro).then(|| averages[axis].clone()))
            };
            let columns: Vec<Nuisance> = nuisances.iter().cloned().chain(fitted.iter().map(column)).collect();
            NormalEquations::new(case.whitenings(&state.noise), &linear, &columns, &case.a_priori(&state.calibration))
        };
        let fit = |fitted: &[(usize, usize)]| -> Vec<(f64, f64)> {
            let (solution, covariance) = normal(fitted).solution();
            let places = nuisances.len()..nuisances.len() + fitted.len();
            places.map(|place| (solution[place], covariance[(place, place)].sqrt())).collect()
        };
        let all: Vec<(usize, usize)> =
            (0..self.drifts.len()).flat_map(|gyro| [0, 1, 2].map(|axis| (gyro, axis))).collect();
        let left = [&normal(&[]), &normal(&all)].map(NormalEquations::projected_residual);
        let is_evident = |gyro: usize| {
            let [before, after] = left.each_ref().map(|own| own[gyro].iter().map(|white| white * white).sum::<f64>());
            let excess = before - left[0][gyro].iter().filter(|white| **white != 0.0).count() as f64;
            before - after > EVIDENT_CHI2.max(EXPLAINED * excess)
        };
        let evident: Vec<bool> = (0..self.drifts.len()).map(is_evident).collect();
        // Along an axis of constant acceleration it is a drift.
        let is_fitted = |((gyro, axis), drift): &(&(usize, usize), (f64, f64))| match is_first {
            true => evident[*gyro] && drift.0.abs() > SIGNIFICANT * drift.1,
            false => self.drifts[*gyro][*axis].1 > 0.0,
        };
        let fitted: Vec<(usize, usize)> = all.iter().zip(fit(&all)).filter(is_fitted).map(|own| *own.0).collect();
        for (&(gyro, axis), (left, sigma)) in fitted.iter().zip(fit(&fitted)) {
            let drift = &mut self.drifts[gyro][axis];
            *drift = (drift.0 + left, sigma);
            let sums = counts.accumulated[gyro].iter_mut().zip(&self.integrals);
            sums.for_each(|(sum, integral)| *sum -= left * integral[axis]);
            residual[gyro].iter_mut().zip(&averages[axis]).for_each(|(own, average)| *own -= left * average);
        }
    }

    /// Integrals averaged over blocks, of each axis.
    fn averages(&self, case: &DiagnosisCase) -> [Vec<f64>; 3] {
        let nodes = &self.integrals[1..=case.measured.block_count() * BLOCK];
        let average = |axis: usize| {
            let of_block = |block: &[[f64; 3]]| block.iter().map(|own| own[axis]).sum::<f64>() / BLOCK as f64;
            nodes.chunks(BLOCK).map(of_block).collect()
        };
        [0, 1, 2].map(average)
    }

    pub fn is_found(&self) -> bool {
        self.drifts.iter().flatten().any(|own| own.1 > 0.0)
    }

    pub fn findings(&self, case: &DiagnosisCase) -> Vec<Finding> {
        let angle = case.nominal.device.angle_unit();
        let finding = |(gyro, drifts): (usize, &[(f64, f64); 3])| {
            let significant =
                AXES.iter().zip(drifts).filter(|(_, own)| own.1 > 0.0 && own.0.abs() > SIGNIFICANT * own.1);
            let value = |(axis, (drift, sigma)): (&&str, &(f64, f64))| {
                // A drift turns the reference, not the measured angle.
                let [drift, sigma] = [-drift, *sigma].map(|own| angle.fixed(own * S_PER_H, 2));
                format!("{drift} ± {sigma} along {axis}")
            };
            let values: Vec<String> = significant.map(value).collect();
            let text = format!(
                "the drift follows the acceleration, which the model does not know, {}/h per m/s2: {}: subtracted",
                angle.name,
                values.join(", ")
            );
            let place = case.nominal.device.heads[gyro].gyro.name().to_owned();
            (!values.is_empty()).then(|| Finding { kind: Finding::ACCELERATION.to_owned(), place, text })
        };
        self.drifts.iter().enumerate().filter_map(finding).collect()
    }
}
