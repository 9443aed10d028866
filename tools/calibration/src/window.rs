//! Which stretches of a recording are evaluated: the manoeuvres of a list, or everything, cut where the unit rests.

use std::io::Read;
use std::path::Path;

use geu_model::units::SAMPLE_INTERVAL_S;
use geu_recording::{CsvTable, RowReader, TableError, open_rows};

use crate::counts::AccumulatedCounts;
use crate::transfer::Transfer;

/// Legs that serve others and are no calibration manoeuvres (Casteren §5).
const PRECAUTIONS: [&str; 6] = ["stabilise", "slew", "survey", "raster", "eclipse", "hold"];

#[derive(Debug, Clone, PartialEq)]
pub struct ManoeuvreWindow {
    pub name: String,
    /// Start, s on the time scale of its list.
    pub start_s: f64,
    pub end_s: f64,
}

impl ManoeuvreWindow {
    /// Whether it is a precaution and no calibration manoeuvre.
    pub fn is_precaution(&self) -> bool {
        PRECAUTIONS.contains(&self.name.as_str())
    }
}

/// Reads `manoeuvres.csv`, which may be compressed; in order of time, whatever that of the lines. An empty end is that of the recording (infinite).
///
/// # Errors
/// The first line that is no manoeuvre, or overlaps the one before.
pub fn read(name: &str) -> Result<Vec<ManoeuvreWindow>, TableError> {
    let expected = "manoeuvres, CSV with the columns manoeuvre,start_s,end_s";
    of_rows(name, open_rows(Path::new(name)).map_err(TableError::read(name, expected))?)
}

/// Reads a text; `name` is what errors call it.
///
/// # Errors
/// As [`read`].
pub fn parse(name: &str, text: &str) -> Result<Vec<ManoeuvreWindow>, TableError> {
    of_rows(name, RowReader::new(text.as_bytes()))
}

fn of_rows(name: &str, rows: RowReader<impl Read>) -> Result<Vec<ManoeuvreWindow>, TableError> {
    let mut table = CsvTable::with_short_rows(name, rows)?;
    let [title, start, end] = table.columns(["manoeuvre", "start_s", "end_s"])?;
    let mut windows: Vec<ManoeuvreWindow> = Vec::new();
    while table.read()? {
        let start_s = table.number(start)?;
        let end_s = if table.text(end).is_empty() { f64::INFINITY } else { table.number(end)? };
        if end_s <= start_s {
            return Err(table.unexpected(end, &format!("an end after the start, {start_s}")));
        }
        if let Some(before) = windows.iter().find(|other| start_s < other.end_s - 1e-6 && end_s > other.start_s + 1e-6)
        {
            let (before, from_s, to_s) = (&before.name, before.start_s, before.end_s);
            let expected = format!("a manoeuvre beside the {before} of {from_s}…{to_s} s, not over it");
            return Err(table.unexpected(start, &expected));
        }
        windows.push(ManoeuvreWindow { name: table.text(title).to_owned(), start_s, end_s });
    }
    windows.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    Ok(windows)
}

/// Smoothed rates below this are rest: the limit cycle, of 5″/s at most and 5 s (Casteren §3.3), averages out.
pub(crate) const REST_ARCSEC_S: f64 = 4.0;
/// Samples over which rates are smoothed: one period of the limit cycle.
const SMOOTHED: usize = 10;
/// Stretches are cut to this length at most, so that scans without a rest still tell their drift; longer in recordings of
/// weeks, so that they do not become too many to be solved together.
pub(crate) const LONGEST_SAMPLE_INTERVALS: usize = 3600;
/// Stretches that a recording is cut into by length alone.
const MOST_BY_LENGTH: usize = 100;
/// Stretches shorter than this are joined to the one before.
const SHORTEST_SAMPLE_INTERVALS: usize = 120;

/// Rate about the control axes around a node, smoothed over a period of the limit cycle, arcsec/s.
pub(crate) fn smoothed_rate_control_arcsec_s(counts: &AccumulatedCounts, transfer: &Transfer, node: usize) -> [f64; 3] {
    let (from, to) = (node.saturating_sub(SMOOTHED / 2), (node + SMOOTHED / 2).min(counts.len()));
    let turned = std::array::from_fn(|gyro| counts.accumulated[gyro][to] - counts.accumulated[gyro][from]);
    let samples = (to - from) as f64;
    transfer.about_control_arcsec(turned, samples).map(|angle| angle / (SAMPLE_INTERVAL_S * samples))
}

/// Cuts a recording between two of its instants where the unit rests, as its counts tell, and once in half an hour at
/// least.
pub fn cut_at_rests(counts: &AccumulatedCounts, transfer: &Transfer, from_s: f64, to_s: f64) -> Vec<ManoeuvreWindow> {
    let first = counts.node_s.partition_point(|&node_s| node_s < from_s);
    let last = counts.node_s.partition_point(|&node_s| node_s <= to_s).saturating_sub(1);
    let longest = LONGEST_SAMPLE_INTERVALS.max(last.saturating_sub(first) / MOST_BY_LENGTH);
    let shortest = SHORTEST_SAMPLE_INTERVALS.max(longest / 30);
    let is_at_rest = |node: usize| {
        smoothed_rate_control_arcsec_s(counts, transfer, node).iter().all(|rate| rate.abs() < REST_ARCSEC_S)
    };
    let mut cuts = vec![first];
    let mut was_at_rest = is_at_rest(first);
    for node in first + 1..last {
        let rests = is_at_rest(node);
        let since = node - cuts[cuts.len() - 1];
        if (rests != was_at_rest && since >= shortest) || since >= longest {
            cuts.push(node);
        }
        was_at_rest = rests;
    }
    if last.saturating_sub(cuts[cuts.len() - 1]) < shortest && cuts.len() > 1 {
        cuts.pop();
    }
    cuts.push(last);
    cuts.windows(2)
        .filter(|pair| pair[1] > pair[0])
        .enumerate()
        .map(|(index, pair)| ManoeuvreWindow {
            name: format!("stretch {}", index + 1),
            start_s: counts.node_s[pair[0]],
            end_s: counts.node_s[pair[1]],
        })
        .collect()
}
