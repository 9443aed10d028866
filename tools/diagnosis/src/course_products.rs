//! Products of the time courses of a signature with itself and with the nuisances of a recording, kept for each noise.
//!
//! A search has another residual than the one before, and other hypotheses, but mostly the same noise. Products with these need no
//! whitened signature: the transposed filter makes of each a factor for every increment of the signature.

use std::cmp::Reverse;
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::DVector;

use crate::course_list::CourseList;
use crate::courses::Mode;
use crate::linear_algebra::{dot, dots};
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, ProjectedSignature};
use crate::signature_bank::{ConstantSignature, SignatureBank};
use crate::whitening::{CoursePart, Forms, State, TailProducts, Whitening};
use geu_hypothesis::amplitude::STEP;

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
                dot(&one[one.len().saturating_sub(other.len())..], other)
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
        let last = bank.block_count() - 1;
        let tail = |place: usize| {
            let (decay, block) = list.courses[place].tail(bank.block_s()).filter(|_| list.is_kept(place))?;
            Some((decay, Reverse(block.min(last)), place))
        };
        let mut tails: Vec<(u64, Reverse<usize>, usize)> = (0..list.courses.len()).filter_map(tail).collect();
        tails.retain(|(.., place)| self.courses[channel][*place].is_empty());
        let tail_of: HashMap<usize, (u64, Reverse<usize>)> =
            tails.iter().map(|(decay, block, place)| (*place, (*decay, *block))).collect();
        let pairs: Vec<(usize, [usize; 2])> =
            list.pairs().enumerate().filter(|(_, two)| two.iter().all(|place| tail_of.contains_key(place))).collect();
        let states = states_before(bank, base, list, normal.whitening(channel), channel, &pairs);
        let decays: Vec<u64> = tails.iter().map(|tail| tail.0).collect::<BTreeSet<_>>().into_iter().collect();
        let of_recording = normal.transposed()[channel].1.iter().filter(|own| own.0 < normal.of_recording());
        let derivatives: Vec<&[f64]> = of_recording.map(|(_, derivatives)| &derivatives[..]).collect();
        let increment = |block: usize| of_value(&base.series[channel], base.mode, block);
        for decays in decays.chunks(LANES) {
            let lane = |decay: u64| decays.iter().position(|own| *own == decay);
            let mut tails: Vec<_> =
                tails.iter().filter_map(|(decay, block, place)| Some((*block, lane(*decay)?, *place))).collect();
            tails.sort_unstable();
            let mut tails = tails.into_iter().peekable();
            let end = |(pair, (number, two)): (usize, &(usize, [usize; 2]))| {
                let (decay, block) = tail_of[&two[1]];
                Some((block, lane(decay)?, pair, *number))
            };
            let mut ends: Vec<_> = pairs.iter().enumerate().filter_map(end).collect();
            ends.sort_unstable();
            let mut ends = ends.into_iter().peekable();
            let of_lanes = std::array::from_fn(|lane| decays.get(lane).map_or(1.0, |decay| f64::from_bits(*decay)));
            normal.whitening(channel).tails::<LANES, _>(forms, &increment, of_lanes, &derivatives, |block, tail| {
                while let Some((_, lane, place)) = tails.next_if(|tail| tail.0.0 == block) {
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
                        CoursePart { state: State::default(), before: 0.0, values: &values[1][..=block - from] },
                    ];
                    self.both[number][channel] = tail.product(lane, block, parts);
                }
            });
        }
    }
}

/// For each pair of courses the state of the filter for the first before the first block of the second.
fn states_before(
    bank: &SignatureBank,
    base: &ConstantSignature,
    list: &CourseList,
    whitening: &Whitening,
    channel: usize,
    pairs: &[(usize, [usize; 2])],
) -> Vec<State> {
    let mut states = vec![State::default(); pairs.len()];
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

/// Key of a noise and products with it.
type NoiseProducts = (u64, Arc<CourseProducts>);

/// The products of a signature, for the noises used last; copies share them.
#[derive(Debug, Clone, Default)]
pub struct ProductCache(Arc<Mutex<Vec<NoiseProducts>>>);

impl ProductCache {
    /// Products with the noise of these equations, in place of the oldest if they are `new`.
    pub fn with_noise(&self, normal: &NormalEquations, new: impl FnOnce() -> CourseProducts) -> Arc<CourseProducts> {
        let kept = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let known = kept().iter().find(|(key, _)| *key == normal.key()).map(|(_, products)| products.clone());
        known.unwrap_or_else(|| {
            let products = Arc::new(new());
            let mut kept = kept();
            kept.retain(|(key, _)| *key != normal.key());
            if kept.len() >= KEPT {
                kept.remove(0);
            }
            kept.push((normal.key(), products.clone()));
            products
        })
    }
}

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

/// The ends of the courses of a list that decay from a block on. Those of one decay follow from each other.
struct Tails {
    /// For each course the place of its tail.
    of_courses: Vec<Option<usize>>,
    /// Bits of the decay and the first block, in order.
    all: Vec<(u64, Reverse<usize>)>,
}

impl Tails {
    fn new(bank: &SignatureBank, list: &CourseList) -> Tails {
        let last = bank.block_count() - 1;
        let tail = |place: usize| {
            let (decay, block) = list.courses[place].tail(bank.block_s()).filter(|_| list.is_kept(place))?;
            Some((decay, Reverse(block.min(last))))
        };
        let of_courses: Vec<_> = (0..list.courses.len()).map(tail).collect();
        let mut all: Vec<_> = of_courses.iter().flatten().copied().collect();
        all.sort_unstable();
        all.dedup();
        let place = |tail: Option<(u64, Reverse<usize>)>| all.binary_search(&tail?).ok();
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
