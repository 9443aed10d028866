//! The separation of two hypotheses by a motion, with all parameters of the false hypothesis free: from signatures, and from a fit of
//! the model.

use std::f64::consts::PI;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use geu_model::parameter_spec::Role;

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_algebra::factored;
use crate::measured::{Block, CHANNELS, Series};
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, Nuisance, RIDGE};
use crate::rounding::Rounding;
use crate::signature::Signature;
use crate::whitening::{NoiseModel, Whitening};
use geu_hypothesis::Hypothesis;

/// Factors of a period or time constant from which a fit starts, so that it need not end at the nearest solution.
const FACTORS: [f64; 3] = [1.0, 0.5, 2.0];
/// Phases of half a wave at which a motion may begin.
const PHASES: u32 = 4;

/// Separation of two hypotheses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Separation {
    /// Share of the signature that the other one has too, as a cosine, with the nuisance parameters projected out.
    pub cosine: f64,
    /// Part of the chi2 reduction that the other one does not explain.
    pub chi2: f64,
}

/// The signatures in one recording or motion, not whitened.
#[derive(Clone)]
pub struct Signatures {
    block_s: f64,
    /// Calibration parameters, each with its a priori sigma.
    a_priori: Vec<(f64, f64)>,
    blocks: [Vec<Block>; CHANNELS],
    rounding: Rounding,
    nuisances: Vec<Nuisance>,
    /// Signatures of each hypothesis: of its amplitude and its shape parameters.
    parameters: Vec<Vec<Nuisance>>,
    /// Signature of each hypothesis' amplitude, at all phases of a wave.
    truths: Vec<Vec<Nuisance>>,
}

/// The hypothesis at `index` of a state and its alternatives, all parameters free but an onset at the start.
pub fn in_place(state: &ModelState, index: usize, alternatives: &[&Hypothesis]) -> Vec<FittedHypothesis> {
    let free = |hypothesis: &Hypothesis| {
        let mut fitted = FittedHypothesis::new(hypothesis.clone());
        let shapes = hypothesis.own_shapes.len();
        (1..=shapes).for_each(|shape| fitted.free(shape));
        fitted
    };
    std::iter::once(&state.held[index].hypothesis).chain(alternatives.iter().copied()).map(free).collect()
}

impl Signatures {
    /// The signatures of hypotheses in the place of the one at `index`.
    pub fn new(case: &DiagnosisCase, state: &ModelState, index: usize, hypotheses: &[FittedHypothesis]) -> Signatures {
        let mut others = state.clone();
        others.held.remove(index);
        // The state holds signatures of its recording.
        others.held.iter_mut().for_each(FittedHypothesis::invalidate);
        let (_, nuisances) = case.linearised(&mut others);
        let columns = |hypothesis: &FittedHypothesis| -> Vec<Nuisance> {
            let mut with = others.clone();
            with.held.push(hypothesis.clone());
            let (_, mut columns) = case.linearised(&mut with);
            columns.split_off(nuisances.len())
        };
        let parameters: Vec<Vec<Nuisance>> = hypotheses.par_iter().map(columns).collect();
        let truths = hypotheses.iter().zip(&parameters).map(|(own, columns)| at_phases(own, columns)).collect();
        let (blocks, rounding) = (case.measured.blocks.clone(), Rounding::clone(&case.rounding));
        let (block_s, a_priori) = (case.measured.block_s(), case.a_priori(&[]));
        Signatures { block_s, a_priori, blocks, rounding, nuisances, parameters, truths }
    }

    /// The signatures in this motion and the next one.
    #[must_use]
    pub fn followed_by(&self, next: &Signatures) -> Signatures {
        let join = |(one, other): (&Nuisance, &Nuisance)| -> Nuisance {
            std::array::from_fn(|channel| {
                let padded = |values: &Option<Vec<f64>>, signatures: &Signatures| {
                    values.clone().unwrap_or_else(|| vec![0.0; signatures.blocks[channel].len()])
                };
                let is_reached = one[channel].is_some() || other[channel].is_some();
                is_reached.then(|| [padded(&one[channel], self), padded(&other[channel], next)].concat())
            })
        };
        let join_all = |(one, other): (&Vec<Nuisance>, &Vec<Nuisance>)| one.iter().zip(other).map(join).collect();
        Signatures {
            block_s: self.block_s,
            a_priori: self.a_priori.clone(),
            blocks: std::array::from_fn(|channel| [&self.blocks[channel][..], &next.blocks[channel]].concat()),
            rounding: std::array::from_fn(|channel| [&self.rounding[channel][..], &next.rounding[channel]].concat()),
            nuisances: join_all((&self.nuisances, &next.nuisances)),
            parameters: self.parameters.iter().zip(&next.parameters).map(join_all).collect(),
            truths: self.truths.iter().zip(&next.truths).map(join_all).collect(),
        }
    }

    /// Separation of the first hypothesis from each of the others, whichever of the two is true, if their amplitudes are `sizes`.
    pub fn separations(&self, noise: &[NoiseModel; CHANNELS], sizes: &[f64]) -> Vec<Separation> {
        let whitenings = std::array::from_fn(|channel| {
            let (blocks, rounding) = (&self.blocks[channel], &self.rounding[channel]);
            Arc::new(Whitening::new(&noise[channel], blocks, rounding, self.block_s))
        });
        let zero: Series = self.blocks.each_ref().map(|blocks| vec![0.0; blocks.len()]);
        let normal = NormalEquations::new(whitenings, &zero, &self.nuisances, &self.a_priori);
        let white = |columns: &Vec<Nuisance>| columns.iter().map(|own| Signature::new(&normal, own)).collect();
        let white = |all: &[Vec<Nuisance>]| -> Vec<Vec<Signature>> { all.iter().map(white).collect() };
        let (parameters, truths) = (white(&self.parameters), white(&self.truths));
        let separation = |other: usize| {
            let of = |truth: usize, model: usize| {
                let phases = truths[truth].iter();
                phases.map(move |own| (own, sizes[truth], model))
            };
            let all = of(0, other).chain(of(other, 0));
            let all = all.map(|(truth, size, model)| Separation::new(&normal, truth, size, &parameters[model]));
            all.min_by(|one, two| one.chi2.total_cmp(&two.chi2)).expect("a phase")
        };
        (1..truths.len()).map(separation).collect()
    }
}

