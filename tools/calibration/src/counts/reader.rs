//! Reads [`AccumulatedCounts`] from the rows of a decoder.

#[cfg(test)]
mod tests;

use geu_model::device::MAX_HEADS;
use geu_model::units::{SAMPLE_INTERVAL_NS, SAMPLE_INTERVAL_S};
use geu_protocol::Gyros;
use geu_protocol::continuity::{Continuity, MAX_MISSING, SequenceStep};
use geu_recording::{Defect, ReceivedSample, Sink};

use super::{AccumulatedCounts, BreakKind, Discontinuity, increments, unusable};

/// Time over which receive times are averaged, s.
const TIMING_S: f64 = 300.0;
/// A receive time this far from the averaged course is a clock jump.
const TIME_JUMP_S: f64 = 0.1;
/// Receive times without a late one or a jump before the end of a part.
const REGULAR: usize = 3;

/// Accumulates the counts of decoded rows.
#[derive(Debug)]
pub struct CountsReader {
    continuity: Continuity,
    nodes: NodeReader,
    missing: u64,
    defects: u64,
    /// End of the part before, ns.
    part_end_ns: Option<i64>,
}

impl Default for CountsReader {
    fn default() -> CountsReader {
        let nodes = NodeReader::new(AccumulatedCounts::starting_at(0));
        CountsReader { continuity: Continuity::default(), nodes, missing: 0, defects: 0, part_end_ns: None }
    }
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
            SequenceStep::Reset => (by_time(&self.nodes.times), Some(BreakKind::Reset)),
            SequenceStep::Jump => (by_time(&self.nodes.times), Some(BreakKind::Jump)),
        };
        let advance = if advance - 1 > MAX_MISSING - self.missing { 1 } else { advance };
        self.missing += advance - 1;
        let electronics_c = f64::from(sample.electronics_centi_c) * 0.01;
        let sensor_c = row.has_clock.then(|| f64::from(sample.sensor_centi_c) * 0.01);
        let time = row.time.map(|time| (time.t_ns, row.is_received));
        self.nodes.push(advance as usize, kind, &increments(sample), electronics_c, sensor_c, time);
        let [self_test, invalid, saturated] = unusable(sample);
        for (kind, gyros) in [invalid, saturated, self_test] {
            self.nodes.note(self.nodes.node - 1, Gyros::ALL.filter(|gyro| gyros[gyro]), kind);
        }
    }

    fn defect(&mut self, _defect: &Defect) {
        // Samples lost by a defect are a gap in the sequence; the decoder reports the defect itself.
        self.defects += 1;
    }
}

impl CountsReader {
    pub fn defects(&self) -> u64 {
        self.defects
    }

    /// Samples since the start or the last part, missing ones counted.
    pub fn samples(&self) -> usize {
        self.nodes.node
    }

    /// Time of the last sample by the receive times before, ns. `None` without times, and if the last few are late or jump, where no
    /// part should end.
    pub fn last_ns(&self, clock_start_ns: i64) -> Option<i64> {
        let times = &self.nodes.times;
        let (node, _, is_received) = *times.last()?;
        let recent =
            times.iter().rev().take((TIMING_S / SAMPLE_INTERVAL_S) as usize).filter(|time| time.2 == is_received);
        let departures_ns: Vec<i64> =
            recent.map(|(node, t_ns, _)| t_ns.saturating_sub(*node as i64 * SAMPLE_INTERVAL_NS)).collect();
        let median_ns = *departures_ns.clone().select_nth_unstable(departures_ns.len() / 2).1;
        let is_regular = |departure_ns: &i64| departure_ns.abs_diff(median_ns) as f64 * 1e-9 < TIME_JUMP_S;
        let zero_ns = if is_received { 0 } else { clock_start_ns };
        let last_ns = || median_ns.saturating_add(node as i64 * SAMPLE_INTERVAL_NS).saturating_add(zero_ns);
        departures_ns.iter().take(REGULAR).all(is_regular).then(last_ns)
    }

