//! What was found, as it is told: each change, walk, lag and fault with its numbers, its rivals and what writes it.

use geu_model::effect::{AngleRandomWalk, DriftRandomWalk, Effect};
use geu_model::number::Numbers;
use geu_model::package::Calibration;
use geu_protocol::Gyro;

use crate::bank::{Bank, Base, Family};
use crate::change::{ALL_GYROS, Amplitude, Change, Gyros, ONSET, Place, sixteen};
use crate::checks::WiringFault;
use crate::explain::Explained;
use crate::measured::{CHANNELS, TIMING};
use crate::noise::Walk;
use crate::normal::dot;
use crate::null::Thresholds;
use crate::outcome::{Class, Entry, Number, RivalShown};
use crate::remedy::Remedies;
use crate::rivals::{APART_CHI2, Prices, Rival, rivals};
use crate::search::{Candidate, search};
use crate::state::{Case, Held, State};

/// A calibration number is told as moved from so many sigmas on: once in 1000 recordings of sixteen.
const RECALIBRATED_SIGMAS: f64 = 4.0;
/// A constant lag beyond this is not the link's (icd.md).
pub const LAG_S: f64 = 0.010;
/// What the link's own lag may be, up to 5 ms (icd.md): its mean, and one sigma.
const LINK_LAG_S: (f64, f64) = (0.0025, 0.0025 / 1.732_050_807_568_877_2);
/// Sigmas within which two gyros have the same size of an effect.
pub const SAME_SIGMAS: f64 = 3.0;
/// Cosine above which a calibration number and an effect are one thing.
const SAME: f64 = 0.9999;
/// Cosine above which two signatures are one.
const SAME_SIGNATURE: f64 = 0.999;
/// Rivals told at least, and at most with what would tell them apart.
const TOLD: usize = 8;

/// What entries are made from.
pub struct Entries<'a> {
    /// Recording and configuration.
    pub case: &'a Case<'a>,
    /// What was searched.
    pub bank: &'a Bank,
    /// What chance does.
    pub thresholds: &'a Thresholds,
    /// What exact checks found wrong in the wiring.
    pub faults: &'a [WiringFault],
}

