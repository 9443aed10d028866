//! All time courses of one signature, projected on the nuisances.
//!
//! A wave of any phase is a sum of two waves with a quarter period between them, so that only these two are whitened; a pulse is the
//! difference of two steps. Squares and products with the nuisances of a recording are kept for each noise ([`crate::course_products`]):
//! another residual needs no whitening.

use std::f64::consts::{FRAC_PI_2, PI};

use crate::course_products::{CourseProducts, KeptProducts};
use crate::courses::pulse_onsets_s;
use crate::linear_algebra::dot;
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, ProjectedSignature, SignatureFit, distinguishable};
use crate::signature_bank::{Column, ConstantSignature, SignatureBank, Variation};
use geu_hypothesis::amplitude::STEP;

/// Searched phases of a wave, over half a period.
const PHASES: usize = 16;
/// Onsets of the grid differ by more.
const SAME_ONSET_S: f64 = 1e-3;

/// A linear function of a signature on one channel.
pub trait Linear: Sized {
    /// Value if that is one for all signatures.
    const CONSTANT: Option<Self>;

    /// Value for the sum of two signatures, each times its factor.
    #[must_use]
    fn sum(one: (f64, &Self), other: (f64, &Self)) -> Self;
}

impl Linear for () {
    const CONSTANT: Option<()> = Some(());

    fn sum(_: (f64, &()), _: (f64, &())) {}
}

impl<const COUNT: usize> Linear for [f32; COUNT] {
    const CONSTANT: Option<Self> = None;

    fn sum((one_factor, one): (f64, &Self), (other_factor, other): (f64, &Self)) -> Self {
        std::array::from_fn(|index| one_factor as f32 * one[index] + other_factor as f32 * other[index])
    }
}

/// For each channel that a signature reaches.
type OfChannels<T> = [Option<T>; CHANNELS];
/// Products of the parts of two signatures on each pair of channels, without their projections on the nuisances.
type Pairs = [[f64; CHANNELS]; CHANNELS];

/// A time course, whitened where its products are not kept.
struct Course {
    white: OfChannels<Column>,
    parts: OfChannels<ProjectedSignature>,
}

impl Course {
    /// Products with another course, of which `both` are those on one channel.
    fn pairs(&self, other: &Course, both: &[f64; CHANNELS]) -> Pairs {
        let product = |i: usize, j: usize| {
            let (Some(one), Some(other)) = (&self.parts[i], &other.parts[j]) else { return 0.0 };
            (if i == j { both[i] } else { 0.0 }) - one.part.dot(&other.part)
        };
        std::array::from_fn(|i| std::array::from_fn(|j| product(i, j)))
    }
}

/// A time course projected on the nuisances.
pub struct Swept<T> {
    /// The linear function.
    pub linear: OfChannels<T>,
    own: [f64; CHANNELS],
    right: [f64; CHANNELS],
    pairs: Pairs,
}

impl<T: Linear> Swept<T> {
    fn new(course: &Course, linear: OfChannels<T>) -> Swept<T> {
        let [own, right] = [|part: &ProjectedSignature| part.own, |part: &ProjectedSignature| part.right]
            .map(|of| course.parts.each_ref().map(|part| part.as_ref().map_or(0.0, of)));
        let pairs = course.pairs(course, &own);
        Swept { linear, own, right, pairs }
    }

    /// Channels that it reaches.
    pub fn reached(&self) -> [bool; CHANNELS] {
        self.linear.each_ref().map(Option::is_some)
    }

    /// Fit on the channels that `has` selects; `None` if it is not distinguishable from the nuisances there.
    pub fn gain(&self, has: impl Fn(usize) -> bool) -> Option<SignatureFit> {
        let has: [bool; CHANNELS] = std::array::from_fn(has);
        let (mut own, mut left, mut right) = (0.0, 0.0, 0.0);
        for one in (0..CHANNELS).filter(|&one| has[one]) {
            own += self.own[one];
            right += self.right[one];
            left += (0..CHANNELS).filter(|&other| has[other]).map(|other| self.pairs[one][other]).sum::<f64>();
        }
        Some(SignatureFit::new(distinguishable(left, own)?, right))
    }

    /// The sum of two time courses, each times its factor, on the channels that both reach; `both` are the products of the two.
    fn sum((a, one): (f64, &Self), (b, other): (f64, &Self), both: &(Pairs, [f64; CHANNELS])) -> Swept<T> {
        let (products, squares) = both;
        Swept {
            linear: std::array::from_fn(|channel| {
                Some(T::sum((a, one.linear[channel].as_ref()?), (b, other.linear[channel].as_ref()?)))
            }),
            own: std::array::from_fn(|channel| {
                a * a * one.own[channel] + 2.0 * a * b * squares[channel] + b * b * other.own[channel]
            }),
            right: std::array::from_fn(|channel| a * one.right[channel] + b * other.right[channel]),
            pairs: std::array::from_fn(|i| {
                std::array::from_fn(|j| {
                    let mixed = products[i][j] + products[j][i];
                    a * a * one.pairs[i][j] + a * b * mixed + b * b * other.pairs[i][j]
                })
            }),
        }
    }

    /// Removes the channels where the square of a difference of two results from rounding errors.
    fn remove_cancelled(&mut self, one: &Self, other: &Self) {
        for channel in 0..CHANNELS {
            if distinguishable(self.own[channel], one.own[channel] + other.own[channel]).is_none() {
                self.linear[channel] = None;
                (self.own[channel], self.right[channel]) = (0.0, 0.0);
                self.pairs[channel] = [0.0; CHANNELS];
                self.pairs.iter_mut().for_each(|row| row[channel] = 0.0);
            }
        }
    }
}

