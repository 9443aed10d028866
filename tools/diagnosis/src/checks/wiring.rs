//! Wiring faults: which law of the model's list turns the predicted counts into those that were measured.
//!
//! A law is tried sample by sample, its memory fed with what was measured, against the prediction without it. The
//! stretch over which it lowers the sum of squares most is where it may hold. It is named if it does there what it says and
//! nothing else: the counts depart from the prediction by once the difference that it makes, not by a part of it. Ordinary
//! effects make at most a few hundredths of that.

use std::ops::Range;

use geu_model::effect::WiringStates;
use geu_protocol::Gyro;
use geu_recording::ReceivedSample;

use super::compared::CountComparison;
use super::law::WiringFault;
use super::law::{Wiring, WiringHypothesis, apply};
use super::timeline::SampleTimes;

/// No recording has more.
const MOST_FAULTS: usize = 8;
/// Shares of the counts that may be ordinary errors: none, and a little more than a scale factor's 5 %.
const ORDINARY: [f64; 2] = [0.0, 0.06];
/// Counts beside such a share that may be: a drift's limit, and misalignments.
const ORDINARY_COUNTS: f64 = 8.0;
/// How far from 1 the part may be that the counts show of the difference a law makes.
const SHOWN: f64 = 0.1;
/// How well that part must be known, 1 sigma.
const SHOWN_SIGMA: f64 = 0.03;
/// Samples over which counts are summed before they are set against a law: one tells fast motion, and a minute small
/// differences that last, since a sum is rounded no worse than an increment.
const SUMMED: [usize; 2] = [1, 120];
/// Sums that a judgement needs.
const FEWEST: f64 = 8.0;
/// By how much the angle must move about its trend before counts that do not are called lost: within pivots or a play,
/// whose limits are 100 arcsec, they may rest.
const HIDDEN_COUNTS: f64 = 150.0;
/// What rounding leaves of a sum: two roundings of variance 1/12.
const ROUNDING_VARIANCE: f64 = 1.0 / 6.0;
/// Rise of the sum of squares over the residual variance within which an onset is as good as another: 5 sigma.
const AS_GOOD: f64 = 25.0;

/// A fault, and where it stands among the samples compared.
pub struct LocatedFault {
    pub fault: WiringFault,
    law: WiringHypothesis,
    halves: Range<usize>,
}

struct Search<'a> {
    compared: &'a CountComparison,
    /// What the wiring remembers before each sample, from what was measured.
    states: Vec<WiringStates>,
    /// Predicted with the wiring believed so far.
    believed: Vec<[f64; 4]>,
}

/// Names the faults beside those found before, and leaves out of `compared` what they destroy. What undoes itself is a harness, which does
/// not come and go: a law that would have to is none.
pub fn search(
    mut laws: Vec<WiringHypothesis>,
    before: &[LocatedFault],
    compared: &mut CountComparison,
    timeline: &SampleTimes,
) -> Vec<LocatedFault> {
    loop {
        let mut tried = compared.clone();
        let found = one_by_one(&laws, &mut tried, timeline);
        let is_again = |index: usize| before.iter().chain(&found[..index]).any(|other| other.law == found[index].law);
        let Some(again) = (0..found.len()).find(|&index| found[index].law.undoes_itself() && is_again(index)) else {
            *compared = tried;
            return found;
        };
        laws.retain(|law| *law != found[again].law);
    }
}

/// The one that explains most first.
fn one_by_one(laws: &[WiringHypothesis], compared: &mut CountComparison, timeline: &SampleTimes) -> Vec<LocatedFault> {
    let mut found: Vec<LocatedFault> = Vec::new();
    while found.len() < MOST_FAULTS {
        let search = Search::of(compared);
        let best = ORDINARY.iter().find_map(|&ordinary| search.best(laws, ordinary, timeline));
        let Some(best) = best else { break };
        let is_lost = !best.law.undoes_itself();
        for half in &mut compared.halves[best.halves.clone()] {
            best.law.set(&mut half.wiring);
            if is_lost {
                best.fault.gyros.iter().for_each(|&gyro| half.is_used[gyro as usize] = false);
            }
        }
        found.push(best);
    }
    found
}

/// Puts the rows right: what undoes itself is done again, what is lost is marked as no measurement.
pub fn undo(found: &[LocatedFault], compared: &CountComparison, rows: &mut [ReceivedSample]) {
    let mut found: Vec<&LocatedFault> = found.iter().collect();
    found.sort_by_key(|found| std::cmp::Reverse(found.law.order()));
    for LocatedFault { law, halves, fault } in found {
        let row = |half: usize| compared.halves.get(half).map_or(rows.len(), |half| half.row);
        let concerned = row(halves.start)..row(halves.end);
        let undoes_itself = law.undoes_itself();
        let sources = law.sources();
        for row in &mut rows[concerned] {
            let sample = &mut row.sample;
            if !undoes_itself {
                fault.gyros.iter().for_each(|gyro| sample.gyro_flags &= !gyro.bit());
                continue;
            }
            let mut counts = sample.increments.map(f64::from);
            apply(&law.with(&Wiring::default()), &mut WiringStates::default(), &mut counts);
            sample.increments = counts.map(|count| count as i16);
            // Flags go with the counts.
            let flags = sample.gyro_flags;
            sample.gyro_flags = (0..4).fold(0, |moved, to| {
                let from = sources[to].abs().clamp(1.0, 4.0) as usize - 1;
                moved | ((flags >> from) & 0x11) << to
            });
        }
    }
}

