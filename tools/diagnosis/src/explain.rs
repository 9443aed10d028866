//! The loop: search, fit the best by the model, keep it where it pays, search again; and what of all that may be believed.
//!
//! Everything is weighed alike: an entry costs what the search would find by chance in its family, and pays what χ² falls by. The
//! same data may speak of several effects or of noise that is larger than believed: both ways are gone, and the cheaper one holds.

use rayon::prelude::*;

use geu_model::Configuration;
use geu_model::course::Law;

use crate::bank::{Bank, Family};
use crate::change::{Amplitude, Change, Gyros, ONSET, Place};
use crate::late;
use crate::measured::{CHANNELS, TIMING};
use crate::noise::{self, Fitted, Walk};
use crate::normal::{Normal, THIRDS};
use crate::null::Thresholds;
use crate::search::{Candidate, products, search};
use crate::state::{Case, Held, State};
use crate::whitening::Noise;

/// Effects at most.
const MOST: usize = 6;
/// Effects of one gyro at most.
pub const MOST_OF_ONE: usize = 3;
/// Candidates fitted in each round.
const FITTED: usize = 4;
/// Candidates that explain less than this share of what the best one does are not fitted.
const NEAR: f64 = 0.93;
/// Nor those that explain less than this share of what they cost: their shapes are nearly the best ones already.
const HOPE: f64 = 0.8;
/// Nor those whose χ² falls by so much less, where that is more.
const NEAR_CHI2: f64 = 12.0;
/// A course that explains no more than this share more than a likelier one of the same amplitude is not fitted.
const NEEDLESS: f64 = 0.02;
/// A shape that has a default is told where χ² falls by this, two sigma, or where it is known to a fifth.
const SHAPE_CHI2: f64 = 4.0;
/// See [`SHAPE_CHI2`].
const SHAPE_KNOWN: f64 = 0.2;
/// Least distance from an onset that is tried, s.
const ONSET_S: f64 = 10.0;
/// Distance from an onset beyond which none is tried, s.
const MOST_ONSET_S: f64 = 2000.0;
/// What χ² may rise by where an onset is moved: rounding of counts alone makes 1 or 2.
const ONSET_CHI2: f64 = 4.0;
/// Half the width of that, in sigmas, from which on χ² is no parabola there, whose half width would be 2.
const FLAT_SIGMAS: f64 = 3.0;
/// What each further walk that is larger costs, where one is: one number more, which chance betters by less in nine of ten.
const TOGETHER_CHI2: f64 = 2.7;
/// What the search finds beyond chance by more than this, three sigma, is there, whether or not there is anything that explains it.
const REFUSED_CHI2: f64 = 9.0;
/// What explains less than this share of all that was found is no more than a fault of the rest: a signature that is like the true one
/// to a cosine of 0.995 leaves as much.
const NEGLIGIBLE: f64 = 0.01;
/// What all thirds together must gain, each foretold by the others, for an effect to stand beside another one of its gyro: three sigma.
const FORETOLD_CHI2: f64 = 9.0;
/// Name of a size that is a whole number.
const WHOLE: &str = "counts";
/// Sigmas from which on a size is one.
const KNOWN_SIGMAS: f64 = 1.0;
/// Sigmas within which a number of counts is a whole one.
const WHOLE_SIGMAS: f64 = 4.0;

/// One round of the loop: what was looked at, the best first.
#[derive(Debug, Clone)]
pub struct Round {
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// What was kept: index of the change in the state.
    pub kept: Option<usize>,
    /// Which of the candidates was added, even where it was dropped again later.
    pub added: Option<usize>,
}

/// A walk that is not as configured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseFound {
    /// The channel.
    pub channel: usize,
    /// Which walk.
    pub walk: Walk,
    /// As fitted.
    pub fitted: Fitted,
}

/// A walk is told from this many times the configured one on: rounding, while a gyro hardly turns, can look like half as much again.
const LEAST_WALK: f64 = 2.0;

impl NoiseFound {
    /// The walk as it was believed.
    pub fn configured(&self, believed: &Configuration) -> f64 {
        let effects = &believed.gyros[self.channel].effects.constant;
        match self.walk {
            Walk::Angle => effects.angle_random_walk.arcsec_per_sqrt_s,
            Walk::Rate => effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
        }
    }

