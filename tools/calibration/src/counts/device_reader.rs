//! Reads [`AccumulatedCounts`] of a described unit, in arcsec, from the rows of its decoder.
//!
//! A unit of many samples per second has nodes at every few samples, as many in a recording as the default unit has.
//! The rows of a table keep their own lengths: between their ends the angle is interpolated at the nodes, by a cubic through four ends.

use geu_model::device::{Device, Head, Output};
use geu_protocol::Gyros;
use geu_protocol::continuity::MAX_MISSING;
use geu_protocol::layout::Quantity;
use geu_recording::{Defect, DeviceSample, ReferenceAttitude, Sink};

use super::bent_angle::{BentAngle, BesideRow};
use super::device_recording::{ConstantRun, DeviceRecording, RowsLeftOut};
use super::head_reader::{HeadAngles, HeadReader, MISSING, slots};
use super::reader::NodeReader;
use super::table_trials::{TableTrials, TrialRow};
use super::{AccumulatedCounts, BreakKind, Discontinuity};

/// Number of nodes from which two become one, and the longest interval of nodes that may result, s: that of the default unit, and a little.
const MAX_NODES: usize = 1 << 14;
const MAX_INTERVAL_S: f64 = 0.6;
/// Samples of one value from which a run of them is kept, and the number of runs kept.
const CONSTANT_SAMPLES: u64 = 5;
const MAX_RUNS: usize = 10_000;
/// A sample farther from its neighbours, in mean departures, is an outlier; and the samples from which the mean is known.
const OUTLIER: f64 = 25.0;
const SETTLED: u64 = 100;
/// Missing samples in a row that are interpolated, and the samples of a node from which they are: then their error is that of a few of
/// many samples.
const INTERPOLATED: u64 = 4;
const MANY_SAMPLES: usize = 8;
/// Smallest and largest of no sample.
const NO_SAMPLE: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
/// Temperature of a unit that sends none, °C.
const UNKNOWN_C: f64 = 20.0;

/// The last samples of one gyro.
#[derive(Debug, Clone)]
struct Recent {
    /// The sample before and the one before that; `NaN` for none.
    values: [f64; 2],
    /// Mean departure of a sample from its neighbours, and the number of departures.
    departure: f64,
    count: u64,
    /// Node at the start of a run of one value, and its samples.
    run: (usize, u64),
    /// Smallest and largest sample after each node.
    extremes: Vec<[f64; 2]>,
    /// Smallest change from sample to sample; infinite without one.
    step: f64,
}

impl Recent {
    const NONE: Recent = Recent {
        values: [f64::NAN; 2],
        departure: 0.0,
        count: 0,
        run: (0, 0),
        extremes: Vec::new(),
        step: f64::INFINITY,
    };
}

/// Accumulates the samples of a described unit.
#[derive(Debug)]
pub struct DeviceCountsReader {
    heads: HeadReader,
    /// Slots of the temperatures of the electronics, of a sensor and of the heads.
    celsius: [Vec<usize>; 3],
    nodes: NodeReader,
    per_node: usize,
    /// Angle since the last node, arcsec.
    since: Vec<f64>,
    /// Coning since then, arcsec².
    coning: Vec<Vec<f64>>,
    /// Reasons of breaks in the node to come, with the node before them.
    pending: Vec<(usize, Gyros, BreakKind)>,
    recent: Vec<Recent>,
    recording: Extras,
    trials: TableTrials,
    /// The last row of a table, until the next one states how the angle bends in it.
    held: Option<DeviceSample>,
    /// Length of the row before, in nominal samples.
    length_before: f64,
    /// See [`DeviceRecording`].
    rate_arcsec: Vec<f64>,
}

/// Findings in the samples, beside their sum.
#[derive(Debug, Default)]
struct Extras {
    constant: Vec<ConstantRun>,
    outliers: Vec<u64>,
    samples: u64,
    missing: u64,
    interpolated: u64,
    defects: u64,
    left_out: RowsLeftOut,
}

