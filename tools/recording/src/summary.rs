//! Summary of all inputs.

use std::fmt::{self, Display, Formatter};

use geu_protocol::Gyro;
use geu_protocol::capture::{CaptureRecord, RecordPosition, Timestamp};
use geu_protocol::continuity::{Continuity, SequenceStep};
use geu_protocol::field::unit_flag;

use crate::account::DecodeAccount;
use crate::cadence::IntervalStatistics;
use crate::clock_fit::ClockFit;
use crate::defect::{Defect, DefectKind, place_text};
use crate::others::Others;
use crate::row::{DeviceSample, ReceivedSample, Sink};

/// Gaps that the summary lists.
const MAX_LISTED_GAPS: usize = 20;
const POLLED: u8 = unit_flag("polled");

/// Account and statistics of everything decoded. [`Display`] writes it: a name, then values, on each line.
#[derive(Debug, Default)]
pub struct DecodeSummary {
    /// Names and formats of the inputs.
    pub inputs: Vec<(String, String)>,
    /// Interface of the rows of CAN, several with commas.
    pub interface: Option<String>,
    /// Frames of the unit on other interfaces.
    pub elsewhere: Vec<(String, u64)>,
    pub account: DecodeAccount,
    /// Identifiers, until the first row.
    pub others: Others,
    pub rows: u64,
    pub serial_frames: u64,
    /// Time of the first and the last row.
    pub span: Option<(Timestamp, Timestamp)>,
    pub lost: u64,
    /// The first gaps: place, time, samples missing.
    pub gaps: Vec<(String, Option<Timestamp>, u64)>,
    pub repeats: u64,
    pub resets: u64,
    /// Rows without clock count and sensor temperature.
    pub without_clock: u64,
    /// Name of each head, and the rows in which it is not valid, and saturated.
    pub heads: Vec<(String, u64, u64)>,
    /// Name of the unit, if a description was given.
    pub device: Option<String>,
    /// Frames of a described unit that were read, by their names.
    pub frames: Vec<(String, u64)>,
    pub polled: u64,
    /// Frames that recorder or socket lost.
    pub dropped: u64,
    pub cadence: IntervalStatistics,
    /// The longest interval between rows, gaps included, ns, and its end.
    pub largest: Option<(i64, String)>,
    /// The unit's clock.
    pub clock: ClockFit,
    pub is_timed: bool,
}

/// Time and position of a frame or a defect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stamp {
    pub place: RecordPosition,
    pub input: u32,
    pub time: Option<Timestamp>,
}

/// Reports rows and defects and counts them.
#[derive(Debug, Default)]
pub(crate) struct Flow {
    pub summary: DecodeSummary,
    continuity: Continuity,
    /// Receive time of the row before.
    last_t_ns: Option<i64>,
    /// True if the row before was polled.
    last_polled: bool,
    /// The longest interval and its end.
    largest: Option<(i64, RecordPosition, u32)>,
}

impl Flow {
    /// The start of the inputs of a unit with these heads.
    pub fn new(heads: impl IntoIterator<Item = String>, device: Option<String>) -> Flow {
        let heads = heads.into_iter().map(|name| (name, 0, 0)).collect();
        Flow { summary: DecodeSummary { heads, device, ..DecodeSummary::default() }, ..Flow::default() }
    }

    pub fn begin(&mut self, name: &str) {
        self.summary.inputs.push((name.to_owned(), String::new()));
    }

    #[inline]
    pub fn input(&self) -> u32 {
        self.summary.inputs.len().saturating_sub(1) as u32
    }

    pub fn stamp(&self, place: RecordPosition, time: Option<Timestamp>) -> Stamp {
        Stamp { place, input: self.input(), time }
    }