    /// Whether it is so much larger than believed that it is no trick of rounding.
    pub fn is_told(&self, believed: &Configuration, state: &State) -> bool {
        self.channel != TIMING && state.noise[self.channel].walk(self.walk) >= LEAST_WALK * self.configured(believed)
    }
}

/// Where the loop ended.
#[derive(Debug)]
pub struct Explained {
    /// All that is held.
    pub state: State,
    /// Its equations.
    pub normal: Normal,
    /// The rounds.
    pub rounds: Vec<Round>,
    /// Walks that are not as configured.
    pub noise: Vec<NoiseFound>,
    /// By how much better each third is foretold by the other two with each change ([`Normal::held_out`]); in the order of the state.
    pub held_out: Vec<[Option<f64>; THIRDS]>,
    /// What was paid for each change.
    costs: Vec<f64>,
    /// Whether more was to be found on a gyro that has as many as it may.
    pub is_cut: bool,
    /// What is left to find in the end and is not explained.
    refused: Option<Refused>,
}

impl Explained {
    /// How unlikely all that is left is beside the sixteen and the lag, and all that was paid for names. A walk can look like
    /// anything, and is as dear as the dearest course.
    pub fn score(&self, case: &Case, thresholds: &Thresholds) -> f64 {
        self.score_with(case, thresholds, &self.state.noise)
    }

    fn score_with(&self, case: &Case, thresholds: &Thresholds, noise: &[Noise; CHANNELS]) -> f64 {
        let own = self.noise.len().min(1) as f64 * thresholds.largest()
            + TOGETHER_CHI2 * self.noise.len().saturating_sub(1) as f64;
        let residual = case.residual(&self.state);
        let normal = Normal::new(case.whitenings(noise), &residual, &case.nuisances);
        normal.deviance() + self.costs.iter().sum::<f64>() + own
    }
}

/// What explains the recording best: effects of the bank, noise, or both; up to one more effect than `most` on one gyro.
pub fn explain(case: &Case, bank: &Bank, thresholds: &Thresholds, start: &State, most: usize) -> Explained {
    let effects_first = || {
        let mut effects = grow(case, bank, thresholds, Explained::start(case, start.clone()), most);
        effects.free_noise(case, thresholds);
        effects.prune(case);
        effects.settled(case, thresholds)
    };
    let noise_first = || {
        let mut noise = Explained::start(case, start.clone());
        noise.free_noise(case, thresholds);
        if noise.noise.is_empty() {
            return None;
        }
        let mut noise = grow(case, bank, thresholds, noise, most);
        // What the walks took of the effects they give back.
        noise.quieten(case, &[true; TIMING]);
        noise.free_noise(case, thresholds);
        noise.prune(case);
        Some(noise.settled(case, thresholds))
    };
    let ((effects, effects_score), noise) = rayon::join(effects_first, noise_first);
    match noise {
        Some((noise, noise_score)) if noise_score < effects_score => noise,
        _ => effects,
    }
}

/// What a larger walk of the rate does in the place of a change, on its gyros.
fn walked(case: &Case, state: &mut State, change: &Change) -> f64 {
    if change.amplitude.place == Place::Unit {
        return 0.0;
    }
    let (residual, nuisances) = case.linearised(state);
    let of = |channel: usize| {
        noise::fit(case, channel, &state.noise[channel], Walk::Rate, &residual, &nuisances).fall.max(0.0)
    };
    (0..TIMING).filter(|&channel| change.gyros[channel]).map(of).sum()
}

