//! Accumulated counts at the ends of samples, with the time of each and the discontinuities.
//!
//! Sequence and clock of the unit place the samples. Receive times, averaged over five minutes, date them: jitter averages
//! out, a fast or drifting clock remains.

mod bent_angle;
mod device_reader;
mod device_recording;
mod head_reader;
mod reader;
mod table_trials;

pub use device_reader::DeviceCountsReader;
pub use device_recording::{ConstantRun, DeviceRecording, RowsLeftOut};
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::field::{GYRO_FLAGS, unit_flag};
use geu_protocol::{Gyro, Gyros, Sample};
use geu_recording::ReferenceAttitude;
pub use head_reader::{HeadAngles, HeadReader};
use nalgebra::{DVector, Matrix4, MatrixXx3, Vector3};
pub use reader::CountsReader;

/// Why the sum over a sample interval is unusable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BreakKind {
    /// Number of missing samples.
    Gap(u64),
    /// Number of missing samples that are interpolated.
    Interpolated(u64),
    /// Sequence and clock do not follow from those before.
    Jump,
    Reset,
    /// Receive times jumped against the unit's clock.
    TimeJump,
    /// The gyro's count is marked as invalid.
    Invalid,
    /// The gyro's count was clipped.
    Saturated,
    /// The counts are the self-test's pattern.
    SelfTest,
    /// A sample far from its neighbours.
    Outlier,
    /// The output does not change.
    Constant,
    /// The reference does not state the turn.
    Unknown,
}

impl std::fmt::Display for BreakKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            BreakKind::Gap(1) | BreakKind::Interpolated(1) => write!(f, "1 sample is missing"),
            BreakKind::Gap(count) | BreakKind::Interpolated(count) => write!(f, "{count} samples are missing"),
            BreakKind::Jump => write!(f, "sequence and clock jump"),
            BreakKind::Reset => write!(f, "the unit restarted"),
            BreakKind::TimeJump => write!(f, "receive times jump"),
            BreakKind::Invalid => write!(f, "the count is not valid"),
            BreakKind::Saturated => write!(f, "the count is saturated"),
            BreakKind::SelfTest => write!(f, "the self-test runs"),
            BreakKind::Outlier => write!(f, "a sample is far from its neighbours"),
            BreakKind::Constant => write!(f, "the output does not change"),
            BreakKind::Unknown => write!(f, "the reference does not state the turn"),
        }
    }
}

/// The gyros whose count of this sample is unusable, for each reason in turn.
pub fn unusable(sample: &Sample) -> [(BreakKind, [bool; 4]); 3] {
    let flag = |index: usize| sample.gyro_flags & (1 << GYRO_FLAGS[index].bit) != 0;
    [
        (BreakKind::SelfTest, [sample.unit_flags & unit_flag("self_test") != 0; 4]),
        (BreakKind::Invalid, Gyro::ALL.map(|gyro| !flag(gyro.index()))),
        (BreakKind::Saturated, Gyro::ALL.map(|gyro| flag(gyro.index() + 4))),
    ]
}

/// The nodes between which sums of some gyros are unusable.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discontinuity {
    pub from: usize,
    pub to: usize,
    pub gyros: Gyros,
    pub kind: BreakKind,
}