impl Search<'_> {
    fn of(compared: &CountComparison) -> Search<'_> {
        let mut now = WiringStates::default();
        let (mut states, mut believed) = (Vec::new(), Vec::new());
        for half in &compared.halves {
            let mut predicted = half.predicted;
            apply(&half.wiring, &mut now.clone(), &mut predicted);
            believed.push(predicted);
            states.push(now.clone());
            apply(&Wiring::default(), &mut now, &mut half.measured.clone());
        }
        Search { compared, states, believed }
    }

    /// The law that explains most; a part of the counts that may be ordinary errors is not held against what is believed.
    fn best(&self, laws: &[WiringHypothesis], ordinary: f64, timeline: &SampleTimes) -> Option<LocatedFault> {
        let mut best: Option<(f64, LocatedFault)> = None;
        for law in laws {
            let gains = self.gains(law, ordinary);
            let (gain, halves) = best_stretch(&gains);
            if best.as_ref().is_none_or(|best| gain > best.0)
                && let Some(found) = self.judge(law, halves, &gains, timeline)
            {
                best = Some((gain, found));
            }
        }
        best.map(|(_, found)| found)
    }

    /// By how much the law lowers the square of what is left of each sample.
    fn gains(&self, law: &WiringHypothesis, ordinary: f64) -> Vec<f64> {
        let is_exact = !law.undoes_itself();
        let one = |index: usize| {
            let (half, believed) = (&self.compared.halves[index], &self.believed[index]);
            let mut changed = half.predicted;
            apply(&law.with(&half.wiring), &mut self.states[index].clone(), &mut changed);
            let largest = half.predicted.iter().fold(0.0, |largest: f64, count| largest.max(count.abs()));
            let allowed = if ordinary > 0.0 { ORDINARY_COUNTS + ordinary * largest } else { 0.0 };
            (0..4)
                .filter(|&gyro| half.is_used[gyro] && changed[gyro] != believed[gyro])
                .map(|gyro| {
                    let with = half.measured[gyro] - changed[gyro];
                    // What is lost is replaced exactly, or not at all.
                    if is_exact && with != 0.0 {
                        return f64::NEG_INFINITY;
                    }
                    let without = ((half.measured[gyro] - believed[gyro]).abs() - allowed).max(0.0);
                    without * without - with * with
                })
                .sum()
        };
        (0..self.believed.len()).map(one).collect()
    }

    /// What the law makes of a stretch, from its first sample on.
    fn with(&self, law: &WiringHypothesis, halves: Range<usize>) -> Vec<[f64; 4]> {
        let mut states = self.states.get(halves.start).cloned().unwrap_or_default();
        let of_half = |index: usize| {
            let mut changed = self.compared.halves[index].predicted;
            apply(&law.with(&self.compared.halves[index].wiring), &mut states, &mut changed);
            changed
        };
        halves.map(of_half).collect()
    }

    fn judge(
        &self,
        law: &WiringHypothesis,
        halves: Range<usize>,
        gains: &[f64],
        timeline: &SampleTimes,
    ) -> Option<LocatedFault> {
        if halves.is_empty() {
            return None;
        }
        let with = self.with(law, halves.clone());
        let is_shown = SUMMED.iter().any(|&summed| {
            let fits = [0, 1, 2, 3].map(|gyro| self.fit(gyro, halves.clone(), &with, summed));
            fits.iter().any(Option::is_some) && fits.iter().flatten().all(Fit::is_the_law)
        });
        let rests = |gyro: usize| self.excursion(gyro, halves.clone(), &with) < HIDDEN_COUNTS;
        if !is_shown || !law.undoes_itself() && (0..4).all(rests) {
            return None;
        }
        let fits = [0, 1, 2, 3].map(|gyro| self.fit(gyro, halves.clone(), &with, 1));
        let gyros = Gyro::ALL.into_iter().filter(|&gyro| fits[gyro as usize].is_some()).collect();
        let variance = fits.iter().flatten().map(Fit::variance).fold(0.0, f64::max);
        let onset = as_good(gains, halves.start, AS_GOOD * variance);
        let end = as_good(gains, halves.end, AS_GOOD * variance);
        // A law with a memory that began earlier would have remembered something else.
        let lasts_from_start = onset.start == 0 && self.agrees(law, halves.start, &with);
        let halves =
            if lasts_from_start { 0 } else { halves.start }..if end.end == gains.len() { end.end } else { halves.end };
        let start_s = |half: usize| match self.compared.halves.get(half) {
            Some(half) => timeline.start_s(half.row),
            None => timeline.end_s.last().copied().unwrap_or(0.0),
        };
        let rms = |squares: fn(&Fit) -> f64| {
            let count: f64 = fits.iter().flatten().map(|fit| fit.count).sum();
            (fits.iter().flatten().map(squares).sum::<f64>() / count.max(1.0)).max(0.0).sqrt()
        };
        let onset_s = (halves.start > 0).then(|| start_s(halves.start));
        let fault = WiringFault {
            hypothesis: law.hypothesis(onset_s),
            gyros,
            onset_s,
            onset_between_s: [start_s(onset.start), start_s(onset.end)],
            end_s: (halves.end < gains.len()).then(|| start_s(halves.end)),
            samples: halves.len(),
            without_rms_counts: rms(|fit| fit.rr),
            with_rms_counts: rms(|fit| fit.rr - 2.0 * fit.rs + fit.ss),
        };
        Some(LocatedFault { fault, law: *law, halves })
    }

    /// Whether the law from the start gives the same as `with` from `onset` on.
    fn agrees(&self, law: &WiringHypothesis, onset: usize, with: &[[f64; 4]]) -> bool {
        let earlier = self.with(law, 0..onset + with.len());
        earlier[onset..].iter().zip(with).all(|(earlier, with)| earlier == with)
    }

    /// How far the angle goes that the law takes away, about the line that a drift makes, counts.
    fn excursion(&self, gyro: usize, halves: Range<usize>, with: &[[f64; 4]]) -> f64 {
        let steps = || {
            let used = halves.clone().zip(with).filter(|(index, _)| self.compared.halves[*index].is_used[gyro]);
            used.map(|(index, with)| with[gyro] - self.believed[index][gyro])
        };
        let mean = steps().sum::<f64>() / (steps().count() as f64).max(1.0);
        let (mut angle, mut least, mut greatest) = (0.0, 0.0_f64, 0.0_f64);
        for step in steps() {
            angle += step - mean;
            (least, greatest) = (least.min(angle), greatest.max(angle));
        }
        greatest - least
    }

    /// Moments of a gyro over a stretch, by sums of so many samples; nothing where the law changes nothing.
    fn fit(&self, gyro: usize, halves: Range<usize>, with: &[[f64; 4]], summed: usize) -> Option<Fit> {
        let (mut fit, mut sums, mut is_changed) = (Fit::default(), (0, 0.0, 0.0), false);
        for (index, with) in halves.zip(with) {
            let half = &self.compared.halves[index];
            if half.is_used[gyro] {
                let believed = self.believed[index][gyro];
                is_changed |= with[gyro] != believed;
                sums = (sums.0 + 1, sums.1 + half.measured[gyro] - believed, sums.2 + with[gyro] - believed);
                if sums.0 == summed {
                    fit.add(sums.1, sums.2);
                    sums = Default::default();
                }
            }
        }
        is_changed.then_some(fit)
    }
}

