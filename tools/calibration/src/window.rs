//! The windows of a recording to evaluate: the manoeuvres of a list, or the whole recording, cut where the unit rests.

use std::path::Path;

use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::Gyro;
use geu_recording::{CsvTable, TableError, open_rows};

use crate::counts::AccumulatedCounts;
use crate::observe::ExcludedData;
use crate::transfer::Transfer;

/// Legs that are no calibration manoeuvres (Casteren §5).
const PRECAUTIONS: [&str; 6] = ["stabilise", "slew", "survey", "raster", "eclipse", "hold"];

#[derive(Debug, Clone, PartialEq)]
pub struct ManoeuvreWindow {
    pub name: String,
    /// Start, s on the time scale of its list.
    pub start_s: f64,
    pub end_s: f64,
}

impl ManoeuvreWindow {
    pub(crate) fn new(name: &str, start_s: f64, end_s: f64) -> ManoeuvreWindow {
        ManoeuvreWindow { name: name.to_owned(), start_s, end_s }
    }

    /// The window, or one gyro of it, as data that is not used.
    pub(crate) fn excluded(&self, gyro: Option<Gyro>, why: String) -> ExcludedData {
        ExcludedData { name: self.name.clone(), start_s: self.start_s, gyro, why }
    }

    /// True for the slew about the sun vector that follows a Y-scan.
    pub(crate) fn is_slew_after(&self, scan: &ManoeuvreWindow) -> bool {
        scan.name == "y-scan" && self.name == "slew" && (self.start_s - scan.end_s).abs() < 0.5
    }

    /// True for a precaution, which is no calibration manoeuvre.
    pub fn is_precaution(&self) -> bool {
        PRECAUTIONS.contains(&self.name.as_str())
    }
}

/// Reads `manoeuvres.csv`, which may be compressed, and sorts it by time. An empty end is that of the recording (infinite).
///
/// # Errors
/// The first line that is no manoeuvre, or overlaps the one before.
pub fn read(name: &str) -> Result<Vec<ManoeuvreWindow>, TableError> {
    let expected = "manoeuvres, CSV with the columns manoeuvre,start_s,end_s";
    let rows = open_rows(Path::new(name)).map_err(TableError::read(name, expected))?;
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
        windows.push(ManoeuvreWindow::new(table.text(title), start_s, end_s));
    }
    windows.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    Ok(windows)
}

/// Smoothed rates below this count as rest: the limit cycle, of 5″/s at most and 5 s (Casteren §3.3), averages out.
pub(crate) const REST_ARCSEC_S: f64 = 4.0;
/// Samples over which rates are smoothed: one period of the limit cycle.
const SMOOTHED: usize = 10;
/// Maximum length of a window, so that scans without a rest still determine their drift.
pub(crate) const LONGEST_SAMPLE_INTERVALS: usize = 3600;
/// Shorter windows are joined to the one before.
const SHORTEST_SAMPLE_INTERVALS: usize = 120;

/// Rate about the control axes around a node, smoothed over a period of the limit cycle, arcsec/s.
pub(crate) fn smoothed_rate_control_arcsec_s(counts: &AccumulatedCounts, transfer: &Transfer, node: usize) -> [f64; 3] {
    let (from, to) = (node.saturating_sub(SMOOTHED / 2), (node + SMOOTHED / 2).min(counts.len()));
    let turned = std::array::from_fn(|gyro| counts.accumulated[gyro][to] - counts.accumulated[gyro][from]);
    let samples = (to - from) as f64;
    transfer.about_control_arcsec(turned, samples).map(|angle| angle / (SAMPLE_INTERVAL_S * samples))
}

/// Cuts a recording between two of its instants where the unit rests, by its counts, and every half hour or more often. `before` is the number
/// of windows before them.
pub fn cut_at_rests(
    counts: &AccumulatedCounts,
    transfer: &Transfer,
    [from_s, to_s]: [f64; 2],
    before: usize,
) -> Vec<ManoeuvreWindow> {
    let first = counts.node_s.partition_point(|&node_s| node_s < from_s);
    let last = counts.node_s.partition_point(|&node_s| node_s <= to_s).saturating_sub(1);
    let is_at_rest = |node: usize| {
        smoothed_rate_control_arcsec_s(counts, transfer, node).iter().all(|rate| rate.abs() < REST_ARCSEC_S)
    };
    let mut cuts = vec![first];
    let mut was_at_rest = is_at_rest(first);
    for node in first + 1..last {
        let rests = is_at_rest(node);
        let since = node - cuts[cuts.len() - 1];
        if (rests != was_at_rest && since >= SHORTEST_SAMPLE_INTERVALS) || since >= LONGEST_SAMPLE_INTERVALS {
            cuts.push(node);
        }
        was_at_rest = rests;
    }
    if last.saturating_sub(cuts[cuts.len() - 1]) < SHORTEST_SAMPLE_INTERVALS && cuts.len() > 1 {
        cuts.pop();
    }
    cuts.push(last);
    cuts.windows(2)
        .filter(|pair| pair[1] > pair[0])
        .enumerate()
        .map(|(index, pair)| {
            let [start_s, end_s] = [pair[0], pair[1]].map(|node| counts.start_s() + counts.node_s[node]);
            ManoeuvreWindow::new(&format!("stretch {}", before + index + 1), start_s, end_s)
        })
        .collect()
}

/// Nodes of the shortest window of a described unit.
pub(crate) const SHORTEST_NODES: usize = 4;
/// Share of its length by which windows of a described unit are moved, each by another part of it: a periodic motion meets them in all
/// phases.
const MOVED: f64 = 0.5;
const GOLDEN: f64 = 0.618_033_988_749_895;

/// Cuts a recording at instants, in order of time, into at most `most` windows.
pub(crate) fn cut_at(counts: &AccumulatedCounts, ends_s: &[f64], most: usize) -> Vec<ManoeuvreWindow> {
    let mut nodes: Vec<usize> = ends_s.iter().filter_map(|t_s| counts.nearest(*t_s)).collect();
    nodes.dedup();
    let step = nodes.len().saturating_sub(1).div_ceil(most).max(1);
    let cuts: Vec<usize> = nodes.iter().copied().step_by(step).collect();
    let window = |(index, ends): (usize, &[usize])| {
        let [start_s, end_s] = [ends[0], ends[1]].map(|node| counts.start_s() + counts.node_s[node]);
        ManoeuvreWindow::new(&format!("window {}", index + 1), start_s, end_s)
    };
    cuts.windows(2).enumerate().map(window).collect()
}

/// Cuts a recording between two of its instants into at most `most` windows, whether the unit rests or not.
pub(crate) fn cut_evenly(counts: &AccumulatedCounts, from_s: f64, to_s: f64, most: usize) -> Vec<ManoeuvreWindow> {
    let first = counts.node_s.partition_point(|&node_s| node_s < from_s);
    let last = counts.node_s.partition_point(|&node_s| node_s <= to_s).saturating_sub(1);
    let nodes = last.saturating_sub(first);
    let parts = most.min(nodes / SHORTEST_NODES);
    let cut = |index: usize| match index {
        0 => first,
        _ if index == parts => last,
        _ => {
            let moved = MOVED * ((index as f64 * GOLDEN).fract() - 0.5);
            first + ((index as f64 + moved) * nodes as f64 / parts as f64) as usize
        }
    };
    let window = |index: usize| {
        let [start_s, end_s] = [index, index + 1].map(|index| counts.start_s() + counts.node_s[cut(index)]);
        ManoeuvreWindow::new(&format!("window {}", index + 1), start_s, end_s)
    };
    (0..parts).map(window).collect()
}