    /// Reports a row; `is_regular` unless its clock was rejected.
    #[inline]
    pub fn row(&mut self, stamp: Stamp, row: &ReceivedSample, is_regular: bool, sink: &mut impl Sink) {
        let sample = &row.sample;
        let summary = &mut self.summary;
        summary.rows += 1;
        summary.is_timed |= row.is_received;
        summary.without_clock += u64::from(!row.has_clock);
        if sample.gyro_flags != 0x0F {
            for (gyro, (_, invalid, saturated)) in Gyro::ALL.into_iter().zip(&mut summary.heads) {
                let bit = gyro.bit();
                *invalid += u64::from(sample.gyro_flags & bit == 0);
                *saturated += u64::from(sample.gyro_flags & bit << 4 != 0);
            }
        }
        if is_regular {
            self.follow(Stamp { time: row.time, ..stamp }, row, sink);
        }
        sink.row(row);
    }

    /// Compares a row with the one before.
    #[inline]
    fn follow(&mut self, stamp: Stamp, row: &ReceivedSample, sink: &mut impl Sink) {
        let sample = &row.sample;
        let summary = &mut self.summary;
        let is_polled = sample.unit_flags & POLLED != 0;
        summary.polled += u64::from(is_polled);
        if let Some(time) = row.time {
            summary.span.get_or_insert((time, time)).1 = time;
        }
        let step = self.continuity.step(sample.sequence, row.has_clock.then_some(sample.clock_count));
        let received = row.time.filter(|_| row.is_received);
        self.pace(stamp, received, step, is_polled, sink);
        if let Some(Timestamp { t_ns, .. }) = received
            && row.has_clock
            && !is_polled
            && step != SequenceStep::Repeat
        {
            self.summary.clock.add(t_ns, sample.sequence, sample.clock_count);
        }
        if step != SequenceStep::Next {
            self.irregular(step, stamp, sink);
        }
    }

    /// Reports a sample of a described unit.
    #[inline]
    pub fn sample(&mut self, stamp: Stamp, step: SequenceStep, row: &DeviceSample, sink: &mut impl Sink<DeviceSample>) {
        self.summary.rows += 1;
        self.summary.is_timed |= row.time.is_some();
        if let Some(time) = row.time {
            self.summary.span.get_or_insert((time, time)).1 = time;
        }
        self.pace(stamp, row.time, step, false, sink);
        if step != SequenceStep::Next {
            self.irregular(step, stamp, sink);
        }
        sink.row(row);
    }

    /// Compares the receive time of a row with that of the row before.
    #[inline]
    fn pace<R>(
        &mut self,
        stamp: Stamp,
        received: Option<Timestamp>,
        step: SequenceStep,
        is_polled: bool,
        sink: &mut impl Sink<R>,
    ) {
        if let Some(Timestamp { t_ns, .. }) = received
            && let Some(last_t_ns) = self.last_t_ns.replace(t_ns)
        {
            let interval_ns = t_ns.saturating_sub(last_t_ns);
            if interval_ns < 0 {
                self.defect(stamp, DefectKind::TimeBackwards, &[], 0, sink);
            } else if step != SequenceStep::Repeat && !is_polled && !self.last_polled {
                if step == SequenceStep::Next {
                    self.summary.cadence.add(interval_ns);
                }
                if self.largest.is_none_or(|(largest_ns, ..)| interval_ns > largest_ns) {
                    self.largest = Some((interval_ns, stamp.place, stamp.input));
                }
            }
        }
        self.last_polled = is_polled;
    }

    #[cold]
    fn irregular<R>(&mut self, step: SequenceStep, at: Stamp, sink: &mut impl Sink<R>) {
        match step {
            SequenceStep::First | SequenceStep::Next => {}
            SequenceStep::Repeat => self.summary.repeats += 1,
            SequenceStep::Reset => self.summary.resets += 1,
            SequenceStep::Jump => self.defect(at, DefectKind::SequenceJump, &[], 0, sink),
            SequenceStep::Gap(lost) => {
                self.summary.lost = self.summary.lost.saturating_add(lost);
                if self.summary.gaps.len() < MAX_LISTED_GAPS {
                    let place = place_text(&self.summary.inputs[at.input as usize].0, at.place);
                    self.summary.gaps.push((place, at.time, lost));
                }
                self.defect(at, DefectKind::SequenceGap, &[], lost, sink);
            }
        }
    }

