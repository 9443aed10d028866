//! What a diagnosis comes to: types alone.

use geu_model::Configuration;
use geu_model::package::Calibration;
use geu_protocol::Gyro;
use serde::{Deserialize, Serialize};

use crate::explain::Round;
use crate::finding::Finding;
use crate::gap::ResidualStats;
use crate::gyros::Gyros;
use crate::hypothesis::Hypothesis;
use crate::measured::{CHANNELS, Series, TIMING};
use crate::normal::THIRDS;
use crate::null::Thresholds;
use crate::stretches::MotionSegment;
use crate::whereabouts::ResidualMap;
use geu_model::number::ParameterSet;

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// No missing effect, and noise-like once what may be out of date is refitted.
    Consistent,
    /// At least one missing effect, and noise-like after.
    Explained,
    /// Otherwise.
    Unexplained,
}

impl Verdict {
    /// All of them.
    pub const ALL: [Verdict; 3] = [Verdict::Consistent, Verdict::Explained, Verdict::Unexplained];

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
pub struct EstimatedValue {
    /// Key in the configuration, unit last.
    pub name: String,
    /// Value.
    pub value: f64,
    /// One sigma; none where it was not fitted.
    pub sigma: Option<f64>,
    /// As a configuration writes it, where that is no number: what is on, another gyro.
    pub written: Option<String>,
}

impl EstimatedValue {
    /// With this sigma, where that is known.
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

/// Whether something is missing in the model or only its calibration out of date.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// An effect that the configuration does not have.
    #[default]
    MissingEffect,
    /// Calibration parameters moved.
    Recalibration,
}

/// What puts an effect into a configuration.
#[derive(Debug, Clone, PartialEq)]
pub enum Correction {
    /// An amplitude of the model.
    Hypothesis(Hypothesis),
    /// A calibration parameter.
    Calibration {
        /// Of this gyro.
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
    /// Puts it into a configuration.
    pub fn apply(&self, configuration: &mut Configuration) {
        match self {
            Correction::Hypothesis(hypothesis) => hypothesis.replace(configuration),
            Correction::Calibration { gyro, number, value, .. } => {
                *configuration.gyros[*gyro as usize].calibration.value_mut(*number) = *value;
            }
        }
    }

    /// What [`Configuration::edited`] takes to have it in the text of `configuration`, which has it already.
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

/// A fall of χ² and the one that was required.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chi2Fall {
    /// By how much χ² falls.
    pub fall: f64,
    /// What it falls by in one recording of a hundred without the effect.
    pub threshold: f64,
}

/// An effect found.
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
    /// Missing or out of date.
    pub class: Class,
    /// The gyros that it acts on.
    #[serde(with = "crate::gyros")]
    pub gyros: Gyros,
    /// Its numbers.
    #[serde(with = "by_name")]
    pub parameters: Vec<EstimatedValue>,
    /// Fall of the fitted part's summed squared residual when it is added in order, over that of the configuration as given.
    #[serde(default)]
    pub gap_share: f64,
    /// None where it was found by exact checks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chi2: Option<Chi2Fall>,
    /// By how much better each third is predicted by the other two; none for one that has nearly all that shows it.
    #[serde(default, rename = "held_out_chi2", skip_serializing_if = "Option::is_none")]
    pub held_out: Option<[Option<f64>; THIRDS]>,
    /// Alternatives.
    #[serde(default)]
    pub rivals: Vec<ReportedAlternative>,
    /// What puts it into a configuration.
    #[serde(skip)]
    pub corrections: Vec<Correction>,
}

impl DiagnosedEffect {
    /// What [`Configuration::edited`] takes to have it in the text of `configuration`, which has it already.
    pub fn assignments(&self, configuration: &Configuration) -> Vec<String> {
        self.corrections.iter().flat_map(|correction| correction.assignments(configuration)).collect()
    }

    /// The number of this name, where it is one.
    pub fn number(&self, name: &str) -> Option<&EstimatedValue> {
        self.parameters.iter().find(|number| number.name == name && number.written.is_none())
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
    #[serde(with = "crate::gyros")]
    pub gyros: Gyros,
    /// Cosine of the two signatures.
    pub cosine: f64,
    /// By how much χ² falls more with what was found; none where the two are one signature.
    pub behind_chi2: Option<f64>,
    /// What would tell them apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

impl ReportedAlternative {
    /// A hypothesis in the place of an effect.
    pub fn new(hypothesis: &Hypothesis, cosine: f64, behind_chi2: f64, remedy: Option<String>) -> ReportedAlternative {
        ReportedAlternative {
            code: hypothesis.amplitude.code(),
            formula: hypothesis.amplitude.formula().map(|formula| formula.to_string()),
            gyros: hypothesis.gyros,
            cosine,
            behind_chi2: Some(behind_chi2),
            remedy,
        }
    }
}

/// What is left that nothing explains.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unexplained {
    /// The gyros that show it.
    #[serde(with = "crate::gyros")]
    pub gyros: Gyros,
    /// From when to when it stands out, s.
    pub interval_s: [f64; 2],
    /// In words.
    pub shape: String,
    /// Terms that it follows.
    pub follows: Vec<FollowedTerm>,
}

/// A term that a residual follows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FollowedTerm {
    /// Its formula.
    pub term: String,
    /// What χ² falls by with it alone.
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

/// The whole of it.
#[derive(Debug)]
pub struct Diagnosis {
    /// In a word.
    pub verdict: Verdict,
    /// What was found: what is missing, then what is out of date.
    pub entries: Vec<DiagnosedEffect>,
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
    pub stretches: Vec<MotionSegment>,
    /// Root mean square of the residual in each stretch on each gyro, before and after.
    pub stretch_rms_arcsec: [Vec<[f64; TIMING]>; 2],
    /// Where the data leave the model, before (what exact checks mended taken as mended) and after.
    pub whereabouts: [ResidualMap; 2],
    /// Whitened residual at the end, for what it still follows.
    pub left: Series,
    /// Common lag, s, and its sigma.
    pub lag_s: (f64, f64),
    /// How much later than the electronics' own course the temperature is told, s.
    pub temperature_late_s: f64,
    /// Noise of each gyro as it was taken.
    pub noise: [crate::whitening::NoiseModel; CHANNELS],
}
