//! Decodes capture records and serial bytes of a described unit to samples and defects.

mod can;
mod serial;
mod table;

use geu_model::device::Device;
use geu_protocol::capture::{CaptureRecord, Detected, Foreign, Format, RecordPosition, Timestamp, detect};
use geu_protocol::continuity::SequenceStep;
use geu_protocol::layout::{Quantity, Sequence};

use self::can::Can;
use self::serial::Serial;
use self::table::Table;
use crate::archive::{ArchiveRows, ArchiveUnit};
use crate::decoder::DecoderOptions;
use crate::defect::DefectKind;
use crate::flow::{Flow, Stamp};
use crate::input_reader::Decode;
use crate::row::{DeviceSample, Sink};
use crate::summary::DecodeSummary;

/// Decodes inputs, one after the other, to samples and defects.
#[derive(Debug)]
pub struct DeviceDecoder {
    can: Option<Can>,
    serial: Option<Serial>,
    table: Option<Table>,
    samples: Samples,
    is_stopped: bool,
    archive: ArchiveUnit,
    /// True before the first row of a file of an archive, and the difference of its numbers to those in the file.
    begins: bool,
    renumbered: u64,
    row: DeviceSample,
}

/// Samples and their account.
#[derive(Debug)]
struct Samples {
    flow: Flow,
    interval_s: f64,
    /// Values of validity and saturation, with the head in the summary and the value that is counted.
    flags: Vec<(usize, usize, f64)>,
    row: DeviceSample,
    last: Option<Timestamp>,
}

impl Samples {
    fn new(device: &Device) -> Samples {
        let (mut heads, mut flags): (Vec<String>, Vec<(usize, usize, f64)>) = Default::default();
        for (slot, value) in device.values().iter().enumerate() {
            let (head, counted) = match value.quantity {
                Quantity::Valid(head) => (head, 0.0),
                Quantity::Saturated(head) => (head, 1.0),
                _ => continue,
            };
            let name = device.heads[head].gyro.name();
            let place = heads.iter().position(|own| own == name).unwrap_or_else(|| {
                heads.push(name.to_owned());
                heads.len() - 1
            });
            flags.push((slot, place, counted));
        }
        let unchecked = if device.is_unchecked() { ", frames unchecked" } else { "" };
        Samples {
            flow: Flow::new(heads, Some(format!("{}{unchecked}", device.name))),
            interval_s: device.interval_s,
            flags,
            row: DeviceSample::default(),
            last: None,
        }
    }

    /// Reports a sample. `is_stamped` if its time was taken when it came, not when it was read: then it shows how many are missing.
    #[inline]
    fn push(
        &mut self,
        stamp: Stamp,
        is_stamped: bool,
        sequence: &mut Sequence,
        values: &[f64],
        sink: &mut impl Sink<DeviceSample>,
    ) {
        let since_ns = |last: Timestamp| Some(stamp.time?.t_ns.saturating_sub(last.t_ns));
        let since_ns = self.last.filter(|_| is_stamped).and_then(since_ns);
        let intervals = since_ns.map(|since_ns| since_ns as f64 * 1e-9 / self.interval_s);
        let step = sequence.step(values, intervals);
        self.report(stamp, step, values, sink);
    }

    /// Begins a trial: its times and numbers are independent of the trial before.
    fn begin_trial(&mut self) {
        (self.last, self.row.number) = (None, 0);
        self.flow.begin_trial();
    }

    /// Reports a sample that follows the one before in this way.
    #[inline]
    fn report(&mut self, stamp: Stamp, step: SequenceStep, values: &[f64], sink: &mut impl Sink<DeviceSample>) {
        self.last = stamp.time;
        let row = &mut self.row;
        row.number = row.number.saturating_add(match step {
            SequenceStep::First | SequenceStep::Repeat => 0,
            SequenceStep::Gap(missing) => missing.saturating_add(1),
            _ => 1,
        });
        row.time = stamp.time;
        row.values.clear();
        row.values.extend_from_slice(values);
        self.give(stamp, step, sink);
    }

    /// Counts and reports the present row.
    #[inline]
    fn give(&mut self, stamp: Stamp, step: SequenceStep, sink: &mut impl Sink<DeviceSample>) {
        for &(slot, head, counted) in &self.flags {
            let (_, invalid, saturated) = &mut self.flow.summary.heads[head];
            *(if counted == 0.0 { invalid } else { saturated }) += u64::from(self.row.values[slot] == counted);
        }
        self.flow.sample(stamp, step, &self.row, sink);
    }
}

impl DeviceDecoder {
    /// A decoder before its first input.
    pub fn new(device: &Device, options: &DecoderOptions) -> DeviceDecoder {
        let (serial, can) = (device.serial.as_ref().map(|own| &own.frames), device.can.as_ref().map(|can| &can.frames));
        let mut samples = Samples::new(device);
        let frames = serial.into_iter().chain(can).flat_map(|set| &set.frames);
        samples.flow.summary.frames = frames.map(|frame| (frame.name.clone(), 0)).collect();
        let table = device.table.clone().map(Table::new);
        samples.flow.gap_kind = table.as_ref().filter(|table| !table.has_sequence()).map(|_| DefectKind::TimeGap);
        let names = serial.map_or(0, |set| set.frames.len());
        DeviceDecoder {
            can: can.map(|frames| Can::new(frames.clone(), options.interface.as_deref(), names)),
            serial: serial.map(|frames| Serial::new(frames.clone())),
            table,
            samples,
            is_stopped: false,
            archive: ArchiveUnit::described(device),
            begins: false,
            renumbered: 0,
            row: DeviceSample { values: vec![f64::NAN; device.values().len()], ..DeviceSample::default() },
        }
    }

