//! A diagnosis from its start to its end: what is missing, what is only out of date, what is left.

use std::cell::LazyCell;

use geu_calibration::CountsReader;
use geu_calibration::window::Window;
use geu_model::Configuration;
use geu_model::effect::{AngleRandomWalk, DriftRandomWalk, Effect};
use geu_model::number::Numbers;
use geu_model::package::Calibration;
use geu_protocol::Gyro;
use geu_recording::{Defect, Reference, Row, Sink};

use crate::bank::{Bank, Family};
use crate::change::{ALL_GYROS, Amplitude, Change, Gyros, Place, sixteen};
use crate::checks::{WiringFault, check};
use crate::explain::{Explained, NoiseFound, Round, explain, unlikeness};
use crate::finding::Finding;
use crate::gap::{self, Gap};
use crate::measured::{BLOCK_S, CHANNELS, Measured, MeasuredError, Series, Shifts, TIMING};
use crate::noise::{self, Walk};
use crate::normal::{Normal, THIRDS};
use crate::null::{Thresholds, thresholds};
use crate::remedy::Remedies;
use crate::rivals::{Rival, rivals};
use crate::search::search;
use crate::state::{Case, Held, State};
use crate::stretches::{self, Stretch};
use crate::whereabouts::{Whereabouts, whereabouts};

/// A formula must be better than the catalogue by so much: odds of e⁵, 150 to one.
const FORMULA_MARGIN: f64 = 10.0;
/// A calibration number is told as moved from so many sigmas on: once in 1000 recordings of sixteen.
const RECALIBRATED_SIGMAS: f64 = 4.0;
/// A constant lag beyond this is not the link's (icd.md).
const LAG_S: f64 = 0.010;
/// What the link's own lag may be, up to 5 ms (icd.md): its mean, and one sigma.
const LINK_LAG_S: (f64, f64) = (0.0025, 0.0025 / 1.732_050_807_568_877_2);
/// A walk is told from this many times the configured one on: rounding, while a gyro hardly turns, can look like half as much again.
const LEAST_WALK: f64 = 2.0;
/// How well calibration numbers hold between checkouts, in the order of [`Calibration::NUMBERS`]: 20 ppm and 6″/h are what a
/// calibration is for (Casteren §1, table 1), 3″ how well pivots let an axis be known (§5.3).
const HOLDS: [f64; Calibration::NUMBERS.len()] = [20e-6, 6.0 / 7200.0, 3.0, 3.0, 3.0];
/// Sigmas within which two gyros have the same size of an effect.
const SAME_SIGMAS: f64 = 3.0;
/// Cosine above which a calibration number and an effect are one thing.
const SAME: f64 = 0.9999;
/// Largest kurtosis of what a walk leaves: 3 is normal, and of 2000 blocks it errs by 0.1.
const MOST_KURTOSIS: f64 = 4.0;
/// What is searched, beside the model's lists: another one where grids, families or nulls change, so that thresholds that were kept
/// are not those of another search.
const SEARCH: &str = concat!(env!("CARGO_PKG_VERSION"), " 2");
/// Cosine above which two signatures are one.
const SAME_SIGNATURE: f64 = 0.999;
/// Rivals told.
const TOLD: usize = 8;
/// Terms told that the rest follows.
const FOLLOWED: usize = 5;

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// No missing effect, and noise-like once the sixteen are refitted.
    Consistent,
    /// At least one missing effect, and noise-like after.
    Explained,
    /// Otherwise.
    Unexplained,
}

impl Verdict {
    /// As JSON has it.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Consistent => "consistent",
            Verdict::Explained => "explained",
            Verdict::Unexplained => "unexplained",
        }
    }
}

/// A number found.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Key in the configuration, unit last.
    pub name: String,
    /// Value.
    pub value: f64,
    /// One sigma; nothing where it was not fitted.
    pub sigma: Option<f64>,
    /// As a configuration writes it, where that is no number: what is on, another gyro.
    pub written: Option<String>,
}

