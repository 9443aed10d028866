//! Least squares on whitened channels: nuisances are projected out of the residual and of every signature, and the three thirds of
//! the recording are kept apart, so that each can be foretold from the other two.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use geu_model::package::Calibration;

use crate::amplitude::calibration_parameters;
use crate::bank::Column;
use crate::measured::{CHANNELS, Series};
use crate::whitening::Whitening;

/// Parts of the recording, each held out in turn.
pub const THIRDS: usize = 3;
/// Of the diagonal: what keeps a direction solvable of which the data tell nothing.
pub(crate) const RIDGE: f64 = 1e-10;
/// How much calibration numbers may move at all, one sigma in the order of [`Calibration::NUMBERS`]: what a launch does to a scale
/// factor (Casteren table 1), and as much wider than an arcminute (§3.4) and a drift. What the motion does not tell stays within; what
/// it tells hardly feels it.
const LOOSE: [f64; Calibration::NUMBERS.len()] = [2000e-6, 600.0 / 7200.0, 300.0, 300.0, 300.0];
/// The same for a fit to two thirds: what they tell by less than this share of what all tell is taken as untold.
const HELD_OUT_RIDGE: f64 = 1e-4;
/// A third without which less than this share of what tells a size is left cannot be foretold.
const LEAST_KNOWN: f64 = 0.2;
/// A signature of which the nuisances leave less than this share cannot be told from them.
const LEAST_LEFT: f64 = 1e-4;

/// Column of a nuisance: for each channel that it reaches, averages over blocks.
pub type Nuisance = [Option<Vec<f64>>; CHANNELS];

/// The residual and the nuisances.
#[derive(Debug)]
pub struct NormalEquations {
    whitenings: [Whitening; CHANNELS],
    /// First block of each third, and the end.
    bounds: [usize; THIRDS + 1],
    /// Whitened.
    residual: Series,
    columns: Vec<Nuisance>,
    /// Products, for each third.
    gram: [DMatrix<f64>; THIRDS],
    right: [DVector<f64>; THIRDS],
    squares: [f64; THIRDS],
    /// Of what the sixteen have moved by, over what they may.
    known_squares: f64,
    /// Of the whole, scaled to a diagonal of ones; what a column is divided by.
    factor: Cholesky<f64, Dyn>,
    scale: DVector<f64>,
    solved: DVector<f64>,
}

/// Products of one signature, with itself, with the residual, with the nuisances; for each third. Those of channels add up.
#[derive(Debug, Clone)]
pub struct Products {
    own: [f64; THIRDS],
    residual: [f64; THIRDS],
    nuisances: [Vec<f64>; THIRDS],
}

/// A signature, or the part of one on one channel, beside the nuisances. Parts add up.
#[derive(Debug, Clone)]
pub struct ProjectedSignature {
    own: f64,
    right: f64,
    part: DVector<f64>,
}

impl ProjectedSignature {
    /// What is left of the square of a sum of parts; nothing where it cannot be told from the nuisances.
    fn projected_residual(parts: &[&ProjectedSignature]) -> Option<f64> {
        let own: f64 = parts.iter().map(|part| part.own).sum();
        let pairs = parts.iter().flat_map(|one| parts.iter().map(|other| one.part.dot(&other.part)));
        let left = own - pairs.sum::<f64>();
        (left > LEAST_LEFT * own && own > 0.0).then_some(left)
    }

    /// The sum of two signatures on one channel, each times its factor; `both` is the product of the two, whitened.
    #[must_use]
    pub fn sum(
        (one_factor, one): (f64, &ProjectedSignature),
        (other_factor, other): (f64, &ProjectedSignature),
        both: f64,
    ) -> ProjectedSignature {
        let mut part = &one.part * one_factor;
        part.axpy(other_factor, &other.part, 1.0);
        ProjectedSignature {
            own: one_factor.powi(2) * one.own
                + 2.0 * one_factor * other_factor * both
                + other_factor.powi(2) * other.own,
            right: one_factor * one.right + other_factor * other.right,
            part,
        }
    }

    /// What a sum of parts explains; nothing where it cannot be told from the nuisances.
    pub fn gain(parts: &[&ProjectedSignature]) -> Option<SignatureFit> {
        let left = ProjectedSignature::projected_residual(parts)?;
        let right: f64 = parts.iter().map(|part| part.right).sum();
        Some(SignatureFit { size: right / left, sigma: left.sqrt().recip(), chi2: right * right / left })
    }
}

/// What a signature explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignatureFit {
    /// Its size.
    pub size: f64,
    /// One sigma of that.
    pub sigma: f64,
    /// By how much χ² falls.
    pub chi2: f64,
}

