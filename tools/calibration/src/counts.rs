//! What the gyros counted: accumulated counts at the ends of samples, with the time of each and the places where
//! the sum cannot be trusted.
//!
//! Samples are placed by the unit's own sequence and clock; when they ended is told by the receive times, averaged
//! over five minutes, so that jitter goes and a clock that is fast, or warms, stays.

use geu_model::units::SAMPLE_INTERVAL_NS;
use geu_protocol::continuity::{Continuity, SequenceStep};
use geu_protocol::field::{GYRO_FLAGS, unit_flag};
use geu_protocol::{Gyro, Sample};
use geu_recording::{Defect, ReceivedSample, Sink};
use nalgebra::Matrix4;

/// Samples over which receive times are averaged.
const TIMING_BLOCK: usize = 600;
/// Samples that may be missing in all, a week's: more are a wrong word, not a gap.
const MOST_MISSING: u64 = 1_209_600;
/// A receive time this far from the averaged course is a jump of somebody's clock.
const TIME_JUMP_S: f64 = 0.1;

/// Why a sum over a sample interval is worth nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BreakKind {
    /// So many samples are missing.
    Gap(u64),
    /// Sequence and clock stand in no relation to those before.
    Jump,
    Reset,
    /// Receive times jumped against the unit's clock.
    TimeJump,
    /// The gyro's count is marked as no measurement.
    Invalid,
    /// The gyro's count was clipped.
    Saturated,
    /// The self-test's pattern is in the counts.
    SelfTest,
}

impl std::fmt::Display for BreakKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            BreakKind::Gap(1) => write!(f, "1 sample is missing"),
            BreakKind::Gap(count) => write!(f, "{count} samples are missing"),
            BreakKind::Jump => write!(f, "sequence and clock jump"),
            BreakKind::Reset => write!(f, "the unit restarted"),
            BreakKind::TimeJump => write!(f, "receive times jump"),
            BreakKind::Invalid => write!(f, "the count is not valid"),
            BreakKind::Saturated => write!(f, "the count is saturated"),
            BreakKind::SelfTest => write!(f, "the self-test runs"),
        }
    }
}

/// A stretch over which sums are worth nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discontinuity {
    pub from: usize,
    pub to: usize,
    /// The gyros concerned, in wire order.
    pub gyros: [bool; 4],
    pub kind: BreakKind,
}

/// Accumulated counts at nodes: node 0 is the start of the first sample interval, node k the end of the k-th.
#[derive(Debug, Clone, Default)]
pub struct AccumulatedCounts {
    /// Time of node 0, ns, on the time scale of the capture.
    pub start_ns: i64,
    /// Whether the times were received; else they are the unit's own clock.
    pub is_received: bool,
    /// Time of each node since node 0, s.
    pub node_s: Vec<f64>,
    /// Sum of the increments up to each node, counts, in the order of [`Gyro::ALL`].
    pub accumulated: [Vec<f64>; 4],
    /// Electronics temperature over the sample interval before each node, °C (node 0 as node 1).
    pub electronics_c: Vec<f64>,
    /// Sensor temperature at each node, °C, the last one known where a row has none; empty where none has.
    pub sensor_c: Vec<f64>,
    /// Nodes of the rows, and how much later each was received than nominal samples since the first would have it, s; empty
    /// where nothing was received.
    pub received_late_s: Vec<(usize, f64)>,
    /// Where sums are worth nothing, in order.
    pub breaks: Vec<Discontinuity>,
    /// The instant after which times ran back, and what followed was dropped.
    pub runs_back_s: Option<f64>,
}

/// Where an instant lies between nodes: weights of four neighbouring nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interpolation {
    pub first: usize,
    /// Its weight and those of the next three.
    pub weights: [f64; 4],
    /// The instant in samples since node 0.
    pub samples: f64,
}

impl AccumulatedCounts {
    /// Counts that start at `start_ns`, with nothing yet.
    pub fn starting_at(start_ns: i64) -> AccumulatedCounts {
        AccumulatedCounts {
            start_ns,
            node_s: vec![0.0],
            accumulated: std::array::from_fn(|_| vec![0.0]),
            ..AccumulatedCounts::default()
        }
    }

    /// Adds a sample that ends `end_s` after the start; `increments` may be real numbers, as before rounding.
    pub fn push(&mut self, end_s: f64, increments: [f64; 4], electronics_c: f64) {
        self.node_s.push(end_s);
        for (sums, increment) in self.accumulated.iter_mut().zip(increments) {
            sums.push(sums[sums.len() - 1] + increment);
        }
        if self.electronics_c.is_empty() {
            self.electronics_c.push(electronics_c);
        }
        self.electronics_c.push(electronics_c);
    }

