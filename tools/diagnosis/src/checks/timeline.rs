//! When each row's sample ended, and how it stands to the one before.

use geu_model::units::SAMPLE_INTERVAL_S;
use geu_protocol::continuity::{Continuity, SequenceStep};
use geu_recording::ReceivedSample;

/// Neighbours on either side over which times are smoothed: a median keeps an edge where it is, and drops late stamps.
const NEIGHBOURS: usize = 4;
/// A sequence that was left out for longer than a week is a wrong word.
const MOST_MISSING: u64 = 1_209_600;

/// Times of the rows.
pub struct SampleTimes {
    /// Start of the first sample on the time scale of the rows, ns.
    pub start_ns: i64,
    /// Whether the times were received; else they are the unit's own clock.
    pub is_received: bool,
    /// End of each row's sample, s since the start of the first; smoothed.
    pub end_s: Vec<f64>,
    /// Receive time of each row, s since the start, where it has one.
    pub stamp_s: Vec<Option<f64>>,
    /// How each row stands to the one before.
    pub steps: Vec<SequenceStep>,
    /// Samples since the first row, by sequence and clock.
    pub samples: Vec<f64>,
}

impl SampleTimes {
    pub fn of(rows: &[ReceivedSample]) -> SampleTimes {
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
                    SequenceStep::Gap(missing) => missing.min(MOST_MISSING) as f64 + 1.0,
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
}

/// Ends by the median of what the neighbours tell, each so many samples away.
fn smoothed(stamp_s: &[Option<f64>], steps: &[SequenceStep]) -> Vec<f64> {
    // Departures from a row each sample: an edge where some are missing.
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
            // As many on either side, so that a course is not pulled at the ends.
            let reach = NEIGHBOURS.min(at).min(known.len() - 1 - at);
            near.clear();
            near.extend(known[at - reach..=at + reach].iter().map(|known| known.1));
            (known[at].0, *near.select_nth_unstable_by(reach, f64::total_cmp).1)
        })
        .collect();
    let mut next = medians.into_iter().peekable();
    let mut departure_s = next.peek().map_or(0.0, |first| first.1);
    (0..steps.len())
        .map(|row| {
            if let Some((_, found_s)) = next.next_if(|found| found.0 == row) {
                departure_s = found_s;
            }
            departure_s + indices[row] * SAMPLE_INTERVAL_S
        })
        .collect()
}
