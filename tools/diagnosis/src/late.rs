//! A temperature that is told late: what follows it in the place of another course, with the lag that suits best.

use geu_model::course::{KINDS, Law};
use rayon::prelude::*;

use crate::bank::Family;
use crate::change::{Amplitude, Change};
use crate::normal::Normal;
use crate::state::{Case, Held, State};

/// How late a temperature may be told, s.
const LATE_S: [f64; 9] = [-300.0, 0.0, 150.0, 300.0, 450.0, 600.0, 900.0, 1200.0, 1800.0];
/// Steps in which the best of them is bettered, s: from half of the widest gap on.
const NEARER_S: [f64; 4] = [150.0, 75.0, 40.0, 20.0];
/// What a lag must lower χ² by, three sigma.
const LAG_CHI2: f64 = 9.0;
/// Share of the greatest size with which a fit begins.
const SMALL: f64 = 1e-4;

/// What follows the temperature, fitted in the place of a change.
pub struct Late {
    /// Everything held, with it.
    pub state: State,
    /// The equations of that.
    pub normal: Normal,
    /// What is paid for it: the family, the gyros, the lag.
    pub cost_chi2: f64,
}

impl Late {
    fn score(&self) -> f64 {
        self.normal.squares() + self.cost_chi2
    }
}

/// The family of what follows the temperature, and the amplitude with that course.
pub fn following_temperature(amplitude: Amplitude) -> Option<(Family, Amplitude)> {
    let kind = KINDS.iter().position(|kind| kind.shapes.is_empty() && kind.law(&[]) == Law::Temperature)?;
    Some((Family::of_kind(kind), amplitude.with(kind)?))
}

/// What is paid for a lag where another one was told before.
pub fn lag_chi2(late_s: f64, before_s: f64) -> f64 {
    if late_s == before_s { 0.0 } else { LAG_CHI2 }
}

/// Puts what follows the temperature in the place of the change at `index`, with the lag that suits best; `price` is what a change of a
/// family costs. Nothing where the amplitude has no such course.
pub fn likeliest(
    case: &Case,
    state: &State,
    index: usize,
    price: &(dyn Fn(Family, &Change) -> f64 + Sync),
) -> Option<Late> {
    let found = &state.held[index].change;
    let (family, amplitude) = following_temperature(found.amplitude)?;
    let size = if found.amplitude == amplitude { found.size } else { amplitude.size().greatest * SMALL };
    let change = Change { amplitude, size, course_shapes: Vec::new(), ..found.clone() };
    let before_s = state.shifts.temperature_s;
    let tried = |late_s: f64| {
        let mut state = state.clone();
        state.shifts.temperature_s = late_s;
        state.held[index] = Held::new(change.clone());
        state.held.iter_mut().for_each(Held::run_anew);
        let normal = case.fit(&mut state);
        Late { cost_chi2: price(family, &change) + lag_chi2(late_s, before_s), state, normal }
    };
    let best_of = |all: &[f64]| {
        all.par_iter().map(|late_s| tried(*late_s)).min_by(|one, other| one.score().total_cmp(&other.score()))
    };
    let mut best = best_of(&[&LATE_S[..], &[before_s]].concat())?;
    for step_s in NEARER_S {
        let late_s = best.state.shifts.temperature_s;
        let near = [late_s - step_s, late_s + step_s].map(|late_s| late_s.clamp(LATE_S[0], LATE_S[LATE_S.len() - 1]));
        if let Some(nearer) = best_of(&near).filter(|nearer| nearer.score() < best.score()) {
            best = nearer;
        }
    }
    Some(best)
}
