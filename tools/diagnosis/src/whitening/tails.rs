//! Whitened courses from each block to the end of a recording: their squares and products, in one pass from the end.
//!
//! The square of the innovations from a block on is a quadratic form of the filter's state before that block. Where the value of a
//! course decays from block to block by a constant factor, the form of a block follows from the next block's, and gives the squares of all
//! courses that begin there.

use std::ops::Range;

use super::Whitening;

/// FilterState of the filter without flicker: what the innovation before leaves less what is predicted, the turn by the rate, the rounding error.
const STATE: usize = 3;
pub type FilterState = [f64; STATE];

/// The form of the blocks after one.
#[derive(Debug, Clone, Copy)]
struct BlockForm {
    /// Form of the state before the next block.
    after: [FilterState; STATE],
    /// The form's product with what an innovation of 1 leaves.
    turned: FilterState,
    /// Square of the innovations after an increment of 1.
    square: f64,
}

/// The forms of all blocks.
#[derive(Debug, Clone)]
pub struct Forms(Vec<BlockForm>);

/// Increment of a signature in a block per value of its course there, and the share of it that falls again in the next block.
pub trait Increment: Fn(usize) -> (f64, f64) {}
impl<F: Fn(usize) -> (f64, f64)> Increment for F {}

/// The later blocks per value of the course in the next one: of the square of the innovations the parts linear in the state and independent
/// of it, and the products.
#[derive(Debug, Clone)]
struct Later<const LANES: usize> {
    linear: [[f64; LANES]; STATE],
    square: [f64; LANES],
    products: Vec<[f64; LANES]>,
}

/// Courses of several decays that begin at or before a block.
pub struct Tail<'a, const LANES: usize, I> {
    whitening: &'a Whitening,
    forms: &'a Forms,
    increment: &'a I,
    derivatives: &'a [&'a [f64]],
    decays: [f64; LANES],
    later: Later<LANES>,
}

/// A course from a block on: the filter's state before it, the value in the block before, and the values.
#[derive(Debug, Clone, Copy)]
pub struct CoursePart<'a> {
    pub state: FilterState,
    pub before: f64,
    pub values: &'a [f64],
}

/// Square and products of a whitened course.
#[derive(Debug, Clone, PartialEq)]
pub struct TailProducts {
    pub square: f64,
    pub products: Vec<f64>,
}

impl Whitening {
    /// The forms; `None` with flicker.
    pub fn forms(&self) -> Option<&Forms> {
        let forms = || {
            self.slow_gains.is_empty().then(|| {
                let mut after = [[0.0; STATE]; STATE];
                let mut forms: Vec<BlockForm> =
                    (0..self.steps.len()).rev().map(|block| self.form(block, &mut after)).collect();
                forms.reverse();
                Forms(forms)
            })
        };
        self.forms.get_or_init(forms).as_ref()
    }

    /// The form of a block, of those after it; `after` becomes that of the state before this block.
    fn form(&self, block: usize, after: &mut [FilterState; STATE]) -> BlockForm {
        let left = self.left_by_innovation(block);
        let turned: FilterState =
            std::array::from_fn(|row| (0..STATE).map(|column| after[row][column] * left[column]).sum());
        let weight = self.steps[block].weight.powi(2);
        let square = weight + (0..STATE).map(|row| left[row] * turned[row]).sum::<f64>();
        let form = BlockForm { after: *after, turned, square };
        let columns: [FilterState; STATE] = std::array::from_fn(|index| {
            let mut unit = [0.0; STATE];
            unit[index] = 1.0;
            self.advanced(block, &unit, unit[0])
        });
        let product = |one: &FilterState, other: &FilterState| -> f64 {
            (0..STATE)
                .map(|row| one[row] * (0..STATE).map(|column| form.after[row][column] * other[column]).sum::<f64>())
                .sum()
        };
        *after = std::array::from_fn(|row| std::array::from_fn(|column| product(&columns[row], &columns[column])));
        after[0][0] += weight;
        form
    }

    /// FilterState after a block in which the innovation was 1 and the state 0.
    fn left_by_innovation(&self, block: usize) -> FilterState {
        let step = &self.steps[block];
        [step.remainder, step.gains[0], step.gains[1]]
    }

    /// FilterState after a block.
    fn advanced(&self, block: usize, state: &FilterState, innovation: f64) -> FilterState {
        let (left, persistence) = (self.left_by_innovation(block), self.steps[block].persistence);
        [
            left[0] * innovation - state[1] - (persistence - 1.0) * state[2],
            left[1] * innovation + state[1],
            left[2] * innovation + persistence * state[2],
        ]
    }

    /// Passes the state before each block to `visit`, of several courses given by their increments.
    pub fn states<const LANES: usize>(
        &self,
        blocks: Range<usize>,
        mut increments: impl FnMut(usize) -> [f64; LANES],
        mut visit: impl FnMut(usize, &[[f64; LANES]; STATE]),
    ) {
        let mut state = [[0.0; LANES]; STATE];
        for block in blocks {
            visit(block, &state);
            let increments = increments(block);
            let of_lane = |lane: usize| {
                let own = state.map(|lanes| lanes[lane]);
                self.advanced(block, &own, increments[lane] + own[0])
            };
            let after: [FilterState; LANES] = std::array::from_fn(of_lane);
            state = std::array::from_fn(|row| after.map(|own| own[row]));
        }
    }

