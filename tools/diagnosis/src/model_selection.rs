//! Model selection: search, fit of the best candidates by the model, acceptance if χ² falls by more than the penalty, and again.
//!
//! The same data may show several effects or noise above its configured level: both orders are fitted, and the likelier one is
//! accepted.
//!
//! `selected` holds the state; `refine`, `noise` and `acceptance` act on it and use each other in this order only. `candidate_fit` fits
//! candidates beside it; `pairs` adds two hypotheses at once, `pulse` joins two.

mod acceptance;
mod candidate_fit;
mod noise;
mod pairs;
mod pulse;
mod refine;
mod selected;

use std::hash::{DefaultHasher, Hash, Hasher};

use crate::diagnosis_case::DiagnosisCase;
use crate::measured::TIMING;
use crate::model_state::ModelState;
use crate::normal_equations::NormalEquations;
use crate::null_distribution::Thresholds;
use crate::recent::Recent;
use crate::search::{Candidate, passes_cross_validation, search, separate_sets};
use crate::signature_bank::SignatureBank;
use crate::significance::{THREE_SIGMA_CHI2, TWO_SIGMA_CHI2};

use acceptance::negligible;
use candidate_fit::{HeldOut, best_fit};
use pairs::likeliest_pair;

pub use noise::early_minimum_s;
pub use selected::{FEW_SAMPLES, IdentifiedNoise, MAX_PER_GYRO, SelectedModel, SelectionStep};

/// Maximum number of effects.
const MAX_EFFECTS: usize = 6;

/// Searches of a selection.
pub struct Searches<'a> {
    /// The recording.
    pub case: &'a DiagnosisCase<'a>,
    /// The hypotheses.
    pub bank: &'a SignatureBank,
    /// Thresholds of their families.
    pub thresholds: &'a Thresholds,
    /// Searches with this bank that recur.
    pub known: Recent<Vec<Candidate>>,
    /// Maximum number of times that two hypotheses are added at once.
    pub pair_rounds: usize,
}

