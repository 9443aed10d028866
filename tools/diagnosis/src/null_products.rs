//! Products of the time courses of one signature with the null recordings.
//!
//! Steps and courses that decay are sums from their onset to the end, in which the value of each block is that of the block before times a
//! constant: one pass from the end gives the sums of all onsets and constants.
//!
//! Each recording has a lane of its own and no target has fused multiply-add, so that vectors of any width give the same results.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::HashMap;

use multiversion::multiversion;

use crate::course_list::CourseList;
use crate::course_products::of_value;
use crate::courses::Mode;
use crate::measured::{CHANNELS, Series};
use crate::normal_equations::NormalEquations;
use crate::signature_bank::{Column, ConstantSignature, SignatureBank};

/// Number of null recordings.
pub const RUNS: usize = 128;

/// Blocks that are added for all courses before the next ones: their derivatives, 128 KiB, fit into the second cache of a core.
const AT_ONCE: usize = 256;
/// Number of courses with their values in memory.
const COURSES_AT_ONCE: usize = 64;
/// Recordings of which the sums fit into registers.
const LANES: usize = 32;

/// A value for each null recording.
pub type OfRuns = [f32; RUNS];
const ZEROS: OfRuns = [0.0; RUNS];

/// Null recordings on one channel, by block, with zeros after the last one.
pub struct NullChannel {
    /// Whitened, without their projections on the nuisances.
    white: Vec<OfRuns>,
    /// Derivatives of the products by the increments of a signature.
    derivatives: Vec<OfRuns>,
}

/// These recordings, of which there are [`RUNS`], on each channel.
pub fn null_channels(normal: &NormalEquations, drawn: Vec<Series>) -> [NullChannel; CHANNELS] {
    let none = || vec![ZEROS; drawn[0][0].len() + 1];
    let mut channels = std::array::from_fn(|_| NullChannel { white: none(), derivatives: none() });
    let put = |all: &mut [OfRuns], run: usize, values: &[f64]| {
        all.iter_mut().zip(values).for_each(|(runs, value)| runs[run] = *value as f32);
    };
    // Each recording ends once it is put: together they take as much memory as the channels.
    for (run, own) in drawn.into_iter().enumerate() {
        for (channel, (values, place)) in own.iter().zip(&mut channels).enumerate() {
            put(&mut place.white, run, values);
            put(&mut place.derivatives, run, &normal.derivatives(channel, values));
        }
    }
    channels
}

/// Products of the courses of one signature.
pub struct NullProducts<'a> {
    bank: &'a SignatureBank,
    base: &'a ConstantSignature,
    list: CourseList,
    channels: &'a [NullChannel; CHANNELS],
    /// For each channel, of courses that decay: the sums from a block on, by the bits of the decay and the block.
    tails: [HashMap<(u64, usize), OfRuns>; CHANNELS],
    /// For each channel, of the other kept courses, by their places.
    others: [HashMap<usize, OfRuns>; CHANNELS],
}

