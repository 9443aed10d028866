//! A diagnosis from start to end: missing effects, outdated calibration parameters, residual.

use std::cell::LazyCell;
use std::sync::Arc;

use geu_calibration::CountsReader;
use geu_calibration::window::ManoeuvreWindow;
use geu_model::Configuration;
use geu_recording::{Defect, ReceivedSample, ReferenceAttitude, Sink};

use crate::cross_validation::{fitted, held_out, reduced_chi2};
use crate::diagnosis_case::DiagnosisCase;
use crate::entries::Entries;
use crate::measured::{MeasuredData, MeasuredError, ModelRun, ReferenceSigma, Series, Shifts, TIMING};
use crate::model_selection::{FEW_SAMPLES, SelectedModel, early_minimum_s};
use crate::model_state::ModelState;
use crate::motion_segments;
use crate::noise;
use crate::null_distribution::{kurtosis_limits, largest_growth};
use crate::outcome::{Class, DiagnosedEffect, Diagnosis, Gaps, Verdict};
use crate::report::admission::{self, Refused, SquaredGap, refuse};
use crate::residual_map::residual_maps;
use crate::residual_stats::{self, residual, windowed};
use crate::shares::Shares;
use crate::solution::{DiagnosisOptions, Solution};
use crate::unexplained::unexplained;
use crate::whiteness::{kurtosis, moment, whiteness_statistic};
use geu_checks::{Finding, WiringFault, check};
use geu_protocol::Gyros;

/// χ² of two degrees of freedom that a walk of constant growth exceeds once in a thousand recordings.
const CHANGED_CHI2: f64 = 13.8;
/// Variance of a whitened residual below which the noise is smaller than configured: four sigma of ten minutes.
const SMALLER_VARIANCE: f64 = 0.5;

/// Diagnoses a decoded recording, exact checks included.
///
/// # Errors
/// Recording and reference have too little in common.
pub fn diagnose_rows(
    rows: &[ReceivedSample],
    defects: &[Defect],
    nominal: &Configuration,
    reference: &ReferenceAttitude,
    options: &DiagnosisOptions,
) -> Result<Diagnosis, MeasuredError> {
    (options.progress)("exact checks");
    let checked = check(rows, defects, nominal, reference);
    if let Some(got) = checked.mismatch {
        return Err(MeasuredError::Mismatch(got));
    }
    let counts = |rows: &[ReceivedSample]| {
        let mut reader = CountsReader::default();
        rows.iter().for_each(|row| reader.row(row));
        reader.finish(options.clock_start_ns).ok_or(MeasuredError::Empty)
    };
    let measured = MeasuredData::new(counts(&checked.rows)?, reference, nominal)?;
    let raw = if checked.faults.is_empty() { None } else { MeasuredData::new(counts(rows)?, reference, nominal).ok() };
    Ok(diagnose(&measured, (raw, &|_, _| None), (checked.findings, checked.faults), nominal, options))
}

/// The recording with its reference smoothed again by calibrated gyros, without what effects add to their counts.
pub(crate) type Smooth<'a> = &'a dyn Fn(&Configuration, &Series) -> Option<MeasuredData>;