    /// Drops what follows the first time that runs back: an instant after it would be there twice.
    fn cut_where_time_runs_back(&mut self) {
        if let Some(node) = self.node_s.windows(2).position(|pair| pair[1] <= pair[0]) {
            self.runs_back_s = Some(self.start_ns as f64 * 1e-9 + self.node_s[node]);
            self.node_s.truncate(node + 1);
            self.electronics_c.truncate(node + 1);
            self.sensor_c.truncate(node + 1);
            self.received_late_s.retain(|received| received.0 <= node);
            self.accumulated.iter_mut().for_each(|sums| sums.truncate(node + 1));
            self.breaks.retain(|found| found.from < node);
            self.breaks.iter_mut().for_each(|found| found.to = found.to.min(node));
        }
    }

    /// Puts the times of a unit whose own clock told them, and is fast by so many ppm, on true time.
    pub fn correct_clock(&mut self, ppm: f64) {
        if !self.is_received {
            self.node_s.iter_mut().for_each(|node_s| *node_s /= 1.0 + ppm * 1e-6);
        }
    }

    pub fn len(&self) -> usize {
        self.node_s.len().saturating_sub(1)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of the last node, s since the start.
    pub fn end_s(&self) -> f64 {
        self.node_s.last().copied().unwrap_or(0.0)
    }

    /// The node nearest to an instant; nothing outside the recording (by more than half a sample).
    pub fn nearest(&self, t_s: f64) -> Option<usize> {
        let after = self.node_s.partition_point(|&node_s| node_s < t_s);
        let nearest = match (after.checked_sub(1), self.node_s.get(after)) {
            (Some(before), Some(&after_s)) if t_s - self.node_s[before] < after_s - t_s => before,
            (_, Some(_)) => after,
            (Some(before), None) => before,
            (None, None) => return None,
        };
        ((self.node_s[nearest] - t_s).abs() <= 0.26).then_some(nearest)
    }

    pub fn at_node(&self, node: usize) -> Interpolation {
        let first = node.min(self.node_s.len().saturating_sub(4));
        let mut weights = [0.0; 4];
        weights[node - first] = 1.0;
        Interpolation { first, weights, samples: node as f64 }
    }

    /// An instant between nodes, by the cubic through the four nearest (Casteren §6 interpolates between samples);
    /// nothing outside the recording.
    pub fn at(&self, t_s: f64) -> Option<Interpolation> {
        let last = self.node_s.len().checked_sub(1).filter(|&last| last >= 4)?;
        // An instant that is a node but for rounding is that node.
        if let Some(node) = self.nearest(t_s).filter(|&node| (self.node_s[node] - t_s).abs() < 1e-6) {
            return Some(self.at_node(node));
        }
        if !(0.0..=self.node_s[last]).contains(&t_s) {
            return None;
        }
        let piece = self.node_s.partition_point(|&node_s| node_s <= t_s).saturating_sub(1).min(last - 1);
        let samples = piece as f64 + (t_s - self.node_s[piece]) / (self.node_s[piece + 1] - self.node_s[piece]);
        let first = piece.saturating_sub(1).min(last - 3);
        let x = samples - first as f64;
        let weights = std::array::from_fn(|own| {
            (0..4).filter(|&other| other != own).map(|other| (x - other as f64) / (own as f64 - other as f64)).product()
        });
        Some(Interpolation { first, weights, samples })
    }

    /// An instant at which the unit rests between two ramps, from two nodes on either side: the angle there of a line
    /// with a parabola of its own on each side. A cubic would err by 0.2″ where ramps of 36″/s² meet.
    pub fn at_rest(&self, t_s: f64) -> Option<Interpolation> {
        let mut reading = self.at(t_s)?;
        let x: [f64; 4] = std::array::from_fn(|index| (reading.first + index) as f64 - reading.samples);
        // Two on either side, neither at the instant itself.
        if x[1] > -1e-3 || x[2] < 1e-3 {
            return Some(reading);
        }
        let shapes = Matrix4::from_fn(|shape, node| match shape {
            0 => 1.0,
            1 => x[node],
            2 => x[node].min(0.0).powi(2),
            _ => x[node].max(0.0).powi(2),
        });
        if let Some(inverse) = shapes.try_inverse() {
            reading.weights = std::array::from_fn(|node| inverse[(node, 0)]);
        }
        Some(reading)
    }

    /// The accumulated count of a gyro at an instant.
    pub fn count(&self, gyro: usize, reading: &Interpolation) -> f64 {
        let nodes = &self.accumulated[gyro][reading.first..];
        reading.weights.iter().zip(nodes).map(|(weight, count)| weight * count).sum()
    }

    /// The first break of a gyro between two instants, or beside one of them among the nodes that it is read from.
    pub fn broken(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> Option<&Discontinuity> {
        let used = |reading: &Interpolation| {
            let nodes = (0..reading.weights.len()).filter(|&index| reading.weights[index] != 0.0);
            let nodes: Vec<usize> = nodes.map(|index| reading.first + index).collect();
            (nodes.first().copied().unwrap_or(reading.first), nodes.last().copied().unwrap_or(reading.first))
        };
        let (first, last) = (used(from).0.min(used(to).0), used(from).1.max(used(to).1));
        self.breaks.iter().find(|found| found.gyros[gyro] && found.from < last && found.to > first)
    }
}

/// Takes rows from a decoder and makes [`AccumulatedCounts`] of them.
#[derive(Debug, Default)]
pub struct CountsReader {
    continuity: Continuity,
    /// Node of the sample before.
    node: usize,
    /// Node, time and whether that was received, of each row.
    times: Vec<(usize, i64, bool)>,
    counts: AccumulatedCounts,
    missing: u64,
    defects: u64,
}

impl Sink for CountsReader {
    fn row(&mut self, row: &ReceivedSample) {
        let sample = &row.sample;
        let step = self.continuity.step(sample.sequence, row.has_clock.then_some(sample.clock_count));
        let by_time = |times: &[(usize, i64, bool)]| {
            let before_ns = times.last().filter(|last| last.2 == row.is_received).map(|last| last.1);
            let passed_ns =
                row.time.zip(before_ns).map_or(SAMPLE_INTERVAL_NS, |(time, before_ns)| time.t_ns - before_ns);
            ((passed_ns + SAMPLE_INTERVAL_NS / 2) / SAMPLE_INTERVAL_NS).max(1) as u64
        };
        let (advance, kind) = match step {
            SequenceStep::First | SequenceStep::Next => (1, None),
            SequenceStep::Repeat => return,
            SequenceStep::Gap(missing) => (missing + 1, Some(BreakKind::Gap(missing))),
            SequenceStep::Reset => (by_time(&self.times), Some(BreakKind::Reset)),
            SequenceStep::Jump => (by_time(&self.times), Some(BreakKind::Jump)),
        };
        let advance = if advance - 1 > MOST_MISSING - self.missing { 1 } else { advance };
        self.missing += advance - 1;
        let advance = advance as usize;
        if self.counts.node_s.is_empty() {
            self.counts = AccumulatedCounts::starting_at(0);
        }
        let from = self.node;
        self.node += advance;
        let electronics_c = f64::from(sample.electronics_centi_c) * 0.01;
        for _ in 1..advance {
            self.counts.push(0.0, [0.0; 4], electronics_c);
        }
        self.counts.push(0.0, increments(sample), electronics_c);
        if let Some(kind) = kind {
            self.note(from, [true; 4], kind);
        }
        let flag = |bit: usize| sample.gyro_flags & (1 << GYRO_FLAGS[bit].bit) != 0;
        let (valid, saturated) =
            (Gyro::ALL.map(|gyro| flag(gyro as usize)), Gyro::ALL.map(|gyro| flag(gyro as usize + 4)));
        self.note(self.node - 1, valid.map(|valid| !valid), BreakKind::Invalid);
        self.note(self.node - 1, saturated, BreakKind::Saturated);
        if sample.unit_flags & unit_flag("self_test") != 0 {
            self.note(self.node - 1, [true; 4], BreakKind::SelfTest);
        }
        if row.has_clock {
            // Rows without one, between, keep the temperature before.
            let held = self.counts.sensor_c.last().copied().unwrap_or(f64::from(sample.sensor_centi_c) * 0.01);
            self.counts.sensor_c.resize(self.node, held);
            self.counts.sensor_c.push(f64::from(sample.sensor_centi_c) * 0.01);
        }
        if let Some(time) = row.time {
            self.times.push((self.node, time.t_ns, row.is_received));
        }
    }

    fn defect(&mut self, _defect: &Defect) {
        // What a defect took away shows as a gap in the sequence; the decoder reports the defect itself.
        self.defects += 1;
    }
}

impl CountsReader {
    pub fn defects(&self) -> u64 {
        self.defects
    }

    fn note(&mut self, from: usize, gyros: [bool; 4], kind: BreakKind) {
        if !gyros.contains(&true) {
            return;
        }
        // One break for a stretch, however long.
        if let Some(last) =
            self.counts.breaks.iter_mut().rev().take(3).find(|last| last.kind == kind && last.gyros == gyros)
            && last.to == from
        {
            last.to = self.node;
            return;
        }
        self.counts.breaks.push(Discontinuity { from, to: self.node, gyros, kind });
    }

    /// What was counted; nothing without a row. `clock_start_ns` is the time at which the unit's clock was 0, for
    /// recordings without receive times.
    pub fn finish(mut self, clock_start_ns: i64) -> Option<AccumulatedCounts> {
        let first = *self.times.first()?;
        let is_received = self.times.iter().any(|time| time.2);
        self.times.retain(|time| time.2 == is_received);
        // Departures of the times from nominal samples since the first, so that no digit is lost.
        let departures: Vec<(usize, f64)> = self
            .times
            .iter()
            .map(|&(node, t_ns, _)| {
                (node, (t_ns - first.1 - (node - first.0) as i64 * SAMPLE_INTERVAL_NS) as f64 * 1e-9)
            })
            .collect();
        let mut counts = self.counts;
        let (course, jumps) = course(&departures);
        let nominal_s = |node: usize| (node as f64 - first.0 as f64) * 0.5;
        let at = |node: usize| nominal_s(node) + course(node as f64);
        let start_s = at(0);
        counts.node_s = (0..counts.node_s.len()).map(|node| at(node) - start_s).collect();
        let zero_ns = if is_received { 0 } else { clock_start_ns };
        if let Some(&held) = counts.sensor_c.last() {
            counts.sensor_c.resize(counts.node_s.len(), held);
        }
        if is_received {
            counts.received_late_s.clone_from(&departures);
        }
        counts.start_ns = first.1 + zero_ns + (start_s * 1e9).round() as i64;
        counts.is_received = is_received;
        counts.breaks.extend(jumps.into_iter().map(|(from, to)| Discontinuity {
            from,
            to,
            gyros: [true; 4],
            kind: BreakKind::TimeJump,
        }));
        counts.breaks.sort_by_key(|found| found.from);
        counts.cut_where_time_runs_back();
        Some(counts)
    }
}

/// Course of the departures over the nodes, by medians of blocks joined by straight lines, and the places where it jumps,
/// on either side of which it has a course of its own.
fn course(departures: &[(usize, f64)]) -> (impl Fn(f64) -> f64, Vec<(usize, usize)>) {
    let (mut parts, mut jumps, mut start) = (vec![], vec![], 0);
    for index in 1..departures.len() {
        let ((before, from_s), (now, to_s)) = (departures[index - 1], departures[index]);
        // A single late stamp is none.
        let stays = departures.get(index + 1).is_none_or(|next| (next.1 - to_s).abs() < TIME_JUMP_S);
        if (to_s - from_s).abs() > TIME_JUMP_S && stays {
            parts.push(knots(&departures[start..index]));
            jumps.push((before, now));
            start = index;
        }
    }
    parts.push(knots(&departures[start..]));
    let ends: Vec<usize> = jumps.iter().map(|jump| jump.0).collect();
    let course = move |node: f64| {
        let knots: &[(f64, f64)] = &parts[ends.partition_point(|&end| (end as f64) < node)];
        if let [only] = knots {
            return only.1;
        }
        let after = knots.partition_point(|knot| knot.0 < node).clamp(1, knots.len() - 1);
        let ((x0, y0), (x1, y1)) = (knots[after - 1], knots[after]);
        y0 + (y1 - y0) * (node - x0) / (x1 - x0)
    };
    (course, jumps)
}

/// Middle and median of each block; two blocks at least where there are points enough for a slope.
fn knots(points: &[(usize, f64)]) -> Vec<(f64, f64)> {
    let blocks = (points.len() / TIMING_BLOCK).max(if points.len() >= 40 { 2 } else { 1 });
    let block = |index: usize| &points[index * points.len() / blocks..(index + 1) * points.len() / blocks];
    (0..blocks)
        .map(|index| {
            let points = block(index);
            let mut departures: Vec<f64> = points.iter().map(|point| point.1).collect();
            let middle = departures.len() / 2;
            let median_s = *departures.select_nth_unstable_by(middle, f64::total_cmp).1;
            (points.iter().map(|point| point.0 as f64).sum::<f64>() / points.len() as f64, median_s)
        })
        .collect()
}

/// The counts of one sample as real numbers.
pub fn increments(sample: &Sample) -> [f64; 4] {
    sample.increments.map(f64::from)
}