/// Adds the best effect as long as one qualifies and no gyro has more than `most`.
fn grow(case: &Case, bank: &Bank, thresholds: &Thresholds, mut now: Explained, most: usize) -> Explained {
    let cost = |candidate: &Candidate| thresholds.price(candidate.family, &candidate.change);
    loop {
        let late_s = now.state.shifts.temperature_s;
        let late = (late_s != 0.0).then(|| bank.late(late_s));
        let bank = late.as_ref().unwrap_or(bank);
        let candidates = search(bank, &now.normal, &now.state, &|family| thresholds.of(family));
        let Some(first) = candidates.first() else { break };
        let spare = first.gain.chi2 - cost(first);
        if now.state.held.len() >= MOST || (0..TIMING).any(|gyro| now.on(gyro).count() > most) {
            now.is_cut = spare > 0.0;
            break;
        }
        let least = (NEAR * spare).min(spare - NEAR_CHI2);
        let fitted = |candidate: &Candidate| -> Option<(f64, Candidate, State, Normal)> {
            let mut state = now.state.clone();
            state.held.push(Held::new(candidate.change.clone()));
            let normal = case.fit(&mut state);
            let fall = now.normal.squares() - normal.squares() - cost(candidate);
            is_possible(state.held.last().expect("just put")).then(|| (fall, candidate.clone(), state, normal))
        };
        let worth: Vec<&Candidate> = candidates
            .iter()
            .take(FITTED)
            .filter(|candidate| candidate.gain.chi2 > HOPE * cost(candidate))
            .filter(|candidate| candidate.gain.chi2 - cost(candidate) >= least)
            .collect();
        let worth = without_needless_courses(worth);
        let tried: Vec<_> = worth.into_par_iter().filter_map(fitted).collect();
        let best = tried
            .into_iter()
            .filter(|(fall, candidate, ..)| *fall > 0.0 && candidate.pays_held_out())
            .max_by(|one, other| one.0.total_cmp(&other.0));
        let mut round = Round { candidates: candidates.clone(), kept: None, added: None };
        let Some((_, candidate, state, normal)) = best else {
            now.rounds.push(round);
            if spare > REFUSED_CHI2 && spare > now.negligible(case) {
                now.refused = Some(now.refusal(case, bank, thresholds, first));
            }
            break;
        };
        round.kept = Some(state.held.len() - 1);
        round.added = candidates.iter().position(|other| {
            (other.base, &other.variation, other.change.gyros)
                == (candidate.base, &candidate.variation, candidate.change.gyros)
        });
        now.rounds.push(round);
        now.costs.push(cost(&candidate));
        now.held_out.push(candidate.held_out);
        (now.state, now.normal) = (state, normal);
        now.shift_temperature(case, thresholds);
        now.free_shapes(case);
        now.take_whole(case);
    }
    now
}

/// Without courses of what explains nearly as much with another course, or none, that is likelier: the others have nothing to tell.
fn without_needless_courses(candidates: Vec<&Candidate>) -> Vec<&Candidate> {
    let key = |candidate: &Candidate| (Amplitude { kind: None, ..candidate.change.amplitude }, candidate.change.gyros);
    let is_needless = |place: usize| {
        let mut before = candidates[..place].iter();
        let has_course = candidates[place].change.amplitude.kind.is_some();
        has_course
            && before.any(|other| {
                key(other) == key(candidates[place]) && candidates[place].gain.chi2 < (1.0 + NEEDLESS) * other.gain.chi2
            })
    };
    (0..candidates.len()).filter(|&place| !is_needless(place)).map(|place| candidates[place]).collect()
}

/// Whether what was found is a thing that there can be: within its limits, and a whole number where it is one of counts.
fn is_possible(held: &Held) -> bool {
    let size = &held.change.parameters()[0];
    let is_whole = size.name != WHOLE || {
        let off = (size.value - size.value.round()).abs();
        size.value.round() != 0.0 && off <= WHOLE_SIGMAS * held.sigmas[0].max(0.01)
    };
    // Of what is smaller nobody can say that it is there: another number of the same change undoes it.
    let is_known = size.value.abs() > KNOWN_SIGMAS * held.sigmas[0];
    is_whole && is_known && held.change.is_within_limits() && held.sigmas[0].is_finite()
}

/// A hypothesis of the search that explains much, and is none that there can be, or that the model, run, bears out.
#[derive(Debug, Clone, Copy)]
struct Refused {
    gyros: Gyros,
    /// The score that it would have.
    score: f64,
}