impl<'a> NullProducts<'a> {
    /// For the searched courses of a signature.
    pub fn new(
        bank: &'a SignatureBank,
        base: &'a ConstantSignature,
        channels: &'a [NullChannel; CHANNELS],
    ) -> NullProducts<'a> {
        let list = CourseList::new(bank, base);
        let mut tails: Vec<(u64, usize)> =
            list.courses.iter().filter_map(|course| course.tail(bank.block_s())).collect();
        tails.sort_by_key(|(decay, from)| (*decay, Reverse(*from)));
        let is_other = |place: &usize| list.is_kept(*place) && list.courses[*place].tail(bank.block_s()).is_none();
        let others: Vec<usize> = (0..list.courses.len()).filter(is_other).collect();
        let (kept_tails, kept_others) = Default::default();
        let mut products = NullProducts { bank, base, list, channels, tails: kept_tails, others: kept_others };
        for channel in (0..CHANNELS).filter(|&channel| base.reaches(channel)) {
            products.tails[channel] = products.sums_of_tails(channel, &tails);
            for places in others.chunks(COURSES_AT_ONCE) {
                let of_others = products.sums(channel, places);
                products.others[channel].extend(places.iter().copied().zip(of_others));
            }
        }
        products
    }

    /// Products of the course at a place of the list on a channel, `white` where it is whitened.
    pub fn products(&self, channel: usize, place: usize, white: Option<&Column>) -> OfRuns {
        if let Some(sums) = self.others[channel].get(&place) {
            return *sums;
        }
        let variation = &self.list.courses[place];
        let (from, values) = (variation.first_block(self.bank.block_s()), self.bank.values(self.base, variation));
        if let (Some(key), Some(values)) = (variation.tail(self.bank.block_s()), &values) {
            let (first, last) = values.split_at(values.len().min(key.1 - from));
            let size = last.first().map_or(0.0, |size| *size as f32);
            let mut sums = self.tails[channel][&key];
            sums.iter_mut().for_each(|sum| *sum *= size);
            for (value, block) in first.iter().zip(from..) {
                add_decayed(&mut sums, 1.0, &self.of_block(channel, block, *value));
            }
            return sums;
        }
        let mut sums = ZEROS;
        if let Some(white) = white {
            let values: Vec<f32> = white.values.iter().map(|value| *value as f32).collect();
            add_products(&mut sums, &values, &self.channels[channel].white[white.from..]);
        }
        sums
    }

    /// Products of the courses at these places on a channel.
    fn sums(&self, channel: usize, places: &[usize]) -> Vec<OfRuns> {
        let course = |place: &usize| {
            let course = &self.list.courses[*place];
            (course.first_block(self.bank.block_s()), self.bank.values(self.base, course))
        };
        let courses: Vec<_> = places.iter().map(course).collect();
        let derivatives = &self.channels[channel].derivatives;
        let mut sums = vec![ZEROS; places.len()];
        for first in (0..self.bank.block_count()).step_by(AT_ONCE) {
            let blocks = first..self.bank.block_count().min(first + AT_ONCE);
            let later = derivatives[first + 1..].iter();
            let falling = |(own, next): (&OfRuns, &OfRuns)| std::array::from_fn(|run| own[run] - next[run]);
            let derivatives = match self.base.mode {
                Mode::Rate => Cow::Borrowed(&derivatives[blocks.clone()]),
                Mode::Level => Cow::Owned(derivatives[blocks.clone()].iter().zip(later).map(falling).collect()),
            };
            for ((from, values), sums) in courses.iter().zip(&mut sums) {
                let size = |block: usize| {
                    let value = match values {
                        Some(values) => block.checked_sub(*from).map_or(0.0, |index| values[index]),
                        None => 1.0,
                    };
                    (value * of_value(&self.base.series[channel], self.base.mode, block).0) as f32
                };
                let mut sizes = [0.0; AT_ONCE];
                sizes.iter_mut().zip(blocks.clone()).for_each(|(own, block)| *own = size(block));
                if sizes.iter().all(|size| *size == 0.0) {
                    continue;
                }
                add_products(sums, &sizes, &derivatives);
            }
        }
        sums
    }

    /// Sums of the courses that decay, by the bits of their decay and the block from which they do. `tails` are in order of decay, the last
    /// block first.
    fn sums_of_tails(&self, channel: usize, tails: &[(u64, usize)]) -> HashMap<(u64, usize), OfRuns> {
        let mut found = HashMap::with_capacity(tails.len());
        let mut of_decays: Vec<_> = tails.chunk_by(|one, other| one.0 == other.0).map(|same| (same, ZEROS)).collect();
        for block in (0..self.bank.block_count()).rev() {
            for (left, sums) in &mut of_decays {
                let count = left.partition_point(|(_, from)| *from > block);
                let (done, later) = left.split_at(count);
                found.extend(done.iter().map(|key| (*key, *sums)));
                *left = later;
            }
            of_decays.retain(|(left, _)| !left.is_empty());
            if of_decays.is_empty() {
                break;
            }
            let products = self.of_block(channel, block, 1.0);
            for (left, sums) in &mut of_decays {
                add_decayed(sums, f64::from_bits(left[0].0) as f32, &products);
            }
        }
        found.extend(of_decays.iter().flat_map(|(left, sums)| left.iter().map(|key| (*key, *sums))));
        found
    }

    /// Products of a course with this value in one block.
    fn of_block(&self, channel: usize, block: usize, value: f64) -> OfRuns {
        let derivatives = &self.channels[channel].derivatives;
        let (size, falls) = of_value(&self.base.series[channel], self.base.mode, block);
        let (size, falls) = ((value * size) as f32, falls as f32);
        std::array::from_fn(|run| size * (derivatives[block][run] - falls * derivatives[block + 1][run]))
    }
}

/// Multiplies sums by a decay and adds products.
#[multiversion(targets("x86_64+avx2"))]
fn add_decayed(sums: &mut OfRuns, decay: f32, products: &OfRuns) {
    sums.iter_mut().zip(products).for_each(|(sum, product)| *sum = decay * *sum + product);
}

