//! Products of the time courses of a signature with itself and with the nuisances of a recording, kept for each noise.
//!
//! A search has another residual than the one before, and other hypotheses, but mostly the same noise. Products with these need no
//! whitened signature: the transposed filter makes of each a factor for every increment of the signature.

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::DVector;

use crate::courses::Mode;
use crate::linear_algebra::dot;
use crate::measured::CHANNELS;
use crate::normal_equations::{NormalEquations, Products, ProjectedSignature};
use crate::signature_bank::ConstantSignature;

/// Noises of which products are kept: that of the start, that with larger walks, and that of the report.
const KEPT: usize = 3;

/// Products of the courses of one signature with one noise, in the order of a sweep.
#[derive(Debug, Default)]
pub struct CourseProducts {
    /// For each channel, of each course: its square, and its products with the nuisances of the recording on this channel.
    courses: [Vec<f64>; CHANNELS],
    /// Products of two courses on each channel.
    both: Vec<[f64; CHANNELS]>,
}

impl CourseProducts {
    /// Adds the products of the next course on a channel.
    pub fn push(&mut self, channel: usize, normal: &NormalEquations, products: Option<&Products>) {
        let own = &mut self.courses[channel];
        own.push(products.map_or(0.0, |products| products.own));
        let of_recording = normal.of_recording();
        let columns = normal.columns(channel).take_while(|(place, _)| *place < of_recording);
        own.extend(columns.map(|(place, _)| products.map_or(0.0, |products| products.nuisances[place])));
    }

    /// Adds the products of the next two courses.
    pub fn push_both(&mut self, both: [f64; CHANNELS]) {
        self.both.push(both);
    }
}

/// Key of a noise and products with it.
type NoiseProducts = (u64, Arc<CourseProducts>);

/// The products of a signature, for the noises used last; copies share them.
#[derive(Debug, Clone, Default)]
pub struct ProductCache(Arc<Mutex<Vec<NoiseProducts>>>);

impl ProductCache {
    /// Products with the noise of these equations.
    pub fn with_noise(&self, normal: &NormalEquations) -> Option<Arc<CourseProducts>> {
        let kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.iter().find(|(key, _)| *key == normal.key()).map(|(_, products)| products.clone())
    }

    /// Keeps products, in place of the oldest.
    pub fn keep(&self, normal: &NormalEquations, products: CourseProducts) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        kept.retain(|(key, _)| *key != normal.key());
        if kept.len() >= KEPT {
            kept.remove(0);
        }
        kept.push((normal.key(), Arc::new(products)));
    }
}

/// Kept products, read in the order of a sweep, beside those with a residual and with hypotheses.
pub struct KeptProducts {
    products: Arc<CourseProducts>,
    channels: [Option<KeptChannel>; CHANNELS],
    both: usize,
}

/// A channel that the signature reaches.
struct KeptChannel {
    /// Places of the nuisances of the recording on this channel.
    places: Vec<usize>,
    /// Place in the kept products.
    next: usize,
    /// Factor of each block's value of a time course, for the product with the residual.
    residual: Vec<f64>,
    /// Factors for the products with the other nuisances, with their places.
    others: Vec<(usize, Vec<f64>)>,
}

impl KeptProducts {
    /// Products of a signature on these channels.
    pub fn new(
        products: Arc<CourseProducts>,
        base: &ConstantSignature,
        normal: &NormalEquations,
        has: [bool; CHANNELS],
    ) -> KeptProducts {
        let transposed = normal.transposed();
        let channel = |channel: usize| {
            let series = &base.series[channel];
            if !has[channel] || series.iter().all(|&value| value == 0.0) {
                return None;
            }
            let factors = |derivatives: &Vec<f64>| factors(series, base.mode, derivatives);
            let (residual, others) = &transposed[channel];
            let of_recording = normal.columns(channel).map(|(place, _)| place);
            Some(KeptChannel {
                places: of_recording.take_while(|place| *place < normal.of_recording()).collect(),
                next: 0,
                residual: factors(residual),
                others: others.iter().map(|(place, derivatives)| (*place, factors(derivatives))).collect(),
            })
        };
        KeptProducts { products, channels: std::array::from_fn(channel), both: 0 }
    }

    /// The next course, with these values from its first block on, or constant.
    pub fn course(
        &mut self,
        normal: &NormalEquations,
        from: usize,
        values: Option<&[f64]>,
    ) -> [Option<ProjectedSignature>; CHANNELS] {
        let product = |factors: &[f64]| match values {
            Some(values) => dot(values, &factors[from..]),
            None => factors.iter().sum(),
        };
        std::array::from_fn(|channel| {
            let own = self.channels[channel].as_mut()?;
            let kept = &self.products.courses[channel][own.next..own.next + 1 + own.places.len()];
            own.next += kept.len();
            let (square, kept) = kept.split_first().filter(|(square, _)| **square > 0.0)?;
            let mut sums = DVector::zeros(normal.nuisances());
            own.places.iter().zip(kept).for_each(|(place, product)| sums[*place] = *product);
            own.others.iter().for_each(|(place, factors)| sums[*place] = product(factors));
            Some(normal.project_sums(*square, product(&own.residual), &sums))
        })
    }

    /// Products of the next two courses.
    pub fn both(&mut self) -> [f64; CHANNELS] {
        self.both += 1;
        self.products.both[self.both - 1]
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