impl Explained {
    /// Whether a formula might do better: as well in the place of one of the changes, or instead of a pile of them, or of noise.
    pub fn is_doubtful(&self, case: &Case, formulas: &Bank, thresholds: &Thresholds) -> bool {
        let is_pile = |gyro: usize| self.state.held.iter().filter(|held| held.change.gyros[gyro]).count() > 1;
        let is_noisy = self.noise.iter().any(|found| found.is_told(case.believed, &self.state));
        if is_noisy || (0..TIMING).any(is_pile) {
            return true;
        }
        let here = search(formulas, &self.normal, &self.state, &|family| thresholds.of(family));
        if here.first().is_some_and(|best| best.gain.chi2 > thresholds.of(best.family)) {
            return true;
        }
        (0..self.state.held.len()).any(|index| {
            let (state, normal) = self.without(case, index);
            let worth = normal.squares() - self.normal.squares() - self.costs[index];
            let candidates = search(formulas, &normal, &state, &|family| thresholds.of(family));
            let best = candidates.first().map(|best| best.gain.chi2 - thresholds.of(best.family));
            best.is_some_and(|best| best > worth)
        })
    }

    /// A fall of χ² that is next to nothing beside that of all that was found, the lag among it; calibration numbers move in any case.
    fn negligible(&self, case: &Case) -> f64 {
        let sixteen = &case.nuisances[..case.nuisances.len() - 1];
        let start = case.residual(&case.start(self.state.noise));
        NEGLIGIBLE * (Normal::new(case.whitenings(&self.state.noise), &start, sixteen).chi2() - self.normal.chi2())
    }

    /// Whether a formula is what explains, and no small mend of other things that do.
    pub fn stands_on_a_formula(&self, case: &Case) -> bool {
        let is_formula = |index: &usize| self.state.held[*index].change.amplitude.place == Place::Discovered;
        (0..self.state.held.len()).filter(is_formula).any(|index| self.worth(case, index).0 > self.negligible(case))
    }

    /// Gyros whose changes are a pile: noise as a last resort beside several of them, a formula beside anything, one that the
    /// others of the thirds do not foretell beside another, or more than anything should have, which explains everything, and so nothing; and those on which
    /// something is left that nothing explains.
    pub fn piled(&self, believed: &Configuration) -> [bool; 4] {
        std::array::from_fn(|gyro| {
            let own = || self.on(gyro).map(|(index, held)| (held, &self.held_out[index]));
            let has_formula = own().any(|(held, _)| held.change.amplitude.place == Place::Discovered);
            let is_noisy = self.noise.iter().any(|found| found.channel == gyro && found.is_told(believed, &self.state));
            if self.refused.is_some_and(|refused| refused.gyros[gyro]) {
                return true;
            }
            let is_told_once = own().any(|(_, held_out)| held_out.iter().flatten().sum::<f64>() < FORETOLD_CHI2);
            own().count() > if has_formula || is_noisy || is_told_once { 1 } else { MOST_OF_ONE }
        })
    }

    /// What a hypothesis would make of the score, with the white noise as it is without it.
    fn refusal(&mut self, case: &Case, bank: &Bank, thresholds: &Thresholds, candidate: &Candidate) -> Refused {
        let noise = self.fitted_white(case);
        let (residual, columns) = case.linearised(&mut self.state);
        let normal = Normal::new(case.whitenings(&noise), &residual, &columns);
        let gain = normal.gain(&products(bank, &normal, candidate)).map_or(0.0, |gain| gain.chi2);
        let worth = gain - thresholds.price(candidate.family, &candidate.change);
        Refused { gyros: candidate.change.gyros, score: self.score_with(case, thresholds, &noise) - worth }
    }

    /// The score, and what was refused only where that would have a better one: walks may explain what it does.
    fn settled(mut self, case: &Case, thresholds: &Thresholds) -> (Explained, f64) {
        let score = self.score(case, thresholds);
        self.refused = self.refused.filter(|refused| refused.score + REFUSED_CHI2 < score);
        let best = self.refused.map_or(score, |refused| refused.score);
        (self, best)
    }

