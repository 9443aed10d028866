//! The search: sets of errors, one error more at a time, or two where one alone does not do.
//!
//! Two, because a bias along the spin and a scale error cancel at one rate: each alone makes things worse at others, and
//! only both together explain. Whatever is larger than what noise alone would give ([`super::null`]) must also foretell
//! each group from the others.

use nalgebra::DMatrix;

use crate::outcome::Verdict;
use crate::rates::apart::{Observability, apart};
use crate::rates::estimator::Estimator;
use crate::rates::fit::{Fit, cosine, fit, joined, sets};
use crate::rates::model::Parameter;
use crate::rates::noise::{Noise, greatest_correlation};
use crate::rates::null::{Products, Thresholds, thresholds};
use crate::rates::windows::{RatesError, Windows};

/// Spare windows without which noise is not known.
const LEAST_SPARE: usize = 4;
/// Errors at a time, and at most: as many as a bias of each of three axes and a scale error.
const MORE: usize = 2;
const MOST: usize = 4;
/// Parts into which a single group is cut.
const PARTS: usize = 3;
/// Fall of χ² below which two sets explain the data alike: 3 sigma.
const ALIKE: f64 = 9.0;

/// Another error in the place of one found.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// The other.
    pub parameter: Parameter,
    /// Cosine of the two signatures, whitened, beside the other errors found.
    pub cosine: f64,
    /// By how much χ² is larger with it; nothing where it fits only beyond all reason.
    pub chi2_more: Option<f64>,
}

impl Rival {
    /// Whether the data do not decide between the two.
    pub fn is_alike(&self) -> bool {
        self.chi2_more.is_some_and(|more| more < ALIKE)
    }
}

/// An error found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Which.
    pub parameter: Parameter,
    /// Its value, arcsec/s or a fraction.
    pub value: f64,
    /// One sigma of it, beside the others found.
    pub sigma: f64,
    /// Share of χ² before that it takes off, added in the order listed.
    pub gap_share: f64,
    /// What else it may be, the likest first.
    pub rivals: Vec<Rival>,
}

/// A gap, over all windows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// Root mean square of the residual.
    pub rms_arcsec_s: f64,
    /// Its greatest.
    pub max_arcsec_s: f64,
    /// χ² of the whitened residual per degree of freedom.
    pub reduced_chi2: f64,
}

/// The gap of one group, rms in arcsec/s.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupGap {
    /// Its name.
    pub group: String,
    /// How many windows.
    pub windows: usize,
    /// As measured.
    pub before_arcsec_s: f64,
    /// With the errors fitted to all groups.
    pub after_arcsec_s: f64,
    /// With the errors fitted to the other groups; nothing where those do not determine them.
    pub held_out_arcsec_s: Option<f64>,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnosis {
    /// How it ends.
    pub verdict: Verdict,
    /// Errors, that which explains most first.
    pub errors: Vec<Found>,
    /// Noise within groups, and what is left between them.
    pub noise: Noise,
    /// Fall of χ² by an offset of every group beside the errors, and the fall that noise alone exceeds once in a hundred.
    pub offsets: (f64, f64),
    /// Sets tried in each step of the search, and the fall of χ² that was asked of the best.
    pub searched: Vec<(usize, f64)>,
    /// The gap before.
    pub before: Gap,
    /// The gap after.
    pub after: Gap,
    /// The gap of what was held out, each group foretold from the others; nothing where they do not determine the errors.
    pub held_out: Option<Gap>,
    /// Group by group.
    pub groups: Vec<GroupGap>,
    /// How far biases and scale can be told apart; nothing where the windows have no signature of one of them.
    pub apart: Option<Observability>,
    /// Whether a channel's noise is as slow as noise may be: slower could not be told from an offset of the group.
    pub is_slow: bool,
    /// The windows, as they were grouped.
    pub windows: Windows,
}

/// Finds which errors explain the windows. `seed` is that of the noise from which thresholds are made.
///
/// # Errors
/// Gyros or windows that do not suffice.
pub fn diagnose(windows: &Windows, seed: u64) -> Result<Diagnosis, RatesError> {
    let windows = windows.cut(PARTS);
    windows.check(LEAST_SPARE)?;
    let mut accepted = Fit::none();
    let mut searched = Vec::new();
    let (noise, null) = loop {
        let estimator = Estimator::new(&windows, &accepted);
        let noise = estimator.estimate(&accepted.residual(&windows));
        accepted = fit(&windows, &noise, &accepted.set, Some(&accepted)).unwrap_or(accepted);
        let more = MORE.min(windows.parameters().len().min(MOST).saturating_sub(accepted.set.len()));
        let null = thresholds(&windows, &accepted, &noise, more, seed);
        searched.extend(null.tried.iter().copied().zip(null.more.iter().copied()));
        match search(&windows, &noise, &accepted, &null) {
            Some(better) => accepted = better,
            None => break (noise, null),
        }
    };
    Ok(told(windows, noise, &null, accepted, searched))
}

