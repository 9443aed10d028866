//! The manoeuvre that is proposed to separate two hypotheses: types, and the configuration with it.

use geu_model::Configuration;
use geu_model::attitude::{Manoeuvre, Scenario};
use geu_model::configuration::RunRecord;
use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};

/// Expected separation, sigmas, from which a manoeuvre is proposed as sure: five, and two for the noise of the new recording.
pub const SURE_SIGMA: f64 = 7.0;
/// The sentence without a manoeuvre.
pub const NO_TEST: &str = "no manoeuvre tried would separate the two";

/// The measurement that would separate a hypothesis from an alternative.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscriminatingTest {
    /// In a sentence.
    pub text: String,
    /// The manoeuvre, if any separates them by 3 sigma or more.
    pub manoeuvre: Option<NextManoeuvre>,
}

/// A scenario of which a new recording, diagnosed by itself, separates two hypotheses.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextManoeuvre {
    /// The scenario.
    #[serde(rename = "manoeuvres", serialize_with = "manoeuvres")]
    pub scenario: Scenario,
    /// Duration.
    pub duration_s: f64,
    /// Expected separation, sigmas: the minimum over either hypothesis being true.
    pub sigma: f64,
}

impl NextManoeuvre {
    /// True if noise hardly prevents the new recording from separating the two by five sigma.
    pub fn is_sure(&self) -> bool {
        self.sigma >= SURE_SIGMA
    }

    /// The unit on this scenario, without planned faults.
    pub fn configuration(&self, nominal: &Configuration) -> Configuration {
        Configuration {
            scenario: self.scenario.clone(),
            faults: Vec::new(),
            expectations: Vec::new(),
            run: RunRecord::default(),
            ..nominal.clone()
        }
    }
}

/// Manoeuvres with their kinds and numbers, as a configuration names them.
fn manoeuvres<S: Serializer>(scenario: &Scenario, serializer: S) -> Result<S::Ok, S::Error> {
    let of = |manoeuvre: &Manoeuvre| {
        let numbers = manoeuvre.numbers();
        let values = numbers.specs().iter().enumerate().map(|(index, number)| (number.name, numbers.value(index)));
        let given = values.filter(|(_, value)| !value.is_nan()).map(|(name, value)| (name.to_owned(), json!(value)));
        let kind = ("kind".to_owned(), json!(manoeuvre.kind()));
        Value::from(std::iter::once(kind).chain(given).collect::<Map<String, Value>>())
    };
    serializer.collect_seq(scenario.manoeuvres.iter().map(of))
}
