//! Rows of a table of a described unit: columns by their names, times and trials of rows.

use geu_model::device::TableWire;
use geu_protocol::capture::{MAX_EXCERPT, Timestamp};
use geu_protocol::continuity::SequenceStep;
use geu_protocol::layout::{Quantity, Sequence};

use super::Samples;
use crate::defect::DefectKind;
use crate::flow::Stamp;
use crate::parquet_text::SEPARATOR;
use crate::row::{DeviceSample, Sink};
use crate::text::timestamp;

/// Time between rows, in intervals, that is none.
const TOLERANCE: f64 = 0.5;

/// The table of a unit.
#[derive(Debug)]
pub struct Table {
    wire: TableWire,
    /// Columns of the present input, once its header is read.
    columns: Option<Columns>,
    /// Numbers of the rows, and their place in the values, if the table has them.
    sequence: Option<(usize, Sequence)>,
    values: Vec<f64>,
    /// The last jump of time: how far, intervals, and the samples that were counted as missing.
    jump: (f64, u64),
}

/// Places of the columns in a row.
#[derive(Debug)]
struct Columns {
    titles: Vec<String>,
    time: usize,
    start: Option<usize>,
    group: Option<usize>,
    fields: Vec<usize>,
}

impl Table {
    pub fn new(wire: TableWire) -> Table {
        let (sequence, values) = (sequence_of(&wire), vec![f64::NAN; wire.frames.values.len()]);
        Table { wire, columns: None, sequence, values, jump: (0.0, 0) }
    }

    /// True if each row has a number of its own, by which missing ones are found.
    pub fn has_sequence(&self) -> bool {
        self.sequence.is_some()
    }

    /// Begins an input, which has a header of its own.
    pub fn begin(&mut self) {
        self.columns = None;
    }

    /// The columns that are expected, in words.
    pub fn expected(&self) -> String {
        let titles: Vec<&str> = self.wire.titles().map(String::as_str).collect();
        format!("the columns {}, separated by {:?}", titles.join(", "), self.wire.delimiter)
    }

    /// True if these first bytes of an input have the columns in their first line; `None` if more bytes are needed.
    pub fn is_begun_by(&self, head: &[u8], is_complete: bool) -> Option<bool> {
        let head = String::from_utf8_lossy(head);
        for line in head.split_inclusive('\n') {
            if !line.ends_with('\n') && !is_complete {
                return None;
            }
            if self.columns_of(line).is_some() {
                return Some(true);
            }
            if !is_remark(line) {
                return Some(false);
            }
        }
        is_complete.then_some(false)
    }

    /// The columns of a header, which may begin as a remark does.
    fn columns_of(&self, line: &str) -> Option<Columns> {
        let line = line.trim_start_matches(['\u{feff}', '#', ' ']);
        let titles: Vec<String> = self.cells(line).iter().map(|title| (*title).to_owned()).collect();
        let place = |title: &String| titles.iter().position(|own| own == title);
        let optional = |title: Option<&String>| title.map_or(Some(None), |title| place(title).map(Some));
        Some(Columns {
            time: place(&self.wire.time.column)?,
            start: optional(self.wire.start.as_ref().map(|start| &start.column))?,
            group: optional(self.wire.group.as_ref())?,
            fields: self.wire.columns.iter().map(place).collect::<Option<_>>()?,
            titles,
        })
    }

