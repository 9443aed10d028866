//! A diagnosis of a described unit: alignment and checks of its heads, a first fit, the smoothed reference.

use std::sync::Arc;

use geu_calibration::DeviceRecording;
use geu_checks::{Alignment, check_heads};
use geu_model::Configuration;
use geu_recording::ReferenceAttitude;

use crate::diagnosis::diagnose;
use crate::diagnosis_case::DiagnosisCase;
use crate::measured::{MeasuredData, MeasuredError, Series};
use crate::model_state::LAG_S;
use crate::outcome::Diagnosis;
use crate::significance::THREE_SIGMAS;
use crate::solution::{self, DiagnosisOptions};

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
    let raw = recording.counts.clone();
    let Alignment { lag_s, clock_ppm: aligned_ppm } = Alignment::find(&raw, &nominal, reference);
    recording.counts.correct_clock(aligned_ppm);
    let checked = check_heads(recording, &nominal, &reference.later(lag_s));
    let (fitted, clock_ppm) = {
        let mut unsmoothed = MeasuredData::combined(checked.counts.clone(), reference, lag_s, None, None)?;
        unsmoothed.clock_ppm = aligned_ppm;
        solution::fitted_with_clock(&DiagnosisCase::new(&unsmoothed, &nominal))
    };
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
        Ok(measured)
    };
    let measured = combined(&fitted.configuration(&nominal), None)?;
    let smoothed = |calibrated: &Configuration, added: &Series| combined(calibrated, Some(added)).ok();
    let has_changed = is_late || clock_ppm != 0.0 || !checked.faults.is_empty();
    let raw = if has_changed { MeasuredData::combined(raw, reference, 0.0, None, None).ok() } else { None };
    Ok(diagnose(&measured, (raw, &smoothed), (checked.findings, checked.faults), &nominal, options))
}
