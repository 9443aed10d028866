//! All the courses of one signature, beside the nuisances: what every search goes through.
//!
//! A wave of any phase is a sum of two a quarter of a turn apart, so that those two alone are whitened.

use std::f64::consts::{FRAC_PI_2, PI};

use crate::bank::{Column, ConstantSignature, SignatureBank, Variation};
use crate::measured::CHANNELS;
use crate::normal::{NormalEquations, ProjectedSignature, dot};

/// Phases of a wave that are looked for, over half a turn.
const PHASES: usize = 16;

/// What is told of a signature on one channel, linear in it.
pub trait Linear: Sized {
    /// The same of the sum of two signatures, each times its factor.
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

/// A signature on one channel beside the nuisances, and what else is told of it there.
pub type Part<T> = Option<(ProjectedSignature, T)>;

/// Goes through the courses of a base: `tell` is given a channel and the whitened signature there, `take` each course.
pub fn sweep<T: Linear>(
    bank: &SignatureBank,
    normal: &NormalEquations,
    base: &ConstantSignature,
    tell: impl Fn(usize, &Column) -> T,
    mut take: impl FnMut(&Variation, &[Part<T>; CHANNELS]),
) {
    let whitened = |variation: &Variation| -> [Option<Column>; CHANNELS] {
        let columns = bank.columns(base, variation);
        // Of a channel without a good block nothing is told.
        let is_told = |white: &Column| white.values.iter().any(|&value| value != 0.0);
        std::array::from_fn(|channel| {
            columns[channel].as_ref().map(|column| normal.white(channel, column)).filter(is_told)
        })
    };
    let parts = |white: &[Option<Column>; CHANNELS]| -> [Part<T>; CHANNELS] {
        std::array::from_fn(|channel| {
            let white = white[channel].as_ref()?;
            Some((normal.beside(&normal.products(channel, white)), tell(channel, white)))
        })
    };
    for variation in bank.variations(base) {
        let white = whitened(&variation);
        let own = parts(&white);
        let Some(quarter) = variation.at_phase(FRAC_PI_2) else {
            take(&variation, &own);
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
                let ((one, one_told), (other, other_told)) = (own[channel].as_ref()?, other[channel].as_ref()?);
                let beside = ProjectedSignature::sum((cos, one), (sin, other), both[channel]);
                Some((beside, T::sum((cos, one_told), (sin, other_told))))
            });
            if let Some(variation) = variation.at_phase(phase_rad) {
                take(&variation, &mixed);
            }
        }
    }
}
