//! The best time course of each kind of a signature on each set of gyros.

use std::borrow::Cow;

use geu_model::parameter_spec::Role;
use geu_model::time_profile::COURSES;

use crate::course_products::of_value;
use crate::courses::is_onset;
use crate::measured::{CHANNELS, TIMING};
use crate::model_state::ModelState;
use crate::normal_equations::{NormalEquations, Nuisance, Products, SignatureFit};
use crate::shape_search::maximise;
use crate::signature::{Signature, reaches};
use crate::signature_bank::{Column, ConstantSignature, HypothesisFamily, SignatureBank, Variation};
use crate::sweep::{Swept, sweep};
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::{AmplitudeRef, STEP};
use geu_protocol::Gyros;

/// A signature with a time course on some gyros, and its fit.
#[derive(Debug, Clone)]
pub struct Spot {
    /// Index of its constant signature in the bank.
    pub base: usize,
    /// Time course.
    pub variation: Variation,
    /// Gyros.
    pub gyros: Gyros,
    /// Fit.
    pub gain: SignatureFit,
}

impl Spot {
    /// Fits a signature; `None` if it is not distinguishable from the nuisances.
    pub fn fit(
        bank: &SignatureBank,
        normal: &NormalEquations,
        base: usize,
        variation: Variation,
        gyros: Gyros,
    ) -> Option<Spot> {
        let mut spot = Spot { base, variation, gyros, gain: SignatureFit { size: 0.0, sigma: 0.0, chi2: 0.0 } };
        spot.gain = normal.gain(&spot.signature(bank, normal).products)?;
        Some(spot)
    }

