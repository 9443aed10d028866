//! The search over sets of errors, one error more at a time, or two if one is not sufficient.
//!
//! A bias along the spin and a scale error cancel at one rate: each alone increases the residual at other rates, and only both
//! together explain the data. A set is accepted if its chi2 reduction exceeds that of noise alone ([`super::null`]) and
//! cross-validation over the groups improves.

use nalgebra::DMatrix;

use crate::estimator::Estimator;
use crate::fit::{Fit, cosine, fit, joined, sets};
use crate::model::Parameter;
use crate::noise::{Noise, max_correlation};
use crate::null::{Products, Thresholds, thresholds};
use crate::observability::{Observability, observability};
use crate::windows::{MagnitudeError, Windows};
use geu_diagnosis::Verdict;

/// Minimum number of spare windows to estimate the noise.
const MIN_SPARE: usize = 4;
/// Largest number of errors added at a time, and in all: a bias of each of three axes and a scale error.
const MAX_ADDED: usize = 2;
const MAX_ERRORS: usize = 4;
/// Parts into which a single group is cut.
const PARTS: usize = 3;
/// Difference of χ² below which two sets are not distinguishable: 3 sigma.
const DISTINGUISHABLE_CHI2: f64 = 9.0;
/// Upper limit of the noise between groups over that within, and bisection steps.
const MAX_BETWEEN: f64 = 1e9;
const BISECTIONS: usize = 60;

/// Another error in place of the one found.
#[derive(Debug, Clone, PartialEq)]
pub struct RateAlternative {
    /// The other error.
    pub parameter: Parameter,
    /// Cosine of the two whitened signatures, with the other errors found projected out.
    pub cosine: f64,
    /// Increase of χ² with it; `None` if it does not fit within its limits.
    pub chi2_more: Option<f64>,
}

impl RateAlternative {
    /// True if the data do not distinguish the two.
    pub fn is_indistinguishable(&self) -> bool {
        self.chi2_more.is_some_and(|more| more < DISTINGUISHABLE_CHI2)
    }
}

/// An error found.
#[derive(Debug, Clone, PartialEq)]
pub struct RateError {
    /// The error.
    pub parameter: Parameter,
    /// Value, arcsec/s or a fraction.
    pub value: f64,
    /// Sigma with the other errors found free.
    pub sigma: f64,
    /// Share of the initial χ² that it removes, added in the order listed.
    pub gap_share: f64,
    /// Alternatives, the largest cosine first.
    pub alternatives: Vec<RateAlternative>,
}

/// Residual over all windows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateResidual {
    /// Root mean square.
    pub rms_arcsec_s: f64,
    /// Maximum.
    pub max_arcsec_s: f64,
    /// χ² of the whitened residual per degree of freedom.
    pub reduced_chi2: f64,
}

/// Residual of one group, rms in arcsec/s.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupResidual {
    /// Name.
    pub group: String,
    /// Number of windows.
    pub windows: usize,
    /// Before any correction.
    pub before_arcsec_s: f64,
    /// With the errors fitted to all groups.
    pub after_arcsec_s: f64,
    /// With the errors fitted to the other groups; `None` if those do not determine them.
    pub held_out_arcsec_s: Option<f64>,
}

/// Result of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// Verdict.
    pub verdict: Verdict,
    /// Errors, the largest chi2 reduction first.
    pub errors: Vec<RateError>,
    /// Noise within and between groups.
    pub noise: Noise,
    /// Chi2 reduction by an offset of every group in addition to the errors, and its threshold.
    pub offsets: (f64, f64),
    /// Number of sets tried in each step of the search, and the threshold of the best.
    pub searched: Vec<(usize, f64)>,
    /// Residual as measured.
    pub before: RateResidual,
    /// Residual with the errors.
    pub after: RateResidual,
    /// Residual of each group with the errors fitted to the others; `None` if those do not determine them.
    pub held_out: Option<RateResidual>,
    /// Residual of each group.
    pub groups: Vec<GroupResidual>,
    /// Observability of biases and scale; `None` if any has no signature in the windows.
    pub observability: Option<Observability>,
    /// True if the correlation is the largest allowed: slower noise is not distinguishable from an offset.
    pub is_slow: bool,
    /// The windows, as they were grouped.
    pub windows: Windows,
}

