//! Products of the time courses of a signature with itself and with the nuisances of a recording, kept for each noise.
//!
//! A search has another residual than the one before, and other hypotheses, but mostly the same noise. Products with these need no
//! whitened signature: the transposed filter makes of each a factor for every increment of the signature.

mod kept;
#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, PoisonError};

use crate::course_list::{CourseList, TailStart};
use crate::courses::Mode;
use crate::linear_algebra::dot;
use crate::measured::CHANNELS;
use crate::normal_equations::NormalEquations;
use crate::signature_bank::{ConstantSignature, SignatureBank};
use crate::whitening::{CoursePart, FilterState, Forms, TailProducts, Whitening};
use geu_hypothesis::amplitude::STEP;
pub use kept::KeptProducts;

/// Noises of which products are kept: that of the start, that with larger walks, and that of the report.
const KEPT: usize = 3;

/// Courses that are whitened at once.
const LANES: usize = 8;

/// Products of the courses of one signature with one noise.
#[derive(Debug)]
pub struct CourseProducts {
    /// For each channel that the signature reaches, and each course: its square, and its products with the nuisances of the recording there.
    courses: [Vec<Vec<f64>>; CHANNELS],
    /// Products of two courses on each channel.
    both: Vec<[f64; CHANNELS]>,
}

impl CourseProducts {
    /// Products of the kept courses of a list.
    pub fn new(bank: &SignatureBank, base: &ConstantSignature, list: &CourseList, normal: &NormalEquations) -> Self {
        let reached: Vec<usize> = (0..CHANNELS).filter(|&channel| base.reaches(channel)).collect();
        let mut products = CourseProducts { courses: Default::default(), both: Vec::new() };
        reached.iter().for_each(|&channel| products.courses[channel] = vec![Vec::new(); list.courses.len()]);
        let forms: Option<Vec<&Forms>> = reached.iter().map(|&channel| normal.whitening(channel).forms()).collect();
        let groups = list.whitened(LANES, forms.is_some(), bank.block_s());
        let is_alone = groups.iter().all(|group| group.len() == 1);
        let whiten = if is_alone { Self::whiten::<1> } else { Self::whiten::<LANES> };
        products.both = whiten(&mut products, bank, base, list, normal, &groups);
        for (&channel, forms) in reached.iter().zip(forms.into_iter().flatten()) {
            products.tails(bank, base, list, normal, channel, forms);
        }
        products
    }

    /// Whitens these courses; returns the products of each pair of them, and 0 for others.
    fn whiten<const LANES: usize>(
        &mut self,
        bank: &SignatureBank,
        base: &ConstantSignature,
        list: &CourseList,
        normal: &NormalEquations,
        groups: &[Vec<usize>],
    ) -> Vec<[f64; CHANNELS]> {
        let reached: Vec<usize> = (0..CHANNELS).filter(|&channel| base.reaches(channel)).collect();
        let factors = |channel: usize| {
            let of_recording = normal.transposed()[channel].1.iter().filter(|own| own.0 < normal.of_recording());
            of_recording.map(|(_, derivatives)| factors(&base.series[channel], base.mode, derivatives)).collect()
        };
        let factors: Vec<Vec<Vec<f64>>> = reached.iter().map(|&channel| factors(channel)).collect();
        let mut with_next = vec![[0.0; CHANNELS]; list.courses.len()];
        // Whitened steps, from their first blocks on.
        let mut steps: Vec<[Vec<f64>; CHANNELS]> = vec![Default::default(); list.courses.len()];
        let is_step = |place: usize| list.courses[place].kind() == Some(STEP);
        for group in groups {
            let firsts: Vec<usize> =
                group.iter().map(|place| list.courses[*place].first_block(bank.block_s())).collect();
            let from = firsts.iter().copied().min().unwrap_or(0);
            let mut values = vec![[0.0; LANES]; bank.block_count() - from];
            for (lane, place) in group.iter().enumerate() {
                let own = values[firsts[lane] - from..].iter_mut().map(|values| &mut values[lane]);
                match bank.values(base, &list.courses[*place]) {
                    Some(course) => own.zip(course.iter()).for_each(|(own, value)| *own = *value),
                    None => own.for_each(|own| *own = 1.0),
                }
            }
            for (&channel, factors) in reached.iter().zip(&factors) {
                let mut before = [0.0; LANES];
                let increments = |block: usize| {
                    let (size, falls) = of_value(&base.series[channel], base.mode, block);
                    let own = values[block - from].map(|value| size * value);
                    let before = std::mem::replace(&mut before, own);
                    std::array::from_fn(|lane| own[lane] - falls * before[lane])
                };
                let (mut squares, mut mixed) = ([0.0; LANES], [0.0; LANES]);
                let mut white_steps: Vec<Vec<f64>> = vec![Vec::new(); group.len()];
                let keeps = is_step(group[0]);
                normal.whitening(channel).pass(from..bank.block_count(), increments, |block, white: [f64; LANES]| {
                    squares.iter_mut().zip(white).for_each(|(square, white)| *square += white * white);
                    let two = white.chunks_exact(2);
                    mixed.iter_mut().zip(two).for_each(|(mixed, two)| *mixed += two[0] * two[1]);
                    if keeps {
                        let lanes = white_steps.iter_mut().zip(&firsts).zip(white);
                        let begun = lanes.filter(|((_, first), _)| block >= **first);
                        begun.for_each(|((step, _), white)| step.push(white));
                    }
                });
                let sums: Vec<[f64; LANES]> = factors.iter().map(|own| products_with(&own[from..], &values)).collect();
                for (lane, &place) in group.iter().enumerate() {
                    let nuisances = sums.iter().map(|sums| sums[lane]);
                    self.courses[channel][place] = std::iter::once(squares[lane]).chain(nuisances).collect();
                    with_next[place][channel] = if lane % 2 == 0 { mixed[lane / 2] } else { 0.0 };
                    steps[place][channel] = std::mem::take(&mut white_steps[lane]);
                }
            }
        }
        let both = |[one, other]: [usize; 2]| match is_step(one) {
            false => with_next[one],
            true => std::array::from_fn(|channel| {
                let [one, other] = [one, other].map(|place| &steps[place][channel]);
                dot(&one[one.len() - other.len()..], other)
            }),
        };
        list.pairs().map(both).collect()
    }