impl NormalEquations {
    /// Takes the residual and the nuisances, not whitened yet; the first of these are the sixteen, as believed.
    pub fn new(whitenings: [Whitening; CHANNELS], residual: &Series, nuisances: &[Nuisance]) -> NormalEquations {
        NormalEquations::departed(whitenings, residual, nuisances, &[])
    }

    /// The same of a state in which the sixteen have moved by so much.
    pub fn departed(
        whitenings: [Whitening; CHANNELS],
        residual: &Series,
        nuisances: &[Nuisance],
        moved: &[f64],
    ) -> NormalEquations {
        let blocks = residual[0].len();
        let bounds = std::array::from_fn(|third| blocks * third / THIRDS);
        let residual: Series = std::array::from_fn(|channel| whitenings[channel].apply(&residual[channel]));
        let white = |column: &Nuisance| -> Nuisance {
            std::array::from_fn(|channel| column[channel].as_ref().map(|values| whitenings[channel].apply(values)))
        };
        let columns: Vec<Nuisance> = nuisances.iter().map(white).collect();
        let count = columns.len();
        let mut normal = NormalEquations {
            whitenings,
            bounds,
            squares: [0.0; THIRDS],
            known_squares: 0.0,
            gram: std::array::from_fn(|_| DMatrix::zeros(count, count)),
            right: std::array::from_fn(|_| DVector::zeros(count)),
            residual,
            columns,
            factor: Cholesky::new(DMatrix::identity(count, count)).expect("the identity is positive"),
            scale: DVector::from_element(count, 1.0),
            solved: DVector::zeros(count),
        };
        for third in 0..THIRDS {
            let range = bounds[third]..bounds[third + 1];
            for channel in 0..CHANNELS {
                let residual = &normal.residual[channel][range.clone()];
                normal.squares[third] += dot(residual, residual);
                for (i, one) in normal.columns.iter().enumerate() {
                    let Some(one) = &one[channel] else { continue };
                    let one = &one[range.clone()];
                    normal.right[third][i] += dot(one, residual);
                    for (j, other) in normal.columns.iter().enumerate().take(i + 1) {
                        if let Some(other) = &other[channel] {
                            normal.gram[third][(i, j)] += dot(one, &other[range.clone()]);
                        }
                    }
                }
            }
            let gram = &mut normal.gram[third];
            for i in 0..count {
                for j in 0..i {
                    gram[(j, i)] = gram[(i, j)];
                }
            }
        }
        let gram: DMatrix<f64> = normal.gram.iter().sum();
        let right: DVector<f64> = normal.right.iter().sum();
        normal.scale = DVector::from_fn(count, |i, _| if gram[(i, i)] > 0.0 { 1.0 / gram[(i, i)].sqrt() } else { 0.0 });
        let (mut known, mut right) = (gram, right);
        for (index, (_, number)) in calibration_parameters().into_iter().enumerate().take(count) {
            let (moved, weight) = (moved.get(index).copied().unwrap_or(0.0), LOOSE[number].powi(-2));
            known[(index, index)] += weight;
            right[index] -= weight * moved;
            normal.known_squares += weight * moved * moved;
        }
        normal.factor = factored(&known, &normal.scale, RIDGE);
        normal.solved = lower(&normal.factor, &normal.scale.component_mul(&right));
        normal
    }

    /// The whitened residual, as it stands.
    pub fn residual(&self) -> &Series {
        &self.residual
    }

    /// How many nuisances there are.
    pub fn nuisances(&self) -> usize {
        self.columns.len()
    }

    /// χ² beside the nuisances.
    pub fn chi2(&self) -> f64 {
        self.squares() - self.solved.norm_squared()
    }

    /// −2 ln of the likelihood beside the nuisances, but for a constant: that of the data without what the nuisances take.
    pub fn deviance(&self) -> f64 {
        let determinants = self.whitenings.iter().map(|whitening| whitening.log_determinant).sum::<f64>();
        let told = (0..self.scale.len()).filter(|&index| self.scale[index] > 0.0);
        let diagonal = |index: usize| self.factor.l_dirty()[(index, index)];
        self.chi2() + determinants + told.map(|index| 2.0 * (diagonal(index) / self.scale[index]).ln()).sum::<f64>()
    }

    /// Squares of the whitened residual as it stands, and of what the sixteen have moved by.
    pub fn squares(&self) -> f64 {
        self.squares.iter().sum::<f64>() + self.known_squares
    }