    /// Reports a row of an archive. Files that are no continuation of each other are numbered through.
    fn archived_row(&mut self, stamp: Stamp, sink: &mut impl Sink<DeviceSample>) {
        let DeviceDecoder { samples, row, .. } = self;
        let is_first = samples.flow.summary.rows == 0 || samples.row.group != row.group;
        if is_first {
            samples.begin_trial();
        }
        let last = samples.row.number;
        if std::mem::take(&mut self.begins) {
            self.renumbered = 0;
            if !is_first && row.number <= last {
                let since_ns = samples.last.zip(row.time).map_or(0, |(last, now)| now.t_ns.saturating_sub(last.t_ns));
                let intervals = (since_ns as f64 * 1e-9 / samples.interval_s).round().max(1.0) as u64;
                self.renumbered = last.saturating_add(intervals) - row.number;
            }
        }
        row.number = row.number.saturating_add(self.renumbered);
        let step = match (is_first, row.number.checked_sub(last)) {
            (true, _) => SequenceStep::First,
            (_, Some(0)) => SequenceStep::Repeat,
            (_, Some(1)) => SequenceStep::Next,
            (_, Some(steps)) => SequenceStep::Gap(steps - 1),
            (_, None) => SequenceStep::Reset,
        };
        samples.last = row.time;
        samples.row.clone_from(row);
        samples.give(stamp, step, sink);
    }

    /// Reports samples of which frames are missing at the end.
    fn incomplete(&mut self, sink: &mut impl Sink<DeviceSample>) {
        let serial = self.serial.as_ref().and_then(Serial::waiting);
        let can = self.can.as_ref().and_then(Can::waiting);
        for stamp in serial.into_iter().chain(can) {
            self.samples.flow.defect(stamp, DefectKind::IncompleteSample, &[], 0, sink);
        }
    }
}

impl Decode for DeviceDecoder {
    type Row = DeviceSample;

    fn begin(&mut self, name: &str, sink: &mut impl Sink<DeviceSample>) {
        if let Some(can) = &mut self.can {
            can.settle(&mut self.samples, sink);
        }
        if let Some(table) = &mut self.table {
            table.begin();
        }
        self.samples.flow.begin(name);
        self.begins = true;
    }

    fn archive(&self) -> ArchiveUnit {
        self.archive.clone()
    }

    fn archived(
        &mut self,
        place: RecordPosition,
        rows: &ArchiveRows,
        row: usize,
        sink: &mut impl Sink<DeviceSample>,
    ) -> Result<(), String> {
        rows.device_sample(row, &mut self.row)?;
        let flow = &mut self.samples.flow;
        flow.summary.account.records += 1;
        flow.summary.account.decoded += 1;
        let stamp = flow.stamp(place, self.row.time);
        self.archived_row(stamp, sink);
        Ok(())
    }

    /// A table is known by its header. A unit without CAN has no captures: the rest is serial bytes.
    fn detect(&self, head: &[u8], is_complete: bool) -> Detected {
        let format = |name| Format::from_name(name).map_or(Detected::UnknownText, Detected::Format);
        match self.table.as_ref().map(|table| table.is_begun_by(head, is_complete)) {
            Some(Some(true)) => format("table"),
            Some(None) => Detected::Undecided,
            _ if self.can.is_some() => detect(head, is_complete),
            _ if self.serial.is_some() => format("serial"),
            _ if head.starts_with(Foreign::PARQUET.signature) => Detected::Foreign(&Foreign::PARQUET),
            _ => Detected::UnknownText,
        }
    }

    fn reads_tables(&self) -> bool {
        self.table.is_some()
    }

    fn columns(&self) -> Option<String> {
        let table = self.table.as_ref().filter(|_| self.can.is_none() && self.serial.is_none());
        table.map(Table::expected)
    }

    fn expected(&self) -> String {
        format!("frames of {}", self.samples.flow.summary.device.as_deref().unwrap_or_default())
    }

    fn summary(&mut self) -> &mut DecodeSummary {
        &mut self.samples.flow.summary
    }

    #[inline]
    fn event(&mut self, place: RecordPosition, event: &CaptureRecord, sink: &mut impl Sink<DeviceSample>) {
        let DeviceDecoder { can, samples, table, .. } = self;
        let frame = match (event, table) {
            (CaptureRecord::Frame(frame), _) => frame,
            (CaptureRecord::Line(line), Some(table)) => {
                return table.line(line, samples.flow.stamp(place, None), samples, sink);
            }
            _ => return samples.flow.other_record(place, event, sink),
        };
        let stamp = samples.flow.stamp(place, frame.time);
        match can {
            Some(can) => can.frame(frame, stamp, samples, sink),
            None => samples.flow.summary.account.other += 1,
        }
    }

    fn dropped(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink<DeviceSample>) {
        self.samples.flow.dropped(place, count, sink);
    }

    fn serial(&mut self, bytes: &[u8], time: Option<Timestamp>, sink: &mut impl Sink<DeviceSample>) {
        let account = &mut self.samples.flow.summary.account;
        account.bytes += bytes.len() as u64;
        match &mut self.serial {
            Some(serial) => serial.read(bytes, time, &mut self.samples, sink),
            None => account.resynchronised_bytes += bytes.len() as u64,
        }
    }

    fn stop(&mut self) {
        self.is_stopped = true;
    }

    fn finish(&mut self, sink: &mut impl Sink<DeviceSample>) {
        if let Some(serial) = &mut self.serial {
            serial.finish(self.is_stopped, &mut self.samples, sink);
        }
        if !self.is_stopped {
            self.incomplete(sink);
        }
        if let Some(can) = &mut self.can {
            can.settle(&mut self.samples, sink);
        }
        self.samples.flow.finish();
    }

    fn into_summary(self) -> DecodeSummary {
        self.samples.flow.summary
    }
}
