//! `geu track`: equation 3 on a live link, as on board (Casteren §4).

use std::io::{IsTerminal, stdout};
use std::path::PathBuf;
use std::slice;

use clap::Args;
use geu_archive::{CellColumns, FileFormat};
use geu_calibration::parity::ParityResidual;
use geu_calibration::{DeviceTracker, GyroSelection, PriorCalibration, Track, Tracker, TrackerEvent};
use geu_model::Configuration;
use geu_model::device::Device;
use geu_model::units::{ARCSEC_PER_DEG, ARCSEC_PER_RAD};
use geu_recording::{Decode, InputReader, Sink};
use geu_report::rows::{TrackFormat, instant, track_columns, track_difference, track_header, write_track};
use nalgebra::{Quaternion, UnitQuaternion};

use crate::command_error::{CommandError, note};
use crate::decode::{ColumnPlace, ColumnRows, RowOutput, TextRows, gives_rows, is_refused, verify_columns_place};
use crate::device::{DEFAULT_DEVICE, unit};
use crate::input_args::{InputArgs, note_elsewhere};
use crate::outputs::{OutputFile, persist};
use crate::settings::{choice, read_text};

/// Applies a calibration to a link (eq 3): increments about the control axes and attitude, every sample.
///
/// A sample that the gyros in use did not measure (lost, not valid, saturated, self-test) has no increments: the
/// attitude then lacks the rotation of this time, and `valid` is 0 from there on. GYRZA and GYRZB are compared, over
/// the last 60 s and since the start. A difference above 5 sigma of rounding, noise and calibration is printed on
/// standard error at its start and when it is below 3 sigma again.
///
/// The rotation of another unit fits all heads that measured; more than three are compared with all of them.
#[derive(Args)]
pub struct Arguments {
    /// CAN interface, pty, serial device, HOST:PORT (live), recording, or `-`, as `geu decode` reads them.
    #[arg(value_name = "LINK")]
    link: String,
    /// Calibration: a configuration, or JSON of `geu calibrate --json`, which adds its sigmas (with the noise of the
    /// reference unit) [default: the reference unit]
    #[arg(long, visible_alias = "calibration", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Override a value of the configuration: gyro.GYRZB.calibration.scale_factor=1.001
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    /// Name or description of another unit than the default one (`geu device list`); its calibration is a configuration
    #[arg(long, value_name = "NAME|FILE")]
    device: Option<String>,
    /// Gyros in use, of the default unit [default: za]
    #[arg(long, value_enum)]
    gyros: Option<GyroSelection>,
    /// Attitude at the start, control frame to inertial [default: 1,0,0,0]
    #[arg(long, value_name = "Q_W,Q_X,Q_Y,Q_Z", allow_hyphen_values = true, value_parser = attitude)]
    attitude: Option<UnitQuaternion<f64>>,
    /// Output format [default: text on a terminal, else csv]
    #[arg(long, value_parser = choice(FORMATS))]
    format: Option<Format>,
    /// Output file, instead of standard output. Until the end (for a live link also Ctrl-C) rows are written to
    /// FILE.….partial; FILE is the previous file or complete.
    #[arg(long, value_name = "FILE")]
    out: Option<OutputFile>,
    #[command(flatten)]
    reading: InputArgs,
    /// Exit with 1 if the attitude lacks samples, the redundant gyros differed, or there were defects.
    #[arg(long)]
    strict: bool,
    /// Do not print the summary to standard error.
    #[arg(long, short)]
    quiet: bool,
}

const FORMATS: &[(&str, Format, &str)] = &[
    ("csv", Format::Text(TrackFormat::Csv), "Comma-separated values with a header"),
    ("jsonl", Format::Text(TrackFormat::Jsonl), "One JSON object a line"),
    ("text", Format::Text(TrackFormat::Text), "A line to read, in arcsec"),
    ("parquet", Format::Columns(FileFormat::Parquet), "Parquet: columns with their units"),
    ("arrow", Format::Columns(FileFormat::Arrow), "Arrow IPC file (Feather 2), the same columns"),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Text(TrackFormat),
    Columns(FileFormat),
}