    fn base<'a>(&self, bank: &'a SignatureBank) -> &'a ConstantSignature {
        &bank.bases[self.base]
    }

    /// Amplitude.
    pub fn amplitude(&self, bank: &SignatureBank) -> AmplitudeRef {
        AmplitudeRef { kind: self.variation.kind(), ..self.base(bank).amplitude }
    }

    /// Family.
    pub fn family(&self, bank: &SignatureBank) -> HypothesisFamily {
        self.base(bank).family(&self.variation)
    }

    /// Hypothesis, with the fitted amplitude.
    pub fn hypothesis(&self, bank: &SignatureBank) -> Hypothesis {
        let base = self.base(bank);
        let value = if base.is_linear { self.gain.size } else { base.size };
        bank.hypothesis(base, &self.variation, value, self.gyros)
    }

    /// True if the signature is valid at the fitted amplitude.
    pub fn is_valid(&self, bank: &SignatureBank) -> bool {
        self.base(bank).is_valid_at(self.gain.size)
    }

    /// True if the amplitude, beside that of a state, is at no time below its smallest possible value: no clearance is negative.
    pub fn is_physical(&self, bank: &SignatureBank, state: &ModelState) -> bool {
        let (base, size) = (self.base(bank), self.gain.size);
        let min = base.amplitude.number().min;
        if min < 0.0 {
            return true;
        }
        let constant = |gyro: usize| base.configured[gyro] + state.constant(&base.amplitude, gyro);
        let constant = (0..TIMING).filter(|&gyro| self.gyros[gyro]).map(constant).fold(f64::INFINITY, f64::min);
        // A wave reaches both of its extremes, and what begins then is 0 before and at most 1.
        let values = match &self.variation {
            own if own.at_phase(0.0).is_some() => Some(Cow::Borrowed(&[-1.0, 1.0][..])),
            own if own.shape(Role::Onset).is_some() => Some(Cow::Borrowed(&[0.0, 1.0][..])),
            own => bank.values(base, own),
        };
        let smallest = match values {
            None => size,
            Some(values) => values.iter().map(|value| size * value).fold(f64::INFINITY, f64::min),
        };
        constant + smallest >= min
    }

    /// Signature on the channels that it reaches.
    fn columns(&self, bank: &SignatureBank) -> [Option<Column>; CHANNELS] {
        let base = self.base(bank);
        let mut columns = bank.columns(base, &self.variation);
        for (channel, column) in columns.iter_mut().enumerate() {
            if !reaches(&base.amplitude, &self.gyros, channel) {
                *column = None;
            }
        }
        columns
    }

    /// Whitened signature.
    pub fn signature(&self, bank: &SignatureBank, normal: &NormalEquations) -> Signature {
        Signature::from_columns(normal, self.columns(bank))
    }

    /// Signature in all blocks.
    pub fn nuisance(&self, bank: &SignatureBank) -> Nuisance {
        self.columns(bank).map(|column| {
            let Column { from, values } = column?;
            let mut all = vec![0.0; from];
            all.extend(values);
            all.resize(bank.block_count(), 0.0);
            Some(all)
        })
    }

    /// The step at the same onset, if the course's end or decay explains less than `shape_chi2` more.
    pub fn as_step(&self, bank: &SignatureBank, normal: &NormalEquations, shape_chi2: f64) -> Option<Spot> {
        let Variation::Course { kind, shapes } = &self.variation else { return None };
        let begins = COURSES[*kind].shapes.first().is_some_and(is_onset);
        if *kind == STEP || !begins {
            return None;
        }
        let step = Variation::Course { kind: STEP, shapes: vec![shapes[0]] };
        let step = Spot::fit(bank, normal, self.base, step, self.gyros)?;
        (step.gain.chi2 > self.gain.chi2 - shape_chi2 && step.is_valid(bank)).then_some(step)
    }

    /// Optimises the shape parameters among the possible spots, for what settles also from these onsets; `None` if the result exceeds the
    /// limits of the model.
    pub fn optimised(
        &self,
        bank: &SignatureBank,
        normal: &NormalEquations,
        onsets_s: &[f64],
        is_possible: impl Fn(&Spot) -> bool,
    ) -> Option<Spot> {
        let duration_s = normal.residual[0].len() as f64 * bank.block_s();
        let at = |variation: &Variation| {
            Spot::fit(bank, normal, self.base, variation.clone(), self.gyros).filter(&is_possible)
        };
        let spacing_s =
            bank.step_spacing_s(self.base(bank).mode).filter(|_| self.variation.shape(Role::Onset).is_some());
        let likeliest_s = spacing_s.and_then(|spacing_s| self.likeliest_step_s(bank, normal, spacing_s, &is_possible));
        let settles = self.variation.shape(Role::TimeConstant).is_some();
        let onsets_s: Vec<f64> = likeliest_s.into_iter().chain(onsets_s.iter().copied().filter(|_| settles)).collect();
        let chi2 = |variation: &Variation| at(variation).map_or(0.0, |spot| spot.gain.chi2);
        let (variation, _) =
            maximise(self.variation.clone(), [duration_s, bank.block_s()], spacing_s.is_some(), &onsets_s, &chi2);
        at(&variation).filter(|spot| spot.hypothesis(bank).is_within_limits())
    }

    /// Onset of the likeliest possible step of the same amplitude and gyros, among those at this spacing.
    pub(crate) fn likeliest_step_s(
        &self,
        bank: &SignatureBank,
        normal: &NormalEquations,
        spacing_s: f64,
        is_possible: impl Fn(&Spot) -> bool,
    ) -> Option<f64> {
        let base = self.base(bank);
        let at = |onset: usize| onset as f64 * spacing_s;
        let count = (bank.block_count() as f64 * bank.block_s() / spacing_s) as usize;
        let step = |onset: usize| Variation::Course { kind: STEP, shapes: vec![at(onset)] };
        let channels =
            (0..CHANNELS).filter(|&channel| base.reaches(channel) && reaches(&base.amplitude, &self.gyros, channel));
        let forms: Option<Vec<_>> =
            channels.map(|channel| Some((channel, normal.whitening(channel).forms()?))).collect();
        let gains: Vec<(usize, SignatureFit)> = match forms {
            Some(forms) => {
                let mut products = vec![Products::none(normal.nuisances()); count];
                for (channel, forms) in forms {
                    let (residual, nuisances) = &normal.transposed()[channel];
                    let derivatives: Vec<&[f64]> = std::iter::once(residual)
                        .chain(nuisances.iter().map(|own| &own.1))
                        .map(|own| &own[..])
                        .collect();
                    let increment = |block: usize| of_value(&base.series[channel], base.mode, block);
                    let mut onset = count;
                    normal.whitening(channel).tails(forms, &increment, [1.0], &derivatives, |block, tail| {
                        while onset > 1 && (at(onset - 1) / bank.block_s()) as usize == block {
                            onset -= 1;
                            let course = tail.course(0, block, &[1.0]);
                            let own = &mut products[onset];
                            own.own += course.square;
                            own.residual += course.products[0];
                            let parts = nuisances.iter().zip(&course.products[1..]);
                            parts.for_each(|((place, _), product)| own.nuisances[*place] += product);
                        }
                    });
                }
                products
                    .iter()
                    .enumerate()
                    .skip(1)
                    .filter_map(|(onset, own)| Some((onset, normal.gain(own)?)))
                    .collect()
            }
            None => {
                let fit = |onset: usize| Spot::fit(bank, normal, self.base, step(onset), self.gyros);
                (1..count).filter_map(|onset| Some((onset, fit(onset)?.gain))).collect()
            }
        };
        let spot = |(onset, gain)| (at(onset), Spot { variation: step(onset), gain, ..self.clone() });
        let possible = gains.into_iter().map(spot).filter(|(_, spot)| is_possible(spot));
        possible.max_by(|one, other| one.1.gain.chi2.total_cmp(&other.1.gain.chi2)).map(|(onset_s, _)| onset_s)
    }
}

/// The best possible time course of each kind of one constant signature on each set of gyros of these channels. `sets` receives the channels that the
/// signature reaches.
pub fn spots(
    bank: &SignatureBank,
    normal: &NormalEquations,
    index: usize,
    has: [bool; CHANNELS],
    sets: impl Fn([bool; CHANNELS]) -> Vec<Gyros>,
    is_possible: impl Fn(&Spot) -> bool,
) -> Vec<Spot> {
    let base = &bank.bases[index];
    let mut best: Vec<Spot> = Vec::new();
    let mut last = ([false; CHANNELS], Vec::new());
    let push = |variation: &Variation, swept: &Swept<()>| {
        if last.1.is_empty() || last.0 != swept.reached() {
            last = (swept.reached(), sets(swept.reached()));
        }
        for &gyros in &last.1 {
            let Some(gain) = swept.gain(|channel| reaches(&base.amplitude, &gyros, channel)) else { continue };
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
    sweep(bank, normal, base, has, |_, _, _| (), push);
    best
}