/// The set with one error more, else two, that is beyond noise and pays held out; the best of them.
fn search(windows: &Windows, noise: &Noise, base: &Fit, null: &Thresholds) -> Option<Fit> {
    let base_held_out = HeldOut::of(windows, noise, base)?;
    null.more.iter().enumerate().find_map(|(index, threshold)| {
        let sets = sets(&windows.parameters(), base.set.len() + index + 1);
        let fits = sets.iter().filter_map(|set| fit(windows, noise, set, Some(base)));
        let mut beyond: Vec<Fit> = fits.filter(|fit| base.chi2_of(windows, noise) - fit.chi2 > *threshold).collect();
        beyond.sort_by(|one, other| one.cost(windows).total_cmp(&other.cost(windows)));
        beyond.into_iter().find(|fit| {
            let held_out = HeldOut::of(windows, noise, fit);
            held_out.is_some_and(|own| own.chi2 < base_held_out.chi2 && own.squares < base_held_out.squares)
        })
    })
}

impl Fit {
    /// χ², and what the choice of one gyro costs beside a scale error of all.
    fn cost(&self, windows: &Windows) -> f64 {
        let own = self.set.iter().filter(|parameter| matches!(parameter, Parameter::OwnScale(_))).count();
        self.chi2 + 2.0 * own as f64 * (windows.gyros.len() as f64).ln()
    }

    fn chi2_of(&self, windows: &Windows, noise: &Noise) -> f64 {
        noise.whiten(windows, &DMatrix::from_columns(&[self.residual(windows)])).norm_squared()
    }
}

/// Every group foretold from the others.
struct HeldOut {
    chi2: f64,
    squares: f64,
    greatest: f64,
    rms: Vec<f64>,
}

impl HeldOut {
    fn of(windows: &Windows, noise: &Noise, whole: &Fit) -> Option<HeldOut> {
        let mut all = HeldOut { chi2: 0.0, squares: 0.0, greatest: 0.0, rms: Vec::new() };
        for group in 0..windows.groups.len() {
            let own = windows.filtered(|window| window.group == group);
            if own.all().is_empty() {
                all.rms.push(0.0);
                continue;
            }
            let others = windows.filtered(|window| window.group != group);
            let fit = fit(&others, noise, &whole.set, Some(whole))?;
            let left = fit.residual(&own);
            all.chi2 += fit.chi2_of(&own, noise);
            all.squares += left.norm_squared();
            all.greatest = all.greatest.max(left.amax());
            all.rms.push(left.norm() / (left.len() as f64).sqrt());
        }
        Some(all)
    }
}