    /// Passes the courses that begin at each block to `visit`, the last block first. [`Whitening::transposed`] gives the
    /// `derivatives` of products by the increments.
    pub fn tails<const LANES: usize, I: Increment>(
        &self,
        forms: &Forms,
        increment: &I,
        decays: [f64; LANES],
        derivatives: &[&[f64]],
        mut visit: impl FnMut(usize, &Tail<LANES, I>),
    ) {
        let later = Later {
            linear: [[0.0; LANES]; STATE],
            square: [0.0; LANES],
            products: vec![[0.0; LANES]; derivatives.len()],
        };
        let mut tail = Tail { whitening: self, forms, increment, derivatives, decays, later };
        for block in (0..self.steps.len()).rev() {
            visit(block, &tail);
            if block > 0 {
                tail.include(block);
            }
        }
    }
}

impl<const LANES: usize, I: Increment> Tail<'_, LANES, I> {
    /// Includes a block, which is not the first of a course.
    fn include(&mut self, block: usize) {
        let BlockForm { turned, square, .. } = self.forms.0[block];
        let left = self.whitening.left_by_innovation(block);
        let (persistence, weight) =
            (self.whitening.steps[block].persistence, self.whitening.steps[block].weight.powi(2));
        let ((size, _), (before, falls)) = ((self.increment)(block), (self.increment)(block - 1));
        let Later { linear, square: sum, products } = &mut self.later;
        let mut increments = [0.0; LANES];
        for lane in 0..LANES {
            let decay = self.decays[lane];
            let increment = size - falls * before / decay;
            let after: FilterState = std::array::from_fn(|row| decay * linear[row][lane]);
            let through: f64 = (0..STATE).map(|row| after[row] * left[row]).sum();
            sum[lane] = square * increment * increment + 2.0 * increment * through + decay * decay * sum[lane];
            let own: FilterState = std::array::from_fn(|row| turned[row] * increment + after[row]);
            linear[0][lane] = (0..STATE).map(|row| left[row] * own[row]).sum::<f64>() + weight * increment;
            linear[1][lane] = own[1] - own[0];
            linear[2][lane] = persistence * own[2] - (persistence - 1.0) * own[0];
            increments[lane] = increment;
        }
        for (product, derivatives) in products.iter_mut().zip(self.derivatives) {
            for lane in 0..LANES {
                product[lane] = self.decays[lane] * product[lane] + increments[lane] * derivatives[block];
            }
        }
    }

    /// Product of two courses with these parts of equal length up to this block, which both decay from there on as the lane does.
    pub fn product(&self, lane: usize, block: usize, parts: [CoursePart; 2]) -> f64 {
        debug_assert_eq!(parts[0].values.len(), parts[1].values.len());
        let first = block + 1 - parts[0].values.len();
        let before = first.checked_sub(1).map_or((0.0, 0.0), |before| (self.increment)(before));
        let mut states = parts.map(|part| part.state);
        let mut falling = parts.map(|part| before.1 * before.0 * part.before);
        let mut sum = 0.0;
        for (place, block) in (first..=block).enumerate() {
            let (size, falls) = (self.increment)(block);
            let mut product = self.whitening.steps[block].weight.powi(2);
            for (part, (state, falling)) in parts.iter().zip(states.iter_mut().zip(&mut falling)) {
                let value = size * part.values[place];
                let innovation = value - *falling + state[0];
                *falling = falls * value;
                *state = self.whitening.advanced(block, state, innovation);
                product *= innovation;
            }
            sum += product;
        }
        let next = parts.map(|part| self.decays[lane] * part.values.last().copied().unwrap_or(0.0));
        let after = &self.forms.0[block].after;
        for row in 0..STATE {
            let [one, other] = states.map(|state| state[row]);
            let quadratic: f64 = (0..STATE).map(|column| after[row][column] * states[1][column]).sum();
            sum += one * quadratic + (next[1] * one + next[0] * other) * self.later.linear[row][lane];
        }
        sum + next[0] * next[1] * self.later.square[lane]
    }

    /// The course that begins with these values up to this block, and decays from there on.
    pub fn course(&self, lane: usize, block: usize, values: &[f64]) -> TailProducts {
        let first = block + 1 - values.len();
        let part = CoursePart { state: [0.0; STATE], before: 0.0, values };
        let mut all =
            TailProducts { square: self.product(lane, block, [part; 2]), products: vec![0.0; self.derivatives.len()] };
        let mut falling = 0.0;
        for (block, value) in (first..).zip(values) {
            let (size, falls) = (self.increment)(block);
            let increment = size * value - falling;
            falling = falls * size * value;
            let products = all.products.iter_mut().zip(self.derivatives);
            products.for_each(|(product, derivatives)| *product += increment * derivatives[block]);
        }
        let next = self.decays[lane] * values.last().copied().unwrap_or(0.0);
        let products = all.products.iter_mut().zip(&self.later.products);
        products.for_each(|(product, later)| *product += next * later[lane]);
        all
    }
}