    /// Ends a part; the next one starts at its last node. See [`CountsReader::finish`].
    pub fn end_part(&mut self, clock_start_ns: i64) -> Option<AccumulatedCounts> {
        let next = NodeReader::new(AccumulatedCounts::starting_at(0));
        self.missing = 0;
        let mut part = std::mem::replace(&mut self.nodes, next).finish(clock_start_ns)?;
        // Both parts have one time of the node that they share, unless times jump there.
        if let Some(before_ns) =
            self.part_end_ns.filter(|end_ns| part.start_ns.abs_diff(*end_ns) < SAMPLE_INTERVAL_NS as u64 / 2)
        {
            let later_s = (part.start_ns - before_ns) as f64 * 1e-9;
            part.node_s.iter_mut().skip(1).for_each(|node_s| *node_s += later_s);
            part.start_ns = before_ns;
        }
        self.part_end_ns = Some(part.start_ns.saturating_add((part.end_s() * 1e9).round() as i64));
        Some(part)
    }

    /// Returns the counts; `None` without a row. `clock_start_ns` is the time at which the unit's clock was 0, for
    /// recordings without receive times.
    pub fn finish(self, clock_start_ns: i64) -> Option<AccumulatedCounts> {
        self.nodes.finish(clock_start_ns)
    }
}

/// Accumulates the samples of any unit at nodes, and dates the nodes at the end.
#[derive(Debug)]
pub(super) struct NodeReader {
    /// Node of the sample before.
    pub node: usize,
    /// Node, time and whether the time was received, of each row.
    pub times: Vec<(usize, i64, bool)>,
    counts: AccumulatedCounts,
}

impl NodeReader {
    /// Before the first sample.
    pub fn new(counts: AccumulatedCounts) -> NodeReader {
        NodeReader { node: 0, times: Vec::new(), counts }
    }

    /// Adds a sample `advance` nodes after the one before; `kind` is the reason of a break before it.
    pub fn push(
        &mut self,
        advance: usize,
        kind: Option<BreakKind>,
        increments: &[f64],
        electronics_c: f64,
        sensor_c: Option<f64>,
        time: Option<(i64, bool)>,
    ) {
        let from = self.node;
        self.node += advance;
        for _ in 1..advance {
            self.counts.push(0.0, &[0.0; MAX_HEADS], electronics_c);
        }
        self.counts.push(0.0, increments, electronics_c);
        if let Some(kind) = kind {
            self.note(from, self.counts.gyros, kind);
        }
        if let Some(sensor_c) = sensor_c {
            // Rows without one keep the temperature before.
            let held = self.counts.sensor_c.last().copied().unwrap_or(sensor_c);
            self.counts.sensor_c.resize(self.node, held);
            self.counts.sensor_c.push(sensor_c);
        }
        self.times.extend(time.map(|(t_ns, is_received)| (self.node, t_ns, is_received)));
    }

    /// Notes that the counts from a node to that of the last sample are unusable.
    pub fn note(&mut self, from: usize, gyros: Gyros, kind: BreakKind) {
        if gyros.is_empty() {
            return;
        }
        // Consecutive samples with one cause are one break.
        if let Some(last) =
            self.counts.breaks.iter_mut().rev().take(3).find(|last| last.kind == kind && last.gyros == gyros)
            && last.to == from
        {
            last.to = self.node;
            return;
        }
        self.counts.breaks.push(Discontinuity { from, to: self.node, gyros, kind });
    }

    /// All gyros of the unit.
    pub fn gyros(&self) -> Gyros {
        self.counts.gyros
    }

    /// Adds a break.
    pub fn add(&mut self, found: Discontinuity) {
        self.counts.breaks.push(found);
    }

    /// Adds the coning of the interval before the last node.
    pub fn push_coning(&mut self, coning: &[Vec<f64>]) {
        let heads = self.counts.gyros.heads();
        let series = &mut self.counts.coning;
        if series.is_empty() {
            *series = vec![vec![vec![0.0]; heads]; heads];
        }
        series.iter_mut().flatten().zip(coning.iter().flatten()).for_each(|(series, value)| series.push(*value));
    }

    /// Keeps every second node, the last of an even number.
    pub fn halve(&mut self) {
        let counts = &mut self.counts;
        for (one, of_one) in counts.coning.iter_mut().enumerate() {
            for (other, series) in of_one.iter_mut().enumerate() {
                let angles = [&counts.accumulated[one], &counts.accumulated[other]];
                let of_pair = |node: usize| {
                    let [[before, after], [other_before, other_after]] =
                        angles.map(|sums| [sums[node + 1] - sums[node], sums[node + 2] - sums[node + 1]]);
                    series[node + 1] + series[node + 2] + 0.5 * (before * other_after - other_before * after)
                };
                let halved = (0..series.len() - 2).step_by(2).map(of_pair);
                *series = std::iter::once(0.0).chain(halved).collect();
            }
        }
        let series = counts.accumulated.iter_mut().chain([&mut counts.electronics_c, &mut counts.sensor_c]);
        series.for_each(|series| *series = series.iter().copied().step_by(2).collect());
        counts.node_s.truncate(self.node / 2 + 1);
        self.node /= 2;
        self.times.retain(|time| time.0.is_multiple_of(2));
        self.times.iter_mut().for_each(|time| time.0 /= 2);
        counts.breaks.iter_mut().for_each(|found| (found.from, found.to) = (found.from / 2, found.to.div_ceil(2)));
        counts.breaks.dedup();
    }