/// Diagnoses a recording after the exact checks; `raw` is the recording before wiring faults were corrected, if there are any.
pub(crate) fn diagnose(
    measured: &MeasuredData,
    (raw, smooth): (Option<MeasuredData>, Smooth),
    (mut findings, faults): (Vec<Finding>, Vec<WiringFault>),
    nominal: &Configuration,
    options: &DiagnosisOptions,
) -> Diagnosis {
    let progress = options.progress;
    let mut solution = Solution::new(measured, nominal, options, true);
    let scales = solution.uneven(options.seed);
    let mut again = solution.smoothed_again(smooth).or_else(|| scales.is_some().then(|| measured.clone()));
    if let Some(again) = &mut again {
        again.noise_scale = scales.map(Arc::new);
    }
    let is_subtracted = !measured.trial_drifts.is_empty() || measured.accelerations.is_found();
    if is_subtracted && !solution.selected.state.held.is_empty() {
        let again = again.get_or_insert_with(|| measured.clone());
        let Solution { case, selected, .. } = &solution;
        let mut residual = case.residual(&selected.state);
        again.accelerations.subtract((&mut again.counts, &mut residual), case, &selected.state, false);
        again.trial_drifts.subtract((&mut again.counts, &residual), case, &selected.state);
    }
    if let Some(again) = &again {
        findings.extend(again.noise_scale.is_some().then(|| uneven_noise(again)));
        // Two at a time would take twice the memory.
        drop(solution);
        solution = Solution::new(again, nominal, options, true);
    }
    let measured = again.as_ref().unwrap_or(measured);
    findings.extend(solution.is_closed_loop().then(|| closed_loop(solution.correlation)));
    findings.extend(glitches(&measured.glitches_s));
    findings.extend(measured.reference_sigma.as_ref().and_then(ReferenceSigma::finding));
    findings.extend(measured.accelerations.findings(&solution.case));
    findings.extend(measured.trial_drifts.findings(&solution.case));
    findings.extend(zones(solution.unknown_rate_arcsec_per_s));
    let angles = solution.needs_angles().then(|| solution.dequantised());
    let second = angles.as_ref().map(|angles| Solution::new(angles, nominal, options, false));
    let raw = raw.or_else(|| angles.is_some().then(|| measured.clone()));
    let Solution { case, start, bank, thresholds, selected, .. } = second.unwrap_or(solution);
    progress("report");
    let (case, bank, thresholds, start) = (&case, &bank, &thresholds, &start);
    let DiagnosisOptions { manoeuvres, seed, plans_manoeuvres, .. } = *options;
    let plans_manoeuvres = plans_manoeuvres && nominal.device.is_iras();
    let entries = Entries { case, bank, thresholds, faults: &faults, plans_manoeuvres };
    let report = Report { entries, start, raw: raw.as_ref(), manoeuvres, seed };
    report.finish(selected, findings)
}

struct Report<'a> {
    entries: Entries<'a>,
    start: &'a ModelState,
    /// The recording before wiring faults were corrected, if there are any.
    raw: Option<&'a MeasuredData>,
    manoeuvres: Option<&'a [ManoeuvreWindow]>,
    /// Seed of the null recordings.
    seed: u64,
}

