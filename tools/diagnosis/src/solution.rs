//! The model selected for a recording: noise, thresholds, and the search over the catalogue and over formulas.

use std::cell::LazyCell;

use geu_calibration::window::ManoeuvreWindow;
use geu_model::Configuration;
use geu_model::effect::{ClockFrequency, Effect};

use crate::diagnosis_case::DiagnosisCase;
use crate::fitted_hypothesis::FittedHypothesis;
use crate::linear_signatures::LinearSignatures;
use crate::measured::{BLOCK, CHANNELS, MeasuredData, ModelRun, Series, Shifts, TIMING};
use crate::model_selection::{MAX_PER_GYRO, Searches, SelectedModel, select_model};
use crate::model_state::ModelState;
use crate::noise;
use crate::normal_equations::NormalEquations;
use crate::null_distribution::{Thresholds, kurtosis_limits, thresholds};
use crate::rounding::{CLOSED_LOOP, CLOSED_LOOP_WITH_EFFECTS, correlation_with_motion};
use crate::signature_bank::HypothesisFamily;
use crate::signature_bank::SignatureBank;
use crate::significance::{FOUR_SIGMA_CHI2, THREE_SIGMAS};
use crate::small_motions::{has_noisy_motion, small_arcsec, unknown_rate_arcsec_per_s};
use crate::whiteness::{kurtosis, whiteness_statistic};
use crate::whitening::NoiseModel;
use geu_hypothesis::Hypothesis;
use geu_hypothesis::amplitude::AmplitudeRef;

/// Margin by which a formula must be better than the catalogue, beside its family's threshold: assumed odds of e^2.5, twelve to one, that
/// an effect is of the catalogue.
const FORMULA_MARGIN: f64 = 5.0;
/// Number of times that a noisy reference is smoothed without the effects: each leaves a part of what the one before took for motion.
const SMOOTHINGS: usize = 3;
/// Reduction of χ² from which an error of the clock is evident without a search: ten sigma.
const EVIDENT_CHI2: f64 = 100.0;
/// Maximum number of times that two hypotheses are added at once.
const PAIR_ROUNDS: usize = 3;
/// Version of the search beside the model's lists. It changes with grids, families and null recordings, so that stored thresholds never
/// apply to another search.
const SEARCH: &str = concat!(env!("CARGO_PKG_VERSION"), " 42");

/// Options of a diagnosis.
pub struct DiagnosisOptions<'a> {
    /// Seed of the null recordings.
    pub seed: u64,
    /// Time at which the unit's clock was 0, ns, for recordings without receive times.
    pub clock_start_ns: i64,
    /// Manoeuvres on the time scale of the recording; without them the motion itself determines the segments.
    pub manoeuvres: Option<&'a [ManoeuvreWindow]>,
    /// True for a manoeuvre that separates each effect from its alternatives.
    pub plans_manoeuvres: bool,
    /// Reads stored thresholds by their key.
    pub known: &'a (dyn Fn(u64) -> Option<Thresholds> + Sync),
    /// Stores new thresholds.
    pub keep: &'a (dyn Fn(u64, &Thresholds) + Sync),
    /// Receives the name of each step at its start.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

impl DiagnosisOptions<'_> {
    /// The first seed, the motion's own segments, no proposed manoeuvre, no stored thresholds and no progress.
    pub fn new(clock_start_ns: i64) -> DiagnosisOptions<'static> {
        DiagnosisOptions {
            seed: 1,
            clock_start_ns,
            manoeuvres: None,
            plans_manoeuvres: false,
            known: &|_| None,
            keep: &|_, _| (),
            progress: &|_| (),
        }
    }
}

/// The selected model of a recording, and what it was selected with.
pub struct Solution<'a> {
    pub case: DiagnosisCase<'a>,
    pub start: ModelState,
    /// Signatures of which alternatives are taken.
    pub bank: SignatureBank,
    pub thresholds: Thresholds,
    pub selected: SelectedModel,
    /// Rate up to which dead zones are not searched, arcsec/s.
    pub unknown_rate_arcsec_per_s: f64,
    /// Of the rounding with the motion.
    pub correlation: f64,
}

