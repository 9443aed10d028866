//! A diagnosis from its start to its end: what is missing, what is only out of date, what is left.

use std::cell::LazyCell;

use geu_calibration::CountsReader;
use geu_calibration::window::ManoeuvreWindow;
use geu_model::Configuration;
use geu_recording::{Defect, ReceivedSample, ReferenceAttitude, Sink};

use crate::amplitude::AmplitudeRef;
use crate::bank::SignatureBank;
use crate::checks::{WiringFault, check};
use crate::entries::{Entries, SAME_SIGMAS};
use crate::explain::{Explained, MOST_OF_ONE, select_model};
use crate::finding::Finding;
use crate::gap;
use crate::gyros::Gyros;
use crate::held_out::{fitted, held_out};
use crate::measured::{BLOCK, CHANNELS, MeasuredData, MeasuredError, Series, Shifts};
use crate::noise;
use crate::null::{Thresholds, thresholds};
use crate::outcome::{Correction, DiagnosedEffect, Diagnosis, Gaps, Verdict};
use crate::remainder::unexplained;
use crate::state::{DiagnosisCase, ModelState};
use crate::stretches;
use crate::whereabouts::whereabouts;
use crate::whiteness::{kurtosis, unlikeness};

/// A formula must be better than the catalogue by so much: odds of e⁵, 150 to one.
const FORMULA_MARGIN: f64 = 10.0;
/// What is searched, beside the model's lists: another one where grids, families or nulls change, so that thresholds that were kept
/// are not those of another search.
const SEARCH: &str = concat!(env!("CARGO_PKG_VERSION"), " 12");

/// What [`diagnose_rows`] takes beside recording and configuration.
pub struct DiagnosisOptions<'a> {
    /// Seed of the null recordings.
    pub seed: u64,
    /// When the unit's clock was 0, ns.
    pub clock_start_ns: i64,
    /// What the unit did, on the time scale of the recording; nothing where its motion is to tell.
    pub manoeuvres: Option<&'a [ManoeuvreWindow]>,
    /// Thresholds by their key.
    pub known: &'a (dyn Fn(u64) -> Option<Thresholds> + Sync),
    /// Keeps thresholds.
    pub keep: &'a (dyn Fn(u64, &Thresholds) + Sync),
    /// Told what is being done.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

