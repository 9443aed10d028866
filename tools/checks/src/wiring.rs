//! Search for wiring faults: the hypothesis of the model's list that turns the predicted counts into the measured ones.
//!
//! Each hypothesis is compared with the prediction without it, sample by sample, with a memory of the measured counts. Its interval is
//! the one with the largest reduction of the sum of squares. It is accepted if the measured counts differ from the prediction there by
//! the whole difference that the fault makes, not by a part of it. Ordinary effects make at most a few hundredths of that.

use std::ops::Range;

use geu_model::effect::WiringStates;
use geu_protocol::Gyro;
use geu_recording::ReceivedSample;

use super::compared::CountComparison;
use super::moments::Moments;
use super::timeline::SampleTimes;
use super::wiring_hypothesis::{Wiring, WiringFault, WiringHypothesis, apply};

/// Maximum number of faults.
const MAX_FAULTS: usize = 8;
/// Shares of the counts that may be ordinary errors: none, and slightly more than the 5 % of a scale factor.
const ORDINARY: [f64; 2] = [0.0, 0.06];
/// Counts allowed in addition to such a share, for drift and misalignments.
const ORDINARY_COUNTS: f64 = 8.0;
/// Tolerance of the measured part of the difference that a fault makes.
const SHOWN: f64 = 0.1;
/// Largest sigma of that part.
const SHOWN_SIGMA: f64 = 0.03;
/// Samples in a sum: one for fast motion, a minute for small lasting differences, because rounding of a sum is that of an increment.
const SUMMED: [usize; 2] = [1, 120];
/// Minimum number of sums.
const MIN_SUMS: f64 = 8.0;
/// Minimum motion of the angle about its trend for lost counts: within pivots or a play, with limits of 100 arcsec, counts may rest.
const MIN_EXCURSION_COUNTS: f64 = 150.0;
/// Minimum residual without lost counts, over that before and after: a noisy reference departs from equal counts too.
const BESIDE: f64 = 3.0;
/// Variance of a sum by rounding: twice 1/12.
const ROUNDING_VARIANCE: f64 = 1.0 / 6.0;
/// Increase of the sum of squares over the residual variance in the interval of an onset: 5 sigma.
const ONSET_CHI2: f64 = 25.0;

/// A fault and its samples.
pub struct LocatedFault {
    pub fault: WiringFault,
    hypothesis: WiringHypothesis,
    samples: Range<usize>,
}

struct Search<'a> {
    compared: &'a CountComparison,
    /// Memory of the wiring before each sample, from the measured counts.
    states: Vec<WiringStates>,
    /// Predicted with the wiring already found.
    known: Vec<[f64; 4]>,
}

/// Finds faults in addition to those found before, and excludes lost counts from `compared`. A fault that undoes itself is in the
/// harness, which does not change repeatedly: a hypothesis that occurs twice is rejected.
pub fn search(
    mut hypotheses: Vec<WiringHypothesis>,
    before: &[LocatedFault],
    compared: &mut CountComparison,
    timeline: &SampleTimes,
) -> Vec<LocatedFault> {
    loop {
        let mut tried = compared.clone();
        let found = one_by_one(&hypotheses, &mut tried, timeline);
        let is_again = |index: usize| {
            before.iter().chain(&found[..index]).any(|other| other.hypothesis == found[index].hypothesis)
        };
        let Some(again) = (0..found.len()).find(|&index| found[index].hypothesis.undoes_itself() && is_again(index))
        else {
            *compared = tried;
            return found;
        };
        hypotheses.retain(|own| *own != found[again].hypothesis);
    }
}

/// Faults in order of their reduction of the sum of squares.
fn one_by_one(
    hypotheses: &[WiringHypothesis],
    compared: &mut CountComparison,
    timeline: &SampleTimes,
) -> Vec<LocatedFault> {
    let mut found: Vec<LocatedFault> = Vec::new();
    while found.len() < MAX_FAULTS {
        let search = Search::new(compared);
        let best = ORDINARY.iter().find_map(|&ordinary| search.best(hypotheses, ordinary, timeline));
        let Some(best) = best else { break };
        let is_lost = !best.hypothesis.undoes_itself();
        for sample in &mut compared.samples[best.samples.clone()] {
            best.hypothesis.set(&mut sample.wiring);
            if is_lost {
                best.fault.gyros.iter().for_each(|&gyro| sample.is_used[gyro.index()] = false);
            }
        }
        found.push(best);
    }
    found
}

