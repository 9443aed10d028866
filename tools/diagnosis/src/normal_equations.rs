//! Least squares on whitened channels: nuisances are projected out of the residual and of every signature. Products of the nuisances are
//! kept per third of the recording, so that each third can be predicted from the other two.

mod products;

use std::hash::{DefaultHasher, Hasher};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::linear_algebra::{dot, factored, inverse_roots, lower};
use crate::measured::{CHANNELS, Series};
use crate::signature_bank::Column;
use crate::whitening::Whitening;

pub use products::{Products, ProjectedSignature, SignatureFit, distinguishable};

/// Parts of the recording, each held out in turn.
pub const THIRDS: usize = 3;
/// Share added to the diagonal, so that directions without information remain solvable.
pub(crate) const RIDGE: f64 = 1e-10;
/// Ridge of a fit to two thirds: information below this share of that of all thirds is ignored.
const HELD_OUT_RIDGE: f64 = 1e-4;
/// A third is not predictable if the others hold less than this share of the information on an amplitude.
const MIN_INFORMATION: f64 = 0.2;

/// Signature of a nuisance: averages over blocks for each channel that it reaches.
pub type Nuisance = [Option<Vec<f64>>; CHANNELS];

/// The whitening filter of each channel.
pub type Filters = [Arc<Whitening>; CHANNELS];

/// Normal equations of a whitened residual and its nuisances.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    whitenings: Filters,
    /// Whitened residual.
    pub residual: Series,
    /// Whitened signatures of the nuisances.
    columns: Vec<Nuisance>,
    /// Products of nuisances with each other and with the residual for each third.
    gram: [DMatrix<f64>; THIRDS],
    right: [DVector<f64>; THIRDS],
    /// Square of the residual.
    squares: f64,
    /// χ² of the departure of the calibration parameters from their a priori values.
    a_priori_chi2: f64,
    /// Number of the calibration parameters.
    parameters: usize,
    /// Factor of the whole, scaled to a diagonal of ones, and that scale.
    factor: Cholesky<f64, Dyn>,
    scale: DVector<f64>,
    solved: DVector<f64>,
    transposed: OnceLock<[Transposed; CHANNELS]>,
    key: OnceLock<u64>,
}

/// Derivatives of products with a whitened series by the increments of that series: for the residual, and for the nuisances, with their
/// places.
pub type Transposed = (Vec<f64>, Vec<(usize, Vec<f64>)>);

impl NormalEquations {
    /// Whitens a residual and the nuisances. The calibration parameters, which are the first nuisances, have moved from their a priori values
    /// by the first number of `a_priori`; the second is their sigma.
    pub fn new(
        whitenings: Filters,
        residual: &Series,
        nuisances: &[Nuisance],
        a_priori: &[(f64, f64)],
    ) -> NormalEquations {
        let blocks = residual[0].len();
        let bounds = std::array::from_fn(|third| blocks * third / THIRDS);
        let residual: Series = std::array::from_fn(|channel| whitenings[channel].apply(&residual[channel]));
        let white = |column: &Nuisance| whitened(&whitenings, 0, column.each_ref().map(Option::as_deref));
        let columns: Vec<Nuisance> = nuisances.iter().map(white).collect();
        let count = columns.len();
        let (gram, right) = parts(&columns, &residual, &bounds);
        let squares = residual.iter().map(|own| dot(own, own)).sum();
        let (mut whole, mut whole_right) = (gram.iter().sum::<DMatrix<f64>>(), right.iter().sum::<DVector<f64>>());
        let scale = inverse_roots(&whole.diagonal());
        let mut a_priori_chi2 = 0.0;
        for (index, (moved, sigma)) in a_priori.iter().enumerate().take(count) {
            let weight = sigma.powi(-2);
            whole[(index, index)] += weight;
            whole_right[index] -= weight * moved;
            a_priori_chi2 += weight * moved * moved;
        }
        let factor = factored(&whole, &scale, RIDGE);
        let solved = lower(&factor, &scale.component_mul(&whole_right));
        NormalEquations {
            whitenings,
            residual,
            columns,
            gram,
            right,
            squares,
            a_priori_chi2,
            parameters: a_priori.len(),
            factor,
            scale,
            solved,
            transposed: OnceLock::new(),
            key: OnceLock::new(),
        }
    }