impl Report<'_> {
    fn finish(&self, mut selected: SelectedModel, mut findings: Vec<Finding>) -> Diagnosis {
        let Entries { case, bank, thresholds, .. } = self.entries;
        let measured = case.measured;
        let (mut unexplained_gyros, mut left) = self.drop_doubtful(&mut selected);
        findings.extend(temperature_lag(&selected.state.shifts));
        let mut entries = self.entries.faults();
        entries.extend(self.entries.effects(&selected));
        entries.extend(self.entries.lag(&mut selected));
        entries.extend(self.entries.recalibrations(&selected));
        // What moves the calibration of an unexplained gyro is not known.
        entries.retain(|entry| entry.class == Class::MissingEffect || !entry.gyros.is_within(&unexplained_gyros));
        self.drop_harmful(&mut entries, selected.state.shifts);
        let shifts = selected.state.shifts;
        let refused = self.refuse(&mut entries, &mut unexplained_gyros, &selected.state);
        refused.iter().for_each(|(entry, _)| selected.drop_stated(case, entry));
        if !refused.is_empty() {
            selected.reset_noise(case, &unexplained_gyros);
            left = selected.normal.projected_residual();
        }
        findings.extend(smaller_noise(case, &left));
        findings.extend(walking_drifts(case, &selected.state));
        let noises = self.entries.noises(&selected);
        let effects_end = entries.iter().take_while(|entry| entry.class == Class::MissingEffect).count();
        entries.splice(effects_end..effects_end, noises);
        let effects = refused.iter().filter(|(entry, _)| entry.class == Class::MissingEffect);
        findings.extend(effects.map(admission::finding));
        let unexplained =
            (!unexplained_gyros.is_empty()).then(|| unexplained(case, bank, &selected, &left, unexplained_gyros));
        // Parameters that moved by less than is reported stay as given.
        let configuration = self.configured_with(&entries);
        // The input configuration is compared with the recording before any correction, without the estimated lag and noise.
        let as_given = case.of_calibration(self.raw.unwrap_or(measured));
        let raw = as_given.measured;
        let given = raw.run(case.nominal, Shifts::default());
        let [lagged, updated] = [case.nominal, &configuration].map(|configuration| measured.run(configuration, shifts));
        let residuals = [(raw, &given), (measured, &updated)]
            .map(|(measured, model)| windowed(measured, residual(measured, model)));
        let gaps = |case: &DiagnosisCase, windowed: &[Vec<f64>; TIMING], model: &ModelRun, state: &ModelState| Gaps {
            fitted: fitted(case, windowed, model, state),
            held_out: held_out(case, state),
        };
        let before = gaps(&as_given, &residuals[0], &given, self.start);
        let after = gaps(case, &residuals[1], &updated, &selected.state);
        Shares {
            case,
            raw: self.raw,
            state: &selected.state,
            configuration: &configuration,
            faults: self.entries.faults,
        }
        .set(&mut entries, residual_stats::squares(raw, &given).iter().sum());
        let segments = match self.manoeuvres {
            Some(windows) => motion_segments::listed(measured, windows),
            None => motion_segments::cut(measured),
        };
        Diagnosis {
            verdict: verdict(&entries, unexplained_gyros, &findings),
            entries,
            findings,
            before,
            after,
            unexplained,
            configuration,
            steps: selected.steps,
            thresholds: thresholds.clone(),
            windowed: residuals,
            segment_rms_arcsec: [
                motion_segments::rms_arcsec(raw, &given, &segments),
                motion_segments::rms_arcsec(measured, &updated, &segments),
            ],
            residual_maps: residual_maps(case, &selected.state.noise, [&lagged, &updated], &segments),
            segments,
            left,
            lag_s: (shifts.lag_s, selected.state.lag_sigma_s),
            temperature_late_s: shifts.temperature_s,
            noise: selected.state.noise,
        }
    }

    /// Removes what may not be stated ([`refuse`]).
    fn refuse(&self, entries: &mut Vec<DiagnosedEffect>, unexplained: &mut Gyros, state: &ModelState) -> Refused {
        let (case, shifts) = (self.entries.case, state.shifts);
        let gap = |entries: &[&DiagnosedEffect]| self.gap_with(entries.iter().copied(), shifts);
        let by_noise = |without: &[&DiagnosedEffect], with: &[&DiagnosedEffect]| {
            let configured = [with, without].map(|own| self.configured_with(own.iter().copied()));
            let [with, without] = configured.map(|configured| case.measured.run(&configured, shifts));
            largest_growth(case, state, &case.measured.difference(&with, &without), self.seed)
        };
        refuse(entries, unexplained, gap, by_noise)
    }

    /// Removes hypotheses that are not acceptable; returns the gyros that remain unexplained and the whitened residual.
    fn drop_doubtful(&self, selected: &mut SelectedModel) -> (Gyros, Series) {
        let Entries { case, thresholds, .. } = self.entries;
        let is_uneven = case.measured.noise_scale.is_some();
        // In sigmas, where effects are no evidence below a multiple of their χ².
        let limit = thresholds.whiteness_statistic * if is_uneven { FEW_SAMPLES.sqrt() } else { 1.0 };
        let unexplained = |left: &Series, overfitted: &Gyros| -> Gyros {
            let (_, channels) = whiteness_statistic(left);
            case.measured.gyros().filter(|gyro| channels[gyro] > limit || overfitted[gyro])
        };
        if is_uneven {
            selected.drop_outliers(case);
        }
        selected.add_unstated_flicker(case);
        let mut overfitted = selected.overfitted_gyros(case.nominal);
        for other in [selected.beside_nonlinear_filter(self.entries.bank), selected.following_variables(case)] {
            overfitted = overfitted.and(other);
        }
        let left = selected.normal.projected_residual();
        // A random walk is Gaussian and stationary: a residual with bursts, or that grows in one third only, is none.
        let (residual, nuisances) = case.linearised(&mut selected.state);
        let limits = LazyCell::new(|| kurtosis_limits(case, &selected.state, &selected.normal, self.seed));
        for found in selected.noise.iter().filter(|found| found.is_significant(&selected.state)) {
            let (channel, noise) = (found.channel, &selected.state.noise[found.channel]);
            let is_changed = !is_uneven
                && (kurtosis(&left[channel]) > limits[channel]
                    || noise::change_chi2(case, channel, noise, found.walk, &residual, &nuisances) > CHANGED_CHI2);
            if is_changed {
                overfitted = overfitted.and(overfitted.only(channel));
            }
        }
        let first = unexplained(&left, &overfitted);
        if !first.is_empty() {
            // Hypotheses on these gyros alone did not leave noise, so they explain nothing.
            selected.drop_on(case, &first);
            // Without them others may no longer exceed their threshold.
            selected.prune(case, thresholds);
        }
        let gyros = unexplained(&selected.normal.projected_residual(), &overfitted);
        // What is uneven has no name.
        selected.noise.retain(|found| !is_uneven && found.is_significant(&selected.state));
        // On an unexplained gyro larger noise only absorbs the residual.
        selected.reset_noise(case, &gyros);
        selected.widen_onsets(case);
        (gyros, selected.normal.projected_residual())
    }

    fn configured_with<'e>(&self, entries: impl IntoIterator<Item = &'e DiagnosedEffect>) -> Configuration {
        let mut configuration = self.entries.case.nominal.clone();
        let corrections = entries.into_iter().flat_map(|entry| &entry.corrections);
        corrections.for_each(|correction| correction.apply(&mut configuration));
        configuration
    }

    /// Gap with these entries in the configuration.
    fn gap_with<'e>(&self, entries: impl IntoIterator<Item = &'e DiagnosedEffect>, shifts: Shifts) -> SquaredGap {
        let case = self.entries.case;
        let model = case.measured.run(&self.configured_with(entries), shifts);
        let squares = residual_stats::squares(case.measured, &model).iter().sum();
        SquaredGap { squares, reduced_chi2: reduced_chi2(case, &model, self.start) }
    }

    /// Removes the new calibration of a gyro if it makes gap and χ² larger beside all other entries: a drift at the start that a larger
    /// random walk carries away is no calibration.
    fn drop_harmful(&self, entries: &mut Vec<DiagnosedEffect>, shifts: Shifts) {
        for gyro in 0..TIMING {
            let is_own = |entry: &DiagnosedEffect| entry.class == Class::Recalibration && entry.gyros[gyro];
            let without = entries.iter().filter(|entry| !is_own(entry));
            if !entries.iter().any(is_own) {
                continue;
            }
            let [with, without] = [self.gap_with(&*entries, shifts), self.gap_with(without, shifts)];
            if without.squares < with.squares && without.reduced_chi2 < with.reduced_chi2 {
                entries.retain(|entry| !is_own(entry));
            }
        }
    }
}