    /// Adds the courses on a channel that decay to the end and are not whitened, and their pairs.
    fn tails(
        &mut self,
        bank: &SignatureBank,
        base: &ConstantSignature,
        list: &CourseList,
        normal: &NormalEquations,
        channel: usize,
        forms: &Forms,
    ) {
        let tails: Vec<(TailStart, usize)> = (0..list.courses.len())
            .filter_map(|place| Some((list.tail(place, bank.block_count(), bank.block_s())?, place)))
            .collect();
        let tail_of: HashMap<usize, TailStart> = tails.iter().map(|(tail, place)| (*place, *tail)).collect();
        let pairs: Vec<(usize, [usize; 2])> =
            list.pairs().enumerate().filter(|(_, two)| two.iter().all(|place| tail_of.contains_key(place))).collect();
        let states = states_before(bank, base, list, normal.whitening(channel), channel, &pairs);
        let decays: Vec<u64> = tails.iter().map(|(tail, _)| tail.0).collect::<BTreeSet<_>>().into_iter().collect();
        let of_recording = normal.transposed()[channel].1.iter().filter(|own| own.0 < normal.of_recording());
        let derivatives: Vec<&[f64]> = of_recording.map(|(_, derivatives)| &derivatives[..]).collect();
        let increment = |block: usize| of_value(&base.series[channel], base.mode, block);
        for decays in decays.chunks(LANES) {
            let lane = |decay: u64| decays.iter().position(|own| *own == decay);
            let of_lane = |((decay, block), place): &(TailStart, usize)| Some((*block, lane(*decay)?, *place));
            let mut begun: Vec<_> = tails.iter().filter_map(of_lane).collect();
            begun.sort_unstable();
            let mut begun = begun.into_iter().peekable();
            let end = |(pair, (number, two)): (usize, &(usize, [usize; 2]))| {
                let [(first_decay, _), (decay, block)] = two.map(|place| tail_of[&place]);
                debug_assert_eq!(first_decay, decay);
                Some((block, lane(decay)?, pair, *number))
            };
            let mut ends: Vec<_> = pairs.iter().enumerate().filter_map(end).collect();
            ends.sort_unstable();
            let mut ends = ends.into_iter().peekable();
            let of_lanes = std::array::from_fn(|lane| decays.get(lane).map_or(1.0, |decay| f64::from_bits(*decay)));
            normal.whitening(channel).tails::<LANES, _>(forms, &increment, of_lanes, &derivatives, |block, tail| {
                while let Some((_, lane, place)) = begun.next_if(|own| own.0.0 == block) {
                    let (course, values) = (&list.courses[place], bank.values(base, &list.courses[place]));
                    let values = values.as_deref().unwrap_or_default();
                    let TailProducts { square, products } =
                        tail.course(lane, block, &values[..=block - course.first_block(bank.block_s())]);
                    self.courses[channel][place] = std::iter::once(square).chain(products).collect();
                }
                while let Some((_, lane, pair, number)) = ends.next_if(|end| end.0.0 == block) {
                    let [one, other] = pairs[pair].1.map(|place| &list.courses[place]);
                    let [begin, from] = [one, other].map(|course| course.first_block(bank.block_s()));
                    let values = [one, other].map(|course| bank.values(base, course).unwrap_or_default());
                    let parts = [
                        CoursePart {
                            state: states[pair],
                            before: if from > begin { values[0][from - begin - 1] } else { 0.0 },
                            values: &values[0][from - begin..=block - begin],
                        },
                        CoursePart { state: FilterState::default(), before: 0.0, values: &values[1][..=block - from] },
                    ];
                    self.both[number][channel] = tail.product(lane, block, parts);
                }
            });
        }
    }
}

