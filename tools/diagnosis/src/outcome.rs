//! Results of a diagnosis: types only.

use std::fmt;

use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_protocol::{Gyro, Gyros};
use serde::{Deserialize, Serialize};

use crate::alternatives::AMBIGUITY_CHI2;
use crate::measured::{CHANNELS, Series, TIMING};
use crate::model_selection::SelectionStep;
use crate::motion_segments::MotionSegment;
use crate::next_manoeuvre::{DiscriminatingTest, NextManoeuvre};
use crate::normal_equations::THIRDS;
use crate::null_distribution::Thresholds;
use crate::residual_map::ResidualMap;
use crate::residual_stats::{ResidualStats, WINDOW};
use geu_checks::Finding;
use geu_hypothesis::Hypothesis;
use geu_model::parameter_spec::ParameterSet;

/// Verdict of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// No missing effect; the residual is noise after a fit of the calibration parameters.
    Consistent,
    /// One missing effect or more, or output in another unit; the residual is noise with them.
    Explained,
    /// Otherwise.
    Unexplained,
}

impl Verdict {
    /// All of them.
    pub const ALL: [Verdict; 3] = [Verdict::Consistent, Verdict::Explained, Verdict::Unexplained];

    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Consistent => "consistent",
            Verdict::Explained => "explained",
            Verdict::Unexplained => "unexplained",
        }
    }
}

/// An estimated parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimatedValue {
    /// Key in the configuration, unit last.
    pub name: String,
    /// Value.
    pub value: f64,
    /// 1 sigma; `None` if it was not fitted.
    pub sigma: Option<f64>,
    /// Value as written in a configuration, if it is not a number: a switch, another gyro.
    pub written: Option<String>,
}

impl EstimatedValue {
    /// A value with a sigma, if that is finite.
    pub fn new(name: String, value: f64, sigma: f64) -> EstimatedValue {
        EstimatedValue { name, value, sigma: sigma.is_finite().then_some(sigma), written: None }
    }
}

/// Numbers in JSON: value and sigma by name.
mod by_name {
    use std::collections::BTreeMap;

    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::{Value, json};

    use super::EstimatedValue;

    #[derive(Serialize, Deserialize)]
    struct Shown {
        value: Value,
        sigma: Option<f64>,
    }

    pub fn serialize<S: Serializer>(numbers: &[EstimatedValue], serializer: S) -> Result<S::Ok, S::Error> {
        let shown = |number: &EstimatedValue| {
            let value = match &number.written {
                Some(written) => serde_json::from_str(written).unwrap_or_else(|_| json!(written)),
                None => json!(number.value),
            };
            Shown { value, sigma: number.sigma }
        };
        serializer.collect_map(numbers.iter().map(|number| (&number.name, shown(number))))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<EstimatedValue>, D::Error> {
        let numbers = BTreeMap::<String, Shown>::deserialize(deserializer)?;
        let of = |(name, Shown { value, sigma }): (String, Shown)| match value.as_f64() {
            Some(value) => EstimatedValue { name, value, sigma, written: None },
            None => EstimatedValue { name, value: f64::NAN, sigma, written: Some(value.to_string()) },
        };
        Ok(numbers.into_iter().map(of).collect())
    }
}

/// Class of a reported effect.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// An effect that the configuration does not have.
    #[default]
    MissingEffect,
    /// Calibration parameters moved.
    Recalibration,
}

/// Correction of a configuration.
#[derive(Debug, Clone, PartialEq)]
pub enum Correction {
    /// An amplitude of the model.
    Hypothesis(Hypothesis),
    /// A calibration parameter.
    Calibration {
        /// The gyro.
        gyro: Gyro,
        /// Index among [`Calibration::NUMBERS`].
        number: usize,
        /// The new value.
        value: f64,
        /// Decimals with which it is written.
        decimals: usize,
    },
}

impl Correction {
    /// Applies it to a configuration.
    pub fn apply(&self, configuration: &mut Configuration) {
        match self {
            Correction::Hypothesis(hypothesis) => hypothesis.replace(configuration),
            Correction::Calibration { gyro, number, value, .. } => {
                *configuration.gyros[gyro.index()].calibration.value_mut(*number) = *value;
            }
        }
    }

