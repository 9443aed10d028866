//! What a diagnosis said against what was hidden.

use std::fmt;

use geu_model::course::KINDS;
use serde_json::Value;

use super::hidden::{Hidden, Origin};
use crate::change::{Amplitude, Change, Gyros, PHASE, Place};
use crate::outcome::Verdict;
use crate::report::{named, names};
use crate::rivals::APART_CHI2;

/// What stands in no catalogue may be called by what is as like as this.
const GROUP_COSINE: f64 = 0.95;
/// Two effects with signatures so alike are one thing.
const SAME_COSINE: f64 = 0.999;

/// What a diagnosis said, of its JSON (cli.md).
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    /// In a word.
    pub verdict: String,
    /// The effects that it calls missing.
    pub missing: Vec<Found>,
    /// How late the temperature is told, with which they are meant, s.
    pub temperature_late_s: f64,
}

/// An effect that a diagnosis calls missing.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Code of the model, or `discovered`.
    pub code: String,
    /// What a discovered term follows.
    pub formula: Option<String>,
    /// The gyros.
    pub gyros: Gyros,
    /// Name, value and sigma of its numbers; those that are no number left out.
    pub parameters: Vec<(String, f64, Option<f64>)>,
    /// What looks like it.
    pub rivals: Vec<FoundRival>,
}

/// A rival as a diagnosis told it.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundRival {
    /// Code.
    pub code: String,
    /// Formula of a discovered term.
    pub formula: Option<String>,
    /// The gyros.
    pub gyros: Gyros,
    /// Cosine of the two signatures.
    pub cosine: f64,
    /// By how much χ² falls more with what was found; nothing where the two are one signature.
    pub behind_chi2: Option<f64>,
}

/// Why a JSON is no result of a diagnosis.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, as `geu diagnose --json` writes it")]
pub struct BadResult {
    field: &'static str,
    expected: &'static str,
}

impl Told {
    /// Reads the JSON that `geu diagnose --json` wrote.
    ///
    /// # Errors
    /// [`BadResult`], with the field.
    pub fn from_json(result: &Value) -> Result<Told, BadResult> {
        let bad = |field, expected| BadResult { field, expected };
        let verdict = result["verdict"].as_str().filter(|word| Verdict::ALL.iter().any(|one| one.name() == *word));
        let verdict = verdict.ok_or(bad("verdict", "consistent, explained or unexplained"))?.to_owned();
        let effects = result["effects"].as_array().ok_or(bad("effects", "a list"))?;
        let missing = effects.iter().filter(|entry| entry["class"] == "missing-effect");
        let missing = missing.map(Found::from_json).collect::<Option<_>>();
        let missing = missing.ok_or(bad("effects", "code, gyros and parameters of each"))?;
        let temperature_late_s = match &result["temperature_late_s"] {
            Value::Null => 0.0,
            value => value.as_f64().ok_or(bad("temperature_late_s", "a number"))?,
        };
        Ok(Told { verdict, missing, temperature_late_s })
    }
}

impl Found {
    fn from_json(entry: &Value) -> Option<Found> {
        let numbers = entry["parameters"].as_object()?.iter();
        let parameters = numbers
            .filter_map(|(name, number)| Some((name.clone(), number["value"].as_f64()?, number["sigma"].as_f64())));
        let rival = |rival: &Value| {
            Some(FoundRival {
                code: rival["code"].as_str()?.to_owned(),
                formula: rival["formula"].as_str().map(str::to_owned),
                gyros: gyros(&rival["gyros"])?,
                cosine: rival["cosine"].as_f64()?,
                behind_chi2: rival["behind_chi2"].as_f64(),
            })
        };
        let rivals = entry["rivals"].as_array().map_or(&[][..], Vec::as_slice);
        Some(Found {
            code: entry["code"].as_str()?.to_owned(),
            formula: entry["formula"].as_str().map(str::to_owned),
            gyros: gyros(&entry["gyros"])?,
            parameters: parameters.collect(),
            rivals: rivals.iter().map(rival).collect::<Option<_>>()?,
        })
    }