/// Corrects the rows: applies a fault that undoes itself again, and marks lost counts as invalid.
pub fn undo(found: &[LocatedFault], compared: &CountComparison, rows: &mut [ReceivedSample]) {
    let mut found: Vec<&LocatedFault> = found.iter().collect();
    found.sort_by_key(|found| std::cmp::Reverse(found.hypothesis.order()));
    for LocatedFault { hypothesis, samples, fault } in found {
        let row = |index: usize| compared.samples.get(index).map_or(rows.len(), |sample| sample.row);
        let affected = row(samples.start)..row(samples.end);
        let undoes_itself = hypothesis.undoes_itself();
        let sources = hypothesis.sources();
        for row in &mut rows[affected] {
            let sample = &mut row.sample;
            if !undoes_itself {
                fault.gyros.iter().for_each(|gyro| sample.gyro_flags &= !gyro.bit());
                continue;
            }
            let mut counts = sample.increments.map(f64::from);
            apply(&hypothesis.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
            sample.increments = counts.map(|count| count as i16);
            // The flags move with the counts.
            let flags = sample.gyro_flags;
            sample.gyro_flags = (0..4).fold(0, |moved, to| {
                let from = sources[to].abs().clamp(1.0, 4.0) as usize - 1;
                moved | ((flags >> from) & 0x11) << to
            });
        }
    }
}

impl Search<'_> {
    fn new(compared: &CountComparison) -> Search<'_> {
        let mut now = WiringStates::default();
        let (mut states, mut known) = (Vec::new(), Vec::new());
        for sample in &compared.samples {
            let mut predicted = sample.predicted;
            apply(&sample.wiring, &mut now.clone(), &mut predicted);
            known.push(predicted);
            states.push(now.clone());
            apply(&Wiring::default(), &mut now, &mut sample.measured.clone());
        }
        Search { compared, states, known }
    }

    /// The accepted hypothesis with the largest reduction. Ordinary errors do not count against the known wiring.
    fn best(&self, hypotheses: &[WiringHypothesis], ordinary: f64, timeline: &SampleTimes) -> Option<LocatedFault> {
        let mut best: Option<(f64, LocatedFault)> = None;
        for hypothesis in hypotheses {
            let gains = self.gains(hypothesis, ordinary);
            let (gain, samples) = best_interval(&gains);
            if best.as_ref().is_none_or(|best| gain > best.0)
                && let Some(found) = self.judge(hypothesis, samples, &gains, timeline)
            {
                best = Some((gain, found));
            }
        }
        best.map(|(_, found)| found)
    }

    /// Reduction of each sample's squared residual.
    fn gains(&self, hypothesis: &WiringHypothesis, ordinary: f64) -> Vec<f64> {
        let is_exact = !hypothesis.undoes_itself();
        let gain = |index: usize| {
            let (sample, known) = (&self.compared.samples[index], &self.known[index]);
            let mut changed = sample.predicted;
            apply(&hypothesis.with(&sample.wiring), &mut self.states[index].clone(), &mut changed);
            let largest = sample.predicted.iter().fold(0.0, |largest: f64, count| largest.max(count.abs()));
            let allowed = if ordinary > 0.0 { ORDINARY_COUNTS + ordinary * largest } else { 0.0 };
            (0..4)
                .filter(|&gyro| sample.is_used[gyro] && changed[gyro] != known[gyro])
                .map(|gyro| {
                    let with = sample.measured[gyro] - changed[gyro];
                    // A fault replaces lost counts exactly, or not at all.
                    if is_exact && with != 0.0 {
                        return f64::NEG_INFINITY;
                    }
                    let without = ((sample.measured[gyro] - known[gyro]).abs() - allowed).max(0.0);
                    without * without - with * with
                })
                .sum()
        };
        (0..self.known.len()).map(gain).collect()
    }

    /// Predicted counts with the fault, from the first sample of an interval.
    fn with(&self, hypothesis: &WiringHypothesis, samples: Range<usize>) -> Vec<[f64; 4]> {
        let mut states = self.states.get(samples.start).cloned().unwrap_or_default();
        let with = |index: usize| {
            let mut changed = self.compared.samples[index].predicted;
            apply(&hypothesis.with(&self.compared.samples[index].wiring), &mut states, &mut changed);
            changed
        };
        samples.map(with).collect()
    }

    fn judge(
        &self,
        hypothesis: &WiringHypothesis,
        samples: Range<usize>,
        gains: &[f64],
        timeline: &SampleTimes,
    ) -> Option<LocatedFault> {
        if samples.is_empty() {
            return None;
        }
        let with = self.with(hypothesis, samples.clone());
        let is_shown = SUMMED.iter().any(|&summed| {
            let fits = [0, 1, 2, 3].map(|gyro| self.fit(gyro, samples.clone(), &with, summed));
            fits.iter().any(Option::is_some) && fits.iter().flatten().all(is_whole_difference)
        });
        let rests = |gyro: usize| self.excursion(gyro, samples.clone(), &with) < MIN_EXCURSION_COUNTS;
        if !is_shown || !hypothesis.undoes_itself() && (0..4).all(rests) {
            return None;
        }
        let fits = [0, 1, 2, 3].map(|gyro| self.fit(gyro, samples.clone(), &with, 1));
        let is_beside = |gyro: usize| {
            fits[gyro].as_ref().is_some_and(|fit| {
                fit.xx / fit.count.max(1.0) < BESIDE * BESIDE * self.mean_square_beside(gyro, &samples)
            })
        };
        if !hypothesis.undoes_itself() && (0..4).any(is_beside) {
            return None;
        }
        let gyros = Gyro::ALL.into_iter().filter(|&gyro| fits[gyro.index()].is_some()).collect();
        let variance = fits.iter().flatten().map(variance).fold(0.0, f64::max);
        let onset = equivalent_edges(gains, samples.start, ONSET_CHI2 * variance);
        let end = equivalent_edges(gains, samples.end, ONSET_CHI2 * variance);
        // A fault with a memory may predict something else from an earlier onset.
        let lasts_from_start = onset.start == 0 && self.agrees(hypothesis, samples.start, &with);
        let samples = if lasts_from_start { 0 } else { samples.start }..if end.end == gains.len() {
            end.end
        } else {
            samples.end
        };
        let start_s = |index: usize| match self.compared.samples.get(index) {
            Some(sample) => timeline.start_s(sample.row),
            None => timeline.end_s.last().copied().unwrap_or(0.0),
        };
        let rms = |squares: fn(&Moments) -> f64| {
            let count: f64 = fits.iter().flatten().map(|fit| fit.count).sum();
            (fits.iter().flatten().map(squares).sum::<f64>() / count.max(1.0)).max(0.0).sqrt()
        };
        let onset_s = (samples.start > 0).then(|| start_s(samples.start));
        let fault = WiringFault {
            hypothesis: hypothesis.hypothesis(onset_s),
            gyros,
            onset_s,
            onset_between_s: [start_s(onset.start), start_s(onset.end)],
            end_s: (samples.end < gains.len()).then(|| start_s(samples.end)),
            samples: samples.len(),
            without_rms_counts: rms(|fit| fit.xx),
            with_rms_counts: rms(|fit| fit.xx - 2.0 * fit.xy + fit.yy),
        };
        Some(LocatedFault { fault, hypothesis: *hypothesis, samples })
    }

    /// True if the fault from the start predicts the same as `with` after `onset`.
    fn agrees(&self, hypothesis: &WiringHypothesis, onset: usize, with: &[[f64; 4]]) -> bool {
        let earlier = self.with(hypothesis, 0..onset + with.len());
        earlier[onset..].iter().zip(with).all(|(earlier, with)| earlier == with)
    }

    /// Range of the angle removed by the fault, about the line of a drift, counts.
    fn excursion(&self, gyro: usize, samples: Range<usize>, with: &[[f64; 4]]) -> f64 {
        let steps = || {
            let used = samples.clone().zip(with).filter(|(index, _)| self.compared.samples[*index].is_used[gyro]);
            used.map(|(index, with)| with[gyro] - self.known[index][gyro])
        };
        let mean = steps().sum::<f64>() / (steps().count() as f64).max(1.0);
        let (mut angle, mut min, mut max) = (0.0, 0.0_f64, 0.0_f64);
        for step in steps() {
            angle += step - mean;
            (min, max) = (min.min(angle), max.max(angle));
        }
        max - min
    }

    /// Mean square of the residual of a gyro in as many samples before and after an interval, a minute or more; 0 if there are none.
    fn mean_square_beside(&self, gyro: usize, samples: &Range<usize>) -> f64 {
        let count = samples.len().max(SUMMED[1]);
        let before = samples.start.saturating_sub(count)..samples.start;
        let after = samples.end..self.known.len().min(samples.end + count);
        let square = |index: usize| (self.compared.samples[index].measured[gyro] - self.known[index][gyro]).powi(2);
        let squares: Vec<f64> = before.chain(after).map(square).collect();
        squares.iter().sum::<f64>() / (squares.len() as f64).max(1.0)
    }

    /// Moments of a gyro in an interval, of sums over `summed` samples: x is the measured and y the predicted difference to the known
    /// wiring. `None` if the fault changes nothing.
    fn fit(&self, gyro: usize, samples: Range<usize>, with: &[[f64; 4]], summed: usize) -> Option<Moments> {
        let used = samples.zip(with).filter(|(index, _)| self.compared.samples[*index].is_used[gyro]);
        let pairs = used.map(|(index, with)| {
            let known = self.known[index][gyro];
            (self.compared.samples[index].measured[gyro] - known, with[gyro] - known)
        });
        pairs.clone().any(|(_, difference)| difference != 0.0).then(|| Moments::of_sums(pairs, summed))
    }
}

