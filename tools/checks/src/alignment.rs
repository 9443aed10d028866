//! Time of a recording against its reference, before any axis, sign or unit is known: a lag and the error of the clock.
//!
//! The turn of all heads together within a tenth of a second does not depend on which head is which. It is compared with that of the
//! reference in segments, each at lags about that of the segment before. A line through the lags is the alignment. It is the start of a fit,
//! and counts only if it leaves less than half of what is unexplained without it.

use geu_calibration::counts::AccumulatedCounts;
use geu_calibration::transfer::sensing_matrix;
use geu_model::Configuration;
use geu_recording::ReferenceAttitude;
use nalgebra::Vector3;

use crate::median;
use crate::moments::Moments;

/// Time over which a turn is taken, s, or the interval of the nodes.
const TURN_S: f64 = 0.1;
/// Number of segments, and nodes of the shortest one.
const SEGMENTS: usize = 16;
const SHORTEST: usize = 256;
/// Largest lag beyond that of the segment before, s, and its limits in nodes.
const REACH_S: f64 = 2.0;
const MIN_REACH_NODES: i64 = 8;
const MAX_REACH_NODES: i64 = 512;
/// Correlation from which a segment shows its lag, and the number of such segments that show the error of a clock.
const CORRELATED: f64 = 0.7;
const MIN_SEGMENTS: usize = 4;
/// Share of what is unexplained that an alignment may leave.
const LEFT: f64 = 0.5;

/// Lag of a recording at its start, and the error of its clock.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Alignment {
    pub lag_s: f64,
    pub clock_ppm: f64,
}

/// Turns of the unit and of the reference.
struct Turns {
    interval_s: f64,
    /// Time of each node on the time scale of the reference, s.
    node_s: Vec<f64>,
    measured: Vec<f64>,
    /// At multiples of the interval, from the first place on.
    reference: Vec<f64>,
    first: usize,
    /// Intervals of a turn.
    turn_nodes: usize,
}

impl Alignment {
    /// The alignment of a recording of a described unit; 0 if it is aligned as it is.
    pub fn find(counts: &AccumulatedCounts, configuration: &Configuration, reference: &ReferenceAttitude) -> Alignment {
        let turns = Turns::new(counts, configuration, reference);
        let lags = turns.lags();
        let between = |(one, of_one): (usize, &(f64, f64))| {
            lags[one + 1..].iter().map(move |other| (other.1 - of_one.1) / (other.0 - of_one.0)).collect::<Vec<_>>()
        };
        let has_clock = lags.len() >= MIN_SEGMENTS && !counts.is_received;
        let mut slopes: Vec<f64> =
            lags.iter().enumerate().filter(|_| has_clock).flat_map(|own| between((own.0, own.1))).collect();
        let slope = if slopes.is_empty() { 0.0 } else { median(&mut slopes) };
        let mut starts: Vec<f64> = lags.iter().map(|(t_s, lag_s)| lag_s - slope * t_s).collect();
        if starts.is_empty() {
            return Alignment::default();
        }
        // Node times are by the unit's clock.
        let clock_ppm = 1e6 * slope / (1.0 - slope);
        let found = Alignment { lag_s: median(&mut starts), clock_ppm };
        let [without, with] = [Alignment::default(), found].map(|own| 1.0 - turns.correlation(own).powi(2));
        if with < LEFT * without && with < 1.0 - CORRELATED * CORRELATED { found } else { Alignment::default() }
    }
}

impl Turns {
    fn new(counts: &AccumulatedCounts, configuration: &Configuration, reference: &ReferenceAttitude) -> Turns {
        let matrix = sensing_matrix(configuration);
        let interval_s = counts.interval_s;
        let turn_nodes = (TURN_S / interval_s).ceil().max(1.0) as usize;
        let measured = |node: usize| {
            let of_head = |angles: &Vec<f64>| (angles[node] - angles[node - turn_nodes]).powi(2);
            counts.accumulated.iter().map(of_head).sum::<f64>().sqrt()
        };
        let offset_s = counts.offset_s(reference);
        // A reference of a year beside minutes of a recording is not needed whole.
        let place = |t_s: f64| (t_s.max(0.0) / interval_s) as usize;
        let beyond_s = SEGMENTS as f64 * REACH_S;
        let first = place(offset_s - beyond_s);
        let last = place(counts.end_s() + offset_s + beyond_s).min(place(reference.truth.end_s()));
        let mut near = 0;
        let mut at = |place: usize| Vector3::from(reference.truth.at(place as f64 * interval_s, &mut near).0);
        let angles: Vec<Vector3<f64>> = (first..=last).map(&mut at).collect();
        let turn = |ends: &[Vector3<f64>]| (&matrix * (ends[turn_nodes] - ends[0])).norm();
        Turns {
            interval_s,
            node_s: counts.node_s.iter().map(|node_s| node_s + offset_s).collect(),
            measured: (0..counts.node_s.len())
                .map(|node| if node < turn_nodes { 0.0 } else { measured(node) })
                .collect(),
            reference: vec![0.0; turn_nodes].into_iter().chain(angles.windows(turn_nodes + 1).map(turn)).collect(),
            first,
            turn_nodes,
        }
    }

    /// Correlation of the turns at these nodes, with the lag of each.
    fn correlation_of(&self, nodes: std::ops::Range<usize>, lag_s: impl Fn(f64) -> f64) -> f64 {
        let mut moments = Moments::default();
        for node in nodes.start.max(self.turn_nodes)..nodes.end {
            let node_s = self.node_s[node];
            let place = ((node_s - lag_s(node_s - self.node_s[0])) / self.interval_s).round() - self.first as f64;
            if place < self.turn_nodes as f64 || place >= self.reference.len() as f64 {
                continue;
            }
            moments.add(self.reference[place as usize], self.measured[node]);
        }
        // Fewer than half of the nodes show no correlation.
        if 2.0 * moments.count > nodes.len() as f64 { moments.correlation() } else { 0.0 }
    }

    fn correlation(&self, alignment: Alignment) -> f64 {
        let slope = alignment.clock_ppm * 1e-6 / (1.0 + alignment.clock_ppm * 1e-6);
        self.correlation_of(0..self.node_s.len(), |t_s| alignment.lag_s + slope * t_s)
    }

    /// Time and lag of the segments that show one.
    fn lags(&self) -> Vec<(f64, f64)> {
        let length = (self.node_s.len() / SEGMENTS).max(SHORTEST);
        let reach = ((REACH_S / self.interval_s) as i64).clamp(MIN_REACH_NODES, MAX_REACH_NODES);
        let (mut found, mut before) = (Vec::new(), 0);
        for segment in 0..self.node_s.len() / length {
            let nodes = segment * length..(segment + 1) * length;
            let at = |lag: i64| self.correlation_of(nodes.clone(), |_| lag as f64 * self.interval_s);
            let lags = before - reach..=before + reach;
            let best = lags.map(|lag| (at(lag), lag)).max_by(|one, other| one.0.total_cmp(&other.0));
            if let Some((correlation, lag)) = best.filter(|best| best.0 > CORRELATED) {
                // The peak of the parabola through three correlations.
                let [early, late] = [at(lag - 1), at(lag + 1)];
                let curvature = 2.0 * correlation - early - late;
                let beside = if curvature > 0.0 { (0.5 * (late - early) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
                let middle_s = self.node_s[(nodes.start + nodes.end) / 2] - self.node_s[0];
                found.push((middle_s, (lag as f64 + beside) * self.interval_s));
                before = lag;
            }
        }
        found
    }
}
