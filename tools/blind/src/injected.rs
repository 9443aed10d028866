//! Injected effects and the answer key, a file of its own.

use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value, value};

use geu_diagnosis::outcome::DiagnosedEffect;
use geu_hypothesis::Hypothesis;
use geu_protocol::Gyros;

/// Origin of an injected effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// An amplitude of the model's lists, with or without a time course.
    Catalogue,
    /// Noise above the configured level.
    Noise,
    /// A wiring fault.
    Wiring,
    /// A term outside the catalogue.
    Unknown,
}

const ORIGINS: [(Origin, &str); 4] = [
    (Origin::Catalogue, "catalogue"),
    (Origin::Noise, "noise"),
    (Origin::Wiring, "wiring"),
    (Origin::Unknown, "unknown"),
];

/// An injected effect.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectedEffect {
    /// The effect.
    pub hypothesis: Hypothesis,
    /// Origin.
    pub origin: Origin,
    /// Cramér–Rao bound of the amplitude; `None` without a signature.
    pub sigma: Option<f64>,
    /// Signature in sigmas of the noise, with calibration parameters, lag and random walks projected out.
    pub strength: Option<f64>,
    /// For a term outside the catalogue, the most similar amplitude of the catalogue and the cosine of the two.
    pub nearest: Option<(String, f64)>,
    /// Assignments that add it to a configuration.
    pub assignments: Vec<String>,
}

/// Effects injected into one recording.
#[derive(Debug, Clone, PartialEq)]
pub struct AnswerKey {
    /// Seed of the trial.
    pub seed: u64,
    /// On-board time simulated.
    pub duration_s: f64,
    /// The effects.
    pub injected: Vec<InjectedEffect>,
}

/// An invalid field of a key or of a result.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, as `geu {writer}` writes it")]
pub struct FieldError {
    pub(super) field: String,
    pub(super) expected: &'static str,
    pub(super) writer: &'static str,
}

impl InjectedEffect {
    /// True if the diagnosis names it, on whichever gyros.
    pub(crate) fn is_named_by(&self, found: &DiagnosedEffect) -> bool {
        found.code == self.code() && found.formula == self.formula()
    }

    /// Code of the model, with the suffix of its time course.
    pub fn code(&self) -> String {
        self.hypothesis.amplitude.code()
    }

    /// Formula of a term outside the catalogue.
    pub fn formula(&self) -> Option<String> {
        self.hypothesis.amplitude.formula().map(|formula| formula.to_string())
    }

    /// The gyros that it changes. A configuration states an exchange of two gyros at either gyro.
    pub fn gyros(&self) -> Gyros {
        let mut gyros = self.hypothesis.gyros;
        if let Some(other) = self.hypothesis.amplitude.gyro_named(self.hypothesis.value) {
            gyros = gyros.and(gyros.only(other.index()));
        }
        gyros
    }

    /// Label and value of each fact.
    pub fn facts(&self) -> Vec<(String, String)> {
        let mut effect = format!("{} {}", self.gyros().names().join("+"), self.code());
        if let Some(formula) = self.formula() {
            effect += &format!(" {formula}");
        }
        let mut facts = vec![("injected".to_owned(), effect)];
        let parameters = self.hypothesis.parameters().into_iter();
        facts.extend(parameters.map(|number| (number.name, format!("{:.4e}", number.value))));
        facts.extend(self.strength.map(|strength| ("strength".to_owned(), format!("{strength:.1} sigma"))));
        let nearest = self.nearest.as_ref();
        facts.extend(nearest.map(|(code, cosine)| ("most like".to_owned(), format!("{code}, cosine {cosine:.3}"))));
        facts
    }

    fn table(&self) -> Table {
        let origin = ORIGINS.iter().find(|(origin, _)| *origin == self.origin).map_or("", |(_, name)| name);
        let parameters = self.hypothesis.parameters().into_iter();
        let parameters = parameters.map(|number| (number.name, Value::from(number.value))).collect::<InlineTable>();
        let nearest = self.nearest.as_ref().map(|(code, cosine)| {
            let fields = [("code", Value::from(code)), ("cosine", Value::from(*cosine))];
            value(fields.into_iter().collect::<InlineTable>())
        });
        let fields = [
            ("origin", Some(value(origin))),
            ("code", Some(value(self.code()))),
            ("formula", self.formula().map(value)),
            ("gyros", Some(value(self.gyros().names().into_iter().collect::<Array>()))),
            ("parameters", Some(value(parameters))),
            ("sigma", self.sigma.map(value)),
            ("strength", self.strength.map(value)),
            ("nearest", nearest),
            ("assignments", Some(value(self.assignments.iter().collect::<Array>()))),
        ];
        fields.into_iter().filter_map(|(key, item)| Some((key, item?))).collect()
    }

