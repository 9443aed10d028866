//! Motion segments of a recording: rests and turns, detected from the reference attitude.
//!
//! Mean rates over 5 s, in which a limit cycle averages out, give start, axis and sense of each turn, so that no list of manoeuvres
//! is necessary.

use geu_checks::median;
use std::ops::Range;

use geu_calibration::window::ManoeuvreWindow;

use crate::measured::{BLOCK, MeasuredData, ModelRun, TIMING};
use crate::residual_stats::{relative, residual};

/// Below this mean rate the unit rests: the largest mean over 5 s of a limit cycle of 4 arcsec/s, less than any manoeuvre.
const REST_ARCSEC_S: f64 = 4.0;
/// Shorter segments, 30 s, join their neighbour: a step of a raster, a stop between two turns. The slews of a survey, 7.5° at
/// 720 arcsec/s, take a minute.
const SHORTEST_BLOCKS: usize = 6;
/// A turn is unidirectional if less than this share of it has the other sense.
const TO_AND_FRO: f64 = 0.2;
/// Names of the control axes.
const AXES: [char; 3] = ['X', 'Y', 'Z'];

/// A rest or a turn.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionSegment {
    /// `rest`, `turn about Y at +720 arcsec/s`, or the name in the list of manoeuvres.
    pub name: String,
    /// Start, s since the start of the recording.
    pub from_s: f64,
    /// End.
    pub to_s: f64,
    /// Control axis with the highest mean rate, 0 to 2; `None` at rest.
    pub axis: Option<usize>,
}

impl MotionSegment {
    /// Range of blocks.
    pub fn blocks(&self, block_s: f64) -> Range<usize> {
        (self.from_s / block_s).round().max(0.0) as usize..(self.to_s / block_s).round().max(0.0) as usize
    }

    /// Range of nodes, including the one at its start.
    fn nodes(&self, block_s: f64) -> Range<usize> {
        let node = |at_s: f64| (at_s / block_s * BLOCK as f64).round().max(0.0) as usize;
        node(self.from_s)..node(self.to_s) + 1
    }
}

/// Cuts the recording where the motion changes.
pub fn cut(measured: &MeasuredData) -> Vec<MotionSegment> {
    let rates = rates(measured);
    let mut runs: Vec<(Motion, Range<usize>)> = Vec::new();
    for (block, rate) in rates.iter().enumerate() {
        let motion = motion(rate);
        match runs.last_mut() {
            Some((before, range)) if *before == motion => range.end = block + 1,
            _ => runs.push((motion, block..block + 1)),
        }
    }
    let mut joined: Vec<(Motion, Range<usize>)> = Vec::new();
    for (motion, range) in runs {
        match joined.last_mut() {
            Some((before, own)) if *before == motion || range.len() < SHORTEST_BLOCKS => own.end = range.end,
            // A segment that is too short joins the next one.
            Some((before, own)) if own.len() < SHORTEST_BLOCKS => (*before, own.end) = (motion, range.end),
            _ => joined.push((motion, range)),
        }
    }
    let block_s = measured.block_s();
    let of = |(_, range): (Motion, Range<usize>)| {
        let (axis, name) = describe(&rates[range.clone()]);
        MotionSegment { name, from_s: range.start as f64 * block_s, to_s: range.end as f64 * block_s, axis }
    };
    joined.into_iter().map(of).collect()
}

/// The parts of listed manoeuvres that lie within the recording.
pub fn listed(measured: &MeasuredData, windows: &[ManoeuvreWindow]) -> Vec<MotionSegment> {
    let (rates, start_s) = (rates(measured), measured.counts.start_ns as f64 * 1e-9);
    let end_s = rates.len() as f64 * measured.block_s();
    let of = |window: &ManoeuvreWindow| {
        let within = |at_s: f64| (at_s - start_s).clamp(0.0, end_s);
        let (from_s, to_s) = (within(window.start_s), within(window.end_s));
        let segment = MotionSegment { name: window.name.clone(), from_s, to_s, axis: None };
        let own = rates.get(segment.blocks(measured.block_s())).filter(|own| !own.is_empty())?;
        Some(MotionSegment { axis: describe(own).0, ..segment })
    };
    windows.iter().filter_map(of).collect()
}

