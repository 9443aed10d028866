//! All time courses of one signature, projected on the nuisances.
//!
//! Squares and products with the nuisances of a recording are kept for each noise ([`crate::course_products`]): another residual needs no
//! whitening.

use std::f64::consts::PI;

use crate::course_list::{CourseList, Sweep};
use crate::course_products::{CourseProducts, KeptProducts};
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, ProjectedSignature, SignatureFit, distinguishable};
use crate::signature_bank::{Column, ConstantSignature, SignatureBank, Variation};

/// Searched phases of a wave, over half a period.
const PHASES: usize = 16;

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

/// For each channel that a signature reaches.
type OfChannels<T> = [Option<T>; CHANNELS];
/// Products of the parts of two signatures on each pair of channels, without their projections on the nuisances.
type Pairs = [[f64; CHANNELS]; CHANNELS];

/// Parts of a time course on the channels that it reaches.
type Parts = OfChannels<ProjectedSignature>;

/// Products of two time courses, of which `both` are those on one channel.
fn pairs(one: &Parts, other: &Parts, both: &[f64; CHANNELS]) -> Pairs {
    let product = |i: usize, j: usize| {
        let (Some(one), Some(other)) = (&one[i], &other[j]) else { return 0.0 };
        (if i == j { both[i] } else { 0.0 }) - one.part.dot(&other.part)
    };
    std::array::from_fn(|i| std::array::from_fn(|j| product(i, j)))
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
    fn new(parts: &Parts, linear: OfChannels<T>) -> Swept<T> {
        let [own, right] = [|part: &ProjectedSignature| part.own, |part: &ProjectedSignature| part.right]
            .map(|of| parts.each_ref().map(|part| part.as_ref().map_or(0.0, of)));
        let pairs = pairs(parts, parts, &own);
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

/// Passes each time course of a signature on these channels to `push`. `linear` is evaluated for it on a channel, by its place in the list of
/// courses, with its whitened signature if its products are not kept.
pub fn sweep<T: Linear>(
    bank: &SignatureBank,
    normal: &NormalEquations,
    base: &ConstantSignature,
    has: [bool; CHANNELS],
    linear: impl Fn(usize, usize, Option<&Column>) -> T,
    mut push: impl FnMut(&Variation, &Swept<T>),
) {
    let list = CourseList::new(bank, base);
    let products = base.products.with_noise(&list, normal, || CourseProducts::new(bank, base, &list, normal));
    let mut kept = KeptProducts::new(products, bank, base, &list, normal, has);
    let course = |place: usize| {
        let variation = &list.courses[place];
        let (parts, white) = match list.is_kept(place) {
            true => {
                let values = bank.values(base, variation);
                (
                    kept.course(normal, place, variation.first_block(bank.block_s()), values.as_deref()),
                    Default::default(),
                )
            }
            false => whitened(bank, normal, base, has, variation),
        };
        let of_channel =
            |channel: usize| parts[channel].as_ref().map(|_| linear(channel, place, white[channel].as_ref()));
        let swept = Swept::new(&parts, std::array::from_fn(of_channel));
        (parts, swept)
    };
    let courses: Vec<(Parts, Swept<T>)> = (0..list.courses.len()).map(course).collect();
    let mut both = |one: &Parts, other: &Parts| {
        let squares = kept.both();
        (pairs(one, other, &squares), squares)
    };
    for result in &list.results {
        match result {
            Sweep::Course(place) => push(&list.courses[*place], &courses[*place].1),
            Sweep::Pulse(variation, two) => {
                let [(begin, from), (end, to)] = two.map(|place| &courses[place]);
                let mut pulse = Swept::sum((1.0, from), (-1.0, to), &both(begin, end));
                pulse.remove_cancelled(from, to);
                push(variation, &pulse);
            }
            Sweep::Wave(two) => {
                let [(first, own), (second, later)] = two.map(|place| &courses[place]);
                let both = both(first, second);
                for phase in 0..PHASES {
                    let phase_rad = PI * phase as f64 / PHASES as f64;
                    let (sin, cos) = phase_rad.sin_cos();
                    if let Some(variation) = list.courses[two[0]].at_phase(phase_rad) {
                        push(&variation, &Swept::sum((cos, own), (sin, later), &both));
                    }
                }
            }
        }
    }
}

/// Parts of a time course that is not kept, and its whitened signature.
fn whitened(
    bank: &SignatureBank,
    normal: &NormalEquations,
    base: &ConstantSignature,
    has: [bool; CHANNELS],
    variation: &Variation,
) -> (Parts, OfChannels<Column>) {
    let mut columns = bank.columns(base, variation);
    columns.iter_mut().zip(has).filter(|(_, has)| !has).for_each(|(column, _)| *column = None);
    // A channel without usable blocks has no part.
    let is_used = |white: &Column| white.values.iter().any(|&value| value != 0.0);
    let white = normal.white_channels(&columns).map(|column| column.filter(is_used));
    let part = |channel: usize| Some(normal.project(&normal.products(channel, white[channel].as_ref()?)));
    (std::array::from_fn(part), white)
}