    /// The change of the model that it is; nothing of what has no signature.
    pub fn change(&self) -> Option<Change> {
        let value = |name: &str| self.parameters.iter().find(|(own, ..)| own == name).map(|(_, value, _)| *value);
        let formula = self.formula.as_deref().and_then(|formula| formula.parse().ok());
        let formula = formula.map(|formula| Amplitude {
            place: Place::Discovered,
            effect: 0,
            amplitude: 0,
            kind: None,
            formula: Some(formula),
        });
        let courses =
            |one: Amplitude| std::iter::once(one).chain((0..KINDS.len()).filter_map(move |kind| one.with(kind)));
        let is_own = |one: &Amplitude| one.code() == self.code && value(&one.size().name).is_some();
        let amplitude = formula.or_else(|| Amplitude::all().into_iter().flat_map(courses).find(is_own))?;
        let shapes = |numbers: &[geu_model::number::Number]| -> Vec<f64> {
            numbers.iter().map(|number| value(number.name).unwrap_or(number.default.initial())).collect()
        };
        let change = Change {
            amplitude,
            size: value(&amplitude.size().name)?,
            own_shapes: shapes(amplitude.own_shapes()),
            course_shapes: shapes(amplitude.course_shapes()),
            gyros: self.gyros,
        };
        change.is_within_limits().then_some(change)
    }

    fn is(&self, hidden: &Hidden) -> bool {
        self.code == hidden.code && self.formula == hidden.formula
    }
}

impl Hidden {
    /// The change of the model that it is; nothing of what has no signature.
    pub fn change(&self) -> Option<Change> {
        let parameters = self.parameters.iter().map(|(name, value)| (name.clone(), *value, None)).collect();
        let (code, formula) = (self.code.clone(), self.formula.clone());
        Found { code, formula, gyros: self.gyros, parameters, rivals: Vec::new() }.change()
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {}", names(&self.gyros).join("+"), self.code)?;
        if let Some(formula) = &self.formula {
            write!(f, " {formula}")?;
        }
        for (name, value, sigma) in &self.parameters {
            write!(f, " {name}={value:.4e}")?;
            if let Some(sigma) = sigma {
                write!(f, "±{sigma:.1e}")?;
            }
        }
        Ok(())
    }
}

fn gyros(value: &Value) -> Option<Gyros> {
    named(&value.as_array()?.iter().map(Value::as_str).collect::<Option<Vec<&str>>>()?)
}

/// What became of something hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Naming {
    /// Nothing was seen.
    Missed,
    /// Something was seen, and no name given.
    Unnamed,
    /// Another name was given.
    Wrong,
    /// A name that cannot be told from the right one.
    Group,
    /// Named, on its gyros.
    Right,
}

impl Naming {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            Naming::Missed => "missed",
            Naming::Unnamed => "seen, not named",
            Naming::Wrong => "wrong",
            Naming::Group => "right group",
            Naming::Right => "right",
        }
    }
}

/// The size of something rightly named.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SizeError {
    /// Found less hidden.
    pub error: f64,
    /// One sigma, as found.
    pub sigma: f64,
    /// Cramér–Rao bound.
    pub bound: f64,
}

impl fmt::Display for SizeError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let SizeError { error, sigma, bound } = self;
        write!(f, "{:.2} of its sigma, {:.2} of its Cramér–Rao bound", error / sigma, error / bound)
    }
}

/// What became of one thing hidden.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// In a word.
    pub naming: Naming,
    /// How well its size was found.
    pub size: Option<SizeError>,
}

/// A diagnosis scored.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Of each thing hidden.
    pub outcomes: Vec<Outcome>,
    /// What was found that is none of them: index among [`Told::missing`].
    pub false_names: Vec<usize>,
}

