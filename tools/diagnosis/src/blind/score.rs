//! What a diagnosis said against what was hidden.

use std::fmt;

use geu_model::number::Role;
use serde::Deserialize;
use serde_json::Value;

use super::hidden::{InjectedEffect, Origin};
use crate::gyros::{Gyros, is_within, names, overlap};
use crate::hypothesis::Hypothesis;
use crate::outcome::{Class, DiagnosedEffect, Diagnosis, ReportedAlternative, Verdict};
use crate::rivals::APART_CHI2;

/// What stands in no catalogue may be called by what is as like as this.
const GROUP_COSINE: f64 = 0.95;
/// Two effects with signatures so alike are one thing.
const SAME_COSINE: f64 = 0.999;

/// A diagnosis as it is scored.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportedDiagnosis {
    /// How it ends.
    pub verdict: Verdict,
    /// The effects that it calls missing.
    pub missing: Vec<DiagnosedEffect>,
    /// How late the temperature is told, with which they are meant, s.
    pub temperature_late_s: f64,
}

/// Why a JSON is no result of a diagnosis.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, as `geu diagnose --json` writes it")]
pub struct BadResult {
    field: &'static str,
    expected: &'static str,
}

impl From<&Diagnosis> for ReportedDiagnosis {
    fn from(diagnosis: &Diagnosis) -> ReportedDiagnosis {
        let missing = diagnosis.entries.iter().filter(|entry| entry.class == Class::MissingEffect);
        ReportedDiagnosis {
            verdict: diagnosis.verdict,
            missing: missing.cloned().collect(),
            temperature_late_s: diagnosis.temperature_late_s,
        }
    }
}

impl ReportedDiagnosis {
    /// Reads the JSON that `geu diagnose --json` wrote.
    ///
    /// # Errors
    /// [`BadResult`], with the field.
    pub fn from_json(result: &Value) -> Result<ReportedDiagnosis, BadResult> {
        let bad = |field, expected| BadResult { field, expected };
        let verdict = Verdict::deserialize(&result["verdict"]);
        let verdict = verdict.map_err(|_| bad("verdict", "consistent, explained or unexplained"))?;
        let effects = result["effects"].as_array().ok_or(bad("effects", "a list"))?;
        let missing = effects.iter().filter(|entry| entry["class"] == "missing-effect");
        let missing = missing.map(DiagnosedEffect::deserialize).collect::<Result<_, _>>();
        let missing = missing.map_err(|_| bad("effects", "code, gyros and parameters of each"))?;
        let temperature_late_s = match &result["temperature_late_s"] {
            Value::Null => 0.0,
            value => value.as_f64().ok_or(bad("temperature_late_s", "a number"))?,
        };
        Ok(ReportedDiagnosis { verdict, missing, temperature_late_s })
    }
}

impl DiagnosedEffect {
    /// The hypothesis that it is; none where the model has no such.
    pub fn hypothesis(&self) -> Option<Hypothesis> {
        let number = |name: &str| self.number(name).map(|number| number.value);
        Hypothesis::from_numbers(&self.code, self.formula.as_deref(), self.gyros, number)
    }

    fn is(&self, hidden: &InjectedEffect) -> bool {
        self.code == hidden.code() && self.formula == hidden.formula()
    }
}

impl fmt::Display for DiagnosedEffect {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {}", names(&self.gyros).join("+"), self.code)?;
        if let Some(formula) = &self.formula {
            write!(f, " {formula}")?;
        }
        let mut numbers: Vec<_> = self.parameters.iter().filter(|number| number.written.is_none()).collect();
        numbers.sort_by(|one, other| one.name.cmp(&other.name));
        for number in numbers {
            write!(f, " {}={:.4e}", number.name, number.value)?;
            if let Some(sigma) = number.sigma {
                write!(f, "±{sigma:.1e}")?;
            }
        }
        Ok(())
    }
}

/// What became of something hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum IsolationResult {
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

impl IsolationResult {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            IsolationResult::Missed => "missed",
            IsolationResult::Unnamed => "seen, not named",
            IsolationResult::Wrong => "wrong",
            IsolationResult::Group => "right group",
            IsolationResult::Right => "right",
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
pub struct EffectScore {
    /// In a word.
    pub naming: IsolationResult,
    /// How well its size was found.
    pub size: Option<SizeError>,
}

/// A diagnosis scored.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Of each thing hidden.
    pub outcomes: Vec<EffectScore>,
    /// What was found that is none of them: index among [`ReportedDiagnosis::missing`].
    pub false_names: Vec<usize>,
}

