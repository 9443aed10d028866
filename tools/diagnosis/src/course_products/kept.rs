//! Products of the courses of a signature, kept with the noise, beside those with a residual and with hypotheses.

use std::cmp::Reverse;
use std::sync::Arc;

use nalgebra::DVector;

use super::{CourseProducts, factors};
use crate::course_list::{CourseList, TailStart};
use crate::linear_algebra::dots;
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, ProjectedSignature};
use crate::signature_bank::{ConstantSignature, SignatureBank};

/// Kept products, read in the order of a sweep, beside those with a residual and with hypotheses.
pub struct KeptProducts {
    products: Arc<CourseProducts>,
    tails: Tails,
    channels: [Option<KeptChannel>; CHANNELS],
    both: usize,
}

/// A channel that the signature reaches.
struct KeptChannel {
    /// Places of the nuisances of the recording on this channel.
    places: Vec<usize>,
    /// For the product with the residual.
    residual: Factors,
    /// For the products with the other nuisances, with their places.
    others: Vec<(usize, Factors)>,
}

impl KeptChannel {
    /// Factors for the product with the residual, then for those with the other nuisances.
    fn factors(&self) -> impl Iterator<Item = &Factors> {
        std::iter::once(&self.residual).chain(self.others.iter().map(|own| &own.1))
    }
}

/// Factors of the values of a time course for a product.
struct Factors {
    of_blocks: Vec<f64>,
    /// For each tail of [`Tails`], its product: of a course with the value 1 in the first block.
    of_tails: Vec<f64>,
}

/// The tails of the courses of a list. Tails with one decay follow from each other.
struct Tails {
    /// For each course the place of its tail.
    of_courses: Vec<Option<usize>>,
    /// In order.
    all: Vec<TailStart>,
}

impl Tails {
    fn new(bank: &SignatureBank, list: &CourseList) -> Tails {
        let tail = |place: usize| list.tail(place, bank.block_count(), bank.block_s());
        let of_courses: Vec<_> = (0..list.courses.len()).map(tail).collect();
        let mut all: Vec<_> = of_courses.iter().flatten().copied().collect();
        all.sort_unstable();
        all.dedup();
        let place = |tail: Option<TailStart>| all.binary_search(&tail?).ok();
        Tails { of_courses: of_courses.into_iter().map(place).collect(), all }
    }

    /// The tail of a course: its first block and its place.
    fn of_course(&self, place: usize) -> Option<(usize, usize)> {
        let tail = self.of_courses[place]?;
        Some((self.all[tail].1.0, tail))
    }

    /// Products of all tails with these factors.
    fn products(&self, factors: &[f64]) -> Vec<f64> {
        let mut products = Vec::with_capacity(self.all.len());
        for same in self.all.chunk_by(|one, other| one.0 == other.0) {
            let (mut next, mut sum) = (factors.len(), 0.0);
            for (decay, Reverse(first)) in same {
                let decay = f64::from_bits(*decay);
                factors[*first..next].iter().rev().for_each(|factor| sum = decay * sum + factor);
                next = *first;
                products.push(sum);
            }
        }
        products
    }
}

impl KeptProducts {
    /// Products of a signature on these channels.
    pub fn new(
        products: Arc<CourseProducts>,
        bank: &SignatureBank,
        base: &ConstantSignature,
        list: &CourseList,
        normal: &NormalEquations,
        has: [bool; CHANNELS],
    ) -> KeptProducts {
        let transposed = normal.transposed();
        let tails = Tails::new(bank, list);
        let channel = |channel: usize| {
            let series = &base.series[channel];
            if !has[channel] || !base.reaches(channel) {
                return None;
            }
            let factors = |derivatives: &Vec<f64>| {
                let of_blocks = factors(series, base.mode, derivatives);
                Factors { of_tails: tails.products(&of_blocks), of_blocks }
            };
            let (residual, nuisances) = &transposed[channel];
            let (of_recording, others) =
                nuisances.split_at(nuisances.partition_point(|(place, _)| *place < normal.of_recording()));
            Some(KeptChannel {
                places: of_recording.iter().map(|(place, _)| *place).collect(),
                residual: factors(residual),
                others: others.iter().map(|(place, derivatives)| (*place, factors(derivatives))).collect(),
            })
        };
        let channels = std::array::from_fn(channel);
        KeptProducts { products, tails, channels, both: 0 }
    }

    /// The course at a place of the list, with these values from its first block on, or constant.
    pub fn course(
        &self,
        normal: &NormalEquations,
        place: usize,
        from: usize,
        values: Option<&[f64]>,
    ) -> [Option<ProjectedSignature>; CHANNELS] {
        let all: Vec<&Factors> = self.channels.iter().flatten().flat_map(KeptChannel::factors).collect();
        let tail = self.tails.of_course(place).zip(values);
        let two = |own: &[&Factors]| {
            let both = [own[0], own[own.len() - 1]];
            let products = match tail {
                Some(((first, tail), values)) => {
                    let (begin, rest) = values.split_at(first - from);
                    let begun = products_of(Some(begin), both.map(|own| &own.of_blocks[from..first]));
                    std::array::from_fn(|place| begun[place] + rest[0] * both[place].of_tails[tail])
                }
                None => products_of(values, both.map(|own| &own.of_blocks[from..])),
            };
            products.into_iter().take(own.len())
        };
        let mut products = all.chunks(2).flat_map(two);
        std::array::from_fn(|channel| {
            let own = self.channels[channel].as_ref()?;
            let residual = products.next()?;
            let others: Vec<f64> = products.by_ref().take(own.others.len()).collect();
            let (square, kept) = self.products.courses[channel][place].split_first()?;
            if *square <= 0.0 {
                return None;
            }
            let mut sums = DVector::zeros(normal.nuisances());
            own.places.iter().zip(kept).for_each(|(place, product)| sums[*place] = *product);
            own.others.iter().zip(others).for_each(|((place, _), product)| sums[*place] = product);
            Some(normal.project_sums(*square, residual, &sums))
        })
    }

    /// Products of the next two courses.
    pub fn both(&mut self) -> [f64; CHANNELS] {
        self.both += 1;
        self.products.both[self.both - 1]
    }
}

/// Products of two series of factors with these values, or with 1.
fn products_of(values: Option<&[f64]>, factors: [&[f64]; 2]) -> [f64; 2] {
    let [one, other] = factors;
    match values {
        Some(values) => dots(values, factors),
        None => one.iter().zip(other).fold([0.0; 2], |sums, (one, other)| [sums[0] + one, sums[1] + other]),
    }
}