impl DeviceCountsReader {
    /// Reads the trials of the reference from a table with trials, or its first one if the reference has none.
    pub fn new(device: &Device, reference: &ReferenceAttitude) -> DeviceCountsReader {
        let gyros = device.all_gyros();
        let mut counts = AccumulatedCounts::of_unit(gyros, device.interval_s, 0);
        let is_rate = |head: &Head| head.is_rounded && device.output == Output::Rate;
        let rate_arcsec = |head: &Head| if is_rate(head) { head.count_arcsec } else { 0.0 };
        for (rounded_to, head) in counts.rounded_to.iter_mut().zip(&device.heads) {
            let is_rounded = head.is_rounded && device.output == Output::Increment;
            *rounded_to = if is_rounded { head.count_arcsec } else { 0.0 };
        }
        DeviceCountsReader {
            heads: HeadReader::new(device),
            celsius: [
                slots(device, &|quantity| *quantity == Quantity::Electronics),
                slots(device, &|quantity| *quantity == Quantity::Sensor),
                slots(device, &|quantity| matches!(quantity, Quantity::Temperature(_))),
            ],
            nodes: NodeReader::new(counts),
            per_node: 1,
            since: vec![0.0; gyros.heads()],
            coning: vec![vec![0.0; gyros.heads()]; gyros.heads()],
            pending: Vec::new(),
            recent: vec![Recent::NONE; gyros.heads()],
            recording: Extras { outliers: vec![0; gyros.heads()], ..Extras::default() },
            trials: TableTrials::new(reference),
            held: None,
            length_before: f64::NAN,
            rate_arcsec: device.heads.iter().map(rate_arcsec).collect(),
        }
    }

    /// Notes what excludes gyros of the node to come.
    fn exclude(&mut self, gyros: Gyros, kind: BreakKind) {
        if !gyros.is_empty() && !self.pending.iter().any(|own| (own.1, own.2) == (gyros, kind)) {
            self.pending.push((self.nodes.node, gyros, kind));
        }
    }

    /// Moves on to an end, in samples, by these angles.
    fn advance(&mut self, from: f64, to: f64, angles: &[BentAngle], row: &DeviceSample) {
        let mut at = from;
        loop {
            let next = ((self.nodes.node + 1) * self.per_node) as f64;
            let until = at.max(next.min(to));
            let [begin, end] = [at, until].map(|at| (at - from) / (to - from));
            let arcsec: Vec<f64> = angles.iter().map(|own| own.at(end) - own.at(begin)).collect();
            for (one, own) in self.coning.iter_mut().enumerate() {
                for (other, own) in own.iter_mut().enumerate() {
                    *own += 0.5 * (self.since[one] * arcsec[other] - self.since[other] * arcsec[one]);
                }
            }
            self.since.iter_mut().zip(arcsec).for_each(|(since, arcsec)| *since += arcsec);
            at = until;
            if next > to + 1e-6 {
                break;
            }
            self.push_node(row, (next - to).abs() < 1e-6);
        }
        self.heads.end = to;
    }