/// Passes each time course of a signature on these channels to `push`. `linear` is evaluated for it and its whitened signature on a channel.
pub fn sweep<T: Linear>(
    bank: &SignatureBank,
    normal: &NormalEquations,
    base: &ConstantSignature,
    has: [bool; CHANNELS],
    linear: impl Fn(usize, &Variation, &Column) -> T,
    mut push: impl FnMut(&Variation, &Swept<T>),
) {
    let mut source = Source::new(bank, normal, base, has, linear);
    let mut steps: Vec<(f64, Course, Swept<T>)> = Vec::new();
    for variation in bank.variations(base) {
        if let Some(onsets_s) = pulse_onsets_s(&variation) {
            let at = |onset_s: f64| steps.iter().find(|step| (step.0 - onset_s).abs() < SAME_ONSET_S);
            if let [Some((_, begin, from)), Some((_, end, to))] = onsets_s.map(at) {
                let mut pulse = Swept::sum((1.0, from), (-1.0, to), &source.both(begin, end));
                pulse.remove_cancelled(from, to);
                push(&variation, &pulse);
            }
            continue;
        }
        let (course, own) = source.course(&variation);
        if let Some(quarter) = variation.at_phase(FRAC_PI_2) {
            let (quarter, later) = source.course(&quarter);
            let both = source.both(&course, &quarter);
            for phase in 0..PHASES {
                let phase_rad = PI * phase as f64 / PHASES as f64;
                let (sin, cos) = phase_rad.sin_cos();
                if let Some(variation) = variation.at_phase(phase_rad) {
                    push(&variation, &Swept::sum((cos, &own), (sin, &later), &both));
                }
            }
            continue;
        }
        push(&variation, &own);
        if let (Some(STEP), Variation::Course { shapes, .. }) = (variation.kind(), &variation) {
            steps.push((shapes[0], course, own));
        }
    }
    source.finish();
}

/// Time courses of one signature, with kept products, or with products to be kept.
struct Source<'a, L> {
    bank: &'a SignatureBank,
    normal: &'a NormalEquations,
    base: &'a ConstantSignature,
    has: [bool; CHANNELS],
    linear: L,
    kept: Option<KeptProducts>,
    new: CourseProducts,
}

impl<'a, T: Linear, L: Fn(usize, &Variation, &Column) -> T> Source<'a, L> {
    fn new(
        bank: &'a SignatureBank,
        normal: &'a NormalEquations,
        base: &'a ConstantSignature,
        has: [bool; CHANNELS],
        linear: L,
    ) -> Source<'a, L> {
        // A linear function requires whitened signatures.
        let products = T::CONSTANT.and_then(|_| base.products.with_noise(normal));
        let kept = products.map(|products| KeptProducts::new(products, base, normal, has));
        Source { bank, normal, base, has, linear, kept, new: CourseProducts::default() }
    }

    fn course(&mut self, variation: &Variation) -> (Course, Swept<T>) {
        // Products with a part of the recording alone are not kept, nor products with courses of the temperature, which has a delay.
        let is_kept = variation.is_of_time() && !matches!(variation, Variation::Onset { .. });
        let (course, linear) = match self.kept.as_mut().filter(|_| is_kept) {
            Some(kept) => {
                let values = self.bank.values(self.base, variation);
                let parts = kept.course(self.normal, variation.first_block(), values.as_deref());
                let linear = parts.each_ref().map(|part| T::CONSTANT.filter(|_| part.is_some()));
                (Course { white: Default::default(), parts }, linear)
            }
            None => self.whitened(variation, is_kept),
        };
        let swept = Swept::new(&course, linear);
        (course, swept)
    }

    fn whitened(&mut self, variation: &Variation, is_kept: bool) -> (Course, OfChannels<T>) {
        let mut columns = self.bank.columns(self.base, variation);
        if !is_kept {
            columns.iter_mut().zip(self.has).filter(|(_, has)| !has).for_each(|(column, _)| *column = None);
        }
        // A channel without usable blocks has no part.
        let is_used = |white: &Column| white.values.iter().any(|&value| value != 0.0);
        let white = self.normal.white_channels(&columns).map(|column| column.filter(is_used));
        let parts = std::array::from_fn(|channel| {
            let products = white[channel].as_ref().map(|white| self.normal.products(channel, white));
            if is_kept {
                self.new.push(channel, self.normal, products.as_ref());
            }
            Some(self.normal.project(&products.filter(|_| self.has[channel])?))
        });
        let linear = std::array::from_fn(|channel| {
            let white = white[channel].as_ref().filter(|_| self.has[channel])?;
            Some((self.linear)(channel, variation, white))
        });
        (Course { white, parts }, linear)
    }

    /// Products of two courses.
    fn both(&mut self, one: &Course, other: &Course) -> (Pairs, [f64; CHANNELS]) {
        let both = match &mut self.kept {
            Some(kept) => kept.both(),
            None => {
                let both = std::array::from_fn(|channel| match (&one.white[channel], &other.white[channel]) {
                    (Some(one), Some(other)) => dot(&one.values[other.from - one.from..], &other.values),
                    _ => 0.0,
                });
                self.new.push_both(both);
                both
            }
        };
        (one.pairs(other, &both), both)
    }

    /// Keeps the products.
    fn finish(self) {
        if self.kept.is_none() {
            self.base.products.keep(self.normal, self.new);
        }
    }
}