impl Entries<'_> {
    /// What exact checks name by a code of the model.
    pub fn faults(&self) -> Vec<Entry> {
        let of = |fault: &WiringFault| {
            let mut gyros = [false; 4];
            fault.gyros.iter().for_each(|gyro| gyros[*gyro as usize] = true);
            let onset = fault.onset_s.map(|onset_s| Number {
                name: ONSET.to_owned(),
                value: onset_s,
                sigma: None,
                written: None,
            });
            let written = fault.written();
            let path = format!("gyro.{}.{}", fault.bearer.name(), fault.code);
            let assignments = std::iter::once(format!("{path}.{} = {written}", fault.parameter))
                .chain(fault.onset_s.map(|onset_s| format!("{path}.time_s = {onset_s:?}")));
            Entry {
                code: fault.code.clone(),
                formula: None,
                class: Class::MissingEffect,
                gyros,
                parameters: std::iter::once(Number {
                    name: fault.parameter.to_owned(),
                    value: fault.value,
                    sigma: None,
                    written: Some(written.clone()),
                })
                .chain(onset)
                .collect(),
                gap_share: 0.0,
                chi2: None,
                held_out: None,
                rivals: Vec::new(),
                assignments: assignments.collect(),
            }
        };
        self.faults.iter().map(of).collect()
    }

    /// The changes held.
    pub fn effects(&self, explained: &Explained) -> Vec<Entry> {
        let configuration = explained.state.configuration(self.case.believed);
        let remedies = Remedies::new(self.case);
        let of = |(index, held): (usize, &Held)| {
            let amplitude = &held.change.amplitude;
            let worth = explained.worth(self.case, index);
            let prices = Prices { found: worth.1, of: &|family, change| self.thresholds.price(family, change) };
            let rivals = rivals(self.case, self.bank, &explained.state, index, &prices).into_iter();
            let mut rivals: Vec<Rival> = rivals.filter(|rival| !is_the_same(amplitude, rival)).collect();
            // The whole group, and what comes next.
            let in_group = rivals.iter().take_while(|rival| rival.behind_chi2 < APART_CHI2).count();
            rivals.truncate((in_group + 1).max(TOLD));
            let remedied = in_group.min(TOLD);
            let mut told = remedies.of(&explained.state, index, &rivals[..remedied]);
            told.resize(rivals.len(), None);
            let numbers = held.change.parameters().into_iter().zip(&held.sigmas).map(|(parameter, sigma)| Number {
                name: parameter.name,
                value: parameter.value,
                sigma: sigma.is_finite().then_some(*sigma),
                written: None,
            });
            Entry {
                code: amplitude.code(),
                formula: amplitude.formula.map(|formula| (formula.to_string(), formula.unit())),
                class: Class::MissingEffect,
                gyros: held.change.gyros,
                parameters: numbers.collect(),
                gap_share: 0.0,
                chi2: Some(worth),
                held_out: explained.held_out.get(index).copied(),
                rivals: rivals
                    .into_iter()
                    .zip(told)
                    .map(|(rival, remedy)| RivalShown { remedy, ..shown(rival) })
                    .collect(),
                assignments: held.change.assignments(&configuration),
            }
        };
        explained.state.held.iter().enumerate().map(of).collect()
    }

    /// Walks that are larger than configured; gyros of one walk whose sizes agree are one entry.
    pub fn noises(&self, explained: &Explained) -> Vec<Entry> {
        let mut entries: Vec<(Entry, f64)> = Vec::new();
        for found in &explained.noise {
            let (spec, number) = match found.walk {
                Walk::Angle => (AngleRandomWalk::SPEC, AngleRandomWalk::default().specs()[0]),
                Walk::Rate => (DriftRandomWalk::SPEC, DriftRandomWalk::default().specs()[0]),
            };
            let value = explained.state.noise[found.channel].walk(found.walk);
            let sigma = found.fitted.log_sigma;
            let same = entries.iter_mut().find(|(entry, other)| {
                let apart = (entry.parameters[0].value / value).ln().abs();
                entry.code == spec.code && apart < SAME_SIGMAS * sigma.hypot(*other)
            });
            match same {
                Some((entry, other)) => {
                    // The weighted mean of the logarithms.
                    let (one, two) = (other.powi(-2), sigma.powi(-2));
                    let mean = (entry.parameters[0].value.ln() * one + value.ln() * two) / (one + two);
                    *other = (one + two).powf(-0.5);
                    entry.parameters[0].value = mean.exp();
                    entry.parameters[0].sigma = Some(mean.exp() * *other);
                    entry.gyros[found.channel] = true;
                    entry.chi2 = entry.chi2.map(|(fall, least)| (fall + found.fitted.fall, least));
                }
                None => entries.push((
                    Entry {
                        code: spec.code.to_owned(),
                        formula: None,
                        class: Class::MissingEffect,
                        gyros: std::array::from_fn(|gyro| gyro == found.channel),
                        parameters: vec![Number {
                            name: number.name.to_owned(),
                            value,
                            sigma: Some(value * sigma),
                            written: None,
                        }],
                        gap_share: 0.0,
                        chi2: Some((found.fitted.fall, self.thresholds.of(Family::NOISE))),
                        held_out: None,
                        rivals: Vec::new(),
                        assignments: Vec::new(),
                    },
                    sigma,
                )),
            }
        }
        let mut entries: Vec<Entry> = entries.into_iter().map(|(entry, _)| entry).collect();
        for entry in &mut entries {
            let (code, number) = (&entry.code, &entry.parameters[0]);
            let gyros = Gyro::ALL.into_iter().filter(|gyro| entry.gyros[*gyro as usize]);
            let assignment = |gyro: Gyro| format!("gyro.{}.{code}.{} = {:?}", gyro.name(), number.name, number.value);
            entry.assignments = gyros.map(assignment).collect();
        }
        self.rival_noises(explained, &mut entries);
        entries
    }

    /// What of the bank explains nearly as much as larger noise does, were that as configured.
    fn rival_noises(&self, explained: &Explained, entries: &mut [Entry]) {
        if entries.is_empty() {
            return;
        }
        let mut state = explained.state.clone();
        for found in &explained.noise {
            let configured = found.configured(self.case.believed);
            state.noise[found.channel] = state.noise[found.channel].with(found.walk, configured);
        }
        let normal = self.case.normal(&mut state);
        let candidates = search(self.bank, &normal, &state, &|_| 0.0);
        for entry in entries {
            let fall = entry.chi2.map_or(0.0, |(fall, _)| fall);
            let is_within = |gyros: &Gyros| gyros.iter().zip(entry.gyros).all(|(own, noisy)| !own || noisy);
            let near = candidates.iter().filter(|candidate| {
                candidate.change.amplitude.place != Place::Unit
                    && is_within(&candidate.change.gyros)
                    && fall - candidate.gain.chi2 < APART_CHI2
            });
            let shown = |candidate: &Candidate| RivalShown {
                code: candidate.change.amplitude.code(),
                formula: candidate.change.amplitude.formula.map(|formula| formula.to_string()),
                gyros: candidate.change.gyros,
                // Noise has no signature.
                cosine: 0.0,
                behind_chi2: Some((fall - candidate.gain.chi2).max(0.0)),
                remedy: None,
            };
            entry.rivals = near.map(shown).collect();
        }
    }

    /// A common lag that is more than a link's, as the effect that has its signature: a reference that is early looks the same.
    pub fn lag(&self, explained: &mut Explained) -> Option<Entry> {
        let state = &mut explained.state;
        let (lag_s, lag_sigma_s) = (state.shifts.lag_s, state.lag_sigma_s);
        let sigma = lag_sigma_s;
        if lag_s.abs() <= LAG_S + SAME_SIGMAS * sigma {
            // At rest nothing tells a lag, and one that is not told would only move the limit cycle.
            if sigma > LAG_S {
                state.shifts.lag_s = 0.0;
            }
            return None;
        }
        let own = self.case.nuisances.last()?;
        let (amplitude, ratio) = self.alike(own, Place::Unit)?;
        // Some of it is the link's.
        let link_s = if self.case.measured.counts.is_received { LINK_LAG_S } else { (0.0, 0.0) };
        let change = Change {
            amplitude,
            size: (lag_s - link_s.0) * ratio,
            own_shapes: Vec::new(),
            course_shapes: Vec::new(),
            gyros: ALL_GYROS,
        };
        let sigma = sigma.hypot(link_s.1);
        state.shifts.lag_s = link_s.0;
        state.held.push(Held::fixed(change.clone()));
        let configuration = state.configuration(self.case.believed);
        let late = RivalShown {
            code: if lag_s > 0.0 { "reference-early" } else { "reference-late" }.to_owned(),
            formula: None,
            gyros: ALL_GYROS,
            cosine: 1.0,
            behind_chi2: None,
            remedy: Some("a time stamp of unit and reference by one clock".to_owned()),
        };
        let limits = amplitude.size();
        Some(Entry {
            code: amplitude.code(),
            formula: None,
            class: Class::MissingEffect,
            gyros: ALL_GYROS,
            parameters: vec![Number {
                name: limits.name,
                value: change.size,
                sigma: Some(sigma * ratio.abs()),
                written: None,
            }],
            gap_share: 0.0,
            chi2: Some(((lag_s / lag_sigma_s).powi(2), (LAG_S / lag_sigma_s).powi(2))),
            held_out: None,
            rivals: vec![late],
            assignments: change.assignments(&configuration),
        })
    }

    /// The constant amplitude that has the signature of a nuisance, and how much of it one unit of the nuisance is. On a short motion
    /// others look much like it: the most alike is meant.
    fn alike(&self, nuisance: &[Option<Vec<f64>>; CHANNELS], place: Place) -> Option<(Amplitude, f64)> {
        let steps = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
        let of_base = |base: &Base| {
            let (mut both, mut ones, mut others) = (0.0, 0.0, 0.0);
            for (channel, values) in nuisance.iter().enumerate().take(TIMING) {
                let Some(values) = values else { continue };
                let (one, other) = (steps(values), steps(base.values(channel)));
                both += dot(&one, &other);
                ones += dot(&one, &one);
                others += dot(&other, &other);
            }
            let cosine = if others > 0.0 { both.abs() / (ones * others).sqrt() } else { 0.0 };
            (cosine, base.amplitude, both / others)
        };
        let all = self.bank.bases.iter().filter(|base| base.amplitude.place == place).map(of_base);
        let (cosine, amplitude, ratio) = all.max_by(|one, other| one.0.total_cmp(&other.0))?;
        (cosine > SAME).then_some((amplitude, ratio))
    }

    /// Calibration numbers that moved.
    pub fn recalibrations(&self, state: &State) -> Vec<Entry> {
        let mut entries: Vec<Entry> = Vec::new();
        for (index, (gyro, number)) in sixteen().into_iter().enumerate() {
            let (value, sigma) = (state.sixteen[index], state.sixteen_sigmas[index]);
            if value.abs() <= RECALIBRATED_SIGMAS * sigma || sigma.is_nan() {
                continue;
            }
            let Some((amplitude, ratio)) = self.alike(&self.case.nuisances[index], Place::Head) else { continue };
            let found = Number {
                name: amplitude.size().name,
                value: value * ratio,
                sigma: Some(sigma * ratio.abs()),
                written: None,
            };
            let key = Calibration::NUMBERS[number].name;
            let total = self.case.believed.gyros[gyro as usize].calibration.value(number) + value;
            // Digits beyond a hundredth of a sigma say nothing.
            let decimals = (2.0 - sigma.log10().floor()).clamp(0.0, 15.0) as usize;
            let assignment = format!("gyro.{}.calibration.{key} = {total:.decimals$}", gyro.name());
            let gyros: Gyros = std::array::from_fn(|other| other == gyro as usize);
            match entries.iter_mut().find(|entry| entry.code == amplitude.code() && entry.gyros == gyros) {
                Some(entry) => {
                    entry.parameters.push(found);
                    entry.assignments.push(assignment);
                    entry.chi2 = entry.chi2.map(|(fall, least)| (fall.max((value / sigma).powi(2)), least));
                }
                None => entries.push(Entry {
                    code: amplitude.code(),
                    formula: None,
                    class: Class::Recalibration,
                    gyros,
                    parameters: vec![found],
                    gap_share: 0.0,
                    chi2: Some(((value / sigma).powi(2), RECALIBRATED_SIGMAS.powi(2))),
                    held_out: None,
                    rivals: Vec::new(),
                    assignments: vec![assignment],
                }),
            }
        }
        entries
    }
}

/// Whether a rival is what was found in other words: a course of it that is constant all through, or its law as a formula.
fn is_the_same(found: &Amplitude, rival: &Rival) -> bool {
    let other = &rival.change.amplitude;
    let is_course =
        found.kind.is_none() && other.kind.is_some() && (other.place, other.effect) == (found.place, found.effect);
    let is_law = found.formula.is_none() && other.formula.is_some();
    rival.cosine > SAME_SIGNATURE && (is_course || is_law)
}

fn shown(rival: Rival) -> RivalShown {
    RivalShown {
        code: rival.change.amplitude.code(),
        formula: rival.change.amplitude.formula.map(|formula| formula.to_string()),
        gyros: rival.change.gyros,
        cosine: rival.cosine,
        behind_chi2: Some(rival.behind_chi2),
        remedy: None,
    }
}