    /// Number of nuisances of the recording, which are the first: the calibration parameters and the lag.
    pub fn of_recording(&self) -> usize {
        self.columns.len().min(self.parameters + 1)
    }

    /// 1 sigma of a nuisance if all others are known.
    pub fn conditional_sigma(&self, index: usize) -> f64 {
        self.scale[index]
    }

    /// Hash of the filters and of the nuisances of the recording.
    pub fn key(&self) -> u64 {
        *self.key.get_or_init(|| {
            let mut hasher = DefaultHasher::new();
            self.whitenings.iter().for_each(|whitening| whitening.add_to_hash(&mut hasher));
            let columns = self.columns[..self.of_recording()].iter().flatten();
            for values in columns {
                hasher.write_usize(values.as_ref().map_or(0, Vec::len));
                values.iter().flatten().for_each(|value| hasher.write_u64(value.to_bits()));
            }
            hasher.finish()
        })
    }

    /// Residual and nuisances through the transposed filters.
    pub fn transposed(&self) -> &[Transposed; CHANNELS] {
        let of_channel = |channel: usize| {
            let transposed = |white: &[f64]| self.derivatives(channel, white);
            let nuisances = self.columns(channel).map(|(place, column)| (place, transposed(column)));
            (transposed(&self.residual[channel]), nuisances.collect())
        };
        self.transposed.get_or_init(|| std::array::from_fn(of_channel))
    }

    /// Derivatives of the product of a whitened series and a signature by the increments of the signature.
    pub fn derivatives(&self, channel: usize, white: &[f64]) -> Vec<f64> {
        self.whitenings[channel].transposed(white)
    }

    /// The filter of a channel.
    pub fn whitening(&self, channel: usize) -> &Whitening {
        &self.whitenings[channel]
    }

    /// Whitened signatures of the nuisances on a channel, with their places.
    pub fn columns(&self, channel: usize) -> impl Iterator<Item = (usize, &[f64])> {
        self.columns.iter().enumerate().filter_map(move |(place, column)| Some((place, column[channel].as_deref()?)))
    }

    /// Number of nuisances.
    pub fn nuisances(&self) -> usize {
        self.columns.len()
    }

    /// χ² with the nuisances fitted.
    pub fn chi2(&self) -> f64 {
        self.squares() - self.solved.norm_squared()
    }

    /// −2 ln of the likelihood with the nuisances integrated out, up to a constant.
    pub fn deviance(&self) -> f64 {
        let determinants = self.whitenings.iter().map(|whitening| whitening.log_determinant).sum::<f64>();
        let determined = (0..self.scale.len()).filter(|&index| self.scale[index] > 0.0);
        let diagonal = |index: usize| self.factor.l_dirty()[(index, index)];
        self.chi2()
            + determinants
            + determined.map(|index| 2.0 * (diagonal(index) / self.scale[index]).ln()).sum::<f64>()
    }

    /// χ² at the current parameters, including their departure from the a priori values.
    pub fn squares(&self) -> f64 {
        self.squares + self.a_priori_chi2
    }

    /// Fitted nuisances and their covariance.
    pub fn solution(&self) -> (DVector<f64>, DMatrix<f64>) {
        let scale = DMatrix::from_diagonal(&self.scale);
        let mut covariance = &scale * self.factor.inverse() * &scale;
        // Nuisances that the data do not determine.
        (0..self.scale.len()).filter(|&index| self.scale[index] == 0.0).for_each(|index| {
            covariance[(index, index)] = f64::INFINITY;
        });
        (self.upper(&self.solved), covariance)
    }

    /// Solves the transposed triangular system and removes the scale.
    fn upper(&self, right: &DVector<f64>) -> DVector<f64> {
        let solved = self.factor.l_dirty().tr_solve_lower_triangular(right).expect("a diagonal without zeros");
        solved.component_mul(&self.scale)
    }

    /// The whitened residual minus its projection on the nuisances.
    pub fn projected_residual(&self) -> Series {
        self.project_white(self.residual.clone())
    }