fn verdict(entries: &[DiagnosedEffect], unexplained: Gyros, findings: &[Finding]) -> Verdict {
    let is_missing = entries.iter().any(|entry| entry.class == Class::MissingEffect)
        || findings.iter().any(|finding| [Finding::UNIT_FACTOR, Finding::ACCELERATION].contains(&&*finding.kind));
    match (!unexplained.is_empty(), is_missing) {
        (true, _) => Verdict::Unexplained,
        (false, true) => Verdict::Explained,
        (false, false) => Verdict::Consistent,
    }
}

/// The finding of a motion that follows the counts.
fn closed_loop(correlation: f64) -> Finding {
    Finding {
        kind: "closed-loop".to_owned(),
        place: "the whole recording".to_owned(),
        text: format!(
            "the motion follows the rounding of the counts (correlation {correlation:.2}): signatures omit small motions"
        ),
    }
}

/// The finding of noise that changes in the course of the recording.
fn uneven_noise(measured: &MeasuredData) -> Finding {
    let scales = || measured.noise_scale.iter().flat_map(|scales| scales.iter().flatten());
    let [lowest, largest] = [scales().copied().fold(f64::INFINITY, f64::min), scales().copied().fold(0.0, f64::max)];
    let is_uneven = |gyro: usize| measured.noise_scale.as_ref().is_some_and(|scales| !scales[gyro].is_empty());
    Finding {
        kind: "uneven-noise".to_owned(),
        place: measured.gyros().filter(is_uneven).names().join(", "),
        text: format!(
            "the noise is {:.2} to {:.2} times that of the noise model: the weights follow it",
            lowest.sqrt(),
            largest.sqrt()
        ),
    }
}