/// Variance of the residual with the fault, about its mean.
fn variance(fit: &Moments) -> f64 {
    let count = fit.count.max(1.0);
    let mean = (fit.x - fit.y) / count;
    ((fit.xx - 2.0 * fit.xy + fit.yy) / count - mean * mean).max(ROUNDING_VARIANCE)
}

/// True if the counts differ by the whole difference that the fault makes, both about zero and about the mean, which a drift does not
/// change.
fn is_whole_difference(fit: &Moments) -> bool {
    let (yy, xy) = (fit.yy - fit.y * fit.y / fit.count, fit.xy - fit.x * fit.y / fit.count);
    let is_shown = |xy: f64, yy: f64| (xy / yy - 1.0).abs() <= SHOWN;
    fit.count >= MIN_SUMS
        && yy * SHOWN_SIGMA * SHOWN_SIGMA >= variance(fit)
        && is_shown(xy, yy)
        && is_shown(fit.xy, fit.yy)
}

/// The interval with the largest sum, and that sum.
fn best_interval(gains: &[f64]) -> (f64, Range<usize>) {
    let (mut best, mut interval, mut sum, mut start) = (0.0, 0..0, 0.0, 0);
    for (index, gain) in gains.iter().enumerate() {
        if sum <= 0.0 {
            (sum, start) = (0.0, index);
        }
        sum += gain;
        if sum > best {
            (best, interval) = (sum, start..index + 1);
        }
    }
    (best, interval)
}

/// Other places of an edge that change the sum by at most `slack`.
fn equivalent_edges(gains: &[f64], edge: usize, slack: f64) -> Range<usize> {
    let reach = |gains: &mut dyn Iterator<Item = &f64>| {
        let mut sum = 0.0;
        gains
            .take_while(|gain| {
                sum += **gain;
                sum.abs() <= slack
            })
            .count()
    };
    edge - reach(&mut gains[..edge].iter().rev())..edge + reach(&mut gains[edge..].iter())
}
