//! One pulse in place of two hypotheses, which are its beginning and its end: where a computed signature of the pulse is not exact, the
//! search does not find it.

use geu_model::parameter_spec::Role;
use geu_model::time_profile::COURSES;

use crate::fitted_hypothesis::FittedHypothesis;
use crate::search::passes_cross_validation;
use crate::signature_bank::Variation;
use crate::significance::TWO_SIGMA_CHI2;
use geu_hypothesis::Hypothesis;

use super::Searches;
use super::refine::{fit_last, is_possible};
use super::selected::SelectedModel;

/// The likelier of the pulses from the earlier onset of two hypotheses to the later one, with the amplitude of either, if that lowers the
/// score by [`TWO_SIGMA_CHI2`].
pub(super) fn joined(searches: &Searches, now: &SelectedModel, two: [usize; 2]) -> Option<SelectedModel> {
    let Searches { case, bank, thresholds, .. } = *searches;
    let onset_s = |index: usize| {
        let parameters = now.state.held[index].hypothesis.parameters();
        parameters.iter().find(|parameter| parameter.role == Role::Onset).map(|parameter| parameter.value)
    };
    let (one_s, other_s) = (onset_s(two[0])?, onset_s(two[1])?);
    let shapes = vec![one_s.min(other_s), (one_s - other_s).abs()];
    let kind = COURSES.iter().position(|kind| kind.shapes.iter().any(|shape| shape.role == Role::Duration))?;
    let without = now.without_all(case, &two);
    let pulse = |index: usize| {
        let own = &now.state.held[index].hypothesis;
        let base = bank.bases.iter().find(|base| base.amplitude == own.amplitude.constant() && !base.is_exact)?;
        let hypothesis =
            Hypothesis { amplitude: base.amplitude.with(kind)?, course_shapes: shapes.clone(), ..own.clone() };
        let family = base.family(&Variation::Course { kind, shapes: shapes.clone() });
        let penalty = thresholds.penalty(family, &hypothesis);
        let mut joined = SelectedModel { rejected: None, ..without.clone() };
        joined.state.held.push(FittedHypothesis::new(hypothesis).with_penalty(penalty));
        joined.normal = fit_last(case, &mut joined.state);
        let last = joined.state.held.len() - 1;
        joined.state.held[last].held_out = case.cross_validate(&joined.state, last);
        let held = &joined.state.held[last];
        let is_likelier = joined.penalised_chi2() < now.penalised_chi2() - TWO_SIGMA_CHI2;
        (is_likelier && is_possible(held, case.measured.block_s()) && passes_cross_validation(&held.held_out))
            .then_some(joined)
    };
    let pulses = two.into_iter().filter_map(pulse);
    pulses.min_by(|one, other| one.penalised_chi2().total_cmp(&other.penalised_chi2()))
}