/// The finding of dead zones that are not searched.
fn zones(up_to_arcsec_per_s: f64) -> Option<Finding> {
    (up_to_arcsec_per_s > 0.0).then(|| Finding {
        kind: "dead-zone-not-searched".to_owned(),
        place: "the whole recording".to_owned(),
        text: match up_to_arcsec_per_s.is_finite() {
            true => format!(
                "dead zones up to {up_to_arcsec_per_s:.1} arcsec/s are not searched: small motions come from the counts or follow them"
            ),
            false => "dead zones and lags of a gyro alone are not searched: the motion contains the noise of the reference".to_owned(),
        },
    })
}

/// The finding of rows of the reference that are left out.
fn glitches(glitches_s: &[f64]) -> Option<Finding> {
    let (first_s, last_s) = (glitches_s.first()?, glitches_s.last()?);
    Some(Finding {
        kind: "reference-glitch".to_owned(),
        place: if first_s == last_s { format!("{first_s:.1} s") } else { format!("{first_s:.1} to {last_s:.1} s") },
        text: format!("rows of the reference far from those beside them: {}; they are left out", glitches_s.len()),
    })
}

/// The finding of random walks that are configured larger than they are. Angles estimated from counts are closer to the model than noise.
fn smaller_noise(case: &DiagnosisCase, left: &Series) -> Option<Finding> {
    let measured = case.measured;
    let is_configured = |gyro: usize| measured.weights[gyro].is_none() && noise::is_declared(case.nominal, gyro);
    let of_gyro = |gyro: usize| if is_configured(gyro) { moment(&left[gyro], 2) } else { 0.0 };
    let variances: Vec<f64> = (0..measured.gyros().heads()).map(of_gyro).collect();
    let is_smaller = measured.gyros().filter(|gyro| variances[gyro] > 0.0 && variances[gyro] < SMALLER_VARIANCE);
    let times = variances.into_iter().filter(|variance| *variance < SMALLER_VARIANCE).fold(0.0, f64::max).sqrt();
    (!is_smaller.is_empty()).then(|| Finding {
        kind: "noise-smaller".to_owned(),
        place: is_smaller.names().join(", "),
        text: format!(
            "at most {times:.2} times the noise as configured: with the walks of the gyro, smaller effects are found"
        ),
    })
}

/// The finding of drifts that change more than any gyro's, where the configuration states no noise.
fn walking_drifts(case: &DiagnosisCase, state: &ModelState) -> Option<Finding> {
    let minimum_s =
        |gyro: usize| early_minimum_s(&state.noise[gyro]).filter(|_| !noise::is_declared(case.nominal, gyro));
    let walking = case.measured.gyros().filter(|gyro| case.measured.is_usable(gyro) && minimum_s(gyro).is_some());
    let earliest_s = walking.gyros().filter_map(|gyro| minimum_s(gyro.index())).fold(f64::INFINITY, f64::min);
    (!walking.is_empty()).then(|| Finding {
        kind: "drift-walks".to_owned(),
        place: walking.names().join(", "),
        text: format!(
            "the drift changes irregularly: the Allan deviation is smallest at {earliest_s:.0} s, earlier than that of any gyro"
        ),
    })
}

/// The finding of an electronics temperature that lags.
fn temperature_lag(shifts: &Shifts) -> Option<Finding> {
    let late_s = shifts.temperature_s;
    let when = if late_s > 0.0 { "before" } else { "after" };
    let late_s = (late_s != 0.0).then_some(late_s.abs())?;
    Some(Finding {
        kind: "temperature-lag".to_owned(),
        place: "the whole recording".to_owned(),
        text: format!("effects follow the electronics temperature {late_s:.0} s {when} its recorded value"),
    })
}