    /// Takes back the walks of these gyros: they are as configured.
    pub fn quieten(&mut self, case: &Case, gyros: &[bool; 4]) {
        let (gone, kept): (Vec<NoiseFound>, _) =
            self.noise.iter().partition(|found| gyros.get(found.channel) == Some(&true));
        self.noise = kept;
        for found in &gone {
            let noise = &mut self.state.noise[found.channel];
            *noise = noise.with(found.walk, found.configured(case.believed));
        }
        if !gone.is_empty() {
            self.normal = case.fit(&mut self.state);
        }
    }

    /// The changes of a gyro, those of the whole unit left out.
    fn on(&self, gyro: usize) -> impl Iterator<Item = (usize, &Held)> {
        let is_own = move |change: &Change| change.amplitude.place != Place::Unit && change.gyros[gyro];
        self.state.held.iter().enumerate().filter(move |(_, held)| is_own(&held.change))
    }

    /// By how much χ² falls with a change, beside all the others, and what was paid for it.
    pub fn worth(&self, case: &Case, index: usize) -> (f64, f64) {
        (self.without(case, index).1.squares() - self.normal.squares(), self.costs[index])
    }

    /// Takes a change back, wherever it is told.
    fn forget(&mut self, index: usize) -> Held {
        self.costs.remove(index);
        self.held_out.remove(index);
        for round in &mut self.rounds {
            round.kept = match round.kept {
                Some(kept) if kept == index => None,
                Some(kept) if kept > index => Some(kept - 1),
                kept => kept,
            };
        }
        self.state.remove(index)
    }

    /// Everything but one change, fitted anew.
    fn without(&self, case: &Case, index: usize) -> (State, Normal) {
        let mut state = self.state.clone();
        state.remove(index);
        let normal = case.fit(&mut state);
        (state, normal)
    }

    /// Makes one change of two that differ in their gyros alone.
    pub fn join(&mut self, case: &Case, one: usize, other: usize) {
        let (cost, held_out) = (self.costs[other], self.held_out[other]);
        let second = self.forget(other);
        let first = &mut self.state.held[one];
        let mut change = first.change.clone();
        change.gyros.iter_mut().zip(second.change.gyros).for_each(|(own, other)| *own |= other);
        let is_free = first.is_free.clone();
        *first = Held::new(change);
        first.is_free = is_free;
        self.costs[one] = self.costs[one].max(cost);
        let sum = |own: Option<f64>, other: Option<f64>| match (own, other) {
            (Some(own), Some(other)) => Some(own + other),
            (own, other) => own.or(other),
        };
        self.held_out[one] = std::array::from_fn(|third| sum(self.held_out[one][third], held_out[third]));
        self.normal = case.fit(&mut self.state);
    }

    /// Drops what acts on no other gyros than these.
    pub fn drop_on(&mut self, case: &Case, gyros: &[bool; 4]) {
        let is_kept = |held: &Held| {
            held.change.amplitude.place == Place::Unit
                || held.change.gyros.iter().zip(gyros).any(|(own, other)| *own && !other)
        };
        for index in (0..self.state.held.len()).rev() {
            if !is_kept(&self.state.held[index]) {
                self.forget(index);
            }
        }
        self.normal = case.fit(&mut self.state);
    }

    fn start(case: &Case, mut state: State) -> Explained {
        let normal = case.fit(&mut state);
        Explained {
            state,
            normal,
            rounds: Vec::new(),
            noise: Vec::new(),
            held_out: Vec::new(),
            costs: Vec::new(),
            is_cut: false,
            refused: None,
        }
    }

    /// Where the last change follows the temperature, or swings as a temperature may, looks for how late the temperature is told.
    fn shift_temperature(&mut self, case: &Case, thresholds: &Thresholds) {
        let Some(last) = self.state.held.last() else { return };
        if !matches!(last.change.law(), Some(Law::Periodic { .. } | Law::Temperature)) {
            return;
        }
        let price = |family, change: &Change| thresholds.price(family, change);
        let Some(late) = late::likeliest(case, &self.state, self.state.held.len() - 1, &price) else { return };
        let paid = self.costs.last_mut().expect("one for each change");
        let is_better = late.normal.squares() + late.cost_chi2 < self.normal.squares() + *paid;
        if is_better && is_possible(late.state.held.last().expect("as many as before")) {
            *paid = late.cost_chi2;
            (self.state, self.normal) = (late.state, late.normal);
        }
    }