/// Scores a diagnosis. `likeness` is the cosine of the signatures of what was hidden and what was found.
///
/// Right is the same code on the same gyros, in one entry or several. In the right group is an entry that tells the right one, on its
/// gyros, as a rival that cannot be told apart, or one that has the same signature; for what stands in no catalogue one that is nearly
/// the same will do.
pub fn score(hidden: &[Hidden], told: &Told, likeness: &dyn Fn(&Hidden, &Found) -> f64) -> Score {
    let mut is_true = vec![false; told.missing.len()];
    let mut first = Vec::new();
    for own in hidden {
        let is_within = |gyros: &Gyros| gyros.iter().zip(own.gyros).all(|(found, hidden)| !found || hidden);
        let mut reached = [false; 4];
        for (found, is_true) in told.missing.iter().zip(&mut is_true).filter(|(found, _)| found.is(own)) {
            if is_within(&found.gyros) {
                *is_true = true;
                reached.iter_mut().zip(found.gyros).for_each(|(all, one)| *all |= one);
            }
        }
        let is_rival = |rival: &FoundRival| {
            let is_alike = rival.behind_chi2.is_none_or(|behind| behind < APART_CHI2);
            rival.code == own.code && rival.formula == own.formula && rival.gyros == own.gyros && is_alike
        };
        let least = if own.origin == Origin::Unknown { GROUP_COSINE } else { SAME_COSINE };
        let mut naming = if reached == own.gyros { Naming::Right } else { Naming::Missed };
        // The same code on other gyros too, or on some of them alone, is the same thing where the others show nothing of it.
        let is_done = |found: &Found| reached == own.gyros && found.is(own) && is_within(&found.gyros);
        for (found, is_true) in told.missing.iter().zip(&mut is_true).filter(|(found, _)| !is_done(found)) {
            if found.rivals.iter().any(is_rival) || likeness(own, found) >= least {
                *is_true = true;
                naming = if naming == Naming::Right { naming } else { Naming::Group };
            }
        }
        first.push(naming);
    }
    let false_names: Vec<usize> = (0..is_true.len()).filter(|&index| !is_true[index]).collect();
    let of = |(own, naming): (&Hidden, Naming)| {
        let overlaps = |found: &Found| found.gyros.iter().zip(own.gyros).any(|(found, hidden)| *found && hidden);
        let naming = match naming {
            Naming::Missed if false_names.iter().any(|&index| overlaps(&told.missing[index])) => Naming::Wrong,
            Naming::Missed if told.verdict == "unexplained" || told.missing.iter().any(overlaps) => Naming::Unnamed,
            naming => naming,
        };
        Outcome { naming, size: if naming == Naming::Right { size_error(own, told) } else { None } }
    };
    Score { outcomes: hidden.iter().zip(first).map(of).collect(), false_names }
}

/// Of what one entry names on all of its gyros.
fn size_error(hidden: &Hidden, told: &Told) -> Option<SizeError> {
    let found = told.missing.iter().find(|found| found.is(hidden) && found.gyros == hidden.gyros)?;
    let (name, truth) = hidden.parameters.first()?;
    let (_, value, sigma) = found.parameters.iter().find(|(own, ..)| own == name)?;
    // A swing of the other sign is one half a turn later.
    let has_phase = hidden.parameters.iter().any(|(name, _)| name == PHASE);
    let error = if has_phase { value.abs() - truth.abs() } else { value - truth };
    Some(SizeError { error, sigma: (*sigma)?, bound: hidden.sigma? })
}

impl Score {
    /// Whether everything was named rightly, or in the right group, and nothing else was named. Of what stands in no catalogue it is
    /// enough that no effect of the catalogue was named for it.
    pub fn is_right(&self, hidden: &[Hidden], told: &Told) -> bool {
        let is_unknown = hidden.iter().any(|own| own.origin == Origin::Unknown);
        let is_formula = |index: &usize| is_unknown && told.missing[*index].formula.is_some();
        let named = self.outcomes.iter().zip(hidden).all(|(outcome, own)| {
            let is_seen = outcome.naming != Naming::Missed;
            outcome.naming >= Naming::Group || own.origin == Origin::Unknown && is_seen
        });
        named && self.false_names.iter().all(is_formula)
    }
}