    /// Assignments for [`Configuration::edited`] that write it to the text of `configuration`, which contains it.
    pub fn assignments(&self, configuration: &Configuration) -> Vec<String> {
        match self {
            Correction::Hypothesis(hypothesis) => hypothesis.assignments(configuration),
            Correction::Calibration { gyro, number, value, decimals } => {
                let key = Calibration::NUMBERS[*number].name;
                vec![format!("gyro.{}.calibration.{key} = {value:.decimals$}", gyro.name())]
            }
        }
    }
}

/// A χ² reduction and its threshold.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chi2Fall {
    /// χ² reduction.
    pub fall: f64,
    /// Reduction at the false alarm rate.
    pub threshold: f64,
}

/// A reported effect.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosedEffect {
    /// Code of the model.
    pub code: String,
    /// Formula of a discovered term.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub formula: Option<String>,
    /// Unit of its coefficient.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coefficient_unit: Option<String>,
    /// Class.
    pub class: Class,
    /// The gyros that it acts on.
    #[serde(with = "geu_hypothesis::gyros")]
    pub gyros: Gyros,
    /// Numbers.
    #[serde(with = "by_name")]
    pub parameters: Vec<EstimatedValue>,
    /// Fall of the fitted part's summed squared residual when it is added in order, the calibration fitted anew, over that of the
    /// configuration as given.
    #[serde(default)]
    pub gap_share: f64,
    /// `None` if exact checks found it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chi2: Option<Chi2Fall>,
    /// Cross-validation of each third; `None` for one that contains nearly all information.
    #[serde(default, rename = "held_out_chi2", skip_serializing_if = "Option::is_none")]
    pub held_out: Option<[Option<f64>; THIRDS]>,
    /// Alternatives.
    #[serde(default, rename = "rivals")]
    pub alternatives: Vec<ReportedAlternative>,
    /// Corrections of the configuration.
    #[serde(skip)]
    pub corrections: Vec<Correction>,
}

impl DiagnosedEffect {
    /// True if χ² falls by less than its own threshold.
    pub fn is_below_threshold(&self) -> bool {
        self.chi2.is_some_and(|chi2| chi2.fall.is_nan() || chi2.fall < chi2.threshold)
    }

    /// Assignments for [`Configuration::edited`] that write it to the text of `configuration`, which contains it.
    pub fn assignments(&self, configuration: &Configuration) -> Vec<String> {
        self.corrections.iter().flat_map(|correction| correction.assignments(configuration)).collect()
    }

    /// The number of this name, where it is one.
    pub fn number(&self, name: &str) -> Option<&EstimatedValue> {
        self.parameters.iter().find(|number| number.name == name && number.written.is_none())
    }

    /// The hypothesis; `None` if the model has no such effect.
    pub fn hypothesis(&self) -> Option<Hypothesis> {
        let number = |name: &str| self.number(name).map(|number| number.value);
        Hypothesis::from_numbers(&self.code, self.formula.as_deref(), self.gyros, number)
    }
}

impl fmt::Display for DiagnosedEffect {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {}", self.gyros.names().join("+"), self.code)?;
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

/// An alternative as it is reported.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ReportedAlternative {
    /// Code.
    pub code: String,
    /// Formula of a discovered term.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub formula: Option<String>,
    /// The gyros.
    #[serde(with = "geu_hypothesis::gyros")]
    pub gyros: Gyros,
    /// Cosine of the two signatures.
    pub cosine: f64,
    /// χ² above that of the reported effect; `None` if the signatures are equal.
    #[serde(rename = "behind_chi2")]
    pub delta_chi2: Option<f64>,
    /// Measurement that discriminates the two.
    #[serde(default, rename = "remedy", skip_serializing_if = "Option::is_none")]
    pub discriminating_test: Option<String>,
    /// Manoeuvre that discriminates the two, or does so more than any other.
    #[serde(skip_deserializing)]
    pub next_manoeuvre: Option<NextManoeuvre>,
    /// Fitted in place of the effect; `None` if the model has no such effect.
    #[serde(skip)]
    pub hypothesis: Option<Hypothesis>,
}

impl ReportedAlternative {
    /// True if the recording does not distinguish it from the effect found.
    pub fn is_indistinguishable(&self) -> bool {
        self.delta_chi2.is_none_or(|delta_chi2| delta_chi2 < AMBIGUITY_CHI2)
    }

