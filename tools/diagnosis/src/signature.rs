//! A signature whitened by the noise of a recording, beside its nuisances.

use crate::amplitude::AmplitudeRef;
use crate::bank::{Column, ConstantSignature, SignatureBank, Variation};
use crate::gyros::Gyros;
use crate::measured::{CHANNELS, TIMING};
use crate::normal::{NormalEquations, Nuisance, Products, dot};

/// Whether what an amplitude adds on these gyros is on a channel.
pub fn reaches(amplitude: &AmplitudeRef, gyros: &Gyros, channel: usize) -> bool {
    amplitude.is_of_unit() || channel != TIMING && gyros[channel]
}

/// A signature, whitened.
pub struct Signature {
    /// Of the channels that are reached.
    white: [Option<Column>; CHANNELS],
    /// Its products, over the channels.
    pub products: Products,
}

impl Signature {
    /// Of averages over blocks.
    pub fn new(normal: &NormalEquations, nuisance: &Nuisance) -> Signature {
        let column = |values: &Option<Vec<f64>>| Some(Column { from: 0, values: values.clone()? });
        Signature::whitened(normal, nuisance.each_ref().map(column))
    }

    /// Of a hypothesis of the bank.
    pub fn of(
        bank: &SignatureBank,
        normal: &NormalEquations,
        base: &ConstantSignature,
        variation: &Variation,
        gyros: &Gyros,
    ) -> Signature {
        let mut columns = bank.columns(base, variation);
        for (channel, column) in columns.iter_mut().enumerate() {
            if !reaches(&base.amplitude, gyros, channel) {
                *column = None;
            }
        }
        Signature::whitened(normal, columns)
    }

    fn whitened(normal: &NormalEquations, columns: [Option<Column>; CHANNELS]) -> Signature {
        let white: [Option<Column>; CHANNELS] =
            std::array::from_fn(|channel| columns[channel].as_ref().map(|column| normal.white(channel, column)));
        let parts = white.iter().enumerate().filter_map(|(channel, own)| Some(normal.products(channel, own.as_ref()?)));
        let products = parts.fold(Products::none(normal.nuisances()), |sum, part| sum.plus(&part));
        Signature { white, products }
    }

    /// Cosine with another, beside the nuisances; without sign.
    pub fn cosine(&self, normal: &NormalEquations, other: &Signature) -> f64 {
        normal.cosine(&self.products, &other.products, self.dot(other)).abs().min(1.0)
    }

    /// The product with another.
    fn dot(&self, other: &Signature) -> f64 {
        let of_channel = |(one, other): (&Option<Column>, &Option<Column>)| {
            let (one, other) = (one.as_ref()?, other.as_ref()?);
            let [end, other_end] = [one, other].map(|column| column.from + column.values.len());
            let (from, to) = (one.from.max(other.from), end.min(other_end));
            let part = |column: &Column| from - column.from..to - column.from;
            (from < to).then(|| dot(&one.values[part(one)], &other.values[part(other)]))
        };
        self.white.iter().zip(&other.white).filter_map(of_channel).sum()
    }
}