    /// Takes a number of counts as the whole one that it is.
    fn take_whole(&mut self, case: &Case) {
        let last = self.state.held.last_mut().expect("just put");
        if last.change.parameters()[0].name == WHOLE {
            let sigma = last.sigmas[0];
            last.change.size = last.change.size.round();
            last.is_free[0] = false;
            last.run_anew();
            self.normal = case.fit(&mut self.state);
            self.state.held.last_mut().expect("still there").sigmas[0] = sigma;
        }
    }

    /// Frees those shapes of the last change that the data tell.
    fn free_shapes(&mut self, case: &Case) {
        let last = self.state.held.len() - 1;
        for index in 0..self.state.held[last].is_free.len() {
            if self.state.held[last].is_free[index] {
                continue;
            }
            let mut tried = self.state.clone();
            tried.held[last].free(index);
            let normal = case.fit(&mut tried);
            let own = &tried.held[last];
            let is_known = own.sigmas[index] < SHAPE_KNOWN * own.change.parameters()[index].value.abs();
            let fall = self.normal.squares() - normal.squares();
            if is_possible(own) && (fall > SHAPE_CHI2 || fall >= 0.0 && is_known) {
                (self.state, self.normal) = (tried, normal);
            }
        }
    }

    /// Puts onsets in the middle of where χ² is nearly the least, with the sigma of what is as likely everywhere there: between two
    /// motions an onset may lie anywhere.
    pub fn widen_onsets(&mut self, case: &Case) {
        for index in 0..self.state.held.len() {
            let parameters = self.state.held[index].change.parameters();
            let Some(place) = parameters.iter().position(|parameter| parameter.name == ONSET) else { continue };
            if !self.state.held[index].is_free[place] {
                continue;
            }
            let least = self.normal.chi2();
            let parameter = &parameters[place];
            let moved = |by_s: f64| {
                let mut state = self.state.clone();
                let value = (parameter.value + by_s).clamp(parameter.least, parameter.greatest);
                state.held[index].change.set(place, value);
                state.held[index].is_free[place] = false;
                state.held[index].run_anew();
                let normal = case.normal(&mut state);
                (normal.chi2() - least, state)
            };
            let reach_s = |sign: f64| {
                let (mut near, mut far) = (0.0, ONSET_S);
                while moved(sign * far).0 <= ONSET_CHI2 && far < MOST_ONSET_S {
                    (near, far) = (far, 2.0 * far);
                }
                while far - near > 0.1 * far {
                    let middle = 0.5 * (near + far);
                    if moved(sign * middle).0 > ONSET_CHI2 { far = middle } else { near = middle }
                }
                near
            };
            let sides: Vec<f64> = [-1.0, 1.0].into_par_iter().map(reach_s).collect();
            let half_s = 0.5 * (sides[0] + sides[1]);
            if half_s <= FLAT_SIGMAS * self.state.held[index].sigmas[place] {
                continue;
            }
            let (rise, mut state) = moved(0.5 * (sides[1] - sides[0]));
            if rise > ONSET_CHI2 {
                self.state.held[index].sigmas[place] = sides[0].max(sides[1]);
                continue;
            }
            self.normal = case.fit(&mut state);
            state.held[index].sigmas[place] = half_s / 3.0_f64.sqrt();
            self.state = state;
        }
    }