/// The signatures of a hypothesis' amplitude, at all phases if it is a wave; `columns`: signatures of its free parameters.
fn at_phases(own: &FittedHypothesis, columns: &[Nuisance]) -> Vec<Nuisance> {
    let parameters = own.hypothesis.parameters();
    let free = (0..parameters.len()).filter(|&index| own.is_free[index]);
    let phase = free.zip(columns).find(|(index, _)| parameters[*index].role == Role::Phase);
    let Some((_, quadrature)) = phase else { return columns[..1].to_vec() };
    // A change of the phase by a quarter: the derivative per unit of amplitude.
    let at = |phase: u32| -> Nuisance {
        let (sin, cos) = (PI * f64::from(phase) / f64::from(PHASES)).sin_cos();
        std::array::from_fn(|channel| {
            let (one, other) = (columns[0][channel].as_ref(), quadrature[channel].as_ref());
            let count = one.or(other)?.len();
            let value = |column: Option<&Vec<f64>>, block: usize| column.map_or(0.0, |values| values[block]);
            Some(
                (0..count)
                    .map(|block| cos * value(one, block) + sin * value(other, block) / own.hypothesis.value)
                    .collect(),
            )
        })
    };
    (0..PHASES).map(at).collect()
}

impl Separation {
    /// Separation of the signature `truth` of amplitude `size` from a model with these signatures of its parameters.
    fn new(normal: &NormalEquations, truth: &Signature, size: f64, model: &[Signature]) -> Separation {
        let whole = normal.gain(&truth.products).map_or(0.0, |gain| (size / gain.sigma).powi(2));
        let count = model.len();
        let among = DMatrix::from_fn(count, count, |one, other| match one == other {
            true => 1.0,
            false => model[one].signed_cosine(normal, &model[other]),
        });
        let with = DVector::from_fn(count, |index, _| truth.signed_cosine(normal, &model[index]));
        let solved = factored(&among, &DVector::repeat(count, 1.0), RIDGE).solve(&with);
        let explained = with.dot(&solved).clamp(0.0, 1.0);
        Separation { cosine: explained.sqrt(), chi2: whole * (1.0 - explained) }
    }
}

/// χ² that remains without noise, if one hypothesis is true and the other one, in the place at `index` of the state, is fitted instead;
/// the minimum over either being true, at any phase of a wave: when the motion begins is not known.
pub fn fitted_chi2(case: &DiagnosisCase, state: &ModelState, index: usize, pair: [&FittedHypothesis; 2]) -> f64 {
    let mut others = case.start(state.noise);
    others.set_temperature_lag(state.shifts.temperature_s);
    others.held = state.held.clone();
    others.held.iter_mut().for_each(FittedHypothesis::invalidate);
    let with = |own: FittedHypothesis| {
        let mut with = others.clone();
        with.held[index] = own;
        with
    };
    let remaining = |truth: &FittedHypothesis, model: &FittedHypothesis| {
        let truth = with(FittedHypothesis::fixed(truth.hypothesis.clone()));
        let measured = case.measured.with_counts(case.run(&truth));
        let case = DiagnosisCase { linear: case.linear.clone(), ..case.on(&measured) };
        let fits = starts(model).into_iter().map(|start| case.fit(&mut with(start)).squares());
        fits.filter(|chi2| chi2.is_finite()).fold(f64::INFINITY, f64::min)
    };
    let [one, other] = pair;
    let truths =
        phases(one).into_iter().map(|truth| (truth, other)).chain(phases(other).into_iter().map(|truth| (truth, one)));
    let truths: Vec<_> = truths.collect();
    truths.par_iter().map(|(truth, model)| remaining(truth, model)).reduce(|| f64::INFINITY, f64::min)
}

/// A hypothesis at other phases of its wave; the opposite ones are the same with another sign.
fn phases(truth: &FittedHypothesis) -> Vec<FittedHypothesis> {
    let by = |role: Role, value: f64| match role {
        Role::Phase => (0..PHASES).map(|phase| value + PI * f64::from(phase) / f64::from(PHASES)).collect(),
        _ => vec![value],
    };
    varied(truth, by)
}

/// A hypothesis with the shape parameters from which its fit starts.
fn starts(model: &FittedHypothesis) -> Vec<FittedHypothesis> {
    let by = |role: Role, value: f64| match role {
        Role::Period | Role::TimeConstant => FACTORS.iter().map(|factor| factor * value).collect(),
        _ => vec![value],
    };
    varied(model, by)
}

/// A hypothesis with all combinations of its parameters' values by role.
fn varied(own: &FittedHypothesis, values: impl Fn(Role, f64) -> Vec<f64>) -> Vec<FittedHypothesis> {
    let parameters = own.hypothesis.parameters();
    parameters.iter().enumerate().fold(vec![own.clone()], |all, (index, parameter)| {
        let values = values(parameter.role, parameter.value);
        let with = |own: FittedHypothesis| {
            values.iter().map(move |value| {
                let mut own = own.clone();
                own.hypothesis.set(index, value.clamp(parameter.min, parameter.max));
                own
            })
        };
        all.into_iter().flat_map(with).collect()
    })
}
