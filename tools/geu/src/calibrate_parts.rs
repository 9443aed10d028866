//! `geu calibrate` of the default unit with a reference: recording and reference are read together, a day at a time.

use std::collections::VecDeque;

use geu_calibration::effects::EffectContribution;
use geu_calibration::window::ManoeuvreWindow;
use geu_calibration::{Calibrated, CalibrationParts, CountsReader};
use geu_model::Configuration;
use geu_model::units::{S_PER_DAY, SAMPLE_INTERVAL_S};
use geu_recording::{Defect, ReceivedSample, ReferenceParts, Sink};

use crate::calibrate::{check_time_system, no_samples, note_defects, read_recordings};
use crate::command_error::CommandError;
use crate::evaluation_args::EvaluationArgs;

/// Samples of a part, at least.
const SAMPLES_PER_PART: usize = (S_PER_DAY / SAMPLE_INTERVAL_S) as usize;
/// Samples behind the end of a part that must follow regularly: late receive times at the start of a part would date it wrongly.
const AHEAD: usize = 10;
/// Departure of the time between two samples, s, that is not regular.
const IRREGULAR_S: f64 = 0.1;

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
        names,
        start_ns: evaluation.start_ns(reference.start_ns()),
        counts: CountsReader::default(),
        ahead: VecDeque::new(),
        reference,
        calibration: calibration.map_err(CommandError::input)?,
        // Effects remember the part before, and a configured clock is corrected from the start of the recording.
        samples_per_part: (!EffectContribution::is_expected(configuration)).then_some(SAMPLES_PER_PART),
        is_received: None,
        error: None,
    };
    let read = read_recordings(names, evaluation.options()?, &mut reader);
    if let Some(error) = reader.error.take() {
        return Err(error);
    }
    read?;
    note_defects(names, reader.counts.defects());
    reader.ahead.drain(..).for_each(|row| reader.counts.row(&row));
    reader.end_part(names)?;
    let PartReader { reference, calibration, is_received, .. } = reader;
    let is_received = is_received.ok_or_else(|| no_samples(names))?;
    evaluation.note_start(names, is_received);
    reference.finish().map_err(CommandError::input)?;
    calibration.finish().map_err(CommandError::input)
}

/// Reads samples into parts, and calibrates each part.
struct PartReader<'a> {
    names: &'a [String],
    /// Time at which the unit's clock was 0, for recordings without receive times.
    start_ns: i64,
    counts: CountsReader,
    reference: ReferenceParts,
    calibration: CalibrationParts<'a>,
    /// `None` if the whole recording is one part.
    samples_per_part: Option<usize>,
    /// True if the times of all parts are receive times; `None` before the first part.
    is_received: Option<bool>,
    /// Samples that are not in a part yet.
    ahead: VecDeque<ReceivedSample>,
    error: Option<CommandError>,
}

impl PartReader<'_> {
    fn end_part(&mut self, names: &[String]) -> Result<(), CommandError> {
        let Some(counts) = self.counts.end_part(self.start_ns) else { return Ok(()) };
        check_time_system(self.reference.time_system(), counts.is_received)?;
        if self.is_received.replace(counts.is_received).is_some_and(|before| before != counts.is_received) {
            return Err(CommandError::input(format!(
                "{}: expected receive times of all days or of none, got days with and without; calibrate them one by one, and --compare the results",
                names.join(" ")
            )));
        }
        let end_ns = counts.start_ns.saturating_add((counts.end_s() * 1e9) as i64);
        let reference = self.reference.read_to(end_ns).map_err(CommandError::input)?;
        self.calibration.add(&counts, &reference).map_err(CommandError::input)
    }
}

impl PartReader<'_> {
    /// True if the samples ahead follow a sample at regular times.
    fn is_regular(&self, row: &ReceivedSample) -> bool {
        let times_s = [row].into_iter().chain(&self.ahead).map(|row| row.time.map(|time| time.t_ns as f64 * 1e-9));
        let is_regular = |pair: (Option<f64>, Option<f64>)| {
            let passed_s = pair.0.zip(pair.1).map(|(before_s, now_s)| now_s - before_s);
            passed_s.is_some_and(|passed_s| (passed_s - SAMPLE_INTERVAL_S).abs() < IRREGULAR_S)
        };
        times_s.clone().zip(times_s.skip(1)).all(is_regular)
    }
}

impl Sink for PartReader<'_> {
    #[inline]
    fn row(&mut self, row: &ReceivedSample) {
        if self.error.is_some() {
            return;
        }
        self.ahead.push_back(*row);
        if self.ahead.len() <= AHEAD {
            return;
        }
        let Some(row) = self.ahead.pop_front() else { return };
        self.counts.row(&row);
        if self.samples_per_part.is_none_or(|samples| self.counts.samples() < samples) || !self.is_regular(&row) {
            return;
        }
        let may_end = |t_ns: i64| self.calibration.may_end_at(t_ns as f64 * 1e-9);
        if self.counts.last_ns(self.start_ns).is_some_and(may_end) {
            self.error = self.end_part(self.names).err();
        }
    }

    fn defect(&mut self, defect: &Defect) {
        self.counts.defect(defect);
    }

    fn is_closed(&self) -> bool {
        self.error.is_some()
    }
}
