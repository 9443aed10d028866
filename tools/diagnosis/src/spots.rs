//! The best time course of each kind of a signature, on each set of gyros.

use crate::amplitude::AmplitudeRef;
use crate::bank::{ConstantSignature, HypothesisFamily, SignatureBank, Variation};
use crate::climb::maximise;
use crate::gyros::Gyros;
use crate::hypothesis::Hypothesis;
use crate::measured::{BLOCK_S, CHANNELS};
use crate::normal::{NormalEquations, ProjectedSignature, SignatureFit};
use crate::signature::{Signature, reaches};
use crate::sweep::{Part, sweep};

/// A signature with a time course on some gyros, and what it explains.
#[derive(Debug, Clone)]
pub struct Spot {
    /// Index of its base.
    pub base: usize,
    /// Its time course.
    pub variation: Variation,
    /// Its gyros.
    pub gyros: Gyros,
    /// What it explains.
    pub gain: SignatureFit,
}

impl Spot {
    fn base<'a>(&self, bank: &'a SignatureBank) -> &'a ConstantSignature {
        &bank.bases[self.base]
    }

    /// Its amplitude.
    pub fn amplitude(&self, bank: &SignatureBank) -> AmplitudeRef {
        AmplitudeRef { kind: self.variation.kind(), ..self.base(bank).amplitude }
    }

    /// Its family.
    pub fn family(&self, bank: &SignatureBank) -> HypothesisFamily {
        self.base(bank).family(&self.variation)
    }

    /// The hypothesis that it is.
    pub fn hypothesis(&self, bank: &SignatureBank) -> Hypothesis {
        let base = self.base(bank);
        let value = if base.is_linear { self.gain.size } else { base.size };
        bank.hypothesis(base, &self.variation, value, self.gyros)
    }

    /// Whether its signature is that of the value that it explains most with.
    pub fn stands(&self, bank: &SignatureBank) -> bool {
        self.base(bank).is_valid_at(self.gain.size)
    }

    /// Its signature on a recording.
    pub fn signature(&self, bank: &SignatureBank, normal: &NormalEquations) -> Signature {
        Signature::of(bank, normal, self.base(bank), &self.variation, &self.gyros)
    }

    /// With another time course; none where that cannot be distinguished from the nuisances.
    pub fn with(&self, bank: &SignatureBank, normal: &NormalEquations, variation: &Variation) -> Option<Spot> {
        let other = Spot { variation: variation.clone(), ..self.clone() };
        let gain = normal.gain(&other.signature(bank, normal).products)?;
        Some(Spot { gain, ..other })
    }

    /// With the shape near by that explains most of those that are possible; none where that is beyond the limits of the model.
    pub fn climbed(
        &self,
        bank: &SignatureBank,
        normal: &NormalEquations,
        is_possible: impl Fn(&Spot) -> bool,
    ) -> Option<Spot> {
        let duration_s = normal.residual()[0].len() as f64 * BLOCK_S;
        let at = |variation: &Variation| self.with(bank, normal, variation).filter(&is_possible);
        let (variation, _) =
            maximise(self.variation.clone(), duration_s, &|variation| at(variation).map_or(0.0, |spot| spot.gain.chi2));
        at(&variation).filter(|spot| spot.hypothesis(bank).is_within_limits())
    }
}

/// The best time course of each kind of one base on each set of gyros, of those that are possible. `sets` is given the channels that
/// the signature reaches.
pub fn spots(
    bank: &SignatureBank,
    normal: &NormalEquations,
    index: usize,
    sets: impl Fn([bool; CHANNELS]) -> Vec<Gyros>,
    is_possible: impl Fn(&Spot) -> bool,
) -> Vec<Spot> {
    let base = &bank.bases[index];
    let mut best: Vec<Spot> = Vec::new();
    let take = |variation: &Variation, parts: &[Part<()>; CHANNELS]| {
        for gyros in sets(parts.each_ref().map(Option::is_some)) {
            let chosen = (0..CHANNELS).filter(|&channel| reaches(&base.amplitude, &gyros, channel));
            let parts = chosen.filter_map(|channel| parts[channel].as_ref().map(|(part, ())| part));
            let Some(gain) = ProjectedSignature::gain(&parts.collect::<Vec<_>>()) else { continue };
            let is_same = |other: &Spot| other.variation.kind() == variation.kind() && other.gyros == gyros;
            let place = best.iter().position(is_same);
            if place.is_some_and(|place| best[place].gain.chi2 >= gain.chi2) {
                continue;
            }
            let spot = Spot { base: index, variation: variation.clone(), gyros, gain };
            match place {
                _ if !is_possible(&spot) => {}
                Some(place) => best[place] = spot,
                None => best.push(spot),
            }
        }
    };
    sweep(bank, normal, base, |_, _| (), take);
    best
}
