use super::*;
use crate::measured::BLOCK;
use geu_model::noise::{Flicker, NoiseStream};
use geu_model::units::S_PER_H;

const BLOCK_S: f64 = 5.0;
const ROUNDING: BlockRounding =
    BlockRounding { variance: 0.05, correlation: 0.7, second_difference: 0.1, ..BlockRounding::NONE };

const NOISE: NoiseModel =
    NoiseModel { white: 1.0 / 120.0, angle_walk: 0.01, rate_walk: 8e-6, scale_walk: 0.0, flicker: 0.0 };

/// A filter of blocks of which one is broken, and two series of draws.
fn broken(flicker: f64, count: usize) -> (Whitening, [Vec<f64>; 2]) {
    let mut blocks = vec![Block::COMPARED; count];
    blocks[90] = Block::BROKEN;
    let noise = NoiseModel { flicker, ..NOISE };
    let mut state = 3;
    let series = std::array::from_fn(|_| (0..count).map(|_| draw(&mut state)).collect());
    (Whitening::new(&noise, &blocks, &vec![ROUNDING; count], BLOCK_S), series)
}

/// Draws that need no generator: a quadratic residue sequence, of variance 1/12 about 0.
fn draw(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
}

#[test]
fn transposed_filter_gives_the_product_with_a_whitened_series() {
    let (whitening, [series, other]) = broken(5.0, 300);
    for from in [0, 40] {
        let white = whitening.apply_from(from, &series[from..]);
        let product: f64 = white.iter().zip(&other[from..]).map(|(one, other)| one * other).sum();
        let derivatives = whitening.transposed(&other);
        let increments = series[from..].windows(2).map(|pair| pair[1] - pair[0]);
        let increments = std::iter::once(series[from]).chain(increments);
        let transposed: f64 = increments.zip(&derivatives[from..]).map(|(one, other)| one * other).sum();
        assert!((product - transposed).abs() < 1e-9 * product.abs().max(1.0), "{product} {transposed}");
    }
}

#[test]
fn a_further_trial_has_a_drift_of_its_own() {
    let noise = NoiseModel { white: 0.01, angle_walk: 0.1, rate_walk: 0.0, scale_walk: 0.0, flicker: 0.0 };
    let mut blocks = vec![Block::COMPARED; 200];
    blocks[100] = Block { begins_trial: true, ..Block::BROKEN };
    let slope: Vec<f64> = (0..200).map(|block| if block < 100 { 0.0 } else { 70.0 * f64::from(block) }).collect();
    let white =
        |blocks: &[Block]| Whitening::new(&noise, blocks, &vec![BlockRounding::NONE; 200], BLOCK_S).apply(&slope);
    assert!(white(&blocks).iter().all(|own| own.abs() < 0.1));
    blocks[100].begins_trial = false;
    assert!(white(&blocks).iter().any(|own| own.abs() > 100.0));
}

#[test]
fn several_series_are_whitened_as_one() {
    for flicker in [0.0, 5.0] {
        let noise = NoiseModel { flicker, ..NOISE };
        let blocks = vec![Block::COMPARED; 300];
        let whitening = Whitening::new(&noise, &blocks, &vec![ROUNDING; blocks.len()], BLOCK_S);
        let mut state = 3;
        let series: [Vec<f64>; 3] = std::array::from_fn(|_| (0..300).map(|_| draw(&mut state)).collect());
        let expected = series.each_ref().map(|own| whitening.apply_from(40, &own[40..]));
        let increments =
            |block: usize| series.each_ref().map(|own| own[block] - if block == 40 { 0.0 } else { own[block - 1] });
        whitening.pass(40..300, increments, |block, white| {
            for (white, expected) in white.iter().zip(&expected) {
                let expected = expected[block - 40];
                assert!((white - expected).abs() < 1e-9, "{flicker} {block}: {white} {expected}");
            }
        });
    }
}

#[test]
fn tails_equal_whitened_courses() {
    let (whitening, [sizes, other]) = broken(0.0, 200);
    let derivatives = whitening.transposed(&other);
    for falls in [0.0, 1.0] {
        let decays = [1.0, 0.97];
        let mut compared = 0;
        whitening.tails(
            whitening.forms().unwrap(),
            &|block| (sizes[block], falls),
            decays,
            &[&derivatives],
            |block, tail| {
                for (lane, decay) in decays.into_iter().enumerate() {
                    for lead in [&[1.0][..], &[0.2, 0.7, 1.1]] {
                        let Some(first) = (block + 1).checked_sub(lead.len()) else { continue };
                        let mut values: Vec<f64> = lead.to_vec();
                        values.extend((0..199 - block).scan(lead[lead.len() - 1], |value, _| {
                            *value *= decay;
                            Some(*value)
                        }));
                        let (mut sum, mut before) = (0.0, 0.0);
                        let of_block = |(block, value): (usize, &f64)| {
                            let own = sizes[block] * value;
                            sum += own - falls * std::mem::replace(&mut before, own);
                            sum
                        };
                        let series: Vec<f64> = (first..).zip(&values).map(of_block).collect();
                        let white = whitening.apply_from(first, &series);
                        let square: f64 = white.iter().map(|white| white * white).sum();
                        let product: f64 = white.iter().zip(&other[first..]).map(|(one, other)| one * other).sum();
                        let found = tail.course(lane, block, lead);
                        let off = (found.square - square).abs();
                        assert!(off < 1e-9 * square.max(1.0), "{block} {lane}: {found:?} {square}");
                        let off = (found.products[0] - product).abs();
                        assert!(off < 1e-9 * square.max(1.0), "{found:?} {product}");
                        compared += 1;
                    }
                }
            },
        );
        assert_eq!(compared, 4 * 200 - 4);
    }
}