/// Scores a diagnosis. `likeness` is the cosine of the signatures of what was hidden and what was found.
///
/// Right is the same code on the same gyros, in one entry or several. In the right group is an entry that tells the right one, on its
/// gyros, as a rival that cannot be told apart, or one that has the same signature; for what stands in no catalogue one that is nearly
/// the same will do.
pub fn score(
    hidden: &[InjectedEffect],
    told: &ReportedDiagnosis,
    likeness: &dyn Fn(&InjectedEffect, &DiagnosedEffect) -> f64,
) -> Score {
    let mut is_true = vec![false; told.missing.len()];
    let mut first = Vec::new();
    for own in hidden {
        let is_within = |gyros: &Gyros| is_within(gyros, &own.gyros);
        let mut reached = [false; 4];
        for (found, is_true) in told.missing.iter().zip(&mut is_true).filter(|(found, _)| found.is(own)) {
            if is_within(&found.gyros) {
                *is_true = true;
                reached.iter_mut().zip(found.gyros).for_each(|(all, one)| *all |= one);
            }
        }
        let is_rival = |rival: &ReportedAlternative| {
            let is_alike = rival.behind_chi2.is_none_or(|behind| behind < APART_CHI2);
            rival.code == own.code() && rival.formula == own.formula() && rival.gyros == own.gyros && is_alike
        };
        let least = if own.origin == Origin::Unknown { GROUP_COSINE } else { SAME_COSINE };
        let mut naming = if reached == own.gyros { IsolationResult::Right } else { IsolationResult::Missed };
        // The same code on other gyros too, or on some of them alone, is the same thing where the others show nothing of it.
        let is_done = |found: &DiagnosedEffect| reached == own.gyros && found.is(own) && is_within(&found.gyros);
        for (found, is_true) in told.missing.iter().zip(&mut is_true).filter(|(found, _)| !is_done(found)) {
            if found.rivals.iter().any(is_rival) || likeness(own, found) >= least {
                *is_true = true;
                naming = if naming == IsolationResult::Right { naming } else { IsolationResult::Group };
            }
        }
        first.push(naming);
    }
    let false_names: Vec<usize> = (0..is_true.len()).filter(|&index| !is_true[index]).collect();
    let of = |(own, naming): (&InjectedEffect, IsolationResult)| {
        let overlaps = |found: &DiagnosedEffect| overlap(&found.gyros, &own.gyros);
        let naming = match naming {
            IsolationResult::Missed if false_names.iter().any(|&index| overlaps(&told.missing[index])) => {
                IsolationResult::Wrong
            }
            IsolationResult::Missed if told.verdict == Verdict::Unexplained || told.missing.iter().any(overlaps) => {
                IsolationResult::Unnamed
            }
            naming => naming,
        };
        EffectScore { naming, size: if naming == IsolationResult::Right { size_error(own, told) } else { None } }
    };
    Score { outcomes: hidden.iter().zip(first).map(of).collect(), false_names }
}

/// Of what one entry names on all of its gyros.
fn size_error(hidden: &InjectedEffect, told: &ReportedDiagnosis) -> Option<SizeError> {
    let found = told.missing.iter().find(|found| found.is(hidden) && found.gyros == hidden.gyros)?;
    let numbers = hidden.hypothesis.parameters();
    let (truth, found) = (numbers[0].value, found.number(&numbers[0].name)?);
    // A swing of the other sign is one half a turn later.
    let has_phase = numbers.iter().any(|number| number.role == Role::Phase);
    let error = if has_phase { found.value.abs() - truth.abs() } else { found.value - truth };
    Some(SizeError { error, sigma: found.sigma?, bound: hidden.sigma? })
}

impl Score {
    /// Whether everything was named rightly, or in the right group, and nothing else was named. Of what stands in no catalogue it is
    /// enough that no effect of the catalogue was named for it.
    pub fn is_right(&self, hidden: &[InjectedEffect], told: &ReportedDiagnosis) -> bool {
        let is_unknown = hidden.iter().any(|own| own.origin == Origin::Unknown);
        let is_formula = |index: &usize| is_unknown && told.missing[*index].formula.is_some();
        let named = self.outcomes.iter().zip(hidden).all(|(outcome, own)| {
            let is_seen = outcome.naming != IsolationResult::Missed;
            outcome.naming >= IsolationResult::Group || own.origin == Origin::Unknown && is_seen
        });
        named && self.false_names.iter().all(is_formula)
    }
}