/// Whether something is missing in the model or only its calibration out of date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Class {
    /// An effect that the configuration does not have.
    MissingEffect,
    /// The sixteen moved.
    Recalibration,
}

/// One thing found.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Code of the model.
    pub code: String,
    /// What it follows, where it is a term that stands in no catalogue, with the unit of its coefficient.
    pub formula: Option<(String, String)>,
    /// Missing or out of date.
    pub class: Class,
    /// The gyros that it acts on.
    pub gyros: Gyros,
    /// Its numbers.
    pub parameters: Vec<Number>,
    /// Fall of the fitted part's summed squared residual when it is added in order, over that of the configuration as given.
    pub gap_share: f64,
    /// By how much χ² falls with it, and what chance does in one recording of a hundred; nothing where it was found by exact checks.
    pub chi2: Option<(f64, f64)>,
    /// By how much it lowers χ² of each third, fitted to the other two.
    pub held_out: Option<[f64; THIRDS]>,
    /// What looks like it.
    pub rivals: Vec<RivalShown>,
    /// What puts it into a configuration.
    pub assignments: Vec<String>,
}

/// A rival as it is told.
#[derive(Debug, Clone, PartialEq)]
pub struct RivalShown {
    /// Code.
    pub code: String,
    /// Formula of a term that stands in no catalogue.
    pub formula: Option<String>,
    /// The gyros.
    pub gyros: Gyros,
    /// Cosine of the two signatures.
    pub cosine: f64,
    /// By how much χ² falls more with what was found; nothing where the two are one signature.
    pub behind_chi2: Option<f64>,
    /// What would tell them apart.
    pub remedy: Option<String>,
}

/// What is left that nothing explains.
#[derive(Debug, Clone, PartialEq)]
pub struct Unexplained {
    /// The gyros that show it.
    pub gyros: Gyros,
    /// From when to when it stands out, s.
    pub interval_s: [f64; 2],
    /// In words.
    pub shape: String,
    /// Terms that it follows, with what χ² falls by with each alone.
    pub follows: Vec<(String, f64)>,
}

/// A gap and the same held out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaps {
    /// On all of the data that were fitted.
    pub fitted: Gap,
    /// On each third, by a fit to the other two.
    pub held_out: Gap,
}

/// The whole of it.
#[derive(Debug)]
pub struct Diagnosis {
    /// In a word.
    pub verdict: Verdict,
    /// What was found: what is missing, then what is out of date.
    pub entries: Vec<Entry>,
    /// What exact checks found.
    pub findings: Vec<Finding>,
    /// With the configuration as given.
    pub before: Gaps,
    /// With the configuration that was written.
    pub after: Gaps,
    /// What is left.
    pub unexplained: Option<Unexplained>,
    /// The configuration with everything found.
    pub configuration: Configuration,
    /// The search, round by round.
    pub rounds: Vec<Round>,
    /// What chance does.
    pub thresholds: Thresholds,
    /// Windowed residual at each node, before and after.
    pub windowed: [[Vec<f64>; TIMING]; 2],
    /// What the unit did.
    pub stretches: Vec<Stretch>,
    /// Root mean square of the residual in each stretch on each gyro, before and after.
    pub stretch_rms_arcsec: [Vec<[f64; TIMING]>; 2],
    /// Where the data leave the model, before (what exact checks mended taken as mended) and after.
    pub whereabouts: [Whereabouts; 2],
    /// Whitened residual at the end, for what it still follows.
    pub left: Series,
    /// Common lag, s, and its sigma.
    pub lag_s: (f64, f64),
    /// Noise of each gyro as it was taken.
    pub noise: [crate::whitening::Noise; CHANNELS],
}

/// What a diagnosis takes beside recording and configuration.
pub struct Options<'a> {
    /// Seed of the null recordings.
    pub seed: u64,
    /// Thresholds known from before, by [`key`].
    pub known: Option<Thresholds>,
    /// The recording before wiring faults were mended, where there are any.
    pub raw: Option<&'a Measured>,
    /// What the unit did; nothing where its motion is to tell.
    pub manoeuvres: Option<&'a [Window]>,
    /// Told what is being done.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