    /// The counts with this interval of the nodes; without receive times they start at `start_ns`.
    pub fn finish_at(mut self, interval_s: f64, start_ns: i64) -> Option<AccumulatedCounts> {
        self.counts.interval_s = interval_s;
        if self.times.len() < 2 {
            // Nodes at their nominal times, by the unit's clock.
            let end_ns = |node: usize| (node as f64 * interval_s * 1e9).round() as i64;
            self.times = (1..=self.node).map(|node| (node, end_ns(node), false)).collect();
        }
        self.finish(start_ns)
    }

    /// Dates the nodes, see [`CountsReader::finish`].
    pub fn finish(self, clock_start_ns: i64) -> Option<AccumulatedCounts> {
        let NodeReader { times, mut counts, .. } = self;
        let is_received = times.iter().any(|time| time.2);
        let mut times = times.into_iter().filter(|time| time.2 == is_received).peekable();
        let first = *times.peek()?;
        let interval_s = counts.interval_s;
        let interval_ns = (interval_s * 1e9).round() as i64;
        // Departures of the times from nominal samples since the first, so that no digit is lost.
        let mut departures: Vec<(usize, f64)> = times
            .map(|(node, t_ns, _)| (node, (t_ns - first.1 - (node - first.0) as i64 * interval_ns) as f64 * 1e-9))
            .collect();
        let (course, jumps) = course(&departures, (TIMING_S / interval_s) as usize);
        let nominal_s = |node: usize| (node as f64 - first.0 as f64) * interval_s;
        let at = |node: usize| nominal_s(node) + course(node as f64);
        let start_s = at(0);
        for (node, node_s) in counts.node_s.iter_mut().enumerate() {
            *node_s = at(node) - start_s;
        }
        let zero_ns = if is_received { 0 } else { clock_start_ns };
        if let Some(&held) = counts.sensor_c.last() {
            counts.sensor_c.resize(counts.node_s.len(), held);
        }
        if is_received {
            // It was collected in the place of the times, which are longer.
            departures.shrink_to_fit();
            counts.received_late_s = departures;
        }
        counts.start_ns = first.1 + zero_ns + (start_s * 1e9).round() as i64;
        counts.is_received = is_received;
        let gyros = counts.gyros;
        let jump = |(from, to)| Discontinuity { from, to, gyros, kind: BreakKind::TimeJump };
        counts.breaks.extend(jumps.into_iter().map(jump));
        counts.breaks.sort_by_key(|found| found.from);
        counts.cut_at_backward_time();
        Some(counts)
    }
}

/// Smooths the departures over the nodes by medians of blocks joined by straight lines. Also returns the jumps, on either
/// side of which the departures are smoothed separately.
fn course(departures: &[(usize, f64)], averaged: usize) -> (impl Fn(f64) -> f64 + use<>, Vec<(usize, usize)>) {
    let (mut parts, mut jumps, mut start) = (vec![], vec![], 0);
    for index in 1..departures.len() {
        let ((before, from_s), (now, to_s)) = (departures[index - 1], departures[index]);
        // A single late stamp is no jump, nor is the return from it, nor one at an end.
        let stays = departures.get(index + 1).is_some_and(|next| (next.1 - to_s).abs() < TIME_JUMP_S);
        let is_other = |before: &(usize, f64)| (to_s - before.1).abs() > TIME_JUMP_S;
        if stays && (to_s - from_s).abs() > TIME_JUMP_S && index > 1 && is_other(&departures[index - 2]) {
            parts.push(knots(&departures[start..index], averaged));
            jumps.push((before, now));
            start = index;
        }
    }
    parts.push(knots(&departures[start..], averaged));
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

/// Middle and median of each block; at least two blocks if there are points enough for a slope.
fn knots(points: &[(usize, f64)], averaged: usize) -> Vec<(f64, f64)> {
    let blocks = (points.len() / averaged.max(1)).max(if points.len() >= 40 { 2 } else { 1 });
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
