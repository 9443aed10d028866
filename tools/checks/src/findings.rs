//! Findings: notes of single samples, joined to runs.

use std::collections::BTreeMap;

use geu_protocol::Gyro;
use geu_recording::{Defect, DefectKind, ReceivedSample};

use super::timeline::SampleTimes;
use super::wiring_hypothesis::WiringFault;
use crate::Finding;

/// Largest distance between notes of one run, s.
const JOINED_S: f64 = 60.0;
/// Maximum number of runs of one kind with a finding each.
const MAX_RUNS: usize = 10;
/// Shortest interval of an onset that is reported, s.
const CERTAIN_S: f64 = 2.0;

/// A kind of note.
#[derive(Debug, Clone, Copy)]
pub struct FindingKind {
    /// Stable name ([`Finding::kind`]).
    pub name: &'static str,
    /// Text after the number of samples.
    pub what: &'static str,
    /// Unit of the noted value; empty without a value.
    pub unit: &'static str,
}

struct Run {
    kind: FindingKind,
    gyro: Option<Gyro>,
    from_s: f64,
    to_s: f64,
    count: u64,
    largest: f64,
}

impl Run {
    fn join(&mut self, other: &Run) {
        self.to_s = self.to_s.max(other.to_s);
        self.count = self.count.saturating_add(other.count);
        if other.largest.abs() > self.largest.abs() {
            self.largest = other.largest;
        }
    }

    fn finding(&self, runs: usize) -> (f64, Finding) {
        let mut text = format!("{} {}", self.count, self.kind.what);
        if runs > 1 {
            text += &format!(", in {runs} runs");
        }
        if !self.kind.unit.is_empty() {
            let separator = if self.count > 1 { ", at most" } else { ":" };
            text += &format!("{separator} {:+.3} {}", self.largest, self.kind.unit);
        }
        let place = place(self.gyro, self.from_s, self.to_s);
        (self.from_s, Finding { kind: self.kind.name.to_owned(), place, text })
    }
}

/// `GYRX, 5200.0–5210.5 s`.
fn place(gyro: Option<Gyro>, from_s: f64, to_s: f64) -> String {
    let gyro = gyro.map_or(String::new(), |gyro| format!("{}, ", gyro.name()));
    format!("{gyro}{from_s:.1}\u{2013}{to_s:.1} s")
}

/// Collects notes and findings.
pub struct FindingCollector<'a> {
    timeline: &'a SampleTimes,
    runs: BTreeMap<(&'static str, Option<Gyro>), Vec<Run>>,
    findings: Vec<(f64, Finding)>,
}

impl<'a> FindingCollector<'a> {
    pub fn new(timeline: &'a SampleTimes) -> FindingCollector<'a> {
        FindingCollector { timeline, runs: BTreeMap::new(), findings: Vec::new() }
    }

    /// Notes one sample, or `count` samples that are missing before it.
    pub fn note(&mut self, kind: FindingKind, gyro: Option<Gyro>, row: usize, count: u64, value: f64) {
        let (from_s, to_s) = (self.timeline.start_s(row), self.timeline.end_s[row]);
        let run = Run { kind, gyro, from_s, to_s, count, largest: value };
        let runs = self.runs.entry((kind.name, gyro)).or_default();
        match runs.last_mut() {
            Some(last) if (from_s - last.to_s).abs() <= JOINED_S => last.join(&run),
            _ => runs.push(run),
        }
    }

    /// Adds a finding for the whole recording or one gyro.
    pub fn whole(&mut self, kind: &str, gyro: Option<Gyro>, text: String) {
        let [from_s, to_s] = match self.timeline.end_s.len() {
            0 => [0.0; 2],
            rows => [self.timeline.start_s(0), self.timeline.end_s[rows - 1]],
        };
        self.findings.push((from_s, Finding { kind: kind.to_owned(), place: place(gyro, from_s, to_s), text }));
    }

    /// Adds a finding for each kind of defect in the input. Gaps and jumps come from the rows.
    pub fn defects(&mut self, defects: &[Defect]) {
        let mut kinds: BTreeMap<DefectKind, (u64, u64, &Defect)> = BTreeMap::new();
        for defect in defects {
            if matches!(defect.kind, DefectKind::SequenceGap | DefectKind::SequenceJump | DefectKind::TimeBackwards) {
                continue;
            }
            let entry = kinds.entry(defect.kind).or_insert((0, 0, defect));
            (entry.0, entry.1) = (entry.0 + 1, entry.1.saturating_add(defect.lost));
        }
        for (kind, (count, lost, first)) in kinds {
            let place = first.place_text();
            let lost = if lost > 0 { format!(", {lost} lost") } else { String::new() };
            let text = format!("{count} in the input{lost}; the first at {place}");
            let since_s = first
                .time
                .map_or(0.0, |time| (i128::from(time.t_ns) - i128::from(self.timeline.start_ns)) as f64 * 1e-9);
            self.findings.push((since_s, Finding { kind: kind.name().to_owned(), place, text }));
        }
    }

    /// Adds a wiring fault.
    pub fn fault(&mut self, fault: &WiringFault) {
        let gyros: Vec<&str> = fault.gyros.iter().map(|gyro| gyro.name()).collect();
        let gyros = gyros.join(", ");
        let place = match (fault.onset_s, fault.end_s) {
            (None, None) => gyros,
            (Some(onset_s), None) => format!("{gyros}, from {onset_s:.1} s"),
            (onset_s, Some(end_s)) => format!("{gyros}, {:.1}\u{2013}{end_s:.1} s", onset_s.unwrap_or(0.0)),
        };
        let mut text = format!(
            "{} samples are {:.2} counts rms from the motion, and {:.2} with {}",
            fault.samples,
            fault.without_rms_counts,
            fault.with_rms_counts,
            fault.code()
        );
        let [from_s, to_s] = fault.onset_between_s;
        if fault.onset_s.is_some() && to_s - from_s > CERTAIN_S {
            text += &format!("; it may have begun between {from_s:.1} and {to_s:.1} s");
        }
        self.findings.push((fault.onset_s.unwrap_or(0.0), Finding { kind: fault.code(), place, text }));
    }

    /// All findings in time order.
    pub fn findings(self) -> Vec<Finding> {
        let mut findings = self.findings;
        for mut runs in self.runs.into_values() {
            let count = runs.len();
            if count > MAX_RUNS {
                let others = runs.split_off(1);
                others.iter().for_each(|run| runs[0].join(run));
                findings.push(runs[0].finding(count));
            } else {
                findings.extend(runs.iter().map(|run| run.finding(1)));
            }
        }
        findings.sort_by(|one, other| one.0.total_cmp(&other.0));
        findings.into_iter().map(|(_, finding)| finding).collect()
    }
}

/// True if two rows have the same sample.
pub fn same(one: &ReceivedSample, other: &ReceivedSample) -> bool {
    let [mut one_sample, other_sample] = [one, other].map(|row| row.sample);
    if !(one.has_clock && other.has_clock) {
        (one_sample.clock_count, one_sample.sensor_centi_c) = (other_sample.clock_count, other_sample.sensor_centi_c);
    }
    one_sample == other_sample
}