/// Root mean square of a model's residual in each segment on each gyro, relative to the segment's first value, arcsec; NaN without
/// usable counts.
pub fn rms_arcsec(measured: &MeasuredData, model: &ModelRun, segments: &[MotionSegment]) -> Vec<[f64; TIMING]> {
    let residual = residual(measured, model);
    let of_gyro = |gyro: usize, segment: &MotionSegment| {
        let nodes = segment.nodes(measured.block_s());
        let nodes = nodes.start.max(1)..nodes.end.min(measured.samples + 1);
        let values = relative(measured, gyro, nodes, |node| residual(gyro, node), |_| false);
        let known = || values.iter().filter(|value| !value.is_nan());
        (known().map(|value| value.powi(2)).sum::<f64>() / known().count() as f64).sqrt()
    };
    let heads = measured.gyros().heads();
    let rms = |gyro: usize, segment: &MotionSegment| if gyro < heads { of_gyro(gyro, segment) } else { f64::NAN };
    segments.iter().map(|segment| std::array::from_fn(|gyro| rms(gyro, segment))).collect()
}

/// `None` at rest, else the axis and whether the rate is positive.
type Motion = Option<(usize, bool)>;

fn motion(rate: &[f64; 3]) -> Motion {
    let axis = (0..3).max_by(|&one, &other| rate[one].abs().total_cmp(&rate[other].abs()))?;
    (rate[axis].abs() >= REST_ARCSEC_S).then_some((axis, rate[axis] > 0.0))
}

/// Mean rates about the control axes over each block, arcsec/s.
fn rates(measured: &MeasuredData) -> Vec<[f64; 3]> {
    let (block_s, mut near) = (measured.block_s(), 0);
    let mut at = |block: usize| measured.reference.at(block as f64 * block_s, &mut near).0;
    let mut before = at(0);
    let mut of_block = |block: usize| {
        let angle = at(block + 1);
        let turned = std::array::from_fn(|axis| (angle[axis] - before[axis]) / block_s);
        before = angle;
        turned
    };
    (0..measured.block_count()).map(&mut of_block).collect()
}

/// Axis and name of a segment with these rates.
fn describe(rates: &[[f64; 3]]) -> (Option<usize>, String) {
    let middle = |axis: usize, of: fn(f64) -> f64| {
        let mut all: Vec<f64> = rates.iter().map(|rate| of(rate[axis])).collect();
        median(&mut all)
    };
    let mean = |axis: usize| rates.iter().map(|rate| rate[axis].abs()).sum::<f64>() / rates.len().max(1) as f64;
    let axis = (0..3).max_by(|&one, &other| mean(one).total_cmp(&mean(other))).unwrap_or(0);
    if mean(axis) < REST_ARCSEC_S {
        return (None, "rest".to_owned());
    }
    // Turns about Y are slews; scans go about the sun vector, which lies in the plane of the other two.
    let kind = if axis == 1 { "turn" } else { "scan" };
    let moving = || rates.iter().filter(|rate| rate[axis].abs() >= REST_ARCSEC_S);
    let positive = moving().filter(|rate| rate[axis] > 0.0).count() as f64 / moving().count().max(1) as f64;
    let name = match (TO_AND_FRO..=1.0 - TO_AND_FRO).contains(&positive) {
        true => format!("{kind} to and fro about {} at {:.0} arcsec/s", AXES[axis], middle(axis, f64::abs)),
        false => format!("{kind} about {} at {:+.0} arcsec/s", AXES[axis], middle(axis, |rate| rate)).replace('-', "−"),
    };
    (Some(axis), name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_described_by_their_median_rate_and_a_limit_cycle_is_rest() {
        let turn = [[0.0, 90.0, 0.0], [1.0, 720.0, -3.0], [0.0, 719.0, 2.0]];
        assert_eq!(describe(&turn), (Some(1), "turn about Y at +719 arcsec/s".to_owned()));
        assert_eq!(describe(&[[3.9, -3.9, 0.0], [-3.9, 2.0, 0.0]]), (None, "rest".to_owned()));
        let scan = [[0.0, 0.0, 231.0], [0.0, 0.0, -231.0]];
        assert_eq!(describe(&scan), (Some(2), "scan to and fro about Z at 231 arcsec/s".to_owned()));
        assert_eq!(describe(&[]), (None, "rest".to_owned()));
    }
}