    /// A hypothesis in the place of an effect.
    pub fn new(
        hypothesis: &Hypothesis,
        cosine: f64,
        delta_chi2: f64,
        test: Option<DiscriminatingTest>,
    ) -> ReportedAlternative {
        let (text, next_manoeuvre) = test.map_or((None, None), |test| (Some(test.text), test.manoeuvre));
        ReportedAlternative {
            code: hypothesis.amplitude.code(),
            formula: hypothesis.amplitude.formula().map(|formula| formula.to_string()),
            gyros: hypothesis.gyros,
            cosine,
            delta_chi2: Some(delta_chi2),
            discriminating_test: text,
            next_manoeuvre,
            hypothesis: Some(hypothesis.clone()),
        }
    }
}

/// A residual without explanation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unexplained {
    /// The gyros that show it.
    #[serde(with = "geu_hypothesis::gyros")]
    pub gyros: Gyros,
    /// Interval in which it is significant, s.
    pub interval_s: [f64; 2],
    /// Description.
    pub shape: String,
    /// Correlated terms.
    pub follows: Vec<FollowedTerm>,
}

/// A term that correlates with a residual.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FollowedTerm {
    /// Formula.
    pub term: String,
    /// χ² reduction by it alone.
    pub score: f64,
}

/// A gap and the same held out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gaps {
    /// On all of the data that were fitted.
    pub fitted: ResidualStats,
    /// On each third, by a fit to the other two.
    pub held_out: ResidualStats,
}

/// A diagnosis.
#[derive(Debug)]
pub struct Diagnosis {
    /// Verdict.
    pub verdict: Verdict,
    /// Missing effects, then outdated calibration parameters.
    pub entries: Vec<DiagnosedEffect>,
    /// Findings of exact checks.
    pub findings: Vec<Finding>,
    /// With the configuration as given.
    pub before: Gaps,
    /// With the updated configuration.
    pub after: Gaps,
    /// The residual without explanation.
    pub unexplained: Option<Unexplained>,
    /// The updated configuration.
    pub configuration: Configuration,
    /// Steps of the selection.
    pub steps: Vec<SelectionStep>,
    /// Detection thresholds.
    pub thresholds: Thresholds,
    /// Windowed residual at each node, before and after.
    pub windowed: [[Vec<f64>; TIMING]; 2],
    /// Motion segments.
    pub segments: Vec<MotionSegment>,
    /// Root mean square of the residual in each segment on each gyro, before and after, arcsec.
    pub segment_rms_arcsec: [Vec<[f64; TIMING]>; 2],
    /// Residual maps before, with corrected wiring faults, and after.
    pub residual_maps: [ResidualMap; 2],
    /// Whitened residual at the end.
    pub left: Series,
    /// Common lag, s, and its sigma.
    pub lag_s: (f64, f64),
    /// Delay of the recorded temperature against that of the electronics, s.
    pub temperature_late_s: f64,
    /// Noise of each channel.
    pub noise: [crate::whitening::NoiseModel; CHANNELS],
}

impl Diagnosis {
    /// Gyros of the unit.
    pub fn gyros(&self) -> Vec<Gyro> {
        self.configuration.device.gyros().collect()
    }

    /// Interval of the nodes, s.
    pub fn interval_s(&self) -> f64 {
        self.configuration.device.interval_s
    }

    /// Length of a window of the gap in words.
    pub fn window(&self) -> String {
        match WINDOW as f64 * self.interval_s() {
            window_s if window_s % 60.0 == 0.0 => format!("{} min", window_s / 60.0),
            window_s => format!("{window_s:.0} s"),
        }
    }

    /// The next manoeuvre, with the effect and the alternative that it separates: the first that is sure, else the first.
    pub fn next_manoeuvre(&self) -> Option<(&DiagnosedEffect, &ReportedAlternative, &NextManoeuvre)> {
        let pairs = || self.entries.iter().flat_map(|entry| entry.alternatives.iter().map(move |other| (entry, other)));
        let all = || pairs().filter_map(|(entry, other)| Some((entry, other, other.next_manoeuvre.as_ref()?)));
        all().find(|(_, _, next)| next.is_sure()).or_else(|| all().next())
    }
}
