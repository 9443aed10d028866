//! What a decoder makes of an input, to be compared bit by bit.

use std::fmt::Debug;
use std::ops::Range;

use geu_protocol::capture::{CaptureRecord, Format, Frame, MAX_EXCERPT, RecordPosition, Timestamp};
use geu_recording::{Decode, DecodeAccount, Defect, DefectKind, DeviceSample, ReceivedSample, Sink};

/// Rows, defects and account of an input.
#[derive(Debug, PartialEq)]
pub struct Decoded<R> {
    pub rows: Vec<R>,
    defects: Vec<OwnDefect>,
    account: DecodeAccount,
    /// Samples lost, repeated, after a reset, and frames that the recorder lost.
    counts: [u64; 4],
}

type OwnDefect = (DefectKind, RecordPosition, Digest, Option<Timestamp>, u64);

struct Collected<R> {
    rows: Vec<R>,
    defects: Vec<OwnDefect>,
}

impl<R> Default for Collected<R> {
    fn default() -> Collected<R> {
        Collected { rows: Vec::new(), defects: Vec::new() }
    }
}

/// A row with comparable numbers, NaN included.
pub trait Row {
    type Own: PartialEq + Debug;
    fn own(&self) -> Self::Own;
}

impl Row for ReceivedSample {
    type Own = ReceivedSample;
    fn own(&self) -> ReceivedSample {
        *self
    }
}

impl Row for DeviceSample {
    type Own = (Option<Timestamp>, Option<Timestamp>, String, u64, Vec<u64>);
    fn own(&self) -> Self::Own {
        let values = self.values.iter().map(|value| value.to_bits()).collect();
        (self.time, self.start, self.group.clone(), self.number, values)
    }
}

impl<R: Row<Own = O>, O> Sink<R> for Collected<O> {
    fn row(&mut self, row: &R) {
        self.rows.push(row.own());
    }
    fn defect(&mut self, defect: &Defect) {
        self.defects.push((defect.kind, defect.place, Digest::new(defect.bytes), defect.time, defect.lost));
    }
}

/// Position and content of each record of a capture.
pub type Records = Vec<(RecordPosition, Record)>;

/// A record of a capture without bytes of its own.
#[derive(Debug, PartialEq)]
pub enum Record {
    Frame { time: Option<Timestamp>, interface: Digest, id: u32, extended: bool, data: Digest },
    Broken(Digest, bool),
    Line(Digest),
    Dropped(u64),
    Other(&'static str),
}

/// Length and hash (FNV-1a) of bytes.
#[derive(Debug, PartialEq)]
pub struct Digest(usize, u64);

impl Digest {
    fn new(bytes: &[u8]) -> Digest {
        let mix = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3);
        Digest(bytes.len(), bytes.iter().fold(0xCBF2_9CE4_8422_2325, mix))
    }
}

impl Record {
    fn new(record: &CaptureRecord) -> Record {
        match *record {
            CaptureRecord::Frame(Frame { time, interface, id, extended, data }) => {
                assert!(data.len() <= 8 && id < 1 << if extended { 29 } else { 11 }, "{record:?}");
                Record::Frame { time, interface: Digest::new(interface), id, extended, data: Digest::new(data) }
            }
            CaptureRecord::Broken { bytes, cut } => {
                assert!(bytes.len() <= MAX_EXCERPT);
                Record::Broken(Digest::new(bytes), cut)
            }
            CaptureRecord::Line(line) => Record::Line(Digest::new(line)),
            CaptureRecord::Dropped(count) => Record::Dropped(count),
            CaptureRecord::Remote => Record::Other("remote"),
            CaptureRecord::Fd => Record::Other("fd"),
            CaptureRecord::Error => Record::Other("error"),
            CaptureRecord::Remark => Record::Other("remark"),
        }
    }
}

/// Reads a capture that arrives in these parts.
fn records(format: &Format, parts: &[&[u8]], mut each: impl FnMut(RecordPosition, CaptureRecord)) -> Records {
    let (mut reader, mut buffer, mut records) = (format.reader().expect("a capture"), Vec::new(), Vec::new());
    for (index, part) in parts.iter().enumerate() {
        buffer.extend_from_slice(part);
        let is_last = index + 1 == parts.len();
        let used = reader.read(&buffer, is_last, &mut |place, record| {
            records.push((place, Record::new(&record)));
            each(place, record);
        });
        assert!(used <= buffer.len() && (!is_last || used == buffer.len()), "{used} of {} bytes", buffer.len());
        buffer.drain(..used);
    }
    assert_eq!(reader.records(), records.len() as u64);
    records
}

/// Reads a capture with a fork of the reader for the whole lines of `part`, as a second thread does; `None` if the format has none.
pub fn forked(format: &Format, content: &[u8], part: Range<usize>) -> Option<Records> {
    let line_end = |at: usize| content[..at].iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    let (start, end) = (line_end(part.start), line_end(part.end));
    let (mut reader, mut records) = (format.reader()?, Vec::new());
    if start == 0 || reader.fork().is_none() {
        return None;
    }
    assert_eq!(
        reader.read(&content[..start], false, &mut |at, record| records.push((at, Record::new(&record)))),
        start
    );
    let (mut fork, before) = (reader.fork()?, reader.records());
    let mut own = Vec::new();
    assert_eq!(fork.read(&content[start..end], false, &mut |_, record| own.push(Record::new(&record))), end - start);
    reader.skip(own.len() as u64);
    records.extend((before + 1..).map(RecordPosition::Line).zip(own));
    reader.read(&content[end..], true, &mut |at, record| records.push((at, Record::new(&record))));
    Some(records)
}

/// Decodes a capture that arrives in these parts.
pub fn capture<D: Decode<Row: Row>>(
    mut decoder: D,
    format: &Format,
    parts: &[&[u8]],
    each: impl Fn(&CaptureRecord),
) -> (Records, Decoded<<D::Row as Row>::Own>) {
    let mut sink = Collected::default();
    decoder.begin("input", &mut sink);
    let records = records(format, parts, |place, record| {
        each(&record);
        decoder.event(place, &record, &mut sink);
    });
    decoder.count_records(records.len() as u64);
    (records, finish(decoder, sink))
}

/// Decodes serial bytes that arrive in these parts.
pub fn serial<D: Decode<Row: Row>>(mut decoder: D, parts: &[&[u8]]) -> Decoded<<D::Row as Row>::Own> {
    let mut sink = Collected::default();
    decoder.begin("input", &mut sink);
    parts.iter().for_each(|part| decoder.serial(part, None, &mut sink));
    finish(decoder, sink)
}

/// Ends the input and checks that the account covers each record and byte.
fn finish<D: Decode<Row: Row>>(
    mut decoder: D,
    mut sink: Collected<<D::Row as Row>::Own>,
) -> Decoded<<D::Row as Row>::Own> {
    decoder.finish(&mut sink);
    let summary = decoder.into_summary();
    assert!(summary.account.adds_up(), "{:?} missing of {:?}", summary.account.missing(), summary.account);
    assert_eq!(summary.rows, sink.rows.len() as u64);
    Decoded {
        counts: [summary.lost, summary.repeats, summary.resets, summary.dropped],
        account: summary.account,
        rows: sink.rows,
        defects: sink.defects,
    }
}