    /// The cells of a row, without quotes and spaces around them.
    fn cells<'a>(&self, line: &'a str) -> Vec<&'a str> {
        let delimiter = if line.contains(SEPARATOR) { SEPARATOR } else { self.wire.delimiter };
        let mut is_quoted = false;
        let cells = line.trim_end_matches(['\r', '\n']).split(|letter| {
            is_quoted ^= letter == '"';
            letter == delimiter && !is_quoted
        });
        let cells = cells.map(|cell| cell.trim().trim_matches('"').trim());
        cells.filter(|cell| delimiter != ' ' || !cell.is_empty()).collect()
    }

    /// Reads a line.
    pub fn line(&mut self, line: &[u8], at: Stamp, samples: &mut Samples, sink: &mut impl Sink<DeviceSample>) {
        let text = String::from_utf8_lossy(line);
        if self.columns.is_none() {
            self.columns = self.columns_of(&text);
            if self.columns.is_some() {
                return samples.flow.summary.account.remarks += 1;
            }
        }
        if is_remark(&text) {
            return samples.flow.summary.account.remarks += 1;
        }
        let cells = self.cells(&text);
        match self.columns.take() {
            Some(columns) => {
                if let Err(bytes) = self.row(&columns, &cells, at, samples, sink) {
                    samples.flow.defect(at, DefectKind::BadRow, cut(bytes.as_deref().unwrap_or(line)), 0, sink);
                }
                self.columns = Some(columns);
            }
            None => samples.flow.defect(at, DefectKind::BadRow, cut(line), 0, sink),
        }
    }

    /// Reads a row. The error is the cell without which it is no sample, or none for a wrong number of cells.
    fn row(
        &mut self,
        columns: &Columns,
        cells: &[&str],
        at: Stamp,
        samples: &mut Samples,
        sink: &mut impl Sink<DeviceSample>,
    ) -> Result<(), Option<Vec<u8>>> {
        if cells.len() != columns.titles.len() {
            return Err(None);
        }
        let quoted = |place: usize| format!("{}: {}", columns.titles[place], cells[place]).into_bytes();
        let time = |place: usize, unit_ns| timestamp(cells[place], unit_ns).ok_or_else(|| Some(quoted(place)));
        let end = time(columns.time, self.wire.time.unit_ns())?;
        let start = columns.start.zip(self.wire.start.as_ref());
        let start = start.map(|(place, start)| time(place, start.unit_ns())).transpose()?;
        if let Some((place, _)) = columns.start.zip(start).filter(|(_, start)| start.t_ns >= end.t_ns) {
            return Err(Some(quoted(place)));
        }
        let (mut bad, mut outputs, mut is_blank) = (Vec::new(), 0, true);
        for (field, &place) in self.wire.frames.frames[0].fields.iter().zip(&columns.fields) {
            let number = cells[place].parse::<f64>().unwrap_or(f64::NAN);
            self.values[field.slot] = if number.is_finite() { field.value(number) } else { f64::NAN };
            let is_output = matches!(self.wire.frames.values[field.slot].quantity, Quantity::Output(_));
            outputs += usize::from(is_output && number.is_finite());
            is_blank &= !is_output || cells[place].is_empty();
            // Other values may come in some rows only.
            if !number.is_finite() && (is_output || !(cells[place].is_empty() || cells[place].parse::<f64>().is_ok())) {
                bad.push(quoted(place));
            }
        }
        let stamp = Stamp { time: Some(end), ..at };
        if outputs == 0 {
            samples.flow.summary.account.remarks += u64::from(is_blank);
            return if is_blank { Ok(()) } else { Err(bad.into_iter().next()) };
        }
        samples.flow.summary.account.decoded += 1;
        bad.iter().for_each(|cell| samples.flow.defect(stamp, DefectKind::BadCell, cut(cell), 0, sink));
        if let Some(place) = columns.group
            && (samples.last.is_none() || samples.row.group != cells[place])
        {
            cells[place].clone_into(&mut samples.row.group);
            samples.begin_trial();
            (self.sequence, self.jump) = (sequence_of(&self.wire), (0.0, 0));
        }
        samples.row.start = start;
        let step = self.step(start, end, samples);
        if step == SequenceStep::Repeat {
            samples.flow.defect(stamp, DefectKind::TimeRepeated, &[], 0, sink);
        }
        samples.report(stamp, step, &self.values, sink);
        Ok(())
    }

    /// Compares a row with the one before: by the sequence, or by the times.
    fn step(&mut self, start: Option<Timestamp>, end: Timestamp, samples: &mut Samples) -> SequenceStep {
        let since_ns = samples.last.map(|last| end.t_ns.saturating_sub(last.t_ns));
        let interval_ns = samples.interval_s * 1e9;
        if let Some((slot, sequence)) = &mut self.sequence
            && !self.values[*slot].is_nan()
        {
            return sequence.step(&self.values, since_ns.map(|since_ns| since_ns as f64 / interval_ns));
        }
        let Some(since_ns) = since_ns else { return SequenceStep::First };
        let length_ns = start.map_or(interval_ns, |start| end.t_ns.saturating_sub(start.t_ns) as f64);
        let beside = (since_ns as f64 - length_ns) / interval_ns;
        let (jump, missing) = self.jump;
        match beside {
            _ if since_ns == 0 => SequenceStep::Repeat,
            _ if since_ns > 0 && beside <= TOLERANCE => SequenceStep::Next,
            // Time returns to where it was before it jumped.
            _ if (beside + jump).abs() <= TOLERANCE => {
                samples.row.number = samples.row.number.saturating_sub(missing);
                samples.flow.summary.lost = samples.flow.summary.lost.saturating_sub(missing);
                self.jump = (0.0, 0);
                SequenceStep::Reset
            }
            _ if since_ns < 0 => {
                self.jump = (beside, 0);
                SequenceStep::Reset
            }
            _ => {
                self.jump = (beside, beside.round() as u64);
                SequenceStep::Gap(self.jump.1)
            }
        }
    }
}

fn sequence_of(wire: &TableWire) -> Option<(usize, Sequence)> {
    let fields = &wire.frames.frames[0].fields;
    let slot = wire.frames.slot(&Quantity::Sequence).filter(|slot| fields.iter().any(|field| field.slot == *slot))?;
    Some((slot, Sequence::new(&wire.frames)))
}

fn is_remark(line: &str) -> bool {
    let line = line.trim_start_matches('\u{feff}').trim();
    line.is_empty() || line.starts_with('#')
}

/// The bytes that a defect keeps.
fn cut(bytes: &[u8]) -> &[u8] {
    &bytes[..bytes.len().min(MAX_EXCERPT)]
}