/// State of the filter for the first course of each pair, before the second begins.
fn states_before(
    bank: &SignatureBank,
    base: &ConstantSignature,
    list: &CourseList,
    whitening: &Whitening,
    channel: usize,
    pairs: &[(usize, [usize; 2])],
) -> Vec<FilterState> {
    let mut states = vec![FilterState::default(); pairs.len()];
    let first_block = |place: usize| list.courses[place].first_block(bank.block_s());
    let begins: Vec<usize> = pairs.iter().map(|(_, two)| two[0]).collect::<BTreeSet<_>>().into_iter().collect();
    for begins in begins.chunks(LANES) {
        let of_pair = |(pair, (_, [one, other])): (usize, &(usize, [usize; 2]))| {
            Some((first_block(*other), begins.binary_search(one).ok()?, pair))
        };
        let mut wanted: Vec<_> = pairs.iter().enumerate().filter_map(of_pair).collect();
        wanted.sort_unstable();
        let courses: Vec<_> = begins
            .iter()
            .map(|&place| (first_block(place), bank.values(base, &list.courses[place]).unwrap_or_default()))
            .collect();
        let from = courses.iter().map(|course| course.0).min().unwrap_or(0);
        let to = wanted.last().map_or(from, |last| last.0 + 1);
        let mut before = [0.0; LANES];
        let increments = |block: usize| {
            let (size, falls) = of_value(&base.series[channel], base.mode, block);
            let value = |lane: usize| {
                let (first, values) = courses.get(lane)?;
                values.get(block.checked_sub(*first)?).copied()
            };
            let own: [f64; LANES] = std::array::from_fn(|lane| size * value(lane).unwrap_or(0.0));
            let before = std::mem::replace(&mut before, own);
            std::array::from_fn(|lane| own[lane] - falls * before[lane])
        };
        let mut wanted = wanted.into_iter().peekable();
        whitening.states::<LANES>(from..to, increments, |block, state| {
            while let Some((_, lane, pair)) = wanted.next_if(|own| own.0 == block) {
                states[pair] = state.map(|lanes| lanes[lane]);
            }
        });
    }
    states
}

/// Sums of the factors times the values of each course.
fn products_with<const LANES: usize>(factors: &[f64], values: &[[f64; LANES]]) -> [f64; LANES] {
    let mut sums = [0.0; LANES];
    for (factor, values) in factors.iter().zip(values) {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
    }
    sums
}

/// Key of a noise and of a list, and their products.
type NoiseProducts = (u64, Arc<CourseProducts>);

/// The products of a signature, for the noises used last; copies share them.
#[derive(Debug, Clone, Default)]
pub struct ProductCache(Arc<Mutex<Vec<NoiseProducts>>>);

impl ProductCache {
    /// Products of the courses of a list with the noise of these equations, in place of the oldest if they are `new`.
    pub fn with_noise(
        &self,
        list: &CourseList,
        normal: &NormalEquations,
        new: impl FnOnce() -> CourseProducts,
    ) -> Arc<CourseProducts> {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut hasher = DefaultHasher::new();
        (normal.key(), list.key()).hash(&mut hasher);
        let key = hasher.finish();
        let known = kept().iter().find(|(own, _)| *own == key).map(|(_, products)| products.clone());
        known.unwrap_or_else(|| {
            let products = Arc::new(new());
            let mut kept = kept();
            kept.retain(|(own, _)| *own != key);
            if kept.len() >= KEPT {
                kept.remove(0);
            }
            kept.push((key, products.clone()));
            products
        })
    }
}

/// Derivatives by the values of a time course, from those by the increments of the signature with it.
fn factors(series: &[f64], mode: Mode, derivatives: &[f64]) -> Vec<f64> {
    let later = derivatives[1..].iter().chain(&[0.0]);
    let of_block = |(block, (own, later)): (usize, (&f64, &f64))| {
        let (size, falls) = of_value(series, mode, block);
        size * (own - falls * later)
    };
    derivatives.iter().zip(later).enumerate().map(of_block).collect()
}

/// Increment of a signature in a block by the value of its time course there, and the share of it that falls again in the next block: a
/// level does, a rate remains.
pub fn of_value(series: &[f64], mode: Mode, block: usize) -> (f64, f64) {
    match mode {
        Mode::Rate => (series[block] - if block == 0 { 0.0 } else { series[block - 1] }, 0.0),
        Mode::Level => (series[block], 1.0),
    }
}