/// Accumulated counts at nodes: node 0 is the start of the first sample interval, node k the end of the k-th.
#[derive(Debug, Clone)]
pub struct AccumulatedCounts {
    /// All gyros of the unit.
    pub gyros: Gyros,
    /// Nominal interval of the nodes, s.
    pub interval_s: f64,
    /// Multiple that the sum of each gyro is rounded to, in units of the sum; 0 for none.
    pub rounded_to: Vec<f64>,
    /// Angle random walk of each gyro by the rounding of rates that stay, in units of the sum per √s; 0 for increments.
    pub rounding_walk: Vec<f64>,
    /// Time of node 0, ns, on the time scale of the capture.
    pub start_ns: i64,
    /// True for receive times; else the times are those of the unit's own clock.
    pub is_received: bool,
    /// Time of each node since node 0, s.
    pub node_s: Vec<f64>,
    /// Sum of the increments of each gyro up to each node, counts.
    pub accumulated: Vec<Vec<f64>>,
    /// Coning of each gyro by each other one in the interval before each node: half the integral of the one's angle since the node before by the
    /// other's, less the reverse. The turn of an interval is the sum of its increments only about an axis that does not move. Empty for the
    /// default unit.
    pub coning: Vec<Vec<Vec<f64>>>,
    /// Electronics temperature over the sample interval before each node, °C (node 0 as node 1).
    pub electronics_c: Vec<f64>,
    /// Sensor temperature at each node, °C, the last one known if a row has none; empty if no row has one.
    pub sensor_c: Vec<f64>,
    /// Node of each row, and its receive time less that of nominal samples since the first, s; empty without receive
    /// times.
    pub received_late_s: Vec<(usize, f64)>,
    /// In order of time.
    pub breaks: Vec<Discontinuity>,
    /// The instant at which times ran backward; the samples after it are dropped.
    pub runs_back_s: Option<f64>,
}

/// An instant between nodes: weights of four neighbouring nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interpolation {
    pub first: usize,
    /// Weights of `first` and the next three nodes.
    pub weights: [f64; 4],
    /// The instant in samples since node 0.
    pub samples: f64,
}

impl Interpolation {
    /// The value at the instant of a quantity given at each node.
    pub(crate) fn apply(&self, nodes: &[f64]) -> f64 {
        self.weights.iter().zip(&nodes[self.first..]).map(|(weight, value)| weight * value).sum()
    }

    /// The nodes with a weight, and their weights.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = (usize, f64)> {
        (self.first..).zip(self.weights).filter(|(_, weight)| *weight != 0.0)
    }
}

impl AccumulatedCounts {
    /// Counts of the default unit that start at `start_ns`, without a sample.
    pub fn starting_at(start_ns: i64) -> AccumulatedCounts {
        let rounded_to = vec![1.0; Gyros::ALL.heads()];
        AccumulatedCounts { rounded_to, ..AccumulatedCounts::of_unit(Gyros::ALL, SAMPLE_INTERVAL_S, start_ns) }
    }

    /// Counts of a unit, not rounded, that start at `start_ns`, without a sample.
    pub fn of_unit(gyros: Gyros, interval_s: f64, start_ns: i64) -> AccumulatedCounts {
        AccumulatedCounts {
            gyros,
            interval_s,
            rounded_to: vec![0.0; gyros.heads()],
            rounding_walk: vec![0.0; gyros.heads()],
            start_ns,
            is_received: false,
            node_s: vec![0.0],
            accumulated: vec![vec![0.0]; gyros.heads()],
            coning: Vec::new(),
            electronics_c: Vec::new(),
            sensor_c: Vec::new(),
            received_late_s: Vec::new(),
            breaks: Vec::new(),
            runs_back_s: None,
        }
    }

    /// Adds a sample that ends `end_s` after the start; `increments` may be real numbers, as before rounding.
    pub fn push(&mut self, end_s: f64, increments: &[f64], electronics_c: f64) {
        self.node_s.push(end_s);
        for (sums, increment) in self.accumulated.iter_mut().zip(increments) {
            sums.push(sums[sums.len() - 1] + increment);
        }
        if self.electronics_c.is_empty() {
            self.electronics_c.push(electronics_c);
        }
        self.electronics_c.push(electronics_c);
    }

    /// Adds a sample of the unit that ends `end_s` after the start.
    pub(crate) fn push_sample(&mut self, end_s: f64, sample: &Sample) {
        self.push(end_s, &increments(sample), f64::from(sample.electronics_centi_c) * 0.01);
    }

