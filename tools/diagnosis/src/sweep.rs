//! All time courses of one signature, projected on the nuisances.
//!
//! A wave of any phase is a sum of two waves with a quarter period between them, so that only these two are whitened; a pulse is the
//! difference of two steps.

use std::f64::consts::{FRAC_PI_2, PI};

use crate::amplitude::STEP;
use crate::courses::pulse_onsets_s;
use crate::linear_algebra::dot;
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, ProjectedSignature};
use crate::signature_bank::{Column, ConstantSignature, SignatureBank, Variation};

/// Searched phases of a wave, over half a period.
const PHASES: usize = 16;
/// Onsets of the grid differ by more.
const SAME_ONSET_S: f64 = 1e-3;

/// A linear function of a signature on one channel.
pub trait Linear: Sized {
    /// Value for the sum of two signatures, each times its factor.
    #[must_use]
    fn sum(one: (f64, &Self), other: (f64, &Self)) -> Self;
}

impl Linear for () {
    fn sum(_: (f64, &()), _: (f64, &())) {}
}

impl<const COUNT: usize> Linear for [f32; COUNT] {
    fn sum((one_factor, one): (f64, &Self), (other_factor, other): (f64, &Self)) -> Self {
        std::array::from_fn(|index| one_factor as f32 * one[index] + other_factor as f32 * other[index])
    }
}

/// A projected signature on one channel, and a linear function of it.
pub type Part<T> = Option<(ProjectedSignature, T)>;

/// A step, which pulses are made of.
struct Step<T> {
    onset_s: f64,
    white: [Option<Column>; CHANNELS],
    parts: [Part<T>; CHANNELS],
}

impl<T: Linear> Step<T> {
    /// Parts of the pulse that ends with another step.
    fn minus(&self, end: &Step<T>) -> [Part<T>; CHANNELS] {
        std::array::from_fn(|channel| {
            let ((one, one_linear), (other, other_linear)) =
                (self.parts[channel].as_ref()?, end.parts[channel].as_ref()?);
            let (begin, end) = (self.white[channel].as_ref()?, end.white[channel].as_ref()?);
            let both = dot(&begin.values[end.from - begin.from..], &end.values);
            let projected = ProjectedSignature::sum((1.0, one), (-1.0, other), both);
            let is_silent = projected.is_cancelled(one, other);
            (!is_silent).then(|| (projected, T::sum((1.0, one_linear), (-1.0, other_linear))))
        })
    }
}

/// Passes each time course of a signature to `push`. `linear` is evaluated for the whitened signature on a channel.
pub fn sweep<T: Linear>(
    bank: &SignatureBank,
    normal: &NormalEquations,
    base: &ConstantSignature,
    linear: impl Fn(usize, &Column) -> T,
    mut push: impl FnMut(&Variation, &[Part<T>; CHANNELS]),
) {
    let whitened = |variation: &Variation| -> [Option<Column>; CHANNELS] {
        let columns = bank.columns(base, variation);
        // A channel without usable blocks has no part.
        let is_used = |white: &Column| white.values.iter().any(|&value| value != 0.0);
        std::array::from_fn(|channel| {
            columns[channel].as_ref().map(|column| normal.white(channel, column)).filter(is_used)
        })
    };
    let parts = |white: &[Option<Column>; CHANNELS]| -> [Part<T>; CHANNELS] {
        std::array::from_fn(|channel| {
            let white = white[channel].as_ref()?;
            Some((normal.project(&normal.products(channel, white)), linear(channel, white)))
        })
    };
    let mut steps: Vec<Step<T>> = Vec::new();
    for variation in bank.variations(base) {
        if let Some(onsets_s) = pulse_onsets_s(&variation) {
            let at = |onset_s: f64| steps.iter().find(|step| (step.onset_s - onset_s).abs() < SAME_ONSET_S);
            if let [Some(begin), Some(end)] = onsets_s.map(at) {
                push(&variation, &begin.minus(end));
            }
            continue;
        }
        let white = whitened(&variation);
        let own = parts(&white);
        if let (Some(STEP), Variation::Course { shapes, .. }) = (variation.kind(), &variation) {
            push(&variation, &own);
            steps.push(Step { onset_s: shapes[0], white, parts: own });
            continue;
        }
        let Some(quarter) = variation.at_phase(FRAC_PI_2) else {
            push(&variation, &own);
            continue;
        };
        let later = whitened(&quarter);
        let other = parts(&later);
        let both: [f64; CHANNELS] = std::array::from_fn(|channel| match (&white[channel], &later[channel]) {
            (Some(one), Some(other)) => dot(&one.values, &other.values),
            _ => 0.0,
        });
        for phase in 0..PHASES {
            let phase_rad = PI * phase as f64 / PHASES as f64;
            let (sin, cos) = phase_rad.sin_cos();
            let mixed: [Part<T>; CHANNELS] = std::array::from_fn(|channel| {
                let ((one, one_linear), (other, other_linear)) = (own[channel].as_ref()?, other[channel].as_ref()?);
                let projected = ProjectedSignature::sum((cos, one), (sin, other), both[channel]);
                Some((projected, T::sum((cos, one_linear), (sin, other_linear))))
            });
            if let Some(variation) = variation.at_phase(phase_rad) {
                push(&variation, &mixed);
            }
        }
    }
}