    fn push_node(&mut self, row: &DeviceSample, is_end: bool) {
        let mean = |slots: &[usize]| {
            let known: Vec<f64> = slots.iter().map(|&slot| row.values[slot]).filter(|value| !value.is_nan()).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        let [electronics, sensor, heads] = self.celsius.each_ref().map(|slots| mean(slots));
        let electronics_c = electronics.or(sensor).or(heads).unwrap_or(UNKNOWN_C);
        let time = row.time.filter(|_| is_end && !self.heads.is_table).map(|time| (time.t_ns, true));
        self.nodes.push(1, None, &self.since, electronics_c, electronics.and(sensor), time);
        self.nodes.push_coning(&self.coning);
        self.since.fill(0.0);
        self.coning.iter_mut().for_each(|own| own.fill(0.0));
        for (from, gyros, kind) in std::mem::take(&mut self.pending) {
            self.nodes.note(from, gyros, kind);
        }
        let is_even = self.nodes.node.is_multiple_of(2);
        if self.nodes.node >= MAX_NODES
            && is_even
            && 2.0 * self.per_node as f64 * self.heads.interval_s <= MAX_INTERVAL_S
        {
            self.per_node *= 2;
            self.nodes.halve();
            self.recording.constant.iter_mut().for_each(|run| (run.from, run.to) = (run.from / 2, run.to.div_ceil(2)));
            for recent in &mut self.recent {
                recent.run.0 /= 2;
                let both =
                    |two: &[[f64; 2]]| two.iter().fold(NO_SAMPLE, |all, own| [all[0].min(own[0]), all[1].max(own[1])]);
                recent.extremes = recent.extremes.chunks(2).map(both).collect();
            }
        }
    }

    /// Finds outliers and runs of one value in the samples of a gyro.
    fn examine(&mut self, gyro: usize, arcsec: f64) {
        let (node, recent) = (self.nodes.node, &mut self.recent[gyro]);
        let [last, before] = recent.values;
        recent.values = [arcsec, last];
        // Not the sample that is no number, at the end.
        if !arcsec.is_nan() {
            recent.extremes.resize((node + 1).max(recent.extremes.len()), NO_SAMPLE);
            let [low, high] = &mut recent.extremes[node];
            (*low, *high) = (low.min(arcsec), high.max(arcsec));
        }
        if arcsec == last {
            recent.run.1 += 1;
        } else {
            let (from, samples) = recent.run;
            let run = ConstantRun { gyro, from, to: node + 1, samples, arcsec: last };
            if run.samples >= CONSTANT_SAMPLES && self.recording.constant.len() < MAX_RUNS {
                self.recording.constant.push(run);
            }
            recent.run = (node, 1);
            recent.step = recent.step.min((arcsec - last).abs());
        }
        let off = (last - 0.5 * (arcsec + before)).abs();
        // Output that stays shows no departure.
        if off.is_nan() || arcsec == last && last == before {
            return;
        }
        recent.count += 1;
        let is_outlier = recent.count > SETTLED
            && off > OUTLIER * recent.departure
            && (arcsec - before).abs() < 0.2 * off
            && recent.departure > 0.0;
        let (limit, share) = match recent.count > SETTLED {
            true => (3.0 * recent.departure, 0.01),
            false => (f64::INFINITY, 1.0 / recent.count as f64),
        };
        recent.departure += share * (off.min(limit) - recent.departure);
        if is_outlier {
            self.recording.outliers[gyro] += 1;
            let from = node.saturating_sub(1);
            let gyros = self.nodes.gyros().only(gyro);
            self.nodes.add(Discontinuity { from, to: node + 1, gyros, kind: BreakKind::Outlier });
            self.exclude(gyros, BreakKind::Outlier);
        }
    }

    pub fn left_out(&self) -> RowsLeftOut {
        self.recording.left_out
    }

    /// Trials of the reference without a row in a table that has trials.
    pub fn missing_trials(&self) -> Vec<&str> {
        self.trials.missing()
    }

    /// The recording; `None` without a sample. `clock_start_ns` is the start of sample 0 of a recording without receive times.
    pub fn finish(mut self, clock_start_ns: i64) -> Option<DeviceRecording> {
        if let Some(last) = self.held.take() {
            self.add(&last, None);
        }
        let start_ns = self.heads.start_ns(clock_start_ns)?;
        for gyro in 0..self.since.len() {
            self.examine(gyro, f64::NAN);
        }
        let interval_s = self.heads.interval_s * self.per_node as f64;
        let mut counts = self.nodes.finish_at(interval_s, start_ns)?;
        let Extras { constant, outliers, samples, missing, mut interpolated, defects, left_out } = self.recording;
        let is_interpolated = |found: &Discontinuity| matches!(found.kind, BreakKind::Interpolated(_));
        if self.per_node >= MANY_SAMPLES {
            counts.breaks.retain(|found| !is_interpolated(found));
        } else {
            interpolated = 0;
        }
        let nodes = counts.node_s.len() - 1;
        let constant = constant
            .into_iter()
            .filter(|run| run.from < nodes)
            .map(|run| ConstantRun { to: run.to.min(nodes), ..run })
            .collect();
        let steps = self.recent.iter().map(|own| own.step).collect();
        let cut = |own: Recent| own.extremes.into_iter().take(nodes).collect();
        let extremes = self.recent.into_iter().map(cut).collect();
        Some(DeviceRecording {
            is_timed: self.heads.is_table || counts.is_received,
            counts,
            constant,
            extremes,
            steps,
            rate_arcsec: self.rate_arcsec,
            outliers,
            samples,
            missing,
            interpolated,
            defects,
            left_out,
        })
    }

    /// Angles of a row of this length, in nominal samples, between the row before and the row after, with its length.
    fn bent(&self, arcsec: &[f64], length: f64, after: Option<(f64, Vec<f64>)>) -> Vec<BentAngle> {
        let row = |row_length: f64, arcsec: f64| BesideRow {
            length: row_length / length,
            arcsec: arcsec * self.heads.rate_length(row_length),
        };
        let angle = |(gyro, &arcsec): (usize, &f64)| {
            let own = if arcsec.is_nan() { 0.0 } else { arcsec * self.heads.rate_length(length) };
            match &after {
                Some((after_length, after)) if !arcsec.is_nan() => {
                    let before = row(self.length_before, self.recent[gyro].values[0]);
                    BentAngle::between(before, own, row(*after_length, after[gyro]))
                }
                _ => BentAngle::even(own),
            }
        };
        arcsec.iter().enumerate().map(angle).collect()
    }

    /// Adds a row; `after` is the row after it of a table.
    fn add(&mut self, row: &DeviceSample, after: Option<&DeviceSample>) {
        let after = after.and_then(|after| Some((self.heads.length_after(row, after)?, after)));
        let (moved, number) = match self.trials.place(row) {
            TrialRow::Single => (None, None),
            TrialRow::Moved(moved, number) => (Some(moved), Some(number)),
            TrialRow::Other => return self.recording.left_out.of_other_trials += 1,
            TrialRow::OutOfOrder => return self.recording.left_out.out_of_order += 1,
        };
        let (begins, row) = (self.trials.begins(number), moved.as_ref().unwrap_or(row));
        if self.heads.is_of_other_trial(row) {
            self.recording.left_out.of_other_trials += 1;
            return;
        }
        let Some((from, to)) = self.heads.place(row) else {
            self.recording.left_out.repeated += 1;
            return;
        };
        let all = self.nodes.gyros();
        let HeadAngles { arcsec, invalid, saturated } = self.heads.angles(row);
        let missing_samples = from - self.heads.end;
        if missing_samples > MISSING {
            let missing = missing_samples.round() as u64;
            if missing > MAX_MISSING - self.recording.missing {
                self.recording.left_out.after_gap += 1;
                return;
            }
            let is_short = missing <= INTERPOLATED && !begins;
            self.recording.missing += if begins { 0 } else { missing };
            self.recording.interpolated += if is_short { missing } else { 0 };
            let kind = match (is_short, begins) {
                (true, _) => BreakKind::Interpolated(missing),
                (false, true) => BreakKind::Unknown,
                (false, false) => BreakKind::Gap(missing),
            };
            // The mean of the samples before and after; of a head without one, that of the other.
            let between = |(recent, &after): (&Recent, &f64)| {
                let before = if recent.values[0].is_nan() { after } else { recent.values[0] };
                let after = if after.is_nan() { before } else { after };
                let mean = 0.5 * (before + after) * missing_samples;
                if is_short && mean.is_finite() { mean } else { 0.0 }
            };
            let between = self.recent.iter().zip(&arcsec).map(between);
            let between: Vec<BentAngle> = between.map(BentAngle::even).collect();
            self.exclude(all, kind);
            let (before, samples) = (self.nodes.node, self.per_node);
            self.advance(self.heads.end, from, &between, row);
            // Also the nodes within the gap.
            let (before, to) = (before * samples / self.per_node, self.nodes.node);
            if before < to {
                self.nodes.add(Discontinuity { from: before, to, gyros: all, kind });
            }
            self.exclude(all, kind);
        }
        self.recording.samples += 1;
        self.trials.note(number);
        let length = to - from;
        let is_touching = missing_samples <= MISSING;
        let after = after.filter(|_| is_touching).map(|(length, after)| (length, self.heads.arcsec(after)));
        let angles = self.bent(&arcsec, length, after);
        self.length_before = length;
        for (gyro, arcsec) in arcsec.into_iter().enumerate().filter(|(_, arcsec)| !arcsec.is_nan()) {
            self.examine(gyro, arcsec);
        }
        self.exclude(invalid, BreakKind::Invalid);
        self.exclude(saturated, BreakKind::Saturated);
        self.advance(from, to, &angles, row);
    }
}

impl Sink<DeviceSample> for DeviceCountsReader {
    fn row(&mut self, row: &DeviceSample) {
        if !self.heads.is_table {
            self.add(row, None);
        } else if let Some(held) = self.held.replace(row.clone()) {
            self.add(&held, Some(row));
        }
    }

    fn defect(&mut self, _defect: &Defect) {
        self.recording.defects += 1;
    }
}
