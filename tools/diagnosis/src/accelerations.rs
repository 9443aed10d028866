//! Drifts in proportion to accelerations, where the reference has them: no effect of the model, since the unit does not know them.
//!
//! They are fitted before the search, which would name other effects in their place, and taken from the counts if they are evident and leave
//! less than half of what is not noise; after the search they are fitted again beside the effects.

use geu_calibration::AccumulatedCounts;
use geu_checks::Finding;
use geu_model::units::S_PER_H;
use geu_recording::ReferenceAttitude;

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::BLOCK;
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
        let (mut sum, mut before_s, mut near) = ([0.0; 3], 0.0, 0);
        let at = |node_s: &f64| {
            let t_s = node_s + offset_s;
            while near + 1 < known.len() && known[near + 1].0 <= t_s {
                near += 1;
            }
            let own = if t_s < first.0 { first.1 } else { known[near].1 };
            let length_s = node_s - std::mem::replace(&mut before_s, *node_s);
            sum = std::array::from_fn(|axis| sum[axis] + own[axis] * length_s);
            sum
        };
        AccelerationDrifts { integrals: counts.node_s.iter().map(at).collect(), drifts }
    }

    /// Takes from counts what a state leaves of the drifts. Before the search, `is_first`, only evident ones.
    pub fn subtract(
        &mut self,
        counts: &mut AccumulatedCounts,
        case: &DiagnosisCase,
        state: &ModelState,
        is_first: bool,
    ) {
        if self.integrals.is_empty() {
            return;
        }
        let (residual, nuisances) = case.linearised(&mut state.clone());
        let normal = |columns: &[Nuisance]| {
            let a_priori = case.a_priori(&state.calibration);
            NormalEquations::new(case.whitenings(&state.noise), &residual, columns, &a_priori)
        };
        let averages = self.averages(case);
        let of_gyro = |gyro: usize| averages.iter().map(move |own| (gyro, own));
        let all = (0..self.drifts.len()).flat_map(of_gyro);
        let column =
            |(gyro, own): (usize, &Vec<f64>)| std::array::from_fn(|channel| (channel == gyro).then(|| own.clone()));
        let columns: Vec<Nuisance> = nuisances.iter().cloned().chain(all.map(column)).collect();
        let (without, with) = (normal(&nuisances), normal(&columns));
        let (solution, covariance) = with.solution();
        let left = [&without, &with].map(NormalEquations::projected_residual);
        for (gyro, drifts) in self.drifts.iter_mut().enumerate() {
            let [before, after] = [0, 1].map(|own| left[own][gyro].iter().map(|white| white * white).sum::<f64>());
            let excess = before - left[0][gyro].iter().filter(|white| **white != 0.0).count() as f64;
            let is_subtracted = drifts.iter().any(|own| own.1 > 0.0);
            let is_evident = before - after > EVIDENT_CHI2.max(EXPLAINED * excess);
            if !(is_evident && is_first || is_subtracted) {
                continue;
            }
            for (axis, drift) in drifts.iter_mut().enumerate() {
                let place = nuisances.len() + 3 * gyro + axis;
                *drift = (drift.0 + solution[place], covariance[(place, place)].sqrt());
                let sums = counts.accumulated[gyro].iter_mut().zip(&self.integrals);
                sums.for_each(|(sum, integral)| *sum -= solution[place] * integral[axis]);
            }
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
