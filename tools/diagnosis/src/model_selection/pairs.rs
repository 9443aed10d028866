//! Two hypotheses at once, in place of one or two or beside all: beside a wrong hypothesis the next one is wrong too, so that two effects on
//! a gyro may not be found one by one.

use crate::fitted_hypothesis::FittedHypothesis;
use crate::measured::TIMING;
use crate::normal_equations::NormalEquations;
use crate::search::{Candidate, best_spots, optimised, score, shape_penalty};
use crate::signature_bank::Variation;
use crate::significance::TWO_SIGMA_CHI2;
use crate::spots::Spot;
use crate::whiteness::whiteness_statistic;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_protocol::Gyros;

use super::candidate_fit::{FITTED, NEAR_CHI2, best_fit, fitted};
use super::selected::{SelectedModel, SelectionStep};
use super::{MAX_EFFECTS, Searches};

/// First hypotheses beside which the best second one is searched, and as many without shapes of a time course: a shape that is the best one
/// alone is mostly another one than beside the right second hypothesis. A replaced hypothesis of some gyros is also tried on all.
const FIRST: usize = 12;
/// Whiteness statistic from which a single hypothesis is tried against pairs. It only saves time: noise exceeds one sigma in every third
/// recording or so, and two effects that one describes leave more in most.
const SUSPECT: f64 = 1.0;

/// The likeliest pair, if the score with it is lower by [`TWO_SIGMA_CHI2`]; beside all other hypotheses only on gyros with larger walks or
/// with a residual that is no noise.
pub(super) fn likeliest_pair(searches: &Searches, selected: &SelectedModel, per_gyro: usize) -> Option<SelectedModel> {
    let mut now = selected.clone();
    now.reset_noise(searches.case, &searches.bank.gyros());
    let held = &now.state.held;
    let (_, channels) = whiteness_statistic(&now.normal.projected_residual());
    let is_noisy = |gyro: usize| {
        let limit = searches.thresholds.whiteness_statistic;
        channels[gyro] > limit || selected.noise.iter().any(|found| found.channel == gyro)
    };
    let noisy: Gyros = searches.bank.gyros().filter(is_noisy);
    let gyros = |index: usize| held[index].hypothesis.gyros;
    let beside_all = (!noisy.is_empty()).then_some((Vec::new(), noisy));
    let is_suspect = |index: &usize| {
        let departs = (0..TIMING).any(|gyro| gyros(*index)[gyro] && channels[gyro] > SUSPECT);
        held.len() > 1 || !noisy.is_empty() || departs
    };
    let in_place_of_one = (0..held.len()).filter(is_suspect).map(|index| (vec![index], gyros(index)));
    let both = |[one, other]: [usize; 2]| gyros(one).and(gyros(other));
    let in_place_of_two = now.overlapping_pairs().map(|two| (Vec::from(two), both(two)));
    let places = beside_all.into_iter().chain(in_place_of_one).chain(in_place_of_two);
    let places = places.filter(|(replaced, _)| held.len() + 2 - replaced.len() <= MAX_EFFECTS);
    let pairs = places.filter_map(|(replaced, gyros)| pair_in_place_of(searches, &now, &replaced, &gyros, per_gyro));
    pairs
        .min_by(|one, other| one.penalised_chi2().total_cmp(&other.penalised_chi2()))
        .filter(|pair| pair.penalised_chi2() < now.penalised_chi2() - TWO_SIGMA_CHI2)
}

/// The likeliest pair in place of the hypotheses with these indices, the first on any of these gyros; the second on those of the first, or
/// of two that are replaced.
fn pair_in_place_of(
    searches: &Searches,
    now: &SelectedModel,
    replaced: &[usize],
    gyros: &Gyros,
    per_gyro: usize,
) -> Option<SelectedModel> {
    let Searches { case, bank, thresholds, .. } = *searches;
    let mut base = now.without_all(case, replaced);
    let bank = bank.late(base.state.shifts.temperature_s);
    let (residual, columns) = case.linearised(&mut base.state);
    let score = |spot: &Spot| score(&bank, Some(thresholds), spot) - shape_penalty(&spot.hypothesis(&bank));
    let score_of_pair = |first: &Spot| {
        let mut columns = columns.clone();
        columns.push(first.nuisance(&bank));
        let noise = case.whitenings(&base.state.noise);
        let normal = NormalEquations::new(noise, &residual, &columns, &searches.case.a_priori(&base.state.calibration));
        let mut beside = base.state.clone();
        beside.held.push(FittedHypothesis::fixed(first.hypothesis(&bank)));
        let gyros = if replaced.len() > 1 && !gyros.is_all() { gyros } else { &first.gyros };
        let second = best_spots(&bank, &normal, &beside, Some(thresholds), gyros).into_iter().next()?;
        Some(score(first) + score(&second))
    };
    let amplitudes: Vec<AmplitudeRef> =
        replaced.iter().map(|&index| now.state.held[index].hypothesis.amplitude).collect();
    let mut firsts = best_spots(&bank, &base.normal, &base.state, Some(thresholds), &bank.gyros());
    let [mut kept, mut shapeless] = [0; 2];
    firsts.retain(|spot| {
        if !spot.gyros.overlaps(gyros) || matches!(spot.variation, Variation::Onset { .. }) {
            return false;
        }
        let is_shapeless = spot.hypothesis(&bank).course_shapes.is_empty();
        kept += 1;
        shapeless += usize::from(is_shapeless);
        let is_of_all = spot.gyros.is_all() && amplitudes.contains(&spot.amplitude(&bank));
        kept <= FIRST || is_shapeless && shapeless <= FIRST || is_of_all
    });
    let required = base.penalised_chi2() - now.penalised_chi2() - NEAR_CHI2;
    let mut ranked: Vec<(f64, Spot)> =
        firsts.into_iter().filter_map(|first| Some((score_of_pair(&first)?, first))).collect();
    ranked.retain(|(score, _)| *score > required);
    ranked.sort_by(|one, other| other.0.total_cmp(&one.0));
    ranked.truncate(FITTED);
    let add = |pair: &mut SelectedModel, candidates: Vec<Candidate>, place, fitted| {
        (pair.state, pair.normal) = fitted;
        pair.steps.push(SelectionStep { candidates, kept: Some(pair.state.held.len() - 1), added: Some(place) });
        pair.free_shapes(case);
        pair.round_count(case);
    };
    let fit = |(_, first): (f64, Spot)| {
        let mut pair = SelectedModel { rejected: None, is_cut: false, ..base.clone() };
        let first = Candidate::new(&bank, &base.normal, optimised(&bank, &base.normal, &base.state, &[], first));
        let (_, state, normal) = fitted(case, thresholds, &base.state, &base.normal, &first, |_| true)?;
        add(&mut pair, vec![first], 0, (state, normal));
        let seconds = searches.candidates(&pair.state, &pair.normal);
        let (_, place, state, normal) = best_fit(case, thresholds, &pair.state, &pair.normal, &seconds, |_| true)?;
        add(&mut pair, seconds, place, (state, normal));
        let is_within = (0..TIMING).all(|gyro| pair.on(gyro).count() <= per_gyro + 1);
        (is_within && pair.is_predicted(case)).then_some(pair)
    };
    ranked.into_iter().filter_map(fit).min_by(|one, other| one.penalised_chi2().total_cmp(&other.penalised_chi2()))
}
