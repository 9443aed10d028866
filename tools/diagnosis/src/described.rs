//! A diagnosis of a described unit: alignment and checks of its heads, a first fit, the smoothed reference.

use std::sync::Arc;

use geu_calibration::DeviceRecording;
use geu_calibration::transfer::sensing_matrix;
use geu_checks::{Alignment, check_heads};
use geu_model::Configuration;
use geu_recording::ReferenceAttitude;

use crate::accelerations::AccelerationDrifts;
use crate::diagnosis::diagnose;
use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{MAX_ROW_S, MeasuredData, MeasuredError, Series};
use crate::model_state::LAG_S;
use crate::noise;
use crate::outcome::Diagnosis;
use crate::significance::THREE_SIGMAS;
use crate::solution::{self, DiagnosisOptions};
use crate::trial_drifts::TrialDrifts;

/// Diagnoses the recording of a described unit, exact checks included.
///
/// # Errors
/// Recording and reference have too little in common.
pub fn diagnose_device(
    mut recording: DeviceRecording,
    nominal: &Configuration,
    reference: &ReferenceAttitude,
    options: &DiagnosisOptions,
) -> Result<Diagnosis, MeasuredError> {
    (options.progress)("exact checks");
    if !nominal.device.sends_temperature() {
        recording.counts.take_temperatures(reference);
    }
    let device = Arc::new(nominal.device.at_nodes(recording.counts.interval_s));
    let nominal = Configuration { device, ..nominal.clone() };
    if reference.row_s() > MAX_ROW_S {
        return Err(MeasuredError::LongRows { row_s: reference.row_s() });
    }
    let matrix = sensing_matrix(&nominal);
    let mut raw = recording.counts.clone();
    raw.leave_out_unknown(reference, &matrix);
    let Alignment { lag_s, clock_ppm: aligned_ppm } = Alignment::find(&raw, &nominal, reference);
    recording.counts.correct_clock(aligned_ppm);
    recording.counts.leave_out_unknown(&reference.later(lag_s), &matrix);
    let mut checked = check_heads(recording, &nominal, &reference.later(lag_s));
    if let Some(got) = checked.mismatch {
        return Err(MeasuredError::Mismatch(got));
    }
    let start_s = lag_s - raw.offset_s(reference);
    let mut trial_drifts = TrialDrifts::none(&reference.trials, start_s, raw.gyros);
    let mut accelerations = AccelerationDrifts::none(&raw, reference, lag_s);
    let fitted = loop {
        let mut unsmoothed = MeasuredData::combined(checked.counts.clone(), reference, lag_s, None, None)?;
        unsmoothed.clock_ppm = aligned_ppm;
        let case = DiagnosisCase::new(&unsmoothed, &nominal);
        let mut fitted = solution::fitted_with_clock(&case);
        // The residual before the fit contained calibration parameters.
        fitted.noise = noise::configured(&nominal, &unsmoothed, &case.rounding, &case.residual(&fitted));
        case.fit(&mut fitted);
        let is_known = accelerations.is_found();
        let mut residual = case.residual(&fitted);
        if !is_known {
            accelerations.subtract((&mut checked.counts, &mut residual), &case, &fitted, true);
        }
        if accelerations.is_found() == is_known {
            trial_drifts.subtract((&mut checked.counts, &residual), &case, &fitted);
            break fitted;
        }
    };
    let clock_ppm = fitted.held.first().map_or(0.0, |clock| clock.hypothesis.value);
    // A lag within that of a link changes no attitude.
    let lag_s = lag_s + fitted.shifts.lag_s;
    let is_late = lag_s.abs() > LAG_S + THREE_SIGMAS * fitted.lag_sigma_s;
    let lag_s = if is_late { lag_s } else { 0.0 };
    let mut counts = checked.counts;
    counts.node_s.clone_from(&raw.node_s);
    counts.correct_clock(clock_ppm);
    let combined = |calibrated: &Configuration, added: Option<&Series>| -> Result<MeasuredData, MeasuredError> {
        let mut measured = MeasuredData::combined(counts.clone(), reference, lag_s, Some(calibrated), added)?;
        measured.clock_ppm = if aligned_ppm == 0.0 { 0.0 } else { clock_ppm };
        measured.trial_drifts = trial_drifts.clone();
        measured.accelerations = accelerations.clone();
        Ok(measured)
    };
    let measured = combined(&fitted.configuration(&nominal), None)?;
    let smoothed = |calibrated: &Configuration, added: &Series| combined(calibrated, Some(added)).ok();
    let is_subtracted = !trial_drifts.is_empty() || accelerations.is_found();
    let has_changed = is_late || clock_ppm != 0.0 || !checked.faults.is_empty() || is_subtracted;
    let raw = if has_changed { MeasuredData::combined(raw, reference, 0.0, None, None).ok() } else { None };
    Ok(diagnose(&measured, (raw, &smoothed), (checked.findings, checked.faults), &nominal, options))
}
