//! Further unknowns: the drift of each gyro in each further trial of a recording, beside that in the first one.

use geu_recording::ReferenceAttitude;
use nalgebra::DMatrix;

use super::{Equations, Observation, PER_GYRO, TrialDrift};

/// The trial of each observation.
pub struct TrialsOfObservations {
    /// Place of each observation's trial among the trials with observations.
    places: Vec<usize>,
    names: Vec<String>,
    /// Sigma of a drift before the data, arcsec/0.5 s.
    pub(super) sigma: f64,
}

impl TrialsOfObservations {
    /// The trials of a reference that begins `-offset_s` after the recording.
    pub fn new(observations: &[Observation], reference: &ReferenceAttitude, offset_s: f64, sigma: f64) -> Self {
        let of = |own: &Observation| reference.trial_at(0.5 * (own.start_s + own.end_s) + offset_s);
        let numbers: Vec<usize> = observations.iter().map(of).collect();
        let mut used = numbers.clone();
        used.sort_unstable();
        used.dedup();
        let places = numbers.iter().map(|number| used.partition_point(|own| own < number)).collect();
        let name = |number: usize| reference.trials.get(number).map_or(String::new(), |trial| trial.name.clone());
        TrialsOfObservations { places, names: used.into_iter().map(name).collect(), sigma }
    }

    /// Change of each equation with each further drift.
    pub(super) fn columns(&self, equations: &Equations) -> DMatrix<f64> {
        let (heads, further) = (equations.parameters.len() / PER_GYRO, self.names.len().saturating_sub(1));
        let mut columns = DMatrix::zeros(equations.rows.len(), further * heads);
        for (row, &(own, gyro)) in equations.rows.iter().enumerate() {
            if let Some(trial) = self.places[own].checked_sub(1) {
                columns[(row, trial * heads + gyro)] = equations.observations[own].samples;
            }
        }
        columns
    }

    /// Drifts with the names of their trials.
    pub(super) fn with_names(&self, drifts: Vec<TrialDrift>) -> Vec<TrialDrift> {
        let further = self.names.iter().skip(1).zip(drifts);
        further.map(|(trial, own)| TrialDrift { trial: trial.clone(), ..own }).collect()
    }
}