    /// The nuisances, fitted, and their covariance.
    pub fn solution(&self) -> (DVector<f64>, DMatrix<f64>) {
        let upper = |right: &DVector<f64>| {
            let l = self.factor.l_dirty();
            l.tr_solve_lower_triangular(right).expect("a diagonal without zeros")
        };
        let solved = upper(&self.solved).component_mul(&self.scale);
        let inverse = self.factor.inverse();
        let scale = DMatrix::from_diagonal(&self.scale);
        let mut covariance = &scale * inverse * &scale;
        // Of what the data tell nothing.
        (0..self.scale.len()).filter(|&index| self.scale[index] == 0.0).for_each(|index| {
            covariance[(index, index)] = f64::INFINITY;
        });
        (solved, covariance)
    }

    /// The whitened residual beside the nuisances.
    pub fn left(&self) -> Series {
        self.left_of_white(self.residual.clone())
    }

    /// Another residual, whitened, beside the nuisances.
    pub fn left_of(&self, residual: &Series) -> Series {
        self.left_of_white(std::array::from_fn(|channel| self.whitenings[channel].apply(&residual[channel])))
    }

    fn left_of_white(&self, white: Series) -> Series {
        let products = |column: &Nuisance| {
            let own = (0..CHANNELS).filter_map(|channel| Some(dot(column[channel].as_ref()?, &white[channel])));
            own.sum::<f64>()
        };
        let right = DVector::from_iterator(self.columns.len(), self.columns.iter().map(products));
        let solved = lower(&self.factor, &self.scale.component_mul(&right));
        let solved = self.factor.l_dirty().tr_solve_lower_triangular(&solved).expect("a diagonal without zeros");
        let solved = solved.component_mul(&self.scale);
        std::array::from_fn(|channel| {
            let mut left = white[channel].clone();
            for (column, size) in self.columns.iter().zip(&solved) {
                if let Some(values) = &column[channel] {
                    left.iter_mut().zip(values).for_each(|(left, value)| *left -= size * value);
                }
            }
            left
        })
    }

    /// A signature, whitened.
    pub fn white(&self, channel: usize, column: &Column) -> Column {
        let values = self.whitenings[channel].apply_from(column.from, &column.values);
        Column { from: column.from, values }
    }

    /// Products of a whitened signature on one channel.
    pub fn products(&self, channel: usize, white: &Column) -> Products {
        let Column { from, values } = white;
        let mut products = Products::none(self.columns.len());
        for third in 0..THIRDS {
            let start = self.bounds[third].max(*from);
            let end = self.bounds[third + 1].min(from + values.len());
            if start >= end {
                continue;
            }
            let own = &values[start - from..end - from];
            products.own[third] = dot(own, own);
            products.residual[third] = dot(own, &self.residual[channel][start..end]);
            for (product, column) in products.nuisances[third].iter_mut().zip(&self.columns) {
                if let Some(column) = &column[channel] {
                    *product = dot(own, &column[start..end]);
                }
            }
        }
        products
    }

    /// The same, not whitened yet.
    pub fn products_of(&self, channel: usize, column: &Column) -> Products {
        self.products(channel, &self.white(channel, column))
    }

    /// A signature beside the nuisances.
    pub fn beside(&self, products: &Products) -> ProjectedSignature {
        let part = self.part(products);
        let right = products.residual.iter().sum::<f64>() - part.dot(&self.solved);
        ProjectedSignature { own: products.own.iter().sum(), right, part }
    }

    /// What a signature explains beside the nuisances; nothing where it cannot be told from them.
    pub fn gain(&self, products: &Products) -> Option<SignatureFit> {
        ProjectedSignature::gain(&[&self.beside(products)])
    }

    fn part(&self, products: &Products) -> DVector<f64> {
        let sums = DVector::from_fn(self.columns.len(), |i, _| products.nuisances.iter().map(|v| v[i]).sum::<f64>());
        lower(&self.factor, &self.scale.component_mul(&sums))
    }

    /// Cosine of two signatures beside the nuisances, from the products of each and the product of the two; 0 where one cannot be
    /// told from the nuisances.
    pub fn cosine(&self, one: &Products, other: &Products, both: f64) -> f64 {
        let (one, other) = (self.beside(one), self.beside(other));
        match (ProjectedSignature::projected_residual(&[&one]), ProjectedSignature::projected_residual(&[&other])) {
            (Some(one_left), Some(other_left)) => (both - one.part.dot(&other.part)) / (one_left * other_left).sqrt(),
            _ => 0.0,
        }
    }