#[test]
fn products_of_two_tails_equal_those_of_whitened_courses() {
    let (whitening, [sizes, _]) = broken(0.0, 200);
    // The first begins with the recording, the second later, in part in its first block.
    let [one, other] = [(0, 0.4), (37, 0.7)].map(|(first, begun): (usize, f64)| {
        let value = |block: usize| {
            if block < first {
                0.0
            } else if block == first {
                begun
            } else {
                1.0
            }
        };
        (0..200).map(value).collect::<Vec<f64>>()
    });
    for falls in [0.0, 1.0] {
        let increment = |values: &[f64], block: usize| {
            let before = block.checked_sub(1).map_or(0.0, |before| sizes[before] * values[before]);
            sizes[block] * values[block] - falls * before
        };
        let white = [&one, &other].map(|values| {
            let mut sum = 0.0;
            let of_block = |block: usize| {
                sum += increment(values, block);
                sum
            };
            whitening.apply(&(0..200).map(of_block).collect::<Vec<f64>>())
        });
        let product: f64 = white[0].iter().zip(&white[1]).map(|(one, other)| one * other).sum();
        let mut states = Vec::new();
        whitening.states::<1>(0..38, |block| [increment(&one, block)], |_, state| states.push(*state));
        let state = states[37].map(|[own]| own);
        let mut found = Vec::new();
        whitening.tails(whitening.forms().unwrap(), &|block| (sizes[block], falls), [1.0], &[], |block, tail| {
            // Wherever the parts end.
            if (38..=50).contains(&block) || block == 199 {
                let first = CoursePart { state, before: one[36], values: &one[37..=block] };
                let second = CoursePart { state: FilterState::default(), before: 0.0, values: &other[37..=block] };
                found.push(tail.product(0, block, [first, second]));
            }
        });
        assert_eq!(found.len(), 14);
        for found in found {
            assert!((found - product).abs() < 1e-9 * product.abs().max(1.0), "{falls}: {found} {product}");
        }
    }
}

#[test]
fn a_count_that_flips_at_rest_is_no_evidence() {
    let noise = NoiseModel { white: 1e-6, angle_walk: 0.005, rate_walk: 0.0, scale_walk: 0.0, flicker: 0.0 };
    let blocks = vec![Block::COMPARED; 20_000];
    let rest = BlockRounding { variance: 1.0 / 12.0, correlation: 1.0, ..BlockRounding::NONE };
    let (mut state, mut angle) = (1u64, 0.4);
    let counts = |_: &Block| {
        angle += noise.angle_walk * BLOCK_S.sqrt() * (0..12).map(|_| draw(&mut state)).sum::<f64>();
        f64::round(angle)
    };
    let series: Vec<f64> = blocks.iter().map(counts).collect();
    assert!(series.windows(2).filter(|pair| pair[0] != pair[1]).count() > 50);
    let white = Whitening::new(&noise, &blocks, &vec![rest; blocks.len()], BLOCK_S).apply(&series);
    let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_999.0;
    // Less than 1: while a count stays, the walk and the rounding error are opposite.
    assert!((0.6..1.1).contains(&variance), "{variance}");
}

#[test]
fn whitened_walks_are_white_across_a_break() {
    for (angle_walk, flicker) in [(0.01, 0.0), (0.3, 0.0), (0.01, 20.0)] {
        let noise = NoiseModel { white: 1.0 / 120.0, angle_walk, rate_walk: 8e-6, scale_walk: 0.0, flicker };
        let mut stream = NoiseStream::of_sensor(1, "flicker");
        let mut processes = Flicker::stationary(&mut stream);
        let mut blocks = vec![Block::COMPARED; 20_000];
        blocks[9_000] = Block::BROKEN;
        let (mut state, mut angle, mut rate) = (1u64, 0.0, 0.0);
        let mut normal = || (0..12).map(|_| draw(&mut state)).sum::<f64>();
        let step_s = BLOCK_S / BLOCK as f64;
        let series: Vec<f64> = (0..blocks.len())
            .map(|block| {
                let of_node = |_| {
                    rate += noise.rate_walk * step_s.sqrt() * normal();
                    let drift = rate + flicker / S_PER_H * processes.advance(step_s, &mut stream);
                    angle += drift * step_s + noise.angle_walk * step_s.sqrt() * normal();
                    angle
                };
                let average = (0..BLOCK).map(of_node).sum::<f64>() / BLOCK as f64;
                let jump = if block > 9_000 { 1e6 } else { 0.0 };
                average + jump + noise.white.sqrt() * normal()
            })
            .collect();
        let white = Whitening::new(&noise, &blocks, &vec![BlockRounding::NONE; blocks.len()], BLOCK_S).apply(&series);
        let variance = white.iter().map(|value| value * value).sum::<f64>() / 19_997.0;
        let neighbours = white.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / 19_997.0;
        // Four deviations: √(2/20 000) and √(1/20 000).
        assert!((variance - 1.0).abs() < 0.04 && neighbours.abs() < 0.029, "{variance} {neighbours}");
        // 200 sums; four deviations of their variance, √(2/200).
        let slow = white.chunks(100).map(|some| some.iter().sum::<f64>().powi(2) / 100.0).sum::<f64>() / 200.0;
        assert!((slow - 1.0).abs() < 0.4, "{slow}");
        assert_eq!(white[9_001], 0.0);
    }
}