/// Diagnoses a recording, after its exact checks.
pub fn diagnose(
    measured: &Measured,
    believed: &Configuration,
    findings: Vec<Finding>,
    faults: &[WiringFault],
    options: &Options,
) -> Diagnosis {
    let tell = options.progress;
    tell("signatures");
    let case = Case::new(measured, believed);
    let catalogue = Bank::new(measured, believed);
    let before = measured.run(believed, Shifts::default());
    let noise = noise::of(believed, measured, &measured.residual(&before));
    let start = case.start(noise);
    let formulas = LazyCell::new(|| catalogue.formulas(measured, believed));
    let all = LazyCell::new(|| catalogue.and(&formulas));
    let thresholds = options.known.clone().unwrap_or_else(|| {
        tell("thresholds");
        let normal = case.fit(&mut start.clone());
        thresholds(&case, &all, &normal, &noise, options.seed)
    });
    tell("search");
    let mut explained = explain(&case, &catalogue, &thresholds, &start);
    let is_noise = unlikeness(&explained.normal.left()).0 <= thresholds.unlikeness;
    if !is_noise || explained.is_doubtful(&case, &formulas, &thresholds) {
        tell("formulas");
        let other = explain(&case, &all, &thresholds, &start);
        let has_formula = other.state.held.iter().any(|held| held.change.amplitude.place == Place::Discovered);
        if has_formula && other.score(&thresholds) + FORMULA_MARGIN < explained.score(&thresholds) {
            explained = other;
        }
    }
    tell("report");
    merge_gyros(&case, &mut explained);
    explained.widen_onsets(&case);
    let bank: &Bank = if !explained.state.held.is_empty() || !is_noise { &all } else { &catalogue };
    let (raw, manoeuvres) = (options.raw, options.manoeuvres);
    Report { case: &case, bank, thresholds: &thresholds, faults, raw, manoeuvres }.finish(explained, findings)
}