/// Adds the sums of the values times the values of each recording.
#[multiversion(targets("x86_64+avx2"))]
fn add_products(sums: &mut OfRuns, values: &[f32], recordings: &[OfRuns]) {
    for (lanes, sums) in sums.chunks_exact_mut(LANES).enumerate() {
        let mut own: [f32; LANES] = std::array::from_fn(|lane| sums[lane]);
        for (value, runs) in values.iter().zip(recordings) {
            let runs = &runs[lanes * LANES..][..LANES];
            own.iter_mut().zip(runs).for_each(|(sum, run)| *sum += value * run);
        }
        sums.copy_from_slice(&own);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    use std::sync::Arc;

    use geu_calibration::{AccumulatedCounts, BreakKind, Discontinuity};
    use geu_model::Configuration;
    use geu_model::attitude::{AttitudeRow, RecordedAttitude};
    use geu_model::units::SAMPLE_INTERVAL_S;
    use geu_recording::ReferenceAttitude;

    use crate::diagnosis_case::DiagnosisCase;
    use crate::measured::{MeasuredData, Shifts, TIMING};
    use crate::noise;
    use crate::signature_bank::Variation;
    use crate::small_motions::SMALL_COUNTS;
    use crate::spots::Spot;
    use crate::sweep::{Swept, sweep};
    use crate::whitening::NoiseModel;
    use geu_hypothesis::amplitude::STEP;
    use geu_protocol::Gyros;

    /// Half an hour of turns about all axes, with a lost sample.
    pub(crate) fn measured(nominal: &Configuration) -> MeasuredData {
        measured_of(nominal, 3600)
    }

    /// That of a number of samples.
    pub(crate) fn measured_of(nominal: &Configuration, nodes: usize) -> MeasuredData {
        let row = |node: usize| AttitudeRow {
            t_s: node as f64 * SAMPLE_INTERVAL_S,
            angle_control_arcsec: [200, 310, 170]
                .map(|nodes| if (node / nodes).is_multiple_of(2) { 3.0 } else { -50.0 }),
            theta_psi_rad: Some((1.5, 0.0)),
        };
        let rows: Vec<AttitudeRow> = (0..=nodes).map(row).collect();
        let truth = Arc::new(RecordedAttitude::new(rows).expect("a truth"));
        let mut counts = AccumulatedCounts::starting_at(0);
        // The temperature of an orbit.
        let electronics_c = |node: usize| 20.0 + 5.0 * (node as f64 / 2_000.0).sin();
        (1..=nodes).for_each(|node| counts.push(node as f64 * SAMPLE_INTERVAL_S, &[0.0; 4], electronics_c(node)));
        counts.breaks = vec![Discontinuity { from: 1800, to: 1801, gyros: Gyros::ALL, kind: BreakKind::Gap(1) }];
        let reference = ReferenceAttitude::of_truth(0, truth);
        MeasuredData::new(counts, &reference, nominal).expect("long enough")
    }

    /// Noise as configured, with rounding along the model's path.
    pub(crate) fn configured_noise(case: &DiagnosisCase) -> [NoiseModel; CHANNELS] {
        let DiagnosisCase { measured, nominal, .. } = *case;
        let residual = measured.residual(&measured.run(nominal, Shifts::default()));
        noise::configured(nominal, measured, &case.rounding, &residual)
    }

    #[test]
    fn sums_from_the_end_equal_the_products_of_whitened_courses() {
        let nominal = Configuration::reference();
        let measured = measured(&nominal);
        let case = DiagnosisCase::new(&measured, &nominal);
        let noise = configured_noise(&case);
        let normal = case.fit(&mut case.start(noise));
        let bank = SignatureBank::new(&measured, &nominal);
        let blocks = measured.block_count();
        let drawn = |run: usize| -> Series {
            std::array::from_fn(|channel| {
                let value =
                    |block: usize| ((run * 7919 + channel * 104_729 + block * block * 31) % 1009) as f64 - 504.0;
                (0..blocks).filter(|_| channel < 4).map(value).collect()
            })
        };
        let channels = null_channels(&normal, (0..RUNS).map(drawn).collect());
        let mut compared = [0, 0];
        for base in bank.bases.iter().filter(|base| base.is_linear) {
            let products = NullProducts::new(&bank, base, &channels);
            let is_kept = |own: &&Variation| own.is_of_time() && !matches!(own, Variation::Onset { .. });
            for (place, variation) in products.list.courses.iter().enumerate().filter(|own| is_kept(&own.1)) {
                for (channel, column) in bank.columns(base, variation).into_iter().enumerate() {
                    let Some(Column { from, values }) = column else { continue };
                    let values = case.whitenings(&noise)[channel].apply_from(from, &values);
                    let recordings = &channels[channel].white[from..];
                    let expected: OfRuns = std::array::from_fn(|run| {
                        let products = values.iter().zip(recordings).map(|(value, runs)| value * f64::from(runs[run]));
                        products.sum::<f64>() as f32
                    });
                    let size = values.iter().map(|value| value * value).sum::<f64>().sqrt() as f32 * 504.0;
                    let found = products.products(channel, place, None);
                    // Rounding of f32 sums over 360 blocks; a block more or less would change them by one in twenty.
                    let is_equal = |(one, other): (&f32, &f32)| (one - other).abs() <= 1e-3 * size;
                    assert!(found.iter().zip(&expected).all(is_equal), "{:?} {variation:?}", base.amplitude);
                    compared[usize::from(base.mode == Mode::Level)] += 1;
                }
            }
        }
        assert!(compared.iter().all(|count| *count > 100), "{compared:?}");
    }

    #[test]
    fn vectors_change_no_bit() {
        let number = |seed: usize| ((seed * 7919) % 1009) as f32 * 1e-3 - 0.5;
        let recordings: Vec<OfRuns> =
            (0..300).map(|block| std::array::from_fn(|run| number(block * RUNS + run))).collect();
        let values: Vec<f32> = (0..300).map(|block| number(block * 31 + 7)).collect();
        let (mut products, mut decayed) = (ZEROS, ZEROS);
        add_products(&mut products, &values, &recordings);
        recordings.iter().for_each(|own| add_decayed(&mut decayed, 0.99, own));
        for run in 0..RUNS {
            let sum = values.iter().zip(&recordings).fold(0.0f32, |sum, (value, runs)| sum + value * runs[run]);
            assert_eq!(products[run].to_bits(), sum.to_bits());
            let sum = recordings.iter().fold(0.0f32, |sum, runs| 0.99 * sum + runs[run]);
            assert_eq!(decayed[run].to_bits(), sum.to_bits());
        }
    }

    #[test]
    fn signatures_without_small_motions_have_products_of_their_own() {
        let nominal = Configuration::reference();
        let measured = measured(&nominal);
        let case = DiagnosisCase::new(&measured, &nominal);
        let path = measured.run(&nominal, Shifts::default());
        let noise = noise::configured(&nominal, &measured, &case.rounding, &measured.residual(&path));
        let normal = case.fit(&mut case.start(noise));
        let whole = SignatureBank::new(&measured, &nominal);
        let at_rest = path.map(|channel| Arc::new(vec![0.0; channel.len()]));
        let largest = |bank: &SignatureBank, index: usize| {
            let mut largest = 0.0f64;
            sweep(
                bank,
                &normal,
                &bank.bases[index],
                [true; CHANNELS],
                |_, _, _| (),
                |_, swept: &Swept<()>| {
                    largest = largest.max(swept.gain(|_| true).map_or(0.0, |gain| gain.chi2));
                },
            );
            largest
        };
        let reduced = whole.clone().without_small_motions(&measured, &at_rest, &[SMALL_COUNTS; TIMING]);
        let index = whole.bases.iter().position(|base| base.amplitude.filters_motion()).expect("a lag");
        assert_eq!(largest(&reduced, index), 0.0);
        assert!(largest(&whole, index) > 0.0);
    }

    #[test]
    fn the_likeliest_step_is_that_of_steps_fitted_one_by_one() {
        let nominal = Configuration::reference();
        let measured = measured(&nominal);
        let case = DiagnosisCase::new(&measured, &nominal);
        let noise = configured_noise(&case);
        let normal = case.fit(&mut case.start(noise));
        let bank = SignatureBank::new(&measured, &nominal);
        let spacing_s = bank.step_spacing_s(Mode::Level).expect("an exact reference");
        let step = |onset: usize| Variation::Course { kind: STEP, shapes: vec![onset as f64 * spacing_s] };
        let count = (bank.block_count() as f64 * bank.block_s() / spacing_s) as usize;
        let mut compared = 0;
        for index in (0..bank.bases.len()).filter(|&index| bank.bases[index].mode == Mode::Level) {
            if bank.bases[index].amplitude.with(STEP).is_none() {
                continue;
            }
            let fit = |onset: usize| Spot::fit(&bank, &normal, index, step(onset), Gyros::ALL);
            let Some(largest) =
                (1..count).filter_map(fit).max_by(|one, other| one.gain.chi2.total_cmp(&other.gain.chi2))
            else {
                continue;
            };
            let found_s = largest.likeliest_step_s(&bank, &normal, spacing_s, |_| true).expect("a step");
            let found = fit((found_s / spacing_s).round() as usize).expect("a fit").gain.chi2;
            assert!((found - largest.gain.chi2).abs() <= 1e-9 * largest.gain.chi2, "{:?}", bank.bases[index].amplitude);
            compared += 1;
        }
        assert!(compared > 0);
    }
}