impl<'a> Solution<'a> {
    pub fn new(
        measured: &'a MeasuredData,
        nominal: &'a Configuration,
        options: &DiagnosisOptions,
        has_counts: bool,
    ) -> Solution<'a> {
        let progress = options.progress;
        progress("signatures");
        let mut case = DiagnosisCase::new(measured, nominal);
        // Rounding depends on the rate: that of the fitted scale factors and drifts.
        let path = case.set_origin(&fitted(&case));
        let noise = noise::configured(nominal, measured, &case.rounding, &measured.residual(&path));
        let start = case.start(noise);
        let correlation = |path: &ModelRun| if has_counts { correlation_with_motion(measured, path) } else { 0.0 };
        let is_loop = correlation(&path) > CLOSED_LOOP;
        let whole = signatures(&case);
        case.linear = LinearSignatures::new(whole.linear());
        // The reference of a described unit may be as noisy as its gyros, and a smoothed motion is taken from them.
        let contains_noise = !has_counts || is_loop || !nominal.device.is_iras() || measured.smoothed.is_some();
        let small_arcsec = small_arcsec(measured, &nominal.device, &noise);
        let evident = |bank: SignatureBank| match contains_noise {
            true => bank.without_small_motions(measured, &path, &small_arcsec),
            false => bank,
        };
        let unknown_rate_arcsec_per_s = unknown_rate_arcsec_per_s(measured, nominal, contains_noise, &small_arcsec);
        let catalogue = evident(whole.clone()).without_zones_up_to(unknown_rate_arcsec_per_s);
        let formulas = LazyCell::new(|| evident(catalogue.formulas(measured, nominal)));
        let all = LazyCell::new(|| catalogue.and(&formulas));
        // A clock that the alignment found is a part of the model from the start: far from it no signature is right.
        let mut seeded = start.clone();
        seeded.held.extend(aligned_clock(&case));
        let key = key(nominal, measured, &path, &noise, contains_noise, options.seed);
        let thresholds = (options.known)(key).unwrap_or_else(|| {
            progress("thresholds");
            let found = thresholds(&case, &all, &path, &case.fit(&mut seeded.clone()), &noise, options.seed);
            (options.keep)(key, &found);
            found
        });
        seeded.held.iter_mut().for_each(|own| own.penalty = thresholds.required(HypothesisFamily::CONSTANT));
        progress("search");
        let of_catalogue = Searches { pair_rounds: PAIR_ROUNDS, ..Searches::new(&case, &catalogue, &thresholds) };
        let of_all = LazyCell::new(|| Searches::new(&case, &all, &thresholds));
        let is_stated = |own: &SelectedModel| is_noise(own, &thresholds) && own.overfitted_gyros(nominal).is_empty();
        let score = |own: &SelectedModel| own.score(&case, &thresholds);
        let pass = |per_gyro: usize| {
            let effects = select_model(&of_catalogue, &seeded, per_gyro);
            if !effects.is_cut && is_noise(&effects, &thresholds) && !effects.is_doubtful(&case, &formulas, &thresholds)
            {
                return effects;
            }
            progress("formulas");
            let other = select_model(&of_all, &seeded, per_gyro);
            // A transient is as unlikely as a formula, and so is another effect at the same time.
            let is_of_time = other.state.held.iter().any(|held| held.hypothesis.amplitude.is_formula_of_time());
            let is_as_likely =
                other.state.held.len() < effects.state.held.len() || effects.has_transient() && !is_of_time;
            let margin = if is_as_likely { 0.0 } else { FORMULA_MARGIN };
            // What would end unexplained needs odds of e⁸ against effects that do not.
            let margin = if is_stated(&other) || !is_stated(&effects) { margin } else { FOUR_SIGMA_CHI2 };
            let is_better = other.requires_formula(&case) && score(&other) + margin < score(&effects);
            if is_better { other } else { effects }
        };
        // A second effect on one gyro is rare: a formula is tried first.
        let single = pass(1);
        let is_better = |several: &SelectedModel| !is_stated(&single) || score(several) < score(&single);
        let mut selected = single.is_cut.then(|| pass(MAX_PER_GYRO)).filter(is_better).unwrap_or(single);
        merge_gyros(&case, &mut selected);
        selected.leave_out_gyros(&case);
        selected.cross_validate(&case);
        let needs_formulas = !selected.state.held.is_empty() || !is_noise(&selected, &thresholds);
        // What is no evidence is an alternative nevertheless.
        let bank = if needs_formulas { whole.and(&formulas) } else { whole };
        let correlation = correlation(&case.run(&selected.state));
        Solution { case, start, bank, thresholds, selected, unknown_rate_arcsec_per_s, correlation }
    }

    /// Noise that changes from block to block, if the noise model as a whole does not describe its residual: that of a
    /// reference by cameras changes with the pose and the rate. Not of the default unit, of which the noise is configured.
    pub fn uneven(&self, seed: u64) -> Option<[Vec<f64>; TIMING]> {
        let Solution { case, selected, start, .. } = self;
        if case.nominal.device.is_iras() {
            return None;
        }
        let left = selected.normal.projected_residual();
        let limits = kurtosis_limits(case, &selected.state, &selected.normal, seed);
        // The rounding of rates that stay is not normal, whatever its size.
        let is_rounding =
            |gyro: usize| 2.0 * case.measured.counts.rounding_walk[gyro].powi(2) > start.noise[gyro].angle_walk.powi(2);
        let is_uneven = |gyro: usize| kurtosis(&left[gyro]) > limits[gyro] && !is_rounding(gyro);
        let is_uneven = case.measured.gyros().filter(is_uneven);
        if is_uneven.is_empty() {
            return None;
        }
        let (residual, a_priori) = (case.residual(&selected.state), case.a_priori(&selected.state.calibration));
        let of_start = NormalEquations::new(case.whitenings(&start.noise), &residual, &case.nuisances, &a_priori);
        let left = of_start.projected_residual();
        Some(std::array::from_fn(|gyro| if is_uneven[gyro] { noise::scales(&left[gyro]) } else { Vec::new() }))
    }

    /// The recording with a noisy reference that is smoothed again without the effects: smoothing takes a part of them for motion.
    pub fn smoothed_again(
        &self,
        smooth: &dyn Fn(&Configuration, &Series) -> Option<MeasuredData>,
    ) -> Option<MeasuredData> {
        let Solution { case, selected, .. } = self;
        if case.measured.smoothed.is_none() || selected.state.held.is_empty() {
            return None;
        }
        let nominal = case.nominal;
        let smoothed = |case: &DiagnosisCase, state: &ModelState| {
            // The times of the nodes contain the error of the clock.
            let mut without = state.clone();
            without.held.retain(|held| held.hypothesis.amplitude.code() == ClockFrequency::SPEC.code);
            let [with, path] = [state, &without].map(|state| case.run(state));
            let added =
                |channel: usize| with[channel].iter().zip(path[channel].iter()).map(|own| own.0 - own.1).collect();
            smooth(&without.configuration(nominal), &std::array::from_fn(added))
        };
        let mut state = selected.state.clone();
        let mut again = smoothed(case, &state)?;
        for _ in 1..SMOOTHINGS {
            let case = DiagnosisCase::new(&again, nominal);
            state.held.iter_mut().for_each(FittedHypothesis::invalidate);
            case.fit(&mut state);
            again = smoothed(&case, &state)?;
        }
        Some(again)
    }

    pub fn is_closed_loop(&self) -> bool {
        self.correlation > CLOSED_LOOP_WITH_EFFECTS
    }

    /// True if the motion answers the rounding and the counts do not agree with the model as given.
    pub fn needs_angles(&self) -> bool {
        let is_overfitted = !self.selected.overfitted_gyros(self.case.nominal).is_empty();
        let is_consistent = self.selected.state.held.is_empty() && is_noise(&self.selected, &self.thresholds);
        self.is_closed_loop() && (is_overfitted || !is_consistent)
    }

    /// The recording with angles along the path without effects, or with those selected.
    pub fn dequantised(&self) -> MeasuredData {
        let walks = std::array::from_fn(|gyro| self.start.noise[gyro].angle_walk);
        let mut fitted = self.start.clone();
        self.case.fit(&mut fitted);
        let paths = [&fitted, &self.selected.state].map(|state| self.case.run(state));
        self.case.measured.dequantised(&paths, walks)
    }
}