    /// Reads a table of the key. The error is the invalid field and the expected content.
    fn read(table: &Table) -> Result<InjectedEffect, (&'static str, &'static str)> {
        let text = |name: &str| table.get(name).and_then(Item::as_str);
        let number = |name: &str| table.get(name).and_then(Item::as_float);
        let texts =
            |name: &str| -> Option<Vec<&str>> { table.get(name)?.as_array()?.iter().map(Value::as_str).collect() };
        let origin = ORIGINS.iter().find(|(_, name)| text("origin") == Some(name));
        let code = text("code").ok_or(("code", "a code of the model"))?;
        let &(origin, _) = origin.ok_or(("origin", "catalogue, noise, wiring or unknown"))?;
        let gyros = texts("gyros").and_then(|names| Gyros::ALL.from_names(&names));
        let gyros = gyros.ok_or(("gyros", "one or more of GYRX, GYRY, GYRZA, GYRZB"))?;
        let parameters = table.get("parameters").and_then(Item::as_inline_table);
        let parameters = parameters.filter(|all| all.iter().all(|(_, value)| value.is_float()));
        let parameters = parameters.ok_or(("parameters", "numbers by name"))?;
        let parameter = |name: &str| parameters.get(name)?.as_float();
        let hypothesis = Hypothesis::from_numbers(code, text("formula"), gyros, parameter);
        let mut hypothesis = hypothesis.ok_or(("code", "a code and parameters of the model, within their limits"))?;
        if let Some(other) = hypothesis.amplitude.gyro_named(hypothesis.value) {
            hypothesis.gyros = hypothesis.gyros.without(hypothesis.gyros.only(other.index()));
        }
        let nearest = table
            .get("nearest")
            .and_then(Item::as_inline_table)
            .and_then(|nearest| Some((nearest.get("code")?.as_str()?.to_owned(), nearest.get("cosine")?.as_float()?)));
        let assignments = texts("assignments").ok_or(("assignments", "PATH=VALUE"))?;
        let assignments = assignments.into_iter().map(str::to_owned).collect();
        let (sigma, strength) = (number("sigma"), number("strength"));
        Ok(InjectedEffect { hypothesis, origin, sigma, strength, nearest, assignments })
    }
}

impl AnswerKey {
    /// The text of `key.toml`.
    pub fn to_toml(&self) -> String {
        let mut document = DocumentMut::new();
        document["seed"] = value(self.seed as i64);
        document["duration_s"] = value(self.duration_s);
        if !self.injected.is_empty() {
            let tables = self.injected.iter().map(InjectedEffect::table).collect::<ArrayOfTables>();
            document["hidden"] = Item::ArrayOfTables(tables);
        }
        format!("# What is hidden in the recording beside this directory.\n{document}")
    }

    /// Reads `key.toml`.
    ///
    /// # Errors
    /// The invalid field.
    pub fn parse(text: &str) -> Result<AnswerKey, FieldError> {
        let bad = |field: &str, expected| FieldError { field: field.to_owned(), expected, writer: "blind hide" };
        let document: DocumentMut = text.parse().map_err(|_| bad("the file", "TOML"))?;
        let seed = document.get("seed").and_then(Item::as_integer).and_then(|seed| u64::try_from(seed).ok());
        let duration_s = document.get("duration_s").and_then(Item::as_float);
        let duration_s = duration_s.filter(|&duration_s| duration_s > 0.0 && duration_s <= 1e6);
        let injected = match document.get("hidden") {
            None => Vec::new(),
            Some(item) => {
                let tables = item.as_array_of_tables().ok_or_else(|| bad("hidden", "tables [[hidden]]"))?.iter();
                let read = |table| {
                    InjectedEffect::read(table).map_err(|(field, expected)| bad(&format!("hidden.{field}"), expected))
                };
                tables.map(read).collect::<Result<_, _>>()?
            }
        };
        Ok(AnswerKey {
            seed: seed.ok_or_else(|| bad("seed", "a whole number of 0 or more"))?,
            duration_s: duration_s.ok_or_else(|| bad("duration_s", "a number of seconds up to 1e6"))?,
            injected,
        })
    }
}