    #[cold]
    pub fn defect<R>(&mut self, at: Stamp, kind: DefectKind, bytes: &[u8], lost: u64, sink: &mut impl Sink<R>) {
        self.count_defects(kind, 1);
        if kind == DefectKind::ReceiverDropped {
            self.summary.dropped += lost;
        }
        let input = self.summary.inputs.get(at.input as usize).map_or("", |(name, _)| name);
        sink.defect(&Defect { input, place: at.place, kind, bytes, time: at.time, lost });
    }

    /// Counts a record of a capture that is no frame.
    pub fn other_record<R>(&mut self, place: RecordPosition, record: CaptureRecord, sink: &mut impl Sink<R>) {
        let account = &mut self.summary.account;
        match record {
            CaptureRecord::Frame(_) => {}
            CaptureRecord::Remote => account.remote += 1,
            CaptureRecord::Fd => account.fd += 1,
            CaptureRecord::Error => account.error += 1,
            CaptureRecord::Remark => account.remarks += 1,
            CaptureRecord::Dropped(count) => {
                account.remarks += 1;
                self.dropped(place, count, sink);
            }
            CaptureRecord::Broken { bytes, cut } => {
                let kind = if cut { DefectKind::CutRecord } else { DefectKind::BrokenRecord };
                self.defect(self.stamp(place, None), kind, bytes, 0, sink);
            }
        }
    }

    /// Reports that the receiver lost `count` frames.
    pub fn dropped<R>(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink<R>) {
        self.defect(self.stamp(place, None), DefectKind::ReceiverDropped, &[], count, sink);
    }

    pub fn count_defects(&mut self, kind: DefectKind, count: u64) {
        if count > 0 {
            *self.summary.account.defects.entry(kind).or_default() += count;
        }
    }

    pub fn finish(&mut self) {
        if let Some((interval_ns, place, input)) = self.largest {
            let place = place_text(&self.summary.inputs[input as usize].0, place);
            self.summary.largest = Some((interval_ns, place));
        }
    }
}

/// `seconds.fraction` with six to nine decimals.
fn seconds(time: Timestamp) -> String {
    let digits = usize::from(time.digits.clamp(6, 9));
    let magnitude = time.t_ns.unsigned_abs();
    let fraction = format!("{:09}", magnitude % 1_000_000_000);
    let sign = if time.t_ns < 0 { "-" } else { "" };
    format!("{sign}{}.{}", magnitude / 1_000_000_000, &fraction[..digits])
}

impl Display for DecodeSummary {
    fn fmt(&self, out: &mut Formatter) -> fmt::Result {
        for (name, kind) in &self.inputs {
            line(out, "input", format_args!("{name} {kind}"))?;
        }
        if let Some(device) = &self.device {
            line(out, "device", device)?;
        }
        line(out, "rows", self.rows)?;
        if let Some((first, last)) = self.span {
            line(out, "span_s", format_args!("{} to {}", seconds(first), seconds(last)))?;
        }
        if let Some(interface) = self.interface.as_ref().filter(|name| !name.is_empty()) {
            line(out, "interface", interface)?;
        }
        for (name, frames) in &self.elsewhere {
            line(out, "interface-not-used", format_args!("{name} {frames} frames of the unit"))?;
        }
        self.write_account(out)?;
        self.write_sequence(out)?;
        self.write_times(out)
    }
}

fn line(out: &mut Formatter, name: &str, value: impl Display) -> fmt::Result {
    writeln!(out, "{name:<24} {value}")
}

impl DecodeSummary {
    /// Notes an interface with rows in use; each input may have its own.
    pub(crate) fn use_interface(&mut self, name: &str) {
        match &mut self.interface {
            Some(names) if names.split(", ").any(|known| known == name) => {}
            Some(names) => *names = format!("{names}, {name}"),
            None => self.interface = Some(name.to_owned()),
        }
    }

