//! A recording cut into what the unit did: rests and turns, as the reference attitude shows them.
//!
//! A diagnosis is given no list of manoeuvres, and needs none: mean rates over 5 s, in which a limit cycle averages out, tell when
//! the unit turns, about which axis and which way.

use std::ops::Range;

use geu_calibration::window::ManoeuvreWindow;
use geu_model::units::SAMPLE_INTERVAL_S;

use crate::gap;
use crate::measured::{BLOCK, BLOCK_S, MeasuredData, Series, TIMING};

/// Below this the unit rests: what a limit cycle of 4 arcsec/s leaves in 5 s, whatever its period, and no manoeuvre.
const REST_ARCSEC_S: f64 = 4.0;
/// What is shorter, 30 s, belongs to what is beside it: a step of a raster, a stop between two turns. The slews of a survey,
/// 7.5° at 720 arcsec/s, take a minute.
const SHORTEST_BLOCKS: usize = 6;
/// Where less than this share of it goes either way, it goes one way.
const TO_AND_FRO: f64 = 0.2;
/// Names of the control axes.
const AXES: [char; 3] = ['X', 'Y', 'Z'];

/// A rest or a turn.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionSegment {
    /// In words: `rest`, `turn about Y at +720 arcsec/s`; or as a list of manoeuvres calls it.
    pub name: String,
    /// Start, s since the start of the recording.
    pub from_s: f64,
    /// End.
    pub to_s: f64,
    /// The control axis about which it turns most, 0 to 2; nothing at rest.
    pub axis: Option<usize>,
}

impl MotionSegment {
    /// Its blocks.
    pub fn blocks(&self) -> Range<usize> {
        (self.from_s / BLOCK_S).round().max(0.0) as usize..(self.to_s / BLOCK_S).round().max(0.0) as usize
    }

    /// Its nodes, with the one at which it starts.
    fn nodes(&self) -> Range<usize> {
        let node = |at_s: f64| (at_s / SAMPLE_INTERVAL_S).round().max(0.0) as usize;
        node(self.from_s)..node(self.to_s) + 1
    }
}

/// The recording from its start to its end, cut where the motion changes.
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
            // What was too short to stand alone goes on as what follows.
            Some((before, own)) if own.len() < SHORTEST_BLOCKS => (*before, own.end) = (motion, range.end),
            _ => joined.push((motion, range)),
        }
    }
    let of = |(_, range): (Motion, Range<usize>)| {
        let (axis, name) = told(&rates[range.clone()]);
        MotionSegment { name, from_s: range.start as f64 * BLOCK_S, to_s: range.end as f64 * BLOCK_S, axis }
    };
    joined.into_iter().map(of).collect()
}

/// The stretches of a list of manoeuvres on the time scale of the recording, as far as they lie within it.
pub fn listed(measured: &MeasuredData, windows: &[ManoeuvreWindow]) -> Vec<MotionSegment> {
    let (rates, start_s) = (rates(measured), measured.counts.start_ns as f64 * 1e-9);
    let end_s = rates.len() as f64 * BLOCK_S;
    let of = |window: &ManoeuvreWindow| {
        let within = |at_s: f64| (at_s - start_s).clamp(0.0, end_s);
        let (from_s, to_s) = (within(window.start_s), within(window.end_s));
        let stretch = MotionSegment { name: window.name.clone(), from_s, to_s, axis: None };
        let own = rates.get(stretch.blocks()).filter(|own| !own.is_empty())?;
        Some(MotionSegment { axis: told(own).0, ..stretch })
    };
    windows.iter().filter_map(of).collect()
}

/// The residual of a model within each stretch, whose first value is set to zero: its root mean square on each gyro, arcsec; NaN
/// where nothing can be trusted.
pub fn rms_arcsec(measured: &MeasuredData, model: &Series, stretches: &[MotionSegment]) -> Vec<[f64; TIMING]> {
    let residual = gap::residual(measured, model);
    let of_gyro = |gyro: usize, stretch: &MotionSegment| {
        let (mut start, mut squares, mut count) = (f64::NAN, 0.0, 0usize);
        for node in stretch.nodes().filter(|&node| (1..=measured.samples).contains(&node)) {
            let Some(block) = measured.blocks[gyro].get((node - 1) / BLOCK) else { break };
            if block.restarts || !block.is_good {
                start = f64::NAN;
            }
            if !block.is_good {
                continue;
            }
            let value = residual(gyro, node);
            if start.is_nan() {
                start = value;
            }
            squares += (value - start).powi(2);
            count += 1;
        }
        if count == 0 { f64::NAN } else { (squares / count as f64).sqrt() }
    };
    stretches.iter().map(|stretch| std::array::from_fn(|gyro| of_gyro(gyro, stretch))).collect()
}

/// At rest, or about which axis and whether in its positive sense.
type Motion = Option<(usize, bool)>;

fn motion(rate: &[f64; 3]) -> Motion {
    let axis = (0..3).max_by(|&one, &other| rate[one].abs().total_cmp(&rate[other].abs()))?;
    (rate[axis].abs() >= REST_ARCSEC_S).then_some((axis, rate[axis] > 0.0))
}

/// Mean rates about the control axes over each block, arcsec/s.
fn rates(measured: &MeasuredData) -> Vec<[f64; 3]> {
    let mut near = 0;
    let mut at = |block: usize| measured.reference.at(block as f64 * BLOCK_S, &mut near).0;
    let mut before = at(0);
    let mut of_block = |block: usize| {
        let angle = at(block + 1);
        let turned = std::array::from_fn(|axis| (angle[axis] - before[axis]) / BLOCK_S);
        before = angle;
        turned
    };
    (0..measured.block_count()).map(&mut of_block).collect()
}

/// The axis and the name of a stretch with these rates.
fn told(rates: &[[f64; 3]]) -> (Option<usize>, String) {
    let middle = |axis: usize, of: fn(f64) -> f64| {
        let mut all: Vec<f64> = rates.iter().map(|rate| of(rate[axis])).collect();
        let middle = all.len() / 2;
        if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 }
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
    fn a_turn_is_told_by_its_middle_rate_and_a_limit_cycle_is_rest() {
        let turn = [[0.0, 90.0, 0.0], [1.0, 720.0, -3.0], [0.0, 719.0, 2.0]];
        assert_eq!(told(&turn), (Some(1), "turn about Y at +719 arcsec/s".to_owned()));
        assert_eq!(told(&[[3.9, -3.9, 0.0], [-3.9, 2.0, 0.0]]), (None, "rest".to_owned()));
        let scan = [[0.0, 0.0, 231.0], [0.0, 0.0, -231.0]];
        assert_eq!(told(&scan), (Some(2), "scan to and fro about Z at 231 arcsec/s".to_owned()));
        assert_eq!(told(&[]), (None, "rest".to_owned()));
    }
}
