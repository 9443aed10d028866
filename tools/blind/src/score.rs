//! Scores of a diagnosis against the injected effects.

use std::fmt;

use geu_model::parameter_spec::Role;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::injected::{FieldError, InjectedEffect, Origin};
use geu_diagnosis::outcome::{Class, DiagnosedEffect, Diagnosis, ReportedAlternative, Verdict};
use geu_protocol::Gyros;

/// Minimum cosine with a term outside the catalogue for the right group.
const GROUP_COSINE: f64 = 0.95;
/// Minimum cosine of two signatures of the same effect.
const SAME_COSINE: f64 = 0.999;

/// A diagnosis as it is scored.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportedDiagnosis {
    /// Verdict.
    pub verdict: Verdict,
    /// Effects reported as missing in the model.
    pub missing: Vec<DiagnosedEffect>,
    /// Lag of the temperature with which they were estimated, s.
    pub temperature_late_s: f64,
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
    /// The invalid field.
    pub fn from_json(result: &Value) -> Result<ReportedDiagnosis, FieldError> {
        let bad = |field: &str, expected| FieldError { field: field.to_owned(), expected, writer: "diagnose --json" };
        let verdict = Verdict::deserialize(&result["verdict"]);
        let effects = result["effects"].as_array();
        let temperature_late_s = &result["temperature_late_s"];
        Ok(ReportedDiagnosis {
            verdict: verdict.map_err(|_| bad("verdict", "consistent, explained or unexplained"))?,
            missing: effects
                .ok_or_else(|| bad("effects", "a list"))?
                .iter()
                .filter(|entry| entry["class"] == "missing-effect")
                .map(DiagnosedEffect::deserialize)
                .collect::<Result<_, _>>()
                .map_err(|_| bad("effects", "code, gyros and parameters of each"))?,
            temperature_late_s: if temperature_late_s.is_null() { Some(0.0) } else { temperature_late_s.as_f64() }
                .ok_or_else(|| bad("temperature_late_s", "a number"))?,
        })
    }
}

/// Isolation of an injected effect, the worst first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub enum IsolationResult {
    /// Not detected.
    Missed,
    /// Detected without an effect.
    Unnamed,
    /// Another effect.
    Wrong,
    /// An effect that is not distinguishable from the injected one.
    Group,
    /// The injected effect, on its gyros.
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

impl From<IsolationResult> for &'static str {
    fn from(result: IsolationResult) -> &'static str {
        result.name()
    }
}

impl TryFrom<String> for IsolationResult {
    type Error = String;

    fn try_from(name: String) -> Result<IsolationResult, String> {
        use IsolationResult::{Group, Missed, Right, Unnamed, Wrong};
        let all = [Missed, Unnamed, Wrong, Group, Right];
        let expected = || format!("expected {}, got {name}", all.map(IsolationResult::name).join("; "));
        all.into_iter().find(|own| own.name() == name).ok_or_else(expected)
    }
}

/// Error of the estimated amplitude.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SizeError {
    /// Estimated minus injected.
    pub error: f64,
    /// Estimated sigma.
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

/// Score of one injected effect.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectScore {
    /// Isolation.
    pub isolation: IsolationResult,
    /// Error of the amplitude of an isolated effect.
    pub size: Option<SizeError>,
}

/// Score of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Outcome of each injected effect.
    pub outcomes: Vec<EffectScore>,
    /// Indices among [`ReportedDiagnosis::missing`] of the effects that were not injected.
    pub false_alarms: Vec<usize>,
}