fn told(windows: Windows, within: Noise, null: &Thresholds, accepted: Fit, searched: Vec<(usize, f64)>) -> Diagnosis {
    let offsets = offsets_gain(&windows, &within, &accepted);
    let is_noise_like = offsets <= null.offsets;
    let noise = with_between(&windows, &within, &accepted);
    // What lies between groups and is no more than noise is not taken as more.
    let weight = if is_noise_like { &within } else { &noise };
    let fitted = fit(&windows, weight, &accepted.set, Some(&accepted)).unwrap_or(accepted);
    let none = Fit::none();
    let before = none.chi2_of(&windows, &within);
    let held_out = HeldOut::of(&windows, weight, &fitted);
    let rms_of = |fit: &Fit, group: usize| {
        let own = windows.filtered(|window| window.group == group);
        let left = fit.residual(&own);
        left.norm() / (left.len().max(1) as f64).sqrt()
    };
    let groups = windows.groups.iter().enumerate().map(|(group, name)| GroupGap {
        group: name.clone(),
        windows: windows.all().iter().filter(|window| window.group == group).count(),
        before_arcsec_s: rms_of(&none, group),
        after_arcsec_s: rms_of(&fitted, group),
        held_out_arcsec_s: held_out.as_ref().map(|held_out| held_out.rms[group]),
    });
    let rows = (windows.channels() * windows.all().len()) as f64;
    let gap = |fit: &Fit| {
        let left = fit.residual(&windows);
        let spare = (rows - fit.set.len() as f64).max(1.0);
        Gap {
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
        offsets: (offsets, null.offsets),
        searched,
        before: gap(&none),
        after: gap(&fitted),
        held_out: held_out.as_ref().map(|held_out| Gap {
            rms_arcsec_s: (held_out.squares / rows).sqrt(),
            max_arcsec_s: held_out.greatest,
            reduced_chi2: held_out.chi2 / rows,
        }),
        groups: groups.collect(),
        apart: apart(&windows, weight, &fitted),
        is_slow: noise.channels.iter().any(|channel| channel.correlation > greatest_correlation(&windows) - 1e-9),
        noise,
        windows,
    }
}

/// The errors found in order of what each takes off.
fn errors(windows: &Windows, noise: &Noise, within: &Noise, fitted: &Fit, before: f64) -> Vec<Found> {
    let covariance = fitted.covariance(windows, noise);
    let (mut rest, mut order, mut last) = (fitted.set.clone(), Vec::new(), before);
    let mut found = Vec::new();
    while !rest.is_empty() {
        let with = |parameter: &Parameter| {
            let set: Vec<Parameter> = order.iter().copied().chain([*parameter]).collect();
            let chi2 = match set.len() == fitted.set.len() {
                true => Some(fitted.chi2_of(windows, within)),
                false => fit(windows, within, &set, None).map(|fit| fit.chi2),
            };
            chi2.unwrap_or(last).min(last)
        };
        let best = rest.iter().enumerate().map(|(index, parameter)| (index, with(parameter)));
        let Some((index, chi2)) = best.min_by(|one, other| one.1.total_cmp(&other.1)) else { break };
        let parameter = rest.remove(index);
        order.push(parameter);
        let place = fitted.set.iter().position(|other| *other == parameter).unwrap_or(0);
        found.push(Found {
            parameter,
            value: fitted.values[place],
            sigma: covariance.as_ref().map_or(f64::INFINITY, |covariance| covariance[(place, place)].sqrt()),
            gap_share: if before > 0.0 { (last - chi2) / before } else { 0.0 },
            rivals: rivals(windows, noise, fitted, place),
        });
        last = chi2;
    }
    found
}

/// What else may stand in the place of an error found.
fn rivals(windows: &Windows, noise: &Noise, fitted: &Fit, place: usize) -> Vec<Rival> {
    let parameters = windows.parameters();
    let others = parameters.iter().filter(|parameter| !fitted.set.contains(parameter));
    let mut rivals: Vec<Rival> = others
        .map(|parameter| {
            let set = [&fitted.set[..], &[*parameter]].concat();
            let (_, slope) = fitted.linearised(windows, &set);
            let white = noise.whiten(windows, &slope);
            let beside: Vec<usize> = (0..fitted.set.len()).filter(|index| *index != place).collect();
            let cosine = cosine(&white, place, fitted.set.len(), &beside);
            let mut swapped = fitted.set.clone();
            swapped[place] = *parameter;
            let chi2 = fit(windows, noise, &swapped, None).map(|fit| fit.chi2);
            let own = fitted.chi2_of(windows, noise);
            Rival { parameter: *parameter, cosine, chi2_more: chi2.map(|chi2| chi2 - own) }
        })
        .collect();
    rivals.sort_by(|one, other| other.cosine.abs().total_cmp(&one.cosine.abs()));
    rivals
}

/// Fall of χ² by an offset of every group beside the errors.
fn offsets_gain(windows: &Windows, noise: &Noise, fitted: &Fit) -> f64 {
    let (left, slope) = fitted.linearised(windows, &fitted.set);
    let columns = joined(slope, &Noise::offsets(windows));
    let products = Products::new(windows, noise, &columns, &left);
    let all: Vec<usize> = (0..columns.ncols()).collect();
    products.gain(&all) - products.gain(&all[..fitted.set.len()])
}

/// The noise with the part between groups with which the means of groups are as large as expected (Paule and Mandel).
fn with_between(windows: &Windows, within: &Noise, fitted: &Fit) -> Noise {
    let with = |size: f64| {
        let mut noise = within.clone();
        // As large beside the noise of each channel.
        noise.channels.iter_mut().for_each(|channel| channel.between_arcsec_s = size * channel.sigma_arcsec_s);
        noise
    };
    let offsets = Noise::offsets(windows);
    let expected = offsets.ncols().saturating_sub(fitted.set.len()).max(1) as f64;
    let places: Vec<usize> = (0..offsets.ncols()).collect();
    let left = fitted.residual(windows);
    let gain = |size: f64| Products::new(windows, &with(size), &offsets, &left).gain(&places);
    let (mut low, mut high) = (0.0, 1.0);
    if gain(low) <= expected {
        return within.clone();
    }
    while gain(high) > expected && high < 1e9 {
        high *= 2.0;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if gain(middle) > expected { low = middle } else { high = middle }
    }
    with(high)
}