/// Moments: r, measured less believed; s, what the law makes of it.
#[derive(Default)]
struct Fit {
    count: f64,
    r: f64,
    s: f64,
    rr: f64,
    rs: f64,
    ss: f64,
}

impl Fit {
    fn add(&mut self, r: f64, s: f64) {
        self.count += 1.0;
        self.r += r;
        self.s += s;
        self.rr += r * r;
        self.rs += r * s;
        self.ss += s * s;
    }

    /// Of what is left with the law, about its mean.
    fn variance(&self) -> f64 {
        let count = self.count.max(1.0);
        let mean = (self.r - self.s) / count;
        ((self.rr - 2.0 * self.rs + self.ss) / count - mean * mean).max(ROUNDING_VARIANCE)
    }

    /// The counts depart by once what the law makes, both about zero and about the mean, where a drift says nothing.
    fn is_the_law(&self) -> bool {
        let (ss, rs) = (self.ss - self.s * self.s / self.count, self.rs - self.r * self.s / self.count);
        let shows = |rs: f64, ss: f64| (rs / ss - 1.0).abs() <= SHOWN;
        self.count >= FEWEST
            && ss * SHOWN_SIGMA * SHOWN_SIGMA >= self.variance()
            && shows(rs, ss)
            && shows(self.rs, self.ss)
    }
}

/// The stretch with the largest sum, and that sum.
fn best_stretch(gains: &[f64]) -> (f64, Range<usize>) {
    let (mut best, mut stretch, mut sum, mut start) = (0.0, 0..0, 0.0, 0);
    for (index, gain) in gains.iter().enumerate() {
        if sum <= 0.0 {
            (sum, start) = (0.0, index);
        }
        sum += gain;
        if sum > best {
            (best, stretch) = (sum, start..index + 1);
        }
    }
    (best, stretch)
}

/// Where else an edge may be for so much of the sum.
fn as_good(gains: &[f64], edge: usize, slack: f64) -> Range<usize> {
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