/// What thresholds depend on: the motion, the blocks that can be used, the noise, what is searched.
pub fn key(measured: &Measured, believed: &Configuration, seed: u64) -> u64 {
    let before = measured.run(believed, Shifts::default());
    let noise = noise::of(believed, measured, &measured.residual(&before));
    // FNV-1a.
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut take = |bytes: &[u8]| {
        for byte in bytes {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    take(SEARCH.as_bytes());
    take(&seed.to_le_bytes());
    for amplitude in Amplitude::all() {
        take(amplitude.code().as_bytes());
    }
    for channel in 0..CHANNELS {
        for block in &measured.blocks[channel] {
            take(&[u8::from(block.is_good), u8::from(block.restarts)]);
        }
        for noise in [noise[channel].angle_walk, noise[channel].rate_walk] {
            take(&noise.to_le_bytes());
        }
        // To a tenth: the white noise is told by the data, which a threshold should not depend on.
        take(&((noise[channel].white.ln() * 10.0).round() as i64).to_le_bytes());
        for value in before[channel].iter().step_by(crate::measured::BLOCK) {
            take(&((value * 10.0).round() as i64).to_le_bytes());
        }
    }
    hash
}

/// Makes one change of those of one code on several gyros whose sizes agree.
fn merge_gyros(case: &Case, explained: &mut Explained) {
    loop {
        let held = &explained.state.held;
        let pair = (0..held.len()).flat_map(|one| (one + 1..held.len()).map(move |other| (one, other))).find(|pair| {
            let (one, other) = (&held[pair.0], &held[pair.1]);
            let agree =
                one.change.parameters().iter().zip(other.change.parameters()).enumerate().all(|(index, (a, b))| {
                    let sigma = one.sigmas[index].hypot(other.sigmas[index]);
                    a.value == b.value || (a.value - b.value).abs() < SAME_SIGMAS * sigma
                });
            one.change.amplitude == other.change.amplitude && one.change.amplitude.place != Place::Unit && agree
        });
        let Some((one, other)) = pair else { return };
        explained.join(case, one, other);
    }
}

struct Report<'a> {
    case: &'a Case<'a>,
    bank: &'a Bank,
    thresholds: &'a Thresholds,
    faults: &'a [WiringFault],
    raw: Option<&'a Measured>,
    manoeuvres: Option<&'a [Window]>,
}

impl Report<'_> {
    fn finish(&self, mut explained: Explained, findings: Vec<Finding>) -> Diagnosis {
        let (case, measured) = (self.case, self.case.measured);
        let (_, channels) = unlikeness(&explained.normal.left());
        let mut piled = explained.piled(&|found| is_told(case.believed, &explained.state, found));
        // A walk is normal and steady: what comes in bursts is none.
        let whitened = explained.normal.left();
        for found in explained.noise.iter().filter(|found| is_told(case.believed, &explained.state, found)) {
            piled[found.channel] |= kurtosis(&whitened[found.channel]) > MOST_KURTOSIS;
        }
        let unlike: Gyros = std::array::from_fn(|gyro| channels[gyro] > self.thresholds.unlikeness || piled[gyro]);
        if unlike.contains(&true) {
            // A pile that does not end in noise explains nothing: what was held of these gyros alone is no name for it.
            explained.drop_on(case, &unlike);
        }
        let left = explained.normal.left();
        let (_, channels) = unlikeness(&left);
        let unlike: Gyros = std::array::from_fn(|gyro| channels[gyro] > self.thresholds.unlikeness || piled[gyro]);
        // On a gyro that is left unexplained larger noise is a last resort, and no name.
        explained.noise.retain(|found| is_told(case.believed, &explained.state, found) && !unlike[found.channel]);
        let mut findings = findings;
        let late_s = explained.state.shifts.temperature_s;
        if late_s != 0.0 {
            findings.push(Finding {
                kind: "temperature-lag".to_owned(),
                place: "the whole recording".to_owned(),
                text: format!(
                    "what follows the electronics temperature does so {late_s:.0} s before the temperature is told"
                ),
            });
        }
        let mut entries = self.faults();
        entries.extend(self.effects(&explained));
        entries.extend(self.noises(&explained));
        if let Some(entry) = self.lag(&mut explained) {
            entries.push(entry);
        }
        let is_missing = !entries.is_empty();
        entries.extend(self.recalibrations(&explained.state));
        let verdict = match (unlike.contains(&true), is_missing) {
            (true, _) => Verdict::Unexplained,
            (false, true) => Verdict::Explained,
            (false, false) => Verdict::Consistent,
        };
        let unexplained = unlike.contains(&true).then(|| self.unexplained(&explained, &left, unlike));
        let configuration = self.written(&entries, &explained);
        let shifts = explained.state.shifts;
        let windowed_of = |model: &Series| gap::windowed(measured, &gap::residual(measured, model));
        let given = measured.run(case.believed, shifts);
        let raw = self.raw.unwrap_or(measured);
        let before = gap::windowed(raw, &gap::residual(raw, &given));
        let after_run = measured.run(&configuration, shifts);
        let after = windowed_of(&after_run);
        let before_gap = self.gap(raw, &before, &given, &explained.state);
        let after_gap = self.gap(measured, &after, &after_run, &explained.state);
        let held_out = self.held_out(&explained, &after_run);
        self.shares(&mut entries, before_gap.squares, shifts);
        let stretches = match self.manoeuvres {
            Some(windows) => stretches::listed(measured, windows),
            None => stretches::cut(measured),
        };
        Diagnosis {
            verdict,
            entries,
            findings,
            before: Gaps { fitted: before_gap, held_out: before_gap },
            after: Gaps { fitted: after_gap, held_out },
            unexplained,
            configuration,
            rounds: explained.rounds,
            thresholds: self.thresholds.clone(),
            windowed: [before, after],
            stretch_rms_arcsec: [
                stretches::rms_arcsec(raw, &given, &stretches),
                stretches::rms_arcsec(measured, &after_run, &stretches),
            ],
            whereabouts: whereabouts(case, &explained.state.noise, [&given, &after_run], &stretches),
            stretches,
            left,
            lag_s: (shifts.lag_s, explained.state.lag_sigma_s),
            noise: explained.state.noise,
        }
    }

    /// What exact checks name by a code of the model.
    fn faults(&self) -> Vec<Entry> {
        let of = |fault: &WiringFault| {
            let mut gyros = [false; 4];
            fault.gyros.iter().for_each(|gyro| gyros[*gyro as usize] = true);
            let onset = fault.onset_s.map(|onset_s| Number {
                name: "time_s".to_owned(),
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
    fn effects(&self, explained: &Explained) -> Vec<Entry> {
        let configuration = explained.state.configuration(self.case.believed);
        let remedies = Remedies::new(self.case);
        let of = |(index, held): (usize, &Held)| {
            let amplitude = &held.change.amplitude;
            let rivals = rivals(self.case, self.bank, &explained.state, index).into_iter();
            let rivals: Vec<Rival> = rivals.filter(|rival| !is_the_same(amplitude, rival)).take(TOLD).collect();
            let told = remedies.of(&explained.state, index, &rivals);
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
                chi2: Some(explained.worth(self.case, index)),
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
    fn noises(&self, explained: &Explained) -> Vec<Entry> {
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
        for (entry, _) in &mut entries {
            let (code, number) = (&entry.code, &entry.parameters[0]);
            let gyros = Gyro::ALL.into_iter().filter(|gyro| entry.gyros[*gyro as usize]);
            let assignment = |gyro: Gyro| format!("gyro.{}.{code}.{} = {:?}", gyro.name(), number.name, number.value);
            entry.assignments = gyros.map(assignment).collect();
        }
        entries.into_iter().map(|(entry, _)| entry).collect()
    }

    /// A common lag that is more than a link's, as the effect that has its signature: a reference that is early looks the same.
    fn lag(&self, explained: &mut Explained) -> Option<Entry> {
        let state = &mut explained.state;
        let (lag_s, lag_sigma_s) = (state.shifts.lag_s, state.lag_sigma_s);
        let sigma = lag_sigma_s;
        if lag_s.abs() <= LAG_S + SAME_SIGMAS * sigma {
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

    /// The constant amplitude that has the signature of a nuisance, and how much of it one unit of the nuisance is.
    fn alike(&self, nuisance: &[Option<Vec<f64>>; CHANNELS], place: Place) -> Option<(Amplitude, f64)> {
        let steps = |values: &[f64]| -> Vec<f64> { values.windows(2).map(|pair| pair[1] - pair[0]).collect() };
        self.bank.bases.iter().filter(|base| base.amplitude.place == place).find_map(|base| {
            let (mut both, mut ones, mut others) = (0.0, 0.0, 0.0);
            for (channel, values) in nuisance.iter().enumerate().take(TIMING) {
                let Some(values) = values else { continue };
                let (one, other) = (steps(values), steps(base.values(channel)));
                both += crate::normal::dot(&one, &other);
                ones += crate::normal::dot(&one, &one);
                others += crate::normal::dot(&other, &other);
            }
            let is_same = others > 0.0 && both.abs() > SAME * (ones * others).sqrt();
            is_same.then(|| (base.amplitude, both / others))
        })
    }

    /// Calibration numbers that moved.
    fn recalibrations(&self, state: &State) -> Vec<Entry> {
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

    /// What is left: which gyros, when, what it follows.
    fn unexplained(&self, explained: &Explained, left: &Series, gyros: Gyros) -> Unexplained {
        const WINDOW: usize = 24;
        // Of two minutes each: how much more than noise.
        let blocks = self.case.measured.block_count();
        let excess: Vec<f64> = (0..blocks / WINDOW)
            .map(|window| {
                let of_gyro = |gyro: usize| {
                    let sum: f64 = left[gyro][window * WINDOW..(window + 1) * WINDOW].iter().sum();
                    (sum * sum / WINDOW as f64 - 1.0).max(0.0)
                };
                (0..TIMING).filter(|&gyro| gyros[gyro]).map(of_gyro).sum()
            })
            .collect();
        let whole: f64 = excess.iter().sum();
        let reached = |share: f64| {
            let mut sum = 0.0;
            excess.iter().position(|excess| {
                sum += excess;
                sum >= share * whole
            })
        };
        let at_s = |window: usize| (window * WINDOW) as f64 * BLOCK_S;
        let (from, to) = (reached(0.05).unwrap_or(0), reached(0.95).unwrap_or(excess.len()));
        let held: usize = excess.iter().filter(|excess| **excess > 4.0).count();
        let share = 100.0 * held as f64 / excess.len().max(1) as f64;
        let shape = match share {
            share if share < 5.0 => "a few short departures",
            share if share < 40.0 => "departures in some manoeuvres",
            _ => "departures through most of it",
        };
        let formulas = search(self.bank, &explained.normal, &explained.state, &|_| 0.0);
        let mut follows: Vec<(String, f64)> = formulas
            .iter()
            .filter(|candidate| {
                candidate.change.amplitude.place == Place::Discovered
                    && candidate.change.gyros.iter().zip(gyros).all(|(one, other)| !one || other)
            })
            .map(|candidate| {
                let name = candidate.change.amplitude.formula.map_or(String::new(), |formula| formula.to_string());
                (name, candidate.gain.chi2)
            })
            .collect();
        follows.sort_by(|one, other| other.1.total_cmp(&one.1));
        let mut seen: Vec<String> = Vec::new();
        follows.retain(|(name, _)| {
            !seen.contains(name) && {
                seen.push(name.clone());
                true
            }
        });
        follows.truncate(FOLLOWED);
        let shape = format!("{shape}: {share:.0} % of the two-minute averages stand out by more than two sigma");
        Unexplained { gyros, interval_s: [at_s(from), at_s((to + 1).min(excess.len()))], shape, follows }
    }

    /// The configuration as the entries write it; what moved by less than is told stays as believed.
    fn written(&self, entries: &[Entry], explained: &Explained) -> Configuration {
        let assignments: Vec<String> = entries.iter().flat_map(|entry| entry.assignments.iter().cloned()).collect();
        let text = self.case.believed.to_toml(false);
        Configuration::parse("the configuration found", &text, &assignments)
            .unwrap_or_else(|_| explained.state.configuration(self.case.believed))
    }

    fn gap(&self, measured: &Measured, windowed: &[Vec<f64>; TIMING], model: &Series, state: &State) -> Gap {
        let residual = measured.residual(model);
        let white = Normal::new(self.case.whitenings(&state.noise), &residual, &[]);
        let squares: f64 = white.residual()[..TIMING].iter().flatten().map(|value| value * value).sum();
        let count: usize = white.residual()[..TIMING].iter().flatten().filter(|value| **value != 0.0).count();
        Gap { reduced_chi2: squares / count.max(1) as f64, ..gap::of(windowed) }
    }

    /// The gap of each third, with everything that is fitted taken from the other two.
    fn held_out(&self, explained: &Explained, model: &Series) -> Gap {
        let (measured, state) = (self.case.measured, &mut explained.state.clone());
        let (residual, columns) = self.case.linearised(state);
        let normal = Normal::new(self.case.whitenings(&state.noise), &residual, &columns);
        let blocks = measured.block_count();
        let mut corrections: Series = std::array::from_fn(|_| vec![0.0; blocks]);
        let mut squares = 0.0;
        for (third, size) in normal.without_thirds(&known(state)).into_iter().enumerate() {
            let range = blocks * third / THIRDS..blocks * (third + 1) / THIRDS;
            let mut own: Series = std::array::from_fn(|channel| residual[channel].clone());
            for (column, size) in columns.iter().zip(&size) {
                for channel in 0..CHANNELS {
                    let Some(values) = &column[channel] else { continue };
                    for block in 0..blocks {
                        own[channel][block] -= size * values[block];
                    }
                    for block in range.clone() {
                        corrections[channel][block] += size * values[block];
                    }
                }
            }
            let white = Normal::new(self.case.whitenings(&state.noise), &own, &[]);
            squares +=
                white.residual()[..TIMING].iter().flat_map(|values| &values[range.clone()]).map(|v| v * v).sum::<f64>();
        }
        let count = normal.residual()[..TIMING].iter().flatten().filter(|value| **value != 0.0).count();
        // Where one third ends and the next begins another fit holds: each window starts anew there.
        let thirds: Vec<usize> = (0..=THIRDS).map(|third| blocks * third / THIRDS).collect();
        let plain = gap::residual(measured, model);
        let of = |gyro: usize, node: usize| {
            let block = ((node - 1) / crate::measured::BLOCK).min(blocks - 1);
            let third = thirds.iter().rposition(|&start| start <= block).unwrap_or(0).min(THIRDS - 1);
            let own = &corrections[gyro][thirds[third]..thirds[third + 1]];
            plain(gyro, node) - gap::at_node(own, node - thirds[third] * crate::measured::BLOCK)
        };
        let mut windowed = gap::windowed(measured, &of);
        for gyro in &mut windowed {
            for &start in &thirds[1..THIRDS] {
                let first = 1 + start * crate::measured::BLOCK;
                let end = (first - 1).next_multiple_of(gap::WINDOW).min(gyro.len() - 1);
                let at_first = gyro.get(first).copied().unwrap_or(f64::NAN);
                if !at_first.is_nan() && !(first - 1).is_multiple_of(gap::WINDOW) {
                    gyro[first..=end].iter_mut().for_each(|value| *value -= at_first);
                }
            }
        }
        Gap { reduced_chi2: squares / count.max(1) as f64, ..gap::of(&windowed) }
    }

    /// The fall of the squares as each entry is added, in order.
    fn shares(&self, entries: &mut [Entry], whole: f64, shifts: Shifts) {
        let measured = self.case.measured;
        let squares = |configuration: &Configuration| {
            let model = measured.run(configuration, shifts);
            gap::of(&gap::windowed(measured, &gap::residual(measured, &model))).squares
        };
        let text = self.case.believed.to_toml(false);
        let (mut assignments, mut before) = (Vec::new(), squares(self.case.believed));
        // What mending the rows took away, among the faults by what each did.
        let did = |fault: &WiringFault| {
            (fault.without_rms_counts.powi(2) - fault.with_rms_counts.powi(2)) * fault.half_seconds as f64
        };
        let all: f64 = self.faults.iter().map(did).sum();
        for (entry, fault) in entries.iter_mut().zip(self.faults) {
            entry.gap_share = if all > 0.0 { (whole - before) / whole * did(fault) / all } else { 0.0 };
        }
        for entry in entries.iter_mut().filter(|entry| entry.chi2.is_some()) {
            assignments.extend(entry.assignments.iter().cloned());
            let Ok(with) = Configuration::parse("the configuration found", &text, &assignments) else { continue };
            let now = squares(&with);
            entry.gap_share = if whole > 0.0 { (before - now) / whole } else { 0.0 };
            before = now;
        }
    }
}

/// Fourth moment over the square of the second; 3 of normal values. Blocks that tell nothing, exactly 0, are left out.
fn kurtosis(values: &[f64]) -> f64 {
    let known = || values.iter().filter(|value| **value != 0.0);
    let count = known().count().max(1) as f64;
    let moment = |power: i32| known().map(|value| value.powi(power)).sum::<f64>() / count;
    if moment(2) > 0.0 { moment(4) / moment(2).powi(2) } else { 0.0 }
}

/// Whether a rival is what was found in other words: a course of it that is constant all through, or its law as a formula.
fn is_the_same(found: &Amplitude, rival: &Rival) -> bool {
    let other = &rival.change.amplitude;
    let is_course = found.kind.is_none() && (other.place, other.effect) == (found.place, found.effect);
    let is_law = found.formula.is_none() && other.formula.is_some();
    rival.cosine > SAME_SIGNATURE && (is_course || is_law)
}

/// Whether a walk is so much larger than configured that it is no trick of rounding.
fn is_told(believed: &Configuration, state: &State, found: &NoiseFound) -> bool {
    if found.channel == TIMING {
        return false;
    }
    let effects = &believed.gyros[found.channel].effects.constant;
    let configured = match found.walk {
        Walk::Angle => effects.angle_random_walk.arcsec_per_sqrt_s,
        Walk::Rate => effects.drift_random_walk.arcsec_per_s_per_sqrt_s,
    };
    state.noise[found.channel].walk(found.walk) >= LEAST_WALK * configured
}

/// What is known of the sixteen and the lag before a recording, as departures from a state: a calibration holds for as long as
/// [`HOLDS`] says, and where it has plainly not held, as much as it was off.
fn known(state: &State) -> Vec<(f64, f64)> {
    let of_number = |((_, number), moved): ((Gyro, usize), &f64)| (-moved, HOLDS[number].max(moved.abs()));
    let sixteen = sixteen().into_iter().zip(&state.sixteen).map(of_number);
    sixteen.chain(std::iter::once((-state.shifts.lag_s, LAG_S.max(state.shifts.lag_s.abs())))).collect()
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

/// A recording as a decoder gave it, diagnosed from its exact checks on. `clock_start_ns` is when the unit's clock was 0, for
/// recordings without receive times; `known` tells thresholds by their key, and is told new ones.
///
/// # Errors
/// Too little of recording or reference.
pub fn diagnose_rows(
    rows: &[Row],
    defects: &[Defect],
    believed: &Configuration,
    reference: &Reference,
    options: &Settings,
) -> Result<Diagnosis, MeasuredError> {
    (options.progress)("exact checks");
    let checked = check(rows, defects, believed, reference);
    let counts = |rows: &[Row]| {
        let mut reader = CountsReader::default();
        rows.iter().for_each(|row| reader.row(row));
        reader.finish(options.clock_start_ns).ok_or(MeasuredError::Empty)
    };
    let measured = Measured::new(counts(&checked.rows)?, reference)?;
    let raw = if checked.faults.is_empty() { None } else { Measured::new(counts(rows)?, reference).ok() };
    let key = key(&measured, believed, options.seed);
    let known = (options.known)(key);
    let is_new = known.is_none();
    let own = Options {
        seed: options.seed,
        known,
        raw: raw.as_ref(),
        manoeuvres: options.manoeuvres,
        progress: options.progress,
    };
    let diagnosis = diagnose(&measured, believed, checked.findings, &checked.faults, &own);
    if is_new {
        (options.keep)(key, &diagnosis.thresholds);
    }
    Ok(diagnosis)
}

/// What [`diagnose_rows`] takes beside recording and configuration.
pub struct Settings<'a> {
    /// Seed of the null recordings.
    pub seed: u64,
    /// When the unit's clock was 0, ns.
    pub clock_start_ns: i64,
    /// What the unit did, on the time scale of the recording; nothing where its motion is to tell.
    pub manoeuvres: Option<&'a [Window]>,
    /// Thresholds by their key.
    pub known: &'a (dyn Fn(u64) -> Option<Thresholds> + Sync),
    /// Keeps thresholds.
    pub keep: &'a (dyn Fn(u64, &Thresholds) + Sync),
    /// Told what is being done.
    pub progress: &'a (dyn Fn(&str) + Sync),
}