/// Finds the errors that explain the windows. `seed` is that of the noise that determines the thresholds.
///
/// # Errors
/// Too few windows.
pub fn diagnose(windows: &Windows, seed: u64) -> Result<Diagnosis, MagnitudeError> {
    let windows = windows.cut(PARTS);
    windows.check(MIN_SPARE)?;
    let mut accepted = Fit::none();
    let mut searched = Vec::new();
    let (noise, null) = loop {
        let noise = Estimator::new(&windows, &accepted).estimate(&accepted.residual(&windows));
        accepted = fit(&windows, &noise, &accepted.set, &accepted).unwrap_or(accepted);
        let more = MAX_ADDED.min(windows.parameters().len().min(MAX_ERRORS).saturating_sub(accepted.set.len()));
        let null = thresholds(&windows, &accepted, &noise, more, seed);
        searched.extend(&null.more);
        match search(&windows, &noise, &accepted, &null) {
            Some(better) => accepted = better,
            None => break (noise, null),
        }
    };
    Ok(report(windows, noise, null.offsets, accepted, searched))
}

/// The best set with one error more, otherwise with two, that exceeds the threshold and improves cross-validation.
fn search(windows: &Windows, noise: &Noise, base: &Fit, null: &Thresholds) -> Option<Fit> {
    let base_held_out = HeldOut::new(windows, noise, base)?;
    let base_chi2 = base.chi2_of(windows, noise);
    null.more.iter().enumerate().find_map(|(index, (_, threshold))| {
        let sets = sets(&windows.parameters(), base.set.len() + index + 1);
        let fits = sets.iter().filter_map(|set| fit(windows, noise, set, base));
        let mut beyond: Vec<Fit> = fits.filter(|fit| base_chi2 - fit.chi2 > *threshold).collect();
        beyond.sort_by(|one, other| one.penalised_chi2(windows).total_cmp(&other.penalised_chi2(windows)));
        beyond.into_iter().find(|fit| {
            let held_out = HeldOut::new(windows, noise, fit);
            held_out.is_some_and(|own| own.chi2 < base_held_out.chi2 && own.squares < base_held_out.squares)
        })
    })
}

impl Fit {
    /// χ² with the penalty for the choice of one gyro, relative to a scale error of all.
    fn penalised_chi2(&self, windows: &Windows) -> f64 {
        let own = self.set.iter().filter(|parameter| matches!(parameter, Parameter::OwnScale(_))).count();
        self.chi2 + 2.0 * own as f64 * (windows.gyros.len() as f64).ln()
    }
}

/// Residuals of each group, with the errors fitted to the others.
struct HeldOut {
    chi2: f64,
    squares: f64,
    max: f64,
    rms: Vec<f64>,
}

impl HeldOut {
    fn new(windows: &Windows, noise: &Noise, whole: &Fit) -> Option<HeldOut> {
        let mut all = HeldOut { chi2: 0.0, squares: 0.0, max: 0.0, rms: Vec::new() };
        for group in 0..windows.groups.len() {
            let [own, others] = windows.split(group);
            if own.all().is_empty() {
                all.rms.push(0.0);
                continue;
            }
            let fit = fit(&others, noise, &whole.set, whole)?;
            let left = fit.residual(&own);
            all.chi2 += fit.chi2_of(&own, noise);
            all.squares += left.norm_squared();
            all.max = all.max.max(left.amax());
            all.rms.push(left.norm() / (left.len() as f64).sqrt());
        }
        Some(all)
    }
}

fn report(windows: Windows, within: Noise, threshold: f64, accepted: Fit, searched: Vec<(usize, f64)>) -> Diagnosis {
    let offsets = offsets_gain(&windows, &within, &accepted);
    let is_noise_like = offsets <= threshold;
    let noise = with_between(&windows, &within, &accepted);
    // Noise between groups counts only above the threshold.
    let weight = if is_noise_like { &within } else { &noise };
    let fitted = fit(&windows, weight, &accepted.set, &accepted).unwrap_or(accepted);
    let none = Fit::none();
    let before = none.chi2_of(&windows, &within);
    let held_out = HeldOut::new(&windows, weight, &fitted);
    let groups = windows.groups.iter().enumerate().map(|(group, name)| {
        let [own, _] = windows.split(group);
        let [before_arcsec_s, after_arcsec_s] = [&none, &fitted].map(|fit| {
            let left = fit.residual(&own);
            left.norm() / (left.len().max(1) as f64).sqrt()
        });
        GroupResidual {
            group: name.clone(),
            windows: own.all().len(),
            before_arcsec_s,
            after_arcsec_s,
            held_out_arcsec_s: held_out.as_ref().map(|held_out| held_out.rms[group]),
        }
    });
    let rows = windows.all().len() as f64;
    let residual = |fit: &Fit| {
        let left = fit.residual(&windows);
        let spare = (rows - fit.set.len() as f64).max(1.0);
        RateResidual {
            rms_arcsec_s: (left.norm_squared() / rows).sqrt(),
            max_arcsec_s: left.amax(),
            reduced_chi2: fit.chi2_of(&windows, &within) / spare,
        }
    };
    let verdict = match (fitted.set.is_empty(), is_noise_like) {
        (_, false) => Verdict::Unexplained,
        (true, true) => Verdict::Consistent,
        (false, true) => Verdict::Explained,
    };
    Diagnosis {
        verdict,
        errors: errors(&windows, weight, &within, &fitted, before),
        offsets: (offsets, threshold),
        searched,
        before: residual(&none),
        after: residual(&fitted),
        held_out: held_out.as_ref().map(|held_out| RateResidual {
            rms_arcsec_s: (held_out.squares / rows).sqrt(),
            max_arcsec_s: held_out.max,
            reduced_chi2: held_out.chi2 / rows,
        }),
        groups: groups.collect(),
        observability: observability(&windows, weight, &fitted),
        is_slow: noise.correlation > max_correlation(&windows) - 1e-9,
        noise,
        windows,
    }
}