    /// Lets walks be larger than configured where that pays, the one that pays most first.
    fn free_noise(&mut self, case: &Case, thresholds: &Thresholds) {
        let questions: Vec<(usize, Walk)> = (0..TIMING)
            .flat_map(|channel| [(channel, Walk::Angle), (channel, Walk::Rate)])
            .chain([(TIMING, Walk::Angle)])
            .collect();
        for _ in 0..questions.len() {
            let (residual, nuisances) = case.linearised(&mut self.state);
            let open = questions.par_iter().filter(|(channel, walk)| {
                let is_taken = |found: &NoiseFound| (found.channel, found.walk) == (*channel, *walk);
                !self.noise.iter().any(is_taken) && case.measured.blocks[*channel].iter().any(|block| block.is_good)
            });
            let fits = open.map(|&(channel, walk)| NoiseFound {
                channel,
                walk,
                fitted: noise::fit(case, channel, &self.state.noise[channel], walk, &residual, &nuisances),
            });
            // One that would rather be smaller says nothing of the others.
            let is_larger = |found: &NoiseFound| {
                found.fitted.noise.walk(found.walk) > self.state.noise[found.channel].walk(found.walk)
            };
            // Walks of one kind on several gyros have one cause: only the first is asked for everything.
            let spare = |found: &NoiseFound| {
                let is_further = self.noise.iter().any(|other| other.walk == found.walk && other.channel != TIMING);
                found.fitted.fall - if is_further { TOGETHER_CHI2 } else { thresholds.of(Family::NOISE) }
            };
            let larger: Vec<NoiseFound> = fits.filter(is_larger).collect();
            match larger.into_iter().max_by(|a, b| spare(a).total_cmp(&spare(b))) {
                Some(found) if spare(&found) > 0.0 => {
                    self.take_walk(found);
                }
                _ => break,
            }
        }
        self.free_together(case, thresholds);
        self.state.noise = self.fitted_white(case);
        self.normal = case.fit(&mut self.state);
    }

    fn take_walk(&mut self, found: NoiseFound) {
        self.state.noise[found.channel] = found.fitted.noise;
        self.noise.push(found);
    }

    /// Lets a walk be larger on all gyros that have it as configured, where it pays on none of them alone but on all together.
    fn free_together(&mut self, case: &Case, thresholds: &Thresholds) {
        for walk in [Walk::Rate, Walk::Angle] {
            let (residual, nuisances) = case.linearised(&mut self.state);
            let is_open = |channel: &usize| {
                !self.noise.iter().any(|found| (found.channel, found.walk) == (*channel, walk))
                    && case.measured.blocks[*channel].iter().any(|block| block.is_good)
            };
            let fits: Vec<NoiseFound> = (0..TIMING)
                .filter(is_open)
                .map(|channel| NoiseFound {
                    channel,
                    walk,
                    fitted: noise::fit(case, channel, &self.state.noise[channel], walk, &residual, &nuisances),
                })
                .filter(|found| found.fitted.noise.walk(walk) > self.state.noise[found.channel].walk(walk))
                .collect();
            let fall: f64 = fits.iter().map(|found| found.fitted.fall).sum();
            // A question more, and a number more for each further gyro.
            let more = TOGETHER_CHI2 * fits.len().saturating_sub(1) as f64;
            if fits.len() > 1 && fall > thresholds.of(Family::NOISE) + more {
                fits.into_iter().for_each(|found| self.take_walk(found));
            }
        }
    }

    /// The noise with its white part as what is left tells it.
    fn fitted_white(&mut self, case: &Case) -> [Noise; CHANNELS] {
        let (residual, nuisances) = case.linearised(&mut self.state);
        let white = |channel: usize| noise::fit_white(case, channel, &self.state.noise[channel], &residual, &nuisances);
        let all: Vec<_> = (0..CHANNELS).into_par_iter().map(white).collect();
        std::array::from_fn(|channel| all[channel])
    }

    /// Drops each change that, beside all the others, is not worth what was paid for it. Where walks are larger than believed, what was
    /// paid is too little: then a change must also better a walk in its place.
    fn prune(&mut self, case: &Case) {
        let is_noisy = self.noise.iter().any(|found| found.is_told(case.believed, &self.state));
        loop {
            let without = |index: usize| {
                let (mut state, normal) = self.without(case, index);
                let walked = if is_noisy { walked(case, &mut state, &self.state.held[index].change) } else { 0.0 };
                (normal.squares() - self.normal.squares() - self.costs[index] - walked, index, state, normal)
            };
            let all: Vec<_> = (0..self.state.held.len()).into_par_iter().map(without).collect();
            match all.into_iter().min_by(|one, other| one.0.total_cmp(&other.0)) {
                Some((worth, index, state, normal)) if worth <= 0.0 => {
                    self.forget(index);
                    (self.state, self.normal) = (state, normal);
                }
                _ => break,
            }
        }
    }
}