/// Signatures of the catalogue on a recording.
fn signatures(case: &DiagnosisCase) -> SignatureBank {
    let mut bank = SignatureBank::new(case.measured, case.nominal);
    if !case.nominal.device.is_iras() {
        bank.set_lag(&case.nuisances[case.nuisances.len() - 1]);
    }
    if has_noisy_motion(case.measured, case.nominal) { bank.without_filters_of_motion() } else { bank }
}

/// Calibration parameters and lag fitted without an effect, beside the error of the clock by which the nodes are dated.
fn fitted(case: &DiagnosisCase) -> ModelState {
    let clock = aligned_clock(case);
    let mut nominal = case.nominal.clone();
    clock.iter().for_each(|own| own.hypothesis.apply(&mut nominal));
    let before = case.measured.run(&nominal, Shifts::default());
    let noise = noise::configured(case.nominal, case.measured, &case.rounding, &case.measured.residual(&before));
    let mut fitted = case.start(noise);
    fitted.held.extend(clock);
    case.fit(&mut fitted);
    fitted.reset_undetermined_lag();
    fitted
}

/// The error of a clock by which nodes without receive times are dated.
fn clock(case: &DiagnosisCase) -> Option<FittedHypothesis> {
    let MeasuredData { counts, clock_ppm, .. } = case.measured;
    let mut all = AmplitudeRef::all(&case.nominal.device).into_iter();
    let clock = all.find(|own| own.code() == ClockFrequency::SPEC.code && !counts.is_received)?;
    Some(FittedHypothesis::new(Hypothesis::constant(clock, *clock_ppm, counts.gyros)))
}