/// Tolerance of a quaternion's length: its parts may be rounded to three digits.
const LENGTH_TOLERANCE: f64 = 1e-3;

fn attitude(text: &str) -> Result<UnitQuaternion<f64>, String> {
    let parts: Vec<f64> = text.split(',').map_while(|part| part.trim().parse().ok()).collect();
    match parts[..] {
        [w, x, y, z] if text.split(',').count() == 4 => {
            let parts = Quaternion::new(w, x, y, z);
            let length = parts.norm();
            if (length - 1.0).abs() <= LENGTH_TOLERANCE {
                Ok(UnitQuaternion::from_quaternion(parts))
            } else {
                Err(format!("expected a quaternion of length 1, got length {length}"))
            }
        }
        _ => Err(format!("expected four numbers q_w,q_x,q_y,q_z, got {text}")),
    }
}

/// The calibration of the default unit, or the configuration of a described one.
fn calibration(arguments: &Arguments) -> Result<Result<PriorCalibration, Configuration>, CommandError> {
    let device = arguments.device.as_deref().map(unit).transpose()?.filter(|device| !device.is_iras());
    let (device, overrides) = (device.as_ref(), &arguments.overrides);
    let text = arguments.config.as_deref().map(|path| {
        let expected = "a configuration, or JSON as `geu calibrate --json` writes it";
        Ok::<_, CommandError>((path.display().to_string(), read_text(path, expected)?))
    });
    let configuration = match (text.transpose()?, device) {
        (Some((name, text)), None) if text.trim_start().starts_with('{') => {
            return PriorCalibration::parse(&name, &text, overrides).map(Ok).map_err(CommandError::input);
        }
        (Some((name, text)), _) => Configuration::parse_for(device, &name, &text, overrides),
        (None, Some(device)) => Configuration::of_device(device, overrides),
        (None, None) => Configuration::reference_with(overrides),
    };
    let configuration = configuration.map_err(CommandError::input)?;
    Ok(if configuration.device.is_iras() { Ok(PriorCalibration::from(&configuration)) } else { Err(configuration) })
}

/// Runs `geu track`.
///
/// # Errors
/// The input cannot be read, the output cannot be written; with `--strict`, an incomplete attitude, alarms or defects.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    arguments.reading.verify(slice::from_ref(&arguments.link))?;
    let start = arguments.attitude.unwrap_or_default();
    match calibration(arguments)? {
        Ok(prior) => {
            let mut tracker = Tracker::new(&prior, arguments.gyros.unwrap_or_default(), start);
            let stop = arguments.reading.stop_at_signals(slice::from_ref(&arguments.link))?;
            let reader = arguments.reading.reader(stop)?;
            track(arguments, reader, None, |row| tracker.push(row))
        }
        Err(configuration) => {
            let device = &configuration.device;
            if arguments.gyros.is_some() {
                let expected = "expected the default unit, of which it selects gyros";
                return Err(CommandError::input(format!("--gyros: {expected}, got {}", device.name)));
            }
            let mut tracker = DeviceTracker::new(&configuration, start).map_err(CommandError::input)?;
            let stop = arguments.reading.stop_at_signals(slice::from_ref(&arguments.link))?;
            let reader = arguments.reading.device_reader(device, stop)?;
            track(arguments, reader, Some(device), |row| tracker.push(row))?;
            if tracker.of_other_trials > 0 {
                note(format_args!("left out       {} rows of other trials\n", tracker.of_other_trials));
            }
            Ok(())
        }
    }
}