/// A recording as a decoder gave it, diagnosed from its exact checks on. `clock_start_ns` is when the unit's clock was 0, for
/// recordings without receive times; `known` tells thresholds by their key, and is told new ones.
///
/// # Errors
/// Too little of recording or reference.
pub fn diagnose_rows(
    rows: &[ReceivedSample],
    defects: &[Defect],
    believed: &Configuration,
    reference: &ReferenceAttitude,
    options: &DiagnosisOptions,
) -> Result<Diagnosis, MeasuredError> {
    (options.progress)("exact checks");
    let checked = check(rows, defects, believed, reference);
    let counts = |rows: &[ReceivedSample]| {
        let mut reader = CountsReader::default();
        rows.iter().for_each(|row| reader.row(row));
        reader.finish(options.clock_start_ns).ok_or(MeasuredError::Empty)
    };
    let measured = MeasuredData::new(counts(&checked.rows)?, reference)?;
    let raw = if checked.faults.is_empty() { None } else { MeasuredData::new(counts(rows)?, reference).ok() };
    let key = key(&measured, believed, options.seed);
    let known = (options.known)(key);
    let is_new = known.is_none();
    let own = SearchOptions {
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

/// What a diagnosis takes beside recording and configuration.
pub struct SearchOptions<'a> {
    /// Seed of the null recordings.
    pub seed: u64,
    /// Thresholds known from before, by [`key`].
    pub known: Option<Thresholds>,
    /// The recording before wiring faults were mended, where there are any.
    pub raw: Option<&'a MeasuredData>,
    /// What the unit did; nothing where its motion is to tell.
    pub manoeuvres: Option<&'a [ManoeuvreWindow]>,
    /// Told what is being done.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

/// Diagnoses a recording, after its exact checks.
pub fn diagnose(
    measured: &MeasuredData,
    believed: &Configuration,
    findings: Vec<Finding>,
    faults: &[WiringFault],
    options: &SearchOptions,
) -> Diagnosis {
    let tell = options.progress;
    tell("signatures");
    let case = DiagnosisCase::new(measured, believed);
    let catalogue = SignatureBank::new(measured, believed);
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
    let mut explained = best_of(&case, &catalogue, &formulas, &all, &thresholds, &start, tell);
    tell("report");
    merge_gyros(&case, &mut explained);
    let bank: &SignatureBank =
        if !explained.state.held.is_empty() || !is_noise(&explained, &thresholds) { &all } else { &catalogue };
    let (raw, manoeuvres) = (options.raw, options.manoeuvres);
    let report = Report { case: &case, start: &start, bank, thresholds: &thresholds, faults, raw, manoeuvres };
    report.finish(explained, findings)
}

/// What explains the recording best, of the catalogue, or with formulas where that leaves doubt. A second effect of one gyro is seldom:
/// before there are more, a formula is tried.
fn best_of(
    case: &DiagnosisCase,
    catalogue: &SignatureBank,
    formulas: &LazyCell<SignatureBank, impl FnOnce() -> SignatureBank>,
    all: &LazyCell<SignatureBank, impl FnOnce() -> SignatureBank>,
    thresholds: &Thresholds,
    start: &ModelState,
    tell: &(dyn Fn(&str) + Sync),
) -> Explained {
    let pass = |most: usize| {
        let effects = select_model(case, catalogue, thresholds, start, most);
        let is_done = !effects.is_cut && is_noise(&effects, thresholds);
        if is_done && !effects.is_doubtful(case, formulas, thresholds) {
            return effects;
        }
        tell("formulas");
        let other = select_model(case, all, thresholds, start, most);
        let is_better = other.stands_on_a_formula(case)
            && other.score(case, thresholds) + FORMULA_MARGIN < effects.score(case, thresholds);
        if is_better { other } else { effects }
    };
    let few = pass(1);
    if few.is_cut { pass(MOST_OF_ONE) } else { few }
}

fn is_noise(explained: &Explained, thresholds: &Thresholds) -> bool {
    unlikeness(&explained.normal.left()).0 <= thresholds.unlikeness
}

/// What thresholds depend on: the motion, the blocks that can be used, the noise, what is searched.
pub fn key(measured: &MeasuredData, believed: &Configuration, seed: u64) -> u64 {
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
    for amplitude in AmplitudeRef::all() {
        take(amplitude.code().as_bytes());
    }
    for celsius in measured.electronics_c() {
        take(&((celsius * 10.0).round() as i64).to_le_bytes());
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
        for value in before[channel].iter().step_by(BLOCK) {
            take(&((value * 10.0).round() as i64).to_le_bytes());
        }
    }
    hash
}

/// Makes one change of those of one code on several gyros whose sizes agree.
fn merge_gyros(case: &DiagnosisCase, explained: &mut Explained) {
    loop {
        let held = &explained.state.held;
        let pair = (0..held.len()).flat_map(|one| (one + 1..held.len()).map(move |other| (one, other))).find(|pair| {
            let (one, other) = (&held[pair.0], &held[pair.1]);
            let agree = one.hypothesis.parameters().iter().zip(other.hypothesis.parameters()).enumerate().all(
                |(index, (a, b))| {
                    let sigma = one.sigmas[index].hypot(other.sigmas[index]);
                    a.value == b.value || (a.value - b.value).abs() < SAME_SIGMAS * sigma
                },
            );
            one.hypothesis.amplitude == other.hypothesis.amplitude && !one.hypothesis.amplitude.is_of_unit() && agree
        });
        let Some((one, other)) = pair else { return };
        explained.join(case, one, other);
    }
}

struct Report<'a> {
    case: &'a DiagnosisCase<'a>,
    start: &'a ModelState,
    bank: &'a SignatureBank,
    thresholds: &'a Thresholds,
    faults: &'a [WiringFault],
    raw: Option<&'a MeasuredData>,
    manoeuvres: Option<&'a [ManoeuvreWindow]>,
}

impl Report<'_> {
    fn finish(&self, mut explained: Explained, mut findings: Vec<Finding>) -> Diagnosis {
        let (case, measured) = (self.case, self.case.measured);
        let (unlike, left) = self.drop_doubtful(&mut explained);
        findings.extend(temperature_lag(&explained.state.shifts));
        let told = Entries { case, bank: self.bank, thresholds: self.thresholds, faults: self.faults };
        let mut entries = told.faults();
        entries.extend(told.effects(&explained));
        entries.extend(told.noises(&explained));
        if let Some(entry) = told.lag(&mut explained) {
            entries.push(entry);
        }
        let is_missing = !entries.is_empty();
        entries.extend(told.recalibrations(&explained.state));
        let verdict = match (unlike.contains(&true), is_missing) {
            (true, _) => Verdict::Unexplained,
            (false, true) => Verdict::Explained,
            (false, false) => Verdict::Consistent,
        };
        let unexplained = unlike.contains(&true).then(|| unexplained(case, self.bank, &explained, &left, unlike));
        let configuration = self.corrected(entries.iter().flat_map(|entry| &entry.corrections));
        let shifts = explained.state.shifts;
        // The configuration as given meets the recording as it was, and knows nothing of what was found afterwards.
        let as_given = case.of_calibration(self.raw.unwrap_or(measured));
        let raw = as_given.measured;
        let given = raw.run(case.believed, Shifts::default());
        let before = gap::windowed(raw, &gap::residual(raw, &given));
        let before_gaps =
            Gaps { fitted: fitted(&as_given, &before, &given, self.start), held_out: held_out(&as_given, self.start) };
        let [lagged, found] = [case.believed, &configuration].map(|configuration| measured.run(configuration, shifts));
        let after = gap::windowed(measured, &gap::residual(measured, &found));
        let after_gaps =
            Gaps { fitted: fitted(case, &after, &found, &explained.state), held_out: held_out(case, &explained.state) };
        self.shares(&mut entries, before_gaps.fitted.squares, shifts);
        let stretches = match self.manoeuvres {
            Some(windows) => stretches::listed(measured, windows),
            None => stretches::cut(measured),
        };
        Diagnosis {
            verdict,
            entries,
            findings,
            before: before_gaps,
            after: after_gaps,
            unexplained,
            configuration,
            rounds: explained.rounds,
            thresholds: self.thresholds.clone(),
            windowed: [before, after],
            stretch_rms_arcsec: [
                stretches::rms_arcsec(raw, &given, &stretches),
                stretches::rms_arcsec(measured, &found, &stretches),
            ],
            whereabouts: whereabouts(case, &explained.state.noise, [&lagged, &found], &stretches),
            stretches,
            left,
            lag_s: (shifts.lag_s, explained.state.lag_sigma_s),
            temperature_late_s: shifts.temperature_s,
            noise: explained.state.noise,
        }
    }

    /// Takes back what is no name for anything, and tells the gyros that are left unexplained and what is left at all.
    fn drop_doubtful(&self, explained: &mut Explained) -> (Gyros, Series) {
        let unlike = |left: &Series, piled: &Gyros| -> Gyros {
            let (_, channels) = unlikeness(left);
            std::array::from_fn(|gyro| channels[gyro] > self.thresholds.unlikeness || piled[gyro])
        };
        let mut piled = explained.overfitted_gyros(self.case.believed);
        let left = explained.normal.left();
        // A walk is normal and steady: what comes in bursts is none.
        for found in explained.noise.iter().filter(|found| found.is_told(self.case.believed, &explained.state)) {
            piled[found.channel] |= kurtosis(&left[found.channel]) > self.thresholds.kurtosis[found.channel];
        }
        let first = unlike(&left, &piled);
        if first.contains(&true) {
            // A pile that does not end in noise explains nothing: what was held of these gyros alone is no name for it.
            explained.drop_on(self.case, &first);
            // What stood beside it may be worth nothing without.
            explained.prune(self.case);
        }
        let unlike = unlike(&explained.normal.left(), &piled);
        explained.noise.retain(|found| found.is_told(self.case.believed, &explained.state));
        // On a gyro that is left unexplained larger noise is a last resort, and no name.
        explained.reset_noise(self.case, &unlike);
        explained.widen_onsets(self.case);
        (unlike, explained.normal.left())
    }

    /// The configuration as the entries correct it; what moved by less than is reported stays as given.
    fn corrected<'a>(&self, corrections: impl Iterator<Item = &'a Correction>) -> Configuration {
        let mut configuration = self.case.believed.clone();
        corrections.for_each(|correction| correction.apply(&mut configuration));
        configuration
    }

    /// The fall of the squares as each entry is added, in order, over those of the whole gap; the lag that was found is no entry and
    /// holds all through.
    fn shares(&self, entries: &mut [DiagnosedEffect], whole: f64, shifts: Shifts) {
        let squares = |measured: &MeasuredData, configuration: &Configuration| {
            let model = measured.run(configuration, shifts);
            gap::of(&gap::windowed(measured, &gap::residual(measured, &model))).squares
        };
        let measured = self.case.measured;
        let (mut with, mut before) = (self.case.believed.clone(), squares(measured, self.case.believed));
        // What mending the rows took away, among the faults by what each did.
        let did = |fault: &WiringFault| {
            (fault.without_rms_counts.powi(2) - fault.with_rms_counts.powi(2)) * fault.samples as f64
        };
        let all: f64 = self.faults.iter().map(did).sum();
        let mended = self.raw.map_or(0.0, |raw| squares(raw, self.case.believed) - before);
        for (entry, fault) in entries.iter_mut().zip(self.faults) {
            entry.gap_share = if all > 0.0 { mended / whole * did(fault) / all } else { 0.0 };
        }
        for entry in entries.iter_mut().filter(|entry| entry.chi2.is_some()) {
            entry.corrections.iter().for_each(|correction| correction.apply(&mut with));
            let now = squares(measured, &with);
            entry.gap_share = if whole > 0.0 { (before - now) / whole } else { 0.0 };
            before = now;
        }
    }
}

/// What is to be said of a temperature that is told late.
fn temperature_lag(shifts: &Shifts) -> Option<Finding> {
    let late_s = shifts.temperature_s;
    let when = if late_s > 0.0 { "before" } else { "after" };
    (late_s != 0.0).then(|| Finding {
        kind: "temperature-lag".to_owned(),
        place: "the whole recording".to_owned(),
        text: format!(
            "what follows the electronics temperature does so {:.0} s {when} the temperature is told",
            late_s.abs()
        ),
    })
}
