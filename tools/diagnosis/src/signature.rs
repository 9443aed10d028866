//! Signatures whitened by the noise of a recording.

use crate::linear_algebra::dot;
use crate::measured::{CHANNELS, TIMING};
use crate::normal_equations::{NormalEquations, Nuisance, Products, THIRDS};
use crate::signature_bank::Column;
use geu_hypothesis::amplitude::AmplitudeRef;
use geu_protocol::Gyros;

/// True if an amplitude on these gyros acts on a channel.
pub fn reaches(amplitude: &AmplitudeRef, gyros: &Gyros, channel: usize) -> bool {
    amplitude.is_of_unit() || channel != TIMING && gyros[channel]
}

/// A whitened signature.
pub struct Signature {
    /// For each channel that it reaches.
    white: [Option<Column>; CHANNELS],
    /// Products, summed over the channels.
    pub products: Products,
}

impl Signature {
    /// Whitens averages over blocks.
    pub fn new(normal: &NormalEquations, nuisance: &Nuisance) -> Signature {
        let column = |values: &Option<Vec<f64>>| Some(Column { from: 0, values: values.clone()? });
        Signature::from_columns(normal, nuisance.each_ref().map(column))
    }

    /// Whitens a signature of the bank.
    pub fn from_columns(normal: &NormalEquations, columns: [Option<Column>; CHANNELS]) -> Signature {
        let white = normal.white_channels(&columns);
        let parts = white.iter().enumerate().filter_map(|(channel, own)| Some(normal.products(channel, own.as_ref()?)));
        let products = parts.fold(Products::none(normal.nuisances()), |sum, part| sum.plus(&part));
        Signature { white, products }
    }

    /// Cross-validation by thirds of its information ([`NormalEquations::cross_validate`]).
    pub fn cross_validate(&self, normal: &NormalEquations) -> [Option<f64>; THIRDS] {
        let bounds = self.bounds_of_thirds(normal.residual[0].len());
        let products = std::array::from_fn(|third| {
            let own = self.white.iter().enumerate();
            let blocks = bounds[third]..bounds[third + 1];
            let parts =
                own.filter_map(|(channel, own)| Some(normal.products_in(channel, own.as_ref()?, blocks.clone())));
            parts.fold(Products::none(normal.nuisances()), |sum, part| sum.plus(&part))
        });
        normal.cross_validate(&bounds, &products)
    }

    /// First block of each third of its square, and the end.
    fn bounds_of_thirds(&self, blocks: usize) -> [usize; THIRDS + 1] {
        let mut squares = vec![0.0; blocks];
        for Column { from, values } in self.white.iter().flatten() {
            squares[*from..].iter_mut().zip(values).for_each(|(sum, value)| *sum += value * value);
        }
        let mut whole = 0.0;
        let of_block = |square: &f64| {
            whole += square;
            whole - square
        };
        let before: Vec<f64> = squares.iter().map(of_block).collect();
        std::array::from_fn(|third| match third {
            0 => 0,
            THIRDS => blocks,
            _ => before.partition_point(|before| *before < whole * third as f64 / THIRDS as f64),
        })
    }

    /// Absolute cosine with another signature, without the projections of both on the nuisances.
    pub fn cosine(&self, normal: &NormalEquations, other: &Signature) -> f64 {
        self.signed_cosine(normal, other).abs()
    }

    /// Cosine with its sign.
    pub fn signed_cosine(&self, normal: &NormalEquations, other: &Signature) -> f64 {
        let of_channel = |(one, other): (&Option<Column>, &Option<Column>)| {
            let (one, other) = (one.as_ref()?, other.as_ref()?);
            let [end, other_end] = [one, other].map(|column| column.from + column.values.len());
            let (from, to) = (one.from.max(other.from), end.min(other_end));
            let part = |column: &Column| from - column.from..to - column.from;
            (from < to).then(|| dot(&one.values[part(one)], &other.values[part(other)]))
        };
        let both = self.white.iter().zip(&other.white).filter_map(of_channel).sum();
        normal.cosine(&self.products, &other.products, both).clamp(-1.0, 1.0)
    }
}