/// Tracks the rows of an input; `device` is that of a described unit.
fn track<D: Decode>(
    arguments: &Arguments,
    reader: InputReader<D>,
    device: Option<&Device>,
    push: impl FnMut(&D::Row) -> Option<Track>,
) -> Result<(), CommandError> {
    let out = arguments.out.as_ref();
    let is_terminal = out.is_none() && stdout().is_terminal();
    let usual = if is_terminal { TrackFormat::Text } else { TrackFormat::Csv };
    match arguments.format.unwrap_or(Format::Text(usual)) {
        Format::Columns(format) => {
            verify_columns_place(out)?;
            let unit_name = device.map_or(DEFAULT_DEVICE, Device::unit_name);
            let columns = CellColumns::new(
                "track",
                unit_name,
                |track: &Track| track.time,
                track_columns(device.is_some()).skip(1),
            );
            track_to(arguments, reader, push, ColumnRows::new(columns, format, ColumnPlace::File(out)))
        }
        Format::Text(format) => {
            let every = device.map_or(1, |device| ((TEXT_S / device.interval_s).round() as u64).max(1));
            let header = if format == TrackFormat::Csv { track_header(device.is_some()) } else { String::new() };
            let write = move |track: &Track, buffer: &mut Vec<u8>| {
                if format != TrackFormat::Text || track.number.is_none_or(|number| number.is_multiple_of(every)) {
                    write_track(format, track, buffer);
                }
            };
            track_to(arguments, reader, push, TextRows::new(out, header, write))
        }
    }
}

fn track_to<D: Decode>(
    arguments: &Arguments,
    mut reader: InputReader<D>,
    push: impl FnMut(&D::Row) -> Option<Track>,
    output: impl RowOutput<Track>,
) -> Result<(), CommandError> {
    let start = arguments.attitude.unwrap_or_default();
    let mut writer = Writer { push, output, is_open: false, broken: None, statistics: Statistics::default() };
    let result = reader.read(&arguments.link, &mut writer);
    let read = usize::from(result.is_ok());
    let (summary, ending) = reader.finish(&mut writer);
    let result = result.and(ending);
    if !is_refused(&result, &summary, read) {
        Sink::<D::Row>::flush(&mut writer);
    }
    if let Some(failure) = writer.broken.take() {
        return Err(failure);
    }
    let Writer { output, is_open, statistics, .. } = writer;
    if gives_rows(&result) && is_open {
        persist(output.finish()?)?;
    }
    let (statistics, defects) = (&statistics, summary.account.defect_count());
    if !arguments.quiet && gives_rows(&result) {
        note(format_args!("{}", statistics.text(&start)));
        if defects > 0 {
            note(format_args!("defects        {defects}; geu decode lists them\n"));
        }
    }
    note_elsewhere(&summary);
    result?;
    arguments.reading.note_no_rows(&summary);
    let is_complete = statistics.last.as_ref().is_some_and(|last| last.is_complete);
    match arguments.strict && (!is_complete || statistics.alarms > 0 || defects > 0) {
        true => Err(CommandError::failed(format!(
            "--strict: attitude {}, {} redundancy alarms, {defects} defects",
            if is_complete { "complete" } else { "not complete" },
            statistics.alarms
        ))),
        false => Ok(()),
    }
}

/// Interval of the lines in the format text, s, of a unit with more samples.
const TEXT_S: f64 = 0.5;

/// Losses printed one by one; the column `notes` has all of them.
const MAX_LOSSES: u64 = 20;

/// Statistics for the summary.
#[derive(Default)]
struct Statistics {
    samples: u64,
    losses: u64,
    alarms: u64,
    /// The largest accumulated difference of the redundant pair, and its time.
    largest: Option<(ParityResidual, String)>,
    last: Option<Track>,
}