    /// By how much better each third is foretold with the signature, its size and the nuisances known from the other two: the fall of
    /// −2 ln of the predictive density p(third | others) = p(all) / p(others), the nuisances and the size integrated out of both.
    /// Nothing for a third without which the size would hardly be known. The filter that whitens runs across the bounds.
    pub fn held_out(&self, products: &Products) -> [Option<f64>; THIRDS] {
        let of = |thirds: &[usize]| -> Option<(f64, f64)> {
            let gram: DMatrix<f64> = thirds.iter().map(|&third| &self.gram[third]).sum();
            let factor = factored(&gram, &self.scale, HELD_OUT_RIDGE);
            let scaled = |vectors: &dyn Fn(usize) -> DVector<f64>| {
                let sum: DVector<f64> = thirds.iter().map(|&third| vectors(third)).sum();
                lower(&factor, &self.scale.component_mul(&sum))
            };
            let part = scaled(&|third| DVector::from_column_slice(&products.nuisances[third]));
            let solved = scaled(&|third| self.right[third].clone());
            let sum = |values: &[f64; THIRDS]| thirds.iter().map(|&third| values[third]).sum::<f64>();
            let left = sum(&products.own) - part.norm_squared();
            let right = sum(&products.residual) - part.dot(&solved);
            (left > 0.0).then(|| (left, right * right / left))
        };
        let Some((left, gain)) = of(&[0, 1, 2]) else { return [None; THIRDS] };
        let without = |third: usize| {
            let others: Vec<usize> = (0..THIRDS).filter(|&other| other != third).collect();
            let (left_without, gain_without) = of(&others).filter(|(others, _)| *others >= LEAST_KNOWN * left)?;
            Some(gain - gain_without - (left / left_without).ln())
        };
        std::array::from_fn(without)
    }

    /// The nuisances fitted without each third; for the first ones something is known beforehand: a value and its sigma.
    pub fn without_thirds(&self, known: &[(f64, f64)]) -> [DVector<f64>; THIRDS] {
        let parts: [_; THIRDS] = std::array::from_fn(|third| (self.gram[third].clone(), self.right[third].clone()));
        std::array::from_fn(|third| fitted_without(&parts, third, known))
    }
}

impl Products {
    /// Of nothing.
    pub fn none(nuisances: usize) -> Products {
        Products {
            own: [0.0; THIRDS],
            residual: [0.0; THIRDS],
            nuisances: std::array::from_fn(|_| vec![0.0; nuisances]),
        }
    }

    /// The sum with those of another channel.
    #[must_use]
    pub fn plus(mut self, other: &Products) -> Products {
        for third in 0..THIRDS {
            self.own[third] += other.own[third];
            self.residual[third] += other.residual[third];
            self.nuisances[third].iter_mut().zip(&other.nuisances[third]).for_each(|(sum, value)| *sum += value);
        }
        self
    }
}

fn fitted_without(parts: &[(DMatrix<f64>, DVector<f64>); THIRDS], third: usize, known: &[(f64, f64)]) -> DVector<f64> {
    let count = parts[0].1.len();
    let whole = parts.iter().fold(DVector::zeros(count), |sum: DVector<f64>, (gram, _)| sum + gram.diagonal());
    let scale = whole.map(|own| if own > 0.0 { 1.0 / own.sqrt() } else { 0.0 });
    let others = (0..THIRDS).filter(|&other| other != third);
    let (mut gram, mut right) = others.fold((DMatrix::zeros(count, count), DVector::zeros(count)), |sums, other| {
        (sums.0 + &parts[other].0, sums.1 + &parts[other].1)
    });
    for (index, (value, sigma)) in known.iter().enumerate() {
        gram[(index, index)] += sigma.powi(-2);
        right[index] += value * sigma.powi(-2);
    }
    let factor = factored(&gram, &scale, HELD_OUT_RIDGE);
    factor.solve(&scale.component_mul(&right)).component_mul(&scale)
}

pub(crate) fn factored(gram: &DMatrix<f64>, scale: &DVector<f64>, ridge: f64) -> Cholesky<f64, Dyn> {
    let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, j| {
        gram[(i, j)] * scale[i] * scale[j] + if i == j { ridge + f64::from(u8::from(scale[i] == 0.0)) } else { 0.0 }
    });
    // Rounding may leave a singular one a trace below 0.
    Cholesky::new(scaled.clone())
        .or_else(|| Cholesky::new(&scaled + DMatrix::identity(gram.nrows(), gram.ncols()) * 1e-6))
        .unwrap_or_else(|| Cholesky::new(DMatrix::identity(gram.nrows(), gram.ncols())).expect("positive"))
}

pub(crate) fn lower(factor: &Cholesky<f64, Dyn>, right: &DVector<f64>) -> DVector<f64> {
    factor.l_dirty().solve_lower_triangular(right).expect("a diagonal without zeros")
}

pub(crate) fn dot(one: &[f64], other: &[f64]) -> f64 {
    // Four sums, so that the processor need not wait for one.
    let mut sums = [0.0; 4];
    let (ones, others) = (one.chunks_exact(4), other.chunks_exact(4));
    let rest: f64 = ones.remainder().iter().zip(others.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in ones.zip(others) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    sums.iter().sum::<f64>() + rest
}
