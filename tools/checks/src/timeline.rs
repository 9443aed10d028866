//! End time of each row's sample, and its sequence step.

use geu_model::Configuration;
use geu_model::temperature::ElectronicsCourse;
use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::continuity::{Continuity, MAX_MISSING, SequenceStep};
use geu_recording::ReceivedSample;

/// Neighbours on either side over which times are smoothed: a median preserves edges and removes late stamps.
const NEIGHBOURS: usize = 4;

/// Times of the rows.
pub struct SampleTimes {
    /// Start of the first sample on the time scale of the rows, ns.
    pub start_ns: i64,
    /// True if the times are receive times, false if they are the unit's clock.
    pub is_received: bool,
    /// End of each row's sample, s since the start of the first; smoothed.
    pub end_s: Vec<f64>,
    /// Receive time of each row, s since the start, if available.
    pub stamp_s: Vec<Option<f64>>,
    /// Sequence step from the row before.
    pub steps: Vec<SequenceStep>,
    /// Samples since the first row, by sequence and clock.
    pub samples: Vec<f64>,
}

impl SampleTimes {
    pub fn new(rows: &[ReceivedSample]) -> SampleTimes {
        let mut continuity = Continuity::default();
        let clock = |row: &ReceivedSample| row.has_clock.then_some(row.sample.clock_count);
        let steps: Vec<SequenceStep> =
            rows.iter().map(|row| continuity.step(row.sample.sequence, clock(row))).collect();
        let mut passed = 0.0;
        let samples: Vec<f64> = steps
            .iter()
            .map(|step| {
                passed += match *step {
                    SequenceStep::First | SequenceStep::Repeat => 0.0,
                    SequenceStep::Gap(missing) => missing.min(MAX_MISSING) as f64 + 1.0,
                    SequenceStep::Next | SequenceStep::Reset | SequenceStep::Jump => 1.0,
                };
                passed
            })
            .collect();
        let is_received = rows.iter().any(|row| row.is_received);
        let times = || rows.iter().map(|row| row.time.filter(|_| row.is_received == is_received));
        let first = times().enumerate().find_map(|(index, time)| Some((index, time?.t_ns)));
        let start_ns = first
            .map_or(0, |(index, t_ns)| t_ns.saturating_sub(((samples[index] + 1.0) * SAMPLE_INTERVAL_S * 1e9) as i64));
        let since_start = |t_ns: i64| (i128::from(t_ns) - i128::from(start_ns)) as f64 * 1e-9;
        let stamp_s: Vec<Option<f64>> =
            times().map(|time| time.filter(|_| is_received).map(|time| since_start(time.t_ns))).collect();
        let end_s = if is_received {
            smoothed(&stamp_s, &steps)
        } else {
            samples.iter().map(|samples| (samples + 1.0) * SAMPLE_INTERVAL_S).collect()
        };
        SampleTimes { start_ns, is_received, end_s, stamp_s, steps, samples }
    }

    /// Start of a row's sample, s.
    pub fn start_s(&self, row: usize) -> f64 {
        self.end_s[row] - SAMPLE_INTERVAL_S
    }

    /// The recorded electronics temperature.
    pub fn electronics(&self, rows: &[ReceivedSample], configuration: &Configuration) -> ElectronicsCourse {
        let celsius = rows.iter().map(|row| f64::from(row.sample.electronics_centi_c) * 0.01);
        let mut electronics = configuration.electronics.clone();
        electronics.follow(self.end_s.iter().copied().zip(celsius).collect());
        electronics
    }
}

/// End times by the median over the neighbours, each corrected by its distance in samples.
fn smoothed(stamp_s: &[Option<f64>], steps: &[SequenceStep]) -> Vec<f64> {
    // Deviation from one row in each sample interval; missing rows are an edge.
    let mut index = 0.0;
    let indices: Vec<f64> = steps
        .iter()
        .map(|step| {
            index += if *step == SequenceStep::Repeat { 0.0 } else { 1.0 };
            index
        })
        .collect();
    let known: Vec<(usize, f64)> = (0..steps.len())
        .filter(|&row| steps[row] != SequenceStep::Repeat)
        .filter_map(|row| Some((row, stamp_s[row]? - indices[row] * SAMPLE_INTERVAL_S)))
        .collect();
    let mut near = Vec::with_capacity(2 * NEIGHBOURS + 1);
    let medians: Vec<(usize, f64)> = (0..known.len())
        .map(|at| {
            // Symmetric, so that a drift causes no bias at the ends.
            let reach = NEIGHBOURS.min(at).min(known.len() - 1 - at);
            near.clear();
            near.extend(known[at - reach..=at + reach].iter().map(|known| known.1));
            (known[at].0, *near.select_nth_unstable_by(reach, f64::total_cmp).1)
        })
        .collect();
    let mut next = medians.into_iter().peekable();
    let mut deviation_s = next.peek().map_or(0.0, |first| first.1);
    (0..steps.len())
        .map(|row| {
            if let Some((_, found_s)) = next.next_if(|found| found.0 == row) {
                deviation_s = found_s;
            }
            deviation_s + indices[row] * SAMPLE_INTERVAL_S
        })
        .collect()
}