    /// Whitens another residual and subtracts its projection on the nuisances.
    pub fn projected_residual_of(&self, residual: &Series) -> Series {
        self.project_white(std::array::from_fn(|channel| self.whitenings[channel].apply(&residual[channel])))
    }

    fn project_white(&self, mut white: Series) -> Series {
        let products = |column: &Nuisance| {
            let own = (0..CHANNELS).filter_map(|channel| Some(dot(column[channel].as_ref()?, &white[channel])));
            own.sum::<f64>()
        };
        let right = DVector::from_iterator(self.columns.len(), self.columns.iter().map(products));
        let solved = self.upper(&lower(&self.factor, &self.scale.component_mul(&right)));
        for (column, size) in self.columns.iter().zip(&solved) {
            for (white, values) in white.iter_mut().zip(column) {
                let values = values.iter().flatten();
                white.iter_mut().zip(values).for_each(|(own, value)| *own -= size * value);
            }
        }
        white
    }

    /// Whitens a signature.
    pub fn white(&self, channel: usize, column: &Column) -> Column {
        let values = self.whitenings[channel].apply_from(column.from, &column.values);
        Column { from: column.from, values }
    }

    /// Whitens the channels of a signature, which have the same blocks.
    pub fn white_channels(&self, columns: &[Option<Column>; CHANNELS]) -> [Option<Column>; CHANNELS] {
        let from = columns.iter().flatten().next().map_or(0, |column| column.from);
        let series = columns.each_ref().map(|column| Some(&column.as_ref()?.values[..]));
        whitened(&self.whitenings, from, series).map(|values| Some(Column { from, values: values? }))
    }

    /// Products of a whitened signature on one channel.
    pub fn products(&self, channel: usize, white: &Column) -> Products {
        self.products_in(channel, white, 0..self.residual[channel].len())
    }

    /// Products in some blocks.
    pub fn products_in(&self, channel: usize, white: &Column, blocks: Range<usize>) -> Products {
        let Column { from, values } = white;
        let mut products = Products::none(self.columns.len());
        let (start, end) = (blocks.start.max(*from), blocks.end.min(from + values.len()));
        if start >= end {
            return products;
        }
        let own = &values[start - from..end - from];
        products.own = dot(own, own);
        products.residual = dot(own, &self.residual[channel][start..end]);
        for (product, column) in products.nuisances.iter_mut().zip(&self.columns) {
            if let Some(column) = &column[channel] {
                *product = dot(own, &column[start..end]);
            }
        }
        products
    }

    /// Projects a signature on the nuisances.
    pub fn project(&self, products: &Products) -> ProjectedSignature {
        self.project_sums(products.own, products.residual, &DVector::from_column_slice(&products.nuisances))
    }

    /// Projects a signature on the nuisances: its square and its products with the residual and with the nuisances.
    pub fn project_sums(&self, own: f64, residual: f64, sums: &DVector<f64>) -> ProjectedSignature {
        let part = lower(&self.factor, &self.scale.component_mul(sums));
        ProjectedSignature { own, right: residual - part.dot(&self.solved), part }
    }

    /// Fit of a signature; `None` if it is not distinguishable from the nuisances.
    pub fn gain(&self, products: &Products) -> Option<SignatureFit> {
        let projected = self.project(products);
        Some(SignatureFit::new(projected.remaining_square()?, projected.right))
    }

    /// Cosine of two signatures without their projections on the nuisances, from the products of each and the product of the two; 0 if
    /// one is not distinguishable from the nuisances.
    pub fn cosine(&self, one: &Products, other: &Products, both: f64) -> f64 {
        let (one, other) = (self.project(one), self.project(other));
        match (one.remaining_square(), other.remaining_square()) {
            (Some(one_left), Some(other_left)) => (both - one.part.dot(&other.part)) / (one_left * other_left).sqrt(),
            _ => 0.0,
        }
    }