/// The error of the clock that the alignment found, if it did.
fn aligned_clock(case: &DiagnosisCase) -> Option<FittedHypothesis> {
    clock(case).filter(|_| case.measured.clock_ppm != 0.0)
}

/// Calibration parameters and lag fitted without an effect; the error of a clock by which nodes without receive times are dated is held
/// if the motion shows it by far.
pub fn fitted_with_clock(case: &DiagnosisCase) -> ModelState {
    let fitted = fitted(case);
    if !fitted.held.is_empty() {
        return fitted;
    }
    let Some(clock) = clock(case) else { return fitted };
    let mut with = fitted.clone();
    with.held.push(clock);
    let fall = case.normal(&mut fitted.clone()).squares() - case.fit(&mut with).squares();
    if fall > EVIDENT_CHI2 { with } else { fitted }
}

fn is_noise(selected: &SelectedModel, thresholds: &Thresholds) -> bool {
    whiteness_statistic(&selected.normal.projected_residual()).0 <= thresholds.whiteness_statistic
}

/// Key of thresholds: a hash of all that they depend on, i.e. search, motion, usable blocks and noise.
fn key(
    nominal: &Configuration,
    measured: &MeasuredData,
    path: &ModelRun,
    noise: &[NoiseModel; CHANNELS],
    contains_noise: bool,
    seed: u64,
) -> u64 {
    // FNV-1a.
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut push = |bytes: &[u8]| {
        for byte in bytes {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    let tenths = |value: f64| ((value * 10.0).round() as i64).to_le_bytes();
    push(SEARCH.as_bytes());
    push(&[u8::from(contains_noise)]);
    push(&seed.to_le_bytes());
    AmplitudeRef::all(&nominal.device).iter().for_each(|amplitude| push(amplitude.code().as_bytes()));
    push(&tenths(nominal.electronics.numbers.reference_c));
    measured.electronics_c().into_iter().for_each(|celsius| push(&tenths(celsius)));
    for weights in measured.weights.iter().flatten() {
        weights.iter().step_by(BLOCK).for_each(|weight| push(&tenths(*weight)));
    }
    // Without stated sigmas all are 1.
    let scales = measured.smoothed.iter().flat_map(|smoothed| smoothed.white_scale.iter().flatten());
    scales.filter(|scale| **scale != 1.0).for_each(|scale| push(&tenths(scale.ln())));
    let scales = measured.noise_scale.iter().flat_map(|scales| scales.iter().flatten());
    scales.for_each(|scale| push(&tenths(scale.ln())));
    for channel in 0..CHANNELS {
        for block in &measured.blocks[channel] {
            push(&[u8::from(block.is_good), u8::from(block.restarts) + 2 * u8::from(block.begins_trial)]);
        }
        push(&noise[channel].angle_walk.to_le_bytes());
        push(&noise[channel].rate_walk.to_le_bytes());
        push(&noise[channel].scale_walk.to_le_bytes());
        push(&noise[channel].flicker.to_le_bytes());
        // Tenths only: the white noise is estimated from data on which a threshold should not depend.
        push(&tenths(noise[channel].white.ln()));
        path[channel].iter().step_by(BLOCK).for_each(|value| push(&tenths(*value)));
    }
    hash
}

/// Joins hypotheses of one amplitude on several gyros if their values agree.
fn merge_gyros(case: &DiagnosisCase, selected: &mut SelectedModel) {
    loop {
        let held = &selected.state.held;
        let pair = (0..held.len()).flat_map(|one| (one + 1..held.len()).map(move |other| (one, other))).find(|pair| {
            let (one, other) = (&held[pair.0], &held[pair.1]);
            let agree = one.hypothesis.parameters().iter().zip(other.hypothesis.parameters()).enumerate().all(
                |(index, (a, b))| {
                    let sigma = one.sigmas[index].hypot(other.sigmas[index]);
                    a.value == b.value || (a.value - b.value).abs() < THREE_SIGMAS * sigma
                },
            );
            one.hypothesis.amplitude == other.hypothesis.amplitude && !one.hypothesis.amplitude.is_of_unit() && agree
        });
        let Some((one, other)) = pair else { return };
        selected.join(case, one, other);
    }
}
