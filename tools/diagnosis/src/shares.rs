//! Shares of the entries in the reduction of the squared residual.
//!
//! An effect is fitted together with the calibration of its gyros: added without that, it may make the residual larger. The effects are
//! therefore added in order, each time with the calibration parameters fitted anew; what the new calibration of a gyro reduces in
//! addition is divided among its entries in proportion to their χ² reductions.

use geu_checks::WiringFault;
use geu_model::Configuration;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::{MeasuredData, Shifts, TIMING};
use crate::model_state::ModelState;
use crate::outcome::{Chi2Fall, Class, Correction, DiagnosedEffect};
use crate::residual_stats;

/// Inputs of the shares.
pub struct Shares<'a> {
    /// Recording and input configuration.
    pub case: &'a DiagnosisCase<'a>,
    /// The recording before any correction, if there is one.
    pub raw: Option<&'a MeasuredData>,
    /// The selected model.
    pub state: &'a ModelState,
    /// The updated configuration.
    pub configuration: &'a Configuration,
    /// Wiring faults, which are the first entries.
    pub faults: &'a [WiringFault],
}

impl Shares<'_> {
    /// Sets the share of each entry in `whole`, the squared residual of the input configuration.
    pub fn set(&self, entries: &mut [DiagnosedEffect], whole: f64) {
        if whole <= 0.0 {
            return;
        }
        let (measured, shifts) = (self.case.measured, self.state.shifts);
        let before = squares(measured, self.case.nominal, shifts);
        self.set_faults(entries, &before, whole);
        let falls = self.set_effects(entries, whole);
        let after = squares(measured, self.configuration, shifts);
        for gyro in 0..TIMING {
            let is_own = |entry: &DiagnosedEffect| entry.class == Class::Recalibration && entry.gyros[gyro];
            let chi2_fall = |entry: &DiagnosedEffect| entry.chi2.map_or(0.0, |chi2: Chi2Fall| chi2.fall);
            let all: f64 = entries.iter().filter(|entry| is_own(entry)).map(chi2_fall).sum();
            let rest = (before[gyro] - after[gyro] - falls[gyro]) / whole;
            for entry in entries.iter_mut().filter(|entry| is_own(entry)) {
                entry.gap_share = rest * chi2_fall(entry) / all;
            }
        }
    }

    /// The reduction by the corrected rows is divided among the wiring faults in proportion to their own.
    fn set_faults(&self, entries: &mut [DiagnosedEffect], corrected: &[f64; TIMING], whole: f64) {
        let reduction = |fault: &WiringFault| {
            (fault.without_rms_counts.powi(2) - fault.with_rms_counts.powi(2)) * fault.samples as f64
        };
        let all: f64 = self.faults.iter().map(reduction).sum();
        let raw = self.raw.map_or(*corrected, |raw| squares(raw, self.case.nominal, self.state.shifts));
        let fall = raw.iter().sum::<f64>() - corrected.iter().sum::<f64>();
        for (entry, fault) in entries.iter_mut().zip(self.faults) {
            entry.gap_share = if all > 0.0 { fall / whole * reduction(fault) / all } else { 0.0 };
        }
    }

    /// Returns the reductions by all effects on each gyro.
    fn set_effects(&self, entries: &mut [DiagnosedEffect], whole: f64) -> [f64; TIMING] {
        let mut state = ModelState { held: Vec::new(), ..self.state.clone() };
        let mut fitted = |added: Option<FittedHypothesis>| {
            state.held.extend(added);
            self.case.fit(&mut state);
            residual_stats::squares(self.case.measured, &self.case.run(&state))
        };
        let first = fitted(None);
        let mut last = first;
        for entry in entries.iter_mut().skip(self.faults.len()) {
            let [Correction::Hypothesis(hypothesis)] = &entry.corrections[..] else { continue };
            if hypothesis.amplitude.has_signature() {
                let before = std::mem::replace(&mut last, fitted(Some(FittedHypothesis::fixed(hypothesis.clone()))));
                entry.gap_share = (before.iter().sum::<f64>() - last.iter().sum::<f64>()) / whole;
            }
        }
        std::array::from_fn(|gyro| first[gyro] - last[gyro])
    }
}

fn squares(measured: &MeasuredData, configuration: &Configuration, shifts: Shifts) -> [f64; TIMING] {
    residual_stats::squares(measured, &measured.run(configuration, shifts))
}