impl<'a> Searches<'a> {
    /// With this bank.
    pub fn new(case: &'a DiagnosisCase, bank: &'a SignatureBank, thresholds: &'a Thresholds) -> Searches<'a> {
        Searches { case, bank, thresholds, known: Recent::default(), pair_rounds: 0 }
    }

    /// Candidates beside a state, best first.
    fn candidates(&self, state: &ModelState, normal: &NormalEquations) -> Vec<Candidate> {
        let mut hasher = DefaultHasher::new();
        [state.key(), normal.squares().to_bits(), normal.chi2().to_bits()].hash(&mut hasher);
        let key = hasher.finish();
        self.known.find(key).unwrap_or_else(|| {
            let bank = self.bank.late(state.shifts.temperature_s);
            let mut found = search(&bank, normal, state, Some(self.thresholds));
            self.drop_errors_of_motion(&mut found, state, normal);
            found.retain(|own| !self.case.measured.contradicts(&own.hypothesis));
            self.known.keep(key, &found);
            found
        })
    }

    /// Removes what may be an error of an effect that withholds motions, such as a dead zone, since the motion between the rows of the
    /// reference is not known: a negligible reduction of χ² on its gyro, and lost counts that are not more than it withholds in a sample.
    fn drop_errors_of_motion(&self, found: &mut Vec<Candidate>, state: &ModelState, normal: &NormalEquations) {
        let mut others = state.clone();
        others.held.retain(|held| !held.hypothesis.amplitude.filters_motion());
        if others.held.len() == state.held.len() {
            return;
        }
        let [with, without] = [state, &others].map(|state| self.case.run(state));
        let withheld_counts: [f64; TIMING] = std::array::from_fn(|gyro| {
            let withheld: Vec<f64> =
                with[gyro].iter().zip(without[gyro].iter()).map(|(with, without)| with - without).collect();
            withheld.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
        });
        let negligible = negligible(self.case, state, normal);
        found.retain(|Candidate { hypothesis, gain, .. }| {
            let counts = if hypothesis.amplitude.is_count() { hypothesis.value.abs() } else { f64::INFINITY };
            let is_error = |gyro: usize| {
                let withheld = withheld_counts[gyro];
                hypothesis.gyros[gyro] && withheld > 0.0 && (gain.chi2 < negligible || counts < withheld)
            };
            !(0..TIMING).any(is_error)
        });
    }
}

/// Selects the model that explains the recording best: effects of the bank, noise, or both; at most `per_gyro` + 1 effects on a gyro.
pub fn select_model(searches: &Searches, start: &ModelState, per_gyro: usize) -> SelectedModel {
    let Searches { case, thresholds, .. } = *searches;
    let finished = |mut selected: SelectedModel| {
        selected.free_noise(case, thresholds);
        if selected.prune(case, thresholds) {
            selected.free_noise(case, thresholds);
        }
        selected.settled(case, thresholds)
    };
    let grown = |selected: &SelectedModel, order| {
        let (mut selected, is_other) = grow(searches, selected.clone(), per_gyro, order);
        // A search that a limit ended is repeated without the limit, or explains nothing.
        if !selected.is_cut && exchange(searches, &mut selected) {
            selected = grow(searches, selected, per_gyro, order).0;
        }
        // Walks are fitted again beside the effects.
        selected.reset_noise(case, &case.measured.gyros());
        (finished(selected), is_other)
    };
    let from = |selected: &SelectedModel| {
        let (separate, is_other) = grown(selected, Order::SeparateFirst);
        match is_other.then(|| grown(selected, Order::BestFirst).0) {
            Some(joint) => likelier(separate, joint),
            None => separate,
        }
    };
    let effects_first = || from(&SelectedModel::start(case, start.clone()));
    let noise_first = || {
        let mut noise = SelectedModel::start(case, start.clone());
        noise.free_noise(case, thresholds);
        (!noise.noise.is_empty()).then(|| from(&noise))
    };
    let mut best = match rayon::join(effects_first, noise_first) {
        (effects, Some(noise)) => likelier(effects, noise),
        (effects, None) => effects,
    };
    // A pair in place of a walk has a penalty more, and may be a step to a better one.
    let mut last = best.clone();
    for _ in 0..searches.pair_rounds {
        if last.0.is_cut || last.1 > best.1 + thresholds.largest() {
            break;
        }
        let Some(pair) = likeliest_pair(searches, &last.0, per_gyro) else { break };
        last = grown(&pair, Order::BestFirst).0;
        if last.1 < best.1 - TWO_SIGMA_CHI2 {
            best = last.clone();
        }
    }
    best.0
}

/// The selection with the lower score. A limit that ended the search of the other one may have made it worse.
fn likelier(one: (SelectedModel, f64), other: (SelectedModel, f64)) -> (SelectedModel, f64) {
    let is_cut = one.0.is_cut || other.0.is_cut;
    let (mut selected, score) = if other.1 < one.1 { other } else { one };
    selected.is_cut = is_cut;
    (selected, score)
}

/// Order in which hypotheses are added.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    /// The best one.
    BestFirst,
    /// The best one on the sets of gyros that have separate hypotheses: on several gyros with different effects, one hypothesis explains a
    /// part of each.
    SeparateFirst,
}

impl Order {
    /// Candidates in this order, and whether the first is another one than in the order of their scores.
    fn sorted(self, mut candidates: Vec<Candidate>, thresholds: &Thresholds) -> (Vec<Candidate>, bool) {
        let score = |own: &Candidate| own.gain.chi2 - thresholds.penalty(own.family, &own.hypothesis);
        let sets = separate_sets(candidates.iter().map(|own| (own.hypothesis.gyros, score(own))));
        let is_separate = |own: &Candidate| sets.contains(&own.hypothesis.gyros);
        let is_other = candidates.first().is_some_and(|first| !sets.is_empty() && !is_separate(first));
        if self == Order::SeparateFirst && is_other {
            candidates.retain(is_separate);
        }
        (candidates, is_other)
    }
}