    /// Cross-validation of a signature with these products in the thirds between bounds: for each third the reduction of −2 ln of the
    /// predictive density p(third | others) = p(all) / p(others), with nuisances and amplitude integrated out of both. `None` for a third
    /// without which the amplitude is hardly determined. The whitening filter runs across the bounds.
    pub fn cross_validate(&self, bounds: &[usize; THIRDS + 1], products: &[Products; THIRDS]) -> [Option<f64>; THIRDS] {
        let (gram, right) = parts(&self.columns, &self.residual, bounds);
        let of = |thirds: &[usize]| -> Option<(f64, f64)> {
            let gram: DMatrix<f64> = thirds.iter().map(|&third| &gram[third]).sum();
            let factor = factored(&gram, &self.scale, HELD_OUT_RIDGE);
            let scaled = |vectors: &dyn Fn(usize) -> DVector<f64>| {
                let sum: DVector<f64> = thirds.iter().map(|&third| vectors(third)).sum();
                lower(&factor, &self.scale.component_mul(&sum))
            };
            let part = scaled(&|third| DVector::from_column_slice(&products[third].nuisances));
            let solved = scaled(&|third| right[third].clone());
            let sum = |value: fn(&Products) -> f64| thirds.iter().map(|&third| value(&products[third])).sum::<f64>();
            let left = sum(|products| products.own) - part.norm_squared();
            let right = sum(|products| products.residual) - part.dot(&solved);
            (left > 0.0).then(|| (left, right * right / left))
        };
        let Some((left, gain)) = of(&[0, 1, 2]) else { return [None; THIRDS] };
        let without = |third: usize| {
            let others: Vec<usize> = (0..THIRDS).filter(|&other| other != third).collect();
            let (left_without, gain_without) = of(&others).filter(|(others, _)| *others >= MIN_INFORMATION * left)?;
            Some(gain - gain_without - (left / left_without).ln())
        };
        std::array::from_fn(without)
    }

    /// Nuisances fitted without a third, with a priori values and sigmas of the first ones.
    pub fn fit_without_third(&self, third: usize, a_priori: &[(f64, f64)]) -> DVector<f64> {
        let scale = inverse_roots(&self.gram.iter().map(DMatrix::diagonal).sum());
        let others = || (0..THIRDS).filter(|&other| other != third);
        let mut gram: DMatrix<f64> = others().map(|other| &self.gram[other]).sum();
        let mut right: DVector<f64> = others().map(|other| &self.right[other]).sum();
        for (index, (value, sigma)) in a_priori.iter().enumerate() {
            gram[(index, index)] += sigma.powi(-2);
            right[index] += value * sigma.powi(-2);
        }
        factored(&gram, &scale, HELD_OUT_RIDGE).solve(&scale.component_mul(&right)).component_mul(&scale)
    }
}

/// Whitens the channels that a signature reaches, two at once.
fn whitened(filters: &Filters, from: usize, series: [Option<&[f64]>; CHANNELS]) -> Nuisance {
    let reached: Vec<_> = (0..CHANNELS).filter_map(|channel| Some((channel, series[channel]?))).collect();
    let mut white = Nuisance::default();
    for some in reached.chunks(2) {
        let both = [some[0], some[some.len() - 1]];
        let values = Whitening::apply_each(both.map(|own| &*filters[own.0]), from, both.map(|own| own.1));
        both.into_iter().zip(values).for_each(|((channel, _), values)| white[channel] = Some(values));
    }
    white
}

/// Products of whitened nuisances with each other and with the residual between bounds.
fn parts(
    columns: &[Nuisance],
    residual: &Series,
    bounds: &[usize; THIRDS + 1],
) -> ([DMatrix<f64>; THIRDS], [DVector<f64>; THIRDS]) {
    let count = columns.len();
    let mut gram: [_; THIRDS] = std::array::from_fn(|_| DMatrix::zeros(count, count));
    let mut right: [_; THIRDS] = std::array::from_fn(|_| DVector::zeros(count));
    for third in 0..THIRDS {
        let range = bounds[third]..bounds[third + 1];
        for channel in 0..CHANNELS {
            let Some(residual) = residual[channel].get(range.clone()) else { continue };
            for (i, one) in columns.iter().enumerate() {
                let Some(one) = &one[channel] else { continue };
                let one = &one[range.clone()];
                right[third][i] += dot(one, residual);
                for (j, other) in columns[..=i].iter().enumerate() {
                    if let Some(other) = &other[channel] {
                        gram[third][(i, j)] += dot(one, &other[range.clone()]);
                    }
                }
            }
        }
        gram[third].fill_upper_triangle_with_lower_triangle();
    }
    (gram, right)
}