    /// Takes the temperatures from a reference that has them; a single one is that of the electronics.
    pub fn take_temperatures(&mut self, reference: &ReferenceAttitude) {
        let offset_s = self.offset_s(reference);
        let at_nodes = |known: &Vec<(f64, f64)>| -> Vec<f64> {
            let at = |node_s: &f64| {
                let t_s = node_s + offset_s;
                let after = known.partition_point(|own| own.0 < t_s).clamp(1, known.len() - 1);
                let [(from_s, from), (to_s, to)] = [known[after - 1], known[after]];
                let share = ((t_s - from_s) / (to_s - from_s).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                from + share * (to - from)
            };
            self.node_s.iter().map(at).collect()
        };
        let mut known = reference.celsius.iter().filter(|known| known.len() > 1).map(at_nodes);
        let (first, second) = (known.next(), known.next());
        if let Some(celsius) = first {
            (self.electronics_c, self.sensor_c) = (celsius, second.unwrap_or_default());
        }
    }

    /// Leaves out the gaps in which the reference does not state the turn: the angles follow its own there, which stays. `matrix` has the axis
    /// of each gyro.
    pub fn leave_out_unknown(&mut self, reference: &ReferenceAttitude, matrix: &MatrixXx3<f64>) {
        let (offset_s, mut near, last) = (self.offset_s(reference), 0, self.len());
        let mut gaps = Vec::new();
        for [from_s, to_s] in reference.truth.unknown_s() {
            let from = self.node_s.partition_point(|node_s| node_s + offset_s <= from_s).saturating_sub(1);
            let to = self.node_s.partition_point(|node_s| node_s + offset_s < to_s).min(last);
            if from < to {
                gaps.push((from, to));
                let (gyros, kind) = (self.gyros, BreakKind::Unknown);
                self.breaks.push(Discontinuity { from, to, gyros, kind });
                self.coning.iter_mut().flatten().for_each(|own| own[from + 1..=to].fill(0.0));
            }
        }
        if gaps.is_empty() {
            return;
        }
        self.breaks.sort_by_key(|found| found.from);
        let mut at =
            |node: usize| matrix * Vector3::from(reference.truth.at(self.node_s[node] + offset_s, &mut near).0);
        // Node and turn of each interval of a gap.
        let of_gap = |&(from, to): &(usize, usize)| {
            let mut before = at(from);
            let mut turn = |node: usize| {
                let now = at(node);
                (node, &now - std::mem::replace(&mut before, now.clone()))
            };
            (from + 1..=to).map(&mut turn).collect::<Vec<_>>()
        };
        let turns: Vec<(usize, DVector<f64>)> = gaps.iter().flat_map(of_gap).collect();
        for (gyro, sums) in self.accumulated.iter_mut().enumerate() {
            let (mut before, mut own) = (sums[0], turns.iter().peekable());
            for node in 1..sums.len() {
                let measured = sums[node] - std::mem::replace(&mut before, sums[node]);
                let turned = own.next_if(|own| own.0 == node).map(|own| own.1[gyro]);
                sums[node] = sums[node - 1] + turned.unwrap_or(measured);
            }
        }
    }

    /// Multiplies the angles of a gyro by a factor.
    pub fn multiply(&mut self, gyro: usize, factor: f64) {
        let of_others = self.coning.iter_mut().map(|own| &mut own[gyro]);
        of_others.chain([&mut self.accumulated[gyro]]).flatten().for_each(|value| *value *= factor);
        self.rounded_to[gyro] *= factor.abs();
        self.rounding_walk[gyro] *= factor.abs();
        self.coning.get_mut(gyro).into_iter().flatten().flatten().for_each(|value| *value *= factor);
    }

    /// Exchanges the angles of two gyros.
    pub fn exchange(&mut self, one: usize, other: usize) {
        self.accumulated.swap(one, other);
        self.rounded_to.swap(one, other);
        self.rounding_walk.swap(one, other);
        if !self.coning.is_empty() {
            self.coning.swap(one, other);
            self.coning.iter_mut().for_each(|own| own.swap(one, other));
        }
    }

    /// Drops the samples after the first time that runs backward: instants after it would occur twice.
    fn cut_at_backward_time(&mut self) {
        if let Some(node) = self.node_s.windows(2).position(|pair| pair[1] <= pair[0]) {
            self.runs_back_s = Some(self.start_s() + self.node_s[node]);
            self.node_s.truncate(node + 1);
            self.electronics_c.truncate(node + 1);
            self.sensor_c.truncate(node + 1);
            self.received_late_s.retain(|received| received.0 <= node);
            let series = self.accumulated.iter_mut().chain(self.coning.iter_mut().flatten());
            series.for_each(|own| own.truncate(node + 1));
            self.breaks.retain(|found| found.from < node);
            self.breaks.iter_mut().for_each(|found| found.to = found.to.min(node));
        }
    }

    /// Converts times of the unit's own clock, fast by `ppm`, to true time.
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

    /// Time of node 0, s on the time scale of the capture.
    pub fn start_s(&self) -> f64 {
        self.start_ns as f64 * 1e-9
    }

    /// Time of node 0 on the time scale of a reference, s.
    pub fn offset_s(&self, reference: &ReferenceAttitude) -> f64 {
        (self.start_ns - reference.start_ns) as f64 * 1e-9
    }

    /// Time of the last node, s since the start.
    pub fn end_s(&self) -> f64 {
        self.node_s.last().copied().unwrap_or(0.0)
    }

    /// The node nearest to an instant; `None` outside the recording (by more than half a sample interval).
    pub fn nearest(&self, t_s: f64) -> Option<usize> {
        let after = self.node_s.partition_point(|&node_s| node_s < t_s);
        let nearest = match (after.checked_sub(1), self.node_s.get(after)) {
            (Some(before), Some(&after_s)) if t_s - self.node_s[before] < after_s - t_s => before,
            (_, Some(_)) => after,
            (Some(before), None) => before,
            (None, None) => return None,
        };
        ((self.node_s[nearest] - t_s).abs() <= 0.52 * self.interval_s).then_some(nearest)
    }

    pub fn at_node(&self, node: usize) -> Interpolation {
        let first = node.min(self.node_s.len().saturating_sub(4));
        let mut weights = [0.0; 4];
        weights[node - first] = 1.0;
        Interpolation { first, weights, samples: node as f64 }
    }

    /// An instant between nodes, by the cubic through the four nearest (Casteren §6 interpolates between samples);
    /// `None` outside the recording.
    pub fn at(&self, t_s: f64) -> Option<Interpolation> {
        let last = self.node_s.len().checked_sub(1).filter(|&last| last >= 4)?;
        // An instant that equals a node except for rounding is that node.
        if let Some(node) = self.nearest(t_s).filter(|&node| (self.node_s[node] - t_s).abs() < 1e-6) {
            return Some(self.at_node(node));
        }
        if !(0.0..=self.node_s[last]).contains(&t_s) {
            return None;
        }
        let interval = self.node_s.partition_point(|&node_s| node_s <= t_s).saturating_sub(1).min(last - 1);
        let samples =
            interval as f64 + (t_s - self.node_s[interval]) / (self.node_s[interval + 1] - self.node_s[interval]);
        let first = interval.saturating_sub(1).min(last - 3);
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
        reading.apply(&self.accumulated[gyro])
    }

    /// The first break of a gyro between two instants, or beside one of them among its nodes.
    pub fn broken(&self, gyro: usize, from: &Interpolation, to: &Interpolation) -> Option<&Discontinuity> {
        let nodes = || [from, to].into_iter().flat_map(Interpolation::nodes).map(|(node, _)| node);
        let (first, last) = (nodes().min()?, nodes().max()?);
        self.breaks.iter().find(|found| found.gyros[gyro] && found.from < last && found.to > first)
    }

    /// Kind and time of a discontinuity, as text.
    pub(crate) fn describe(&self, found: &Discontinuity) -> String {
        format!("{} at {:.1} s", found.kind, self.start_s() + self.node_s[found.from])
    }
}

/// The counts of one sample as real numbers.
pub fn increments(sample: &Sample) -> [f64; 4] {
    sample.increments.map(f64::from)
}