/// Scores a diagnosis. `cosine` is that of the signatures of an injected and a reported effect.
///
/// An effect is isolated if entries report its code on all of its gyros. It is in the right group if an entry has it, on the same gyros,
/// among the alternatives that are not distinguishable, or if an entry has the same signature; for a term outside the
/// catalogue a similar signature suffices.
pub fn score(
    injected: &[InjectedEffect],
    result: &ReportedDiagnosis,
    cosine: &dyn Fn(&InjectedEffect, &DiagnosedEffect) -> f64,
) -> Score {
    let mut is_true = vec![false; result.missing.len()];
    let mut isolations = Vec::new();
    for own in injected {
        let gyros = own.gyros();
        let is_own = |found: &DiagnosedEffect| own.is_named_by(found) && found.gyros.is_within(&gyros);
        let mut reached = Gyros::default();
        for found in result.missing.iter().filter(|found| is_own(found)) {
            reached = reached.and(found.gyros);
        }
        let is_right = reached == gyros;
        let is_alternative = |other: &ReportedAlternative| {
            other.code == own.code()
                && other.formula == own.formula()
                && other.gyros == gyros
                && other.is_indistinguishable()
        };
        let min_cosine = if own.origin == Origin::Unknown { GROUP_COSINE } else { SAME_COSINE };
        let mut isolation = if is_right { IsolationResult::Right } else { IsolationResult::Missed };
        for (found, is_true) in result.missing.iter().zip(&mut is_true) {
            *is_true |= is_own(found);
            // The code on some of its gyros, or on more, is the same effect if the signatures agree.
            let is_done = is_right && is_own(found);
            if !is_done && (found.alternatives.iter().any(is_alternative) || cosine(own, found) >= min_cosine) {
                *is_true = true;
                isolation = isolation.max(IsolationResult::Group);
            }
        }
        isolations.push(isolation);
    }
    let false_alarms: Vec<usize> = (0..is_true.len()).filter(|&index| !is_true[index]).collect();
    let outcome = |(own, isolation): (&InjectedEffect, IsolationResult)| {
        let overlaps = |found: &DiagnosedEffect| found.gyros.overlaps(&own.gyros());
        let isolation = match isolation {
            IsolationResult::Missed if false_alarms.iter().any(|&index| overlaps(&result.missing[index])) => {
                IsolationResult::Wrong
            }
            IsolationResult::Missed
                if result.verdict == Verdict::Unexplained || result.missing.iter().any(overlaps) =>
            {
                IsolationResult::Unnamed
            }
            isolation => isolation,
        };
        let size = if isolation == IsolationResult::Right { size_error(own, result) } else { None };
        EffectScore { isolation, size }
    };
    Score { outcomes: injected.iter().zip(isolations).map(outcome).collect(), false_alarms }
}

/// Amplitude error of an effect that one entry reports on all of its gyros.
fn size_error(injected: &InjectedEffect, result: &ReportedDiagnosis) -> Option<SizeError> {
    let gyros = injected.gyros();
    let found = result.missing.iter().find(|found| injected.is_named_by(found) && found.gyros == gyros)?;
    let numbers = injected.hypothesis.parameters();
    let (truth, found) = (numbers[0].value, found.number(&numbers[0].name)?);
    // The sign of a wave is ambiguous with its phase.
    let has_phase = numbers.iter().any(|number| number.role == Role::Phase);
    let error = if has_phase { found.value.abs() - truth.abs() } else { found.value - truth };
    Some(SizeError { error, sigma: found.sigma?, bound: injected.sigma? })
}

impl Score {
    /// True if every effect was isolated, or in the right group, without a false alarm. For a term outside the catalogue a detection
    /// without an effect of the catalogue suffices.
    pub fn is_right(&self, injected: &[InjectedEffect], result: &ReportedDiagnosis) -> bool {
        let is_unknown = injected.iter().any(|own| own.origin == Origin::Unknown);
        let is_formula = |index: &usize| is_unknown && result.missing[*index].formula.is_some();
        let is_isolated = |(outcome, own): (&EffectScore, &InjectedEffect)| {
            let is_detected = own.origin == Origin::Unknown && outcome.isolation != IsolationResult::Missed;
            outcome.isolation >= IsolationResult::Group || is_detected
        };
        self.outcomes.iter().zip(injected).all(is_isolated) && self.false_alarms.iter().all(is_formula)
    }
}