/// Adds the best effect as long as one is acceptable and no gyro has more than `per_gyro`; also returns whether another order differs.
fn grow(searches: &Searches, mut now: SelectedModel, per_gyro: usize, order: Order) -> (SelectedModel, bool) {
    let Searches { case, bank, thresholds, .. } = *searches;
    let mut is_other = false;
    // The selection before a hypothesis that the thirds do not predict, and that hypothesis.
    let mut doubtful: Option<(SelectedModel, Candidate)> = None;
    // Hypotheses that are not acceptable beside the state; the search continues on the other gyros.
    let mut rejected: Vec<Candidate> = Vec::new();
    now.rejected = None;
    loop {
        let mut candidates = searches.candidates(&now.state, &now.normal);
        candidates.retain(|own| !rejected.iter().any(|other| own.hypothesis.gyros.overlaps(&other.hypothesis.gyros)));
        let (candidates, differs) = order.sorted(candidates, thresholds);
        is_other |= differs;
        let Some(first) = candidates.first() else { break };
        let best = first.gain.chi2 - thresholds.penalty(first.family, &first.hypothesis);
        if now.state.held.len() >= MAX_EFFECTS || (0..TIMING).any(|gyro| now.on(gyro).count() > per_gyro) {
            now.is_cut = best > 0.0;
            break;
        }
        let fit = |is_predicted: fn(&HeldOut) -> bool| {
            best_fit(case, thresholds, &now.state, &now.normal, &candidates, is_predicted)
        };
        let mut chosen = fit(passes_cross_validation);
        let is_real = best > THREE_SIGMA_CHI2 && best > now.negligible(case);
        if chosen.is_none() && is_real && doubtful.is_none() {
            // Of two effects on a gyro neither may be predicted without the other.
            chosen = fit(|_| true);
            doubtful = chosen.is_some().then(|| (now.clone(), first.clone()));
        }
        let mut step = SelectionStep { candidates: candidates.clone(), kept: None, added: None };
        let Some((_, place, state, normal)) = chosen else {
            now.steps.push(step);
            if is_real {
                rejected.push(first.clone());
                continue;
            }
            break;
        };
        rejected.clear();
        (step.kept, step.added) = (Some(state.held.len() - 1), Some(place));
        now.steps.push(step);
        (now.state, now.normal) = (state, normal);
        now.shift_temperature(case, bank, thresholds);
        now.free_shapes(case);
        now.round_count(case);
        now.join_lagged(case, bank, thresholds);
    }
    if let Some((before, first)) = doubtful
        && !now.is_cut
        && !now.is_predicted(case)
    {
        (now, rejected) = (before, vec![first]);
    }
    rejected.iter().for_each(|own| now.reject(case, &bank.late(now.state.shifts.temperature_s), thresholds, own));
    (now, is_other)
}

/// Replaces each of several hypotheses, and each two that overlap, by a likelier one beside the others: an earlier one may have explained
/// a part of a later one, and two may be one. Returns true if one was replaced.
fn exchange(searches: &Searches, now: &mut SelectedModel) -> bool {
    let mut is_other = false;
    // Each exchange lowers the score, so that none is repeated.
    loop {
        let single = (0..now.state.held.len()).filter(|_| now.state.held.len() > 1).map(|index| vec![index]);
        let sets: Vec<Vec<usize>> = single.chain(now.overlapping_pairs().map(Vec::from)).collect();
        let likelier = sets.iter().find_map(|replaced| exchanged(searches, now, replaced));
        let pulse = || now.overlapping_pairs().find_map(|two| pulse::joined(searches, now, two));
        let Some(likelier) = likelier.or_else(pulse) else { return is_other };
        (*now, is_other) = (likelier, true);
    }
}

/// Replaces the hypotheses with these indices by one, if that lowers the score by [`TWO_SIGMA_CHI2`].
fn exchanged(searches: &Searches, now: &SelectedModel, replaced: &[usize]) -> Option<SelectedModel> {
    let Searches { case, thresholds, .. } = *searches;
    let mut other = SelectedModel { rejected: None, ..now.without_all(case, replaced) };
    let candidates = searches.candidates(&other.state, &other.normal);
    let (_, place, state, normal) =
        best_fit(case, thresholds, &other.state, &other.normal, &candidates, passes_cross_validation)?;
    other.steps.push(SelectionStep { candidates, kept: Some(state.held.len() - 1), added: Some(place) });
    (other.state, other.normal) = (state, normal);
    let is_likelier = |other: &SelectedModel| other.penalised_chi2() < now.penalised_chi2() - TWO_SIGMA_CHI2;
    if !is_likelier(&other) {
        return None;
    }
    other.free_shapes(case);
    other.round_count(case);
    is_likelier(&other).then_some(other)
}