impl Statistics {
    fn text(&self, start: &UnitQuaternion<f64>) -> String {
        let Some(last) = &self.last else { return "samples   0\n".to_owned() };
        let q = last.attitude;
        let turned = start.inverse() * q;
        let [x, y, z] = last.angle_control_arcsec;
        let mut text = format!("samples   {}, {} lost", self.samples, last.lost_samples);
        if !last.is_complete {
            text += "; the attitude lacks the rotation of this time";
        }
        text += &format!("\nattitude       q_w {:+.9}  q_x {:+.9}  q_y {:+.9}  q_z {:+.9}", q.w, q.i, q.j, q.k);
        if let Some((axis, angle_rad)) = turned.axis_angle() {
            let angle_deg = angle_rad * ARCSEC_PER_RAD / ARCSEC_PER_DEG;
            text += &format!("; turned {angle_deg:.6}° about {:+.4} {:+.4} {:+.4}", axis.x, axis.y, axis.z);
        }
        text += &format!("\nangles         x {x:+.3}″  y {y:+.3}″  z {z:+.3}″, summed\n");
        match (&self.largest, &last.parity) {
            (None, _) if last.number.is_some() => {
                if let Some((head, arcsec)) = last.residual {
                    text += &format!("redundancy     {arcsec:+.3}″ of {head} against all heads, summed: the largest\n");
                }
            }
            (Some((largest, at)), latest) => {
                let latest = latest
                    .map_or_else(|| "none at the end".to_owned(), |checked| track_difference(checked.accumulated));
                let alarms = self.alarms;
                text += &format!(
                    "GYRZA − GYRZB  {latest}; largest {} at {at}; {alarms} alarm{}\n",
                    track_difference(*largest),
                    if alarms == 1 { "" } else { "s" }
                );
            }
            (None, _) => text += "GYRZA − GYRZB  never both measured\n",
        }
        text
    }
}

/// Tracks rows as they are read, and writes.
struct Writer<P, O> {
    push: P,
    output: O,
    /// True once the link, and with it the output, is open.
    is_open: bool,
    /// The first failure of writing.
    broken: Option<CommandError>,
    statistics: Statistics,
}

impl<P, O> Writer<P, O> {
    /// Keeps the first failure.
    fn keep(&mut self, result: Result<(), CommandError>) {
        if let Err(failure) = result {
            self.broken.get_or_insert(failure);
        }
    }

    fn log_events(&mut self, track: &Track) {
        for event in &track.events {
            match event {
                TrackerEvent::Lost { .. } | TrackerEvent::Again { .. } | TrackerEvent::Switched(_) => {
                    self.statistics.losses += 1;
                    match self.statistics.losses {
                        MAX_LOSSES => note(format_args!("geu: the column notes has further ones\n")),
                        losses if losses > MAX_LOSSES => {}
                        _ => note(format_args!("geu: {}: {event}\n", instant(track))),
                    }
                }
                TrackerEvent::Exceeds(..) | TrackerEvent::Recovered(..) => {
                    self.statistics.alarms += u64::from(matches!(event, TrackerEvent::Exceeds(..)));
                    note(format_args!("geu: {}: {event}\n", instant(track)));
                }
            }
        }
    }
}

impl<R, P: FnMut(&R) -> Option<Track>, O: RowOutput<Track>> Sink<R> for Writer<P, O> {
    fn opened(&mut self) {
        self.is_open = true;
        let opened = self.output.open();
        self.keep(opened);
    }

    fn row(&mut self, row: &R) {
        let Some(track) = (self.push)(row) else { return };
        let written = self.output.row(&track);
        self.keep(written);
        self.log_events(&track);
        self.statistics.samples += 1;
        if let Some(checked) = &track.parity {
            let largest = self.statistics.largest.as_ref().map_or(-1.0, |largest| largest.0.arcsec.abs());
            if checked.accumulated.arcsec.abs() > largest {
                self.statistics.largest = Some((checked.accumulated, instant(&track)));
            }
        }
        self.statistics.last = Some(track);
    }

    fn flush(&mut self) {
        if self.is_open {
            let written = self.output.flush();
            self.keep(written);
        }
    }

    fn is_closed(&self) -> bool {
        self.broken.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attitude_is_a_quaternion_of_length_one() {
        assert_eq!(attitude("1,0,0,0"), Ok(UnitQuaternion::identity()));
        assert!((attitude("-0.7071, 0, 0.7071, 0").unwrap().norm() - 1.0).abs() < 1e-15);
        for (wrong, got) in
            [("1,1,0,0", "length 1.414"), ("0,0,0,0", "length 0"), ("1,0,0", "four"), ("1,0,0,0,x", "four")]
        {
            assert!(attitude(wrong).unwrap_err().contains(got), "{wrong}");
        }
    }
}
