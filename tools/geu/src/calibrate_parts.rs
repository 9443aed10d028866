//! `geu calibrate` of the default unit with a reference: recording and reference are read together, a day at a time.

use geu_calibration::effects::EffectContribution;
use geu_calibration::window::ManoeuvreWindow;
use geu_calibration::{Calibrated, CalibrationParts, CountsReader};
use geu_model::Configuration;
use geu_model::units::{S_PER_DAY, SAMPLE_INTERVAL_S};
use geu_recording::{Defect, ReceivedSample, ReferenceParts, Sink};

use crate::calibrate::{check_time_system, no_samples, note_defects, read_recordings};
use crate::command_error::CommandError;
use crate::evaluation_args::EvaluationArgs;

/// Samples of a part.
const PART: usize = (S_PER_DAY / SAMPLE_INTERVAL_S) as usize;

/// Calibrates recordings, which are one stream, with a reference file. The noise of the reference about each axis is estimated from the data
/// if it is not stated, arcsec.
///
/// # Errors
/// An input cannot be read, or does not determine the parameters.
pub fn calibrate(
    (names, evaluation): (&[String], &EvaluationArgs),
    configuration: &Configuration,
    windows: Option<&[ManoeuvreWindow]>,
    (reference, sigma_arcsec): (&str, Option<f64>),
) -> Result<Calibrated, CommandError> {
    let reference = ReferenceParts::open(reference).map_err(CommandError::input)?;
    let calibration = CalibrationParts::new(configuration, windows, sigma_arcsec.map(|sigma_arcsec| [sigma_arcsec; 3]));
    let mut reader = PartReader {
        start_ns: evaluation.start_ns(reference.start_ns()),
        counts: CountsReader::default(),
        reference,
        calibration: calibration.map_err(CommandError::input)?,
        // The memory of effects does not end with a part.
        part: if EffectContribution::is_expected(configuration) { usize::MAX } else { PART },
        is_received: None,
        error: None,
    };
    read_recordings(names, evaluation.options()?, &mut reader)?;
    note_defects(names, reader.counts.defects());
    if reader.error.is_none() {
        reader.error = reader.end_part().err();
    }
    let PartReader { reference, calibration, is_received, error, .. } = reader;
    if let Some(error) = error {
        return Err(error);
    }
    let is_received = is_received.ok_or_else(|| no_samples(names))?;
    evaluation.note_start(names, is_received);
    reference.finish().map_err(CommandError::input)?;
    calibration.finish().map_err(CommandError::input)
}

/// Reads samples into parts, and calibrates each part.
struct PartReader<'a> {
    /// Time at which the unit's clock was 0, for recordings without receive times.
    start_ns: i64,
    counts: CountsReader,
    reference: ReferenceParts,
    calibration: CalibrationParts<'a>,
    /// Samples of a part, at least.
    part: usize,
    /// True if the times of the parts are receive times; `None` before the first part.
    is_received: Option<bool>,
    error: Option<CommandError>,
}

impl PartReader<'_> {
    fn end_part(&mut self) -> Result<(), CommandError> {
        let Some(counts) = self.counts.end_part(self.start_ns) else { return Ok(()) };
        if self.is_received.is_none() {
            check_time_system(self.reference.time_system(), counts.is_received)?;
        }
        self.is_received = Some(counts.is_received);
        let end_ns = counts.start_ns.saturating_add((counts.end_s() * 1e9) as i64);
        let reference = self.reference.read_to(end_ns).map_err(CommandError::input)?;
        self.calibration.add(&counts, &reference).map_err(CommandError::input)
    }
}

impl Sink for PartReader<'_> {
    #[inline]
    fn row(&mut self, row: &ReceivedSample) {
        self.counts.row(row);
        if self.counts.samples() < self.part {
            return;
        }
        let zero_ns = if row.is_received { 0 } else { self.start_ns };
        let may_end = |t_ns: i64| self.calibration.may_end_at((t_ns + zero_ns) as f64 * 1e-9);
        if self.error.is_none() && row.time.is_some_and(|time| may_end(time.t_ns)) {
            self.error = self.end_part().err();
        }
    }

    fn defect(&mut self, defect: &Defect) {
        self.counts.defect(defect);
    }

    fn is_closed(&self) -> bool {
        self.error.is_some()
    }
}
