//! Drifts of the gyros in the further trials of a recording, beside those in the first one.
//!
//! They are not solved with the parameters: each is a common error of the equations of its trial and gyro, of which the solution does not
//! depend, and is estimated from what the solution leaves.

use geu_recording::ReferenceAttitude;
use nalgebra::{DMatrix, DVector};

use super::{Equations, Observation, PER_GYRO, Solution, SolveError, TrialDrift, root};

/// The trial of each equation's observation.
pub struct TrialsOfObservations {
    /// Number of the trial of each observation.
    numbers: Vec<usize>,
    names: Vec<String>,
    /// Sigma of a drift before the data, arcsec/0.5 s.
    sigma: f64,
}

impl TrialsOfObservations {
    /// The trials of a reference that begins `-offset_s` after the recording.
    pub fn new(observations: &[Observation], reference: &ReferenceAttitude, offset_s: f64, sigma: f64) -> Self {
        let names = reference.trials.iter().map(|trial| trial.name.clone()).collect();
        let of = |own: &Observation| {
            let middle_s = 0.5 * (own.start_s + own.end_s) + offset_s;
            reference.trials.partition_point(|trial| trial.from_s <= middle_s).saturating_sub(1)
        };
        TrialsOfObservations { numbers: observations.iter().map(of).collect(), names, sigma }
    }

    /// Adds these errors to the covariance of the equations.
    pub(super) fn free_drifts(&self, equations: &mut Equations) {
        let added = self.turns(equations) * self.sigma;
        let added = &added * added.transpose();
        equations.weighting += &added;
        equations.reported += added;
    }

    /// Turn of each equation by a unit of each drift.
    fn turns(&self, equations: &Equations) -> DMatrix<f64> {
        let (heads, further) = (equations.parameters.len() / PER_GYRO, self.names.len().saturating_sub(1));
        let mut turns = DMatrix::zeros(equations.rows.len(), further * heads);
        for (row, &(own, gyro)) in equations.rows.iter().enumerate() {
            if let Some(trial) = self.numbers[own].checked_sub(1) {
                turns[(row, trial * heads + gyro)] = equations.observations[own].samples;
            }
        }
        turns
    }

    /// The drift of each gyro in each further trial, with its sigma, from what a solution leaves of equations with this covariance.
    pub(super) fn drifts(
        &self,
        equations: &Equations,
        solution: &Solution,
        covariance: &DMatrix<f64>,
    ) -> Result<Vec<TrialDrift>, SolveError> {
        if self.names.len() < 2 {
            return Ok(Vec::new());
        }
        let (turns, root_of_rows) = (self.turns(equations), root(covariance)?);
        let weighted = root_of_rows.solve(&turns);
        let mut inverse = turns.tr_mul(&weighted);
        (0..inverse.nrows()).for_each(|drift| inverse[(drift, drift)] += self.sigma.powi(-2));
        let of_drifts = root(&inverse)?;
        // A drift turns the reference, not the measured angle.
        let left = DVector::from_iterator(equations.rows.len(), solution.residuals.iter().map(|own| -own.arcsec));
        let drifts = of_drifts.solve(&weighted.tr_mul(&left));
        let by_solution = of_drifts.solve(&weighted.tr_mul(&equations.design));
        let sigmas = of_drifts.inverse() + &by_solution * &solution.covariance * by_solution.transpose();
        let all: Vec<(f64, f64)> = drifts.iter().copied().zip(sigmas.diagonal().iter().map(|own| own.sqrt())).collect();
        let further = self.names[1..].iter().zip(all.chunks(equations.parameters.len() / PER_GYRO));
        Ok(further.map(|(name, own)| TrialDrift { trial: name.clone(), drifts: own.to_vec() }).collect())
    }
}