    /// Notes frames of the unit on an interface that is not used.
    pub(crate) fn leave_out(&mut self, name: &str, frames: u64) {
        match self.elsewhere.iter_mut().find(|(known, _)| known == name) {
            _ if frames == 0 => {}
            Some((_, count)) => *count += frames,
            None => self.elsewhere.push((name.to_owned(), frames)),
        }
    }

    fn write_account(&self, out: &mut Formatter) -> fmt::Result {
        let account = &self.account;
        let (records, bytes) = account.missing();
        if account.records > 0 {
            line(out, "records", account.records)?;
            for (name, count) in account.record_counts() {
                line(out, &format!("records-{name}"), count)?;
            }
        }
        if account.bytes > 0 {
            line(out, "bytes", account.bytes)?;
            for (name, count) in account.byte_counts() {
                line(out, &format!("bytes-{name}"), count)?;
            }
        }
        line(
            out,
            "account",
            if account.adds_up() {
                "accounts for all".to_owned()
            } else {
                format!("DOES NOT ADD UP: {records} records and {bytes} bytes unexplained")
            },
        )?;
        for (name, count) in &self.frames {
            line(out, &format!("frames-{name}"), count)?;
        }
        line(out, "defects", account.defect_count())?;
        for (kind, count) in &account.defects {
            line(out, &format!("defect-{}", kind.name()), count)?;
        }
        if self.dropped > 0 {
            line(out, "frames-dropped", format_args!("{} by recorder or socket", self.dropped))?;
        }
        Ok(())
    }

    fn write_sequence(&self, out: &mut Formatter) -> fmt::Result {
        line(out, if self.device.is_some() { "samples-lost" } else { "half-seconds-lost" }, self.lost)?;
        for (place, time, lost) in &self.gaps {
            let time = time.map_or(String::new(), |time| format!(" t_s {}", seconds(time)));
            line(out, "gap", format_args!("{lost} before {place}{time}"))?;
        }
        line(out, "repeats", self.repeats)?;
        if self.device.is_none() {
            line(out, "resets", self.resets)?;
            line(out, "polled", self.polled)?;
            line(out, "without-clock", self.without_clock)?;
        }
        let counts = |count: fn(&(String, u64, u64)) -> u64| {
            self.heads.iter().map(|head| format!("{} {}", head.0, count(head))).collect::<Vec<_>>().join(" ")
        };
        if self.heads.is_empty() {
            return Ok(());
        }
        line(out, "not-valid", counts(|head| head.1))?;
        line(out, "saturated", counts(|head| head.2))
    }

    fn write_times(&self, out: &mut Formatter) -> fmt::Result {
        if self.rows == 0 {
            return Ok(());
        }
        if !self.is_timed {
            let why = "not measurable: the recording holds no receive times";
            line(out, "interval_s", why)?;
            return if self.device.is_some() { Ok(()) } else { line(out, "clock_ppm", why) };
        }
        if self.cadence.count() > 0 {
            let median = self.cadence.median_s().map_or("1 or more".to_owned(), |median| format!("{median:.6}"));
            line(
                out,
                "interval_s",
                format_args!(
                    "min {:.6} median {median} max {:.6} sigma {:.6} n {}",
                    self.cadence.min_s(),
                    self.cadence.max_s(),
                    self.cadence.sigma_s(),
                    self.cadence.count()
                ),
            )?;
        }
        if let Some((interval_ns, place)) = &self.largest {
            line(out, "interval-largest_s", format_args!("{:.6} before {place}", *interval_ns as f64 * 1e-9))?;
        }
        match self.clock.rate() {
            _ if self.device.is_some() => Ok(()),
            Some(rate) => line(
                out,
                "clock_ppm",
                format_args!(
                    "{:+.4} sigma {:.4} n {} segments {} residual_us {:.1} correlation {:.2}",
                    rate.clock_ppm,
                    rate.sigma_ppm,
                    rate.points,
                    rate.segments,
                    rate.residual_s * 1e6,
                    rate.correlation
                ),
            ),
            None => line(out, "clock_ppm", "not measurable: fewer than three timed rows with a clock count"),
        }
    }
}