/// The errors found, in order of their chi2 reduction.
fn errors(windows: &Windows, noise: &Noise, within: &Noise, fitted: &Fit, before: f64) -> Vec<RateError> {
    let covariance = fitted.covariance(windows, noise);
    let (mut rest, mut order, mut last) = (fitted.set.clone(), Vec::new(), before);
    let mut found = Vec::new();
    while !rest.is_empty() {
        let with = |parameter: &Parameter| {
            let set = [&order[..], &[*parameter]].concat();
            let chi2 = match set.len() == fitted.set.len() {
                true => Some(fitted.chi2_of(windows, within)),
                false => fit(windows, within, &set, &Fit::none()).map(|fit| fit.chi2),
            };
            chi2.unwrap_or(last).min(last)
        };
        let best = rest.iter().enumerate().map(|(index, parameter)| (index, with(parameter)));
        let Some((index, chi2)) = best.min_by(|one, other| one.1.total_cmp(&other.1)) else { break };
        let parameter = rest.remove(index);
        order.push(parameter);
        let place = fitted.set.iter().position(|other| *other == parameter).unwrap_or(0);
        found.push(RateError {
            parameter,
            value: fitted.values[place],
            sigma: covariance.as_ref().map_or(f64::INFINITY, |covariance| covariance[(place, place)].sqrt()),
            gap_share: if before > 0.0 { (last - chi2) / before } else { 0.0 },
            alternatives: alternatives(windows, noise, fitted, place),
        });
        last = chi2;
    }
    found
}

/// Every other error in place of the one at `place`.
fn alternatives(windows: &Windows, noise: &Noise, fitted: &Fit, place: usize) -> Vec<RateAlternative> {
    let own = fitted.chi2_of(windows, noise);
    let others: Vec<usize> = (0..fitted.set.len()).filter(|index| *index != place).collect();
    let parameters = windows.parameters().into_iter().filter(|parameter| !fitted.set.contains(parameter));
    let mut alternatives: Vec<RateAlternative> = parameters
        .map(|parameter| {
            let (_, slope) = fitted.linearised(windows, &[&fitted.set[..], &[parameter]].concat());
            let cosine = cosine(&noise.whiten(windows, &slope), place, fitted.set.len(), &others);
            let mut swapped = fitted.set.clone();
            swapped[place] = parameter;
            let chi2_more = fit(windows, noise, &swapped, &Fit::none()).map(|fit| fit.chi2 - own);
            RateAlternative { parameter, cosine, chi2_more }
        })
        .collect();
    alternatives.sort_by(|one, other| other.cosine.abs().total_cmp(&one.cosine.abs()));
    alternatives
}

/// Chi2 reduction by an offset of every group in addition to the errors.
fn offsets_gain(windows: &Windows, noise: &Noise, fitted: &Fit) -> f64 {
    let (left, slope) = fitted.linearised(windows, &fitted.set);
    let columns = joined(slope, &Noise::offsets(windows));
    let products = Products::new(windows, noise, &columns, &left);
    let all: Vec<usize> = (0..columns.ncols()).collect();
    products.gain(&all) - products.gain(&all[..fitted.set.len()])
}

/// The noise between groups with which the group means are as large as expected (Paule and Mandel).
fn with_between(windows: &Windows, within: &Noise, fitted: &Fit) -> Noise {
    let with = |size: f64| Noise { between_arcsec_s: size * within.sigma_arcsec_s, ..*within };
    let offsets: DMatrix<f64> = Noise::offsets(windows);
    let expected = offsets.ncols().saturating_sub(fitted.set.len()).max(1) as f64;
    let places: Vec<usize> = (0..offsets.ncols()).collect();
    let left = fitted.residual(windows);
    let is_above = |size: f64| Products::new(windows, &with(size), &offsets, &left).gain(&places) > expected;
    let (mut low, mut high) = (0.0, 1.0);
    if !is_above(low) {
        return *within;
    }
    while is_above(high) && high < MAX_BETWEEN {
        high *= 2.0;
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if is_above(middle) { low = middle } else { high = middle }
    }
    with(high)
}
