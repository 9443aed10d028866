//! What is hidden, and the key that tells it: a file of its own.

use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Table, Value, value};

use crate::gyros::{Gyros, named, names};
use crate::hypothesis::Hypothesis;

/// Where something hidden comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// An amplitude of the model's lists, with or without a course.
    Catalogue,
    /// A noise that is larger than believed.
    Noise,
    /// A wiring fault.
    Wiring,
    /// A term that stands in no catalogue.
    Unknown,
}

impl Origin {
    const ALL: [Origin; 4] = [Origin::Catalogue, Origin::Noise, Origin::Wiring, Origin::Unknown];

    fn name(self) -> &'static str {
        match self {
            Origin::Catalogue => "catalogue",
            Origin::Noise => "noise",
            Origin::Wiring => "wiring",
            Origin::Unknown => "unknown",
        }
    }
}

/// An injected effect.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectedEffect {
    /// What it is.
    pub hypothesis: Hypothesis,
    /// Where it comes from.
    pub origin: Origin,
    /// The gyros that it acts on.
    pub gyros: Gyros,
    /// Cramér–Rao bound of the amplitude; none of what has no signature.
    pub sigma: Option<f64>,
    /// Its signature in sigmas of the noise, beside the calibration parameters, the lag and the walks.
    pub strength: Option<f64>,
    /// The amplitude of the catalogue that looks most like a term outside it, and the cosine of the two.
    pub nearest: Option<(String, f64)>,
    /// What puts it into a configuration.
    pub assignments: Vec<String>,
}

/// What was hidden in one recording.
#[derive(Debug, Clone, PartialEq)]
pub struct AnswerKey {
    /// Seed that it was drawn with.
    pub seed: u64,
    /// On-board time flown.
    pub duration_s: f64,
    /// All that is hidden.
    pub hidden: Vec<InjectedEffect>,
}

/// Why a text is no key.
#[derive(Debug, thiserror::Error)]
#[error("{name}: {field}: expected {expected}, as `geu blind hide` writes it")]
pub struct BadKey {
    name: String,
    field: String,
    expected: &'static str,
}

impl InjectedEffect {
    /// Code of the model, with the suffix of its time course.
    pub fn code(&self) -> String {
        self.hypothesis.amplitude.code()
    }

    /// Formula of a term outside the catalogue.
    pub fn formula(&self) -> Option<String> {
        self.hypothesis.amplitude.formula().map(|formula| formula.to_string())
    }

    /// All that is known of it: label and value of each fact.
    pub fn facts(&self) -> Vec<(String, String)> {
        let mut what = format!("{} {}", names(&self.gyros).join("+"), self.code());
        if let Some(formula) = self.formula() {
            what += &format!(" {formula}");
        }
        let mut facts = vec![("injected".to_owned(), what)];
        let parameters = self.hypothesis.parameters().into_iter();
        facts.extend(parameters.map(|number| (number.name, format!("{:.4e}", number.value))));
        facts.extend(self.strength.map(|strength| ("strength".to_owned(), format!("{strength:.1} sigma"))));
        let nearest = self.nearest.as_ref();
        facts.extend(nearest.map(|(code, cosine)| ("most like".to_owned(), format!("{code}, cosine {cosine:.3}"))));
        facts
    }
}

impl AnswerKey {
    /// As `key.toml` has it.
    pub fn to_toml(&self) -> String {
        let mut document = DocumentMut::new();
        document["seed"] = value(self.seed as i64);
        document["duration_s"] = value(self.duration_s);
        let mut all = ArrayOfTables::new();
        self.hidden.iter().for_each(|hidden| all.push(hidden.table()));
        if !all.is_empty() {
            document["hidden"] = Item::ArrayOfTables(all);
        }
        format!("# What is hidden in the recording beside this directory.\n{document}")
    }

    /// Reads `key.toml`; `name` is what errors call it.
    ///
    /// # Errors
    /// [`BadKey`], with the field.
    pub fn parse(name: &str, text: &str) -> Result<AnswerKey, BadKey> {
        let bad = |field: &str, expected| BadKey { name: name.to_owned(), field: field.to_owned(), expected };
        let document: DocumentMut = text.parse().map_err(|_| bad("the file", "TOML"))?;
        let seed = document.get("seed").and_then(Item::as_integer).and_then(|seed| u64::try_from(seed).ok());
        let duration_s = document.get("duration_s").and_then(Item::as_float);
        let tables = match document.get("hidden") {
            None => Vec::new(),
            Some(item) => {
                let tables = item.as_array_of_tables().ok_or_else(|| bad("hidden", "tables [[hidden]]"))?;
                tables.iter().collect()
            }
        };
        let hidden = tables.into_iter().map(|table| {
            InjectedEffect::read(table).map_err(|(field, expected)| bad(&format!("hidden.{field}"), expected))
        });
        Ok(AnswerKey {
            seed: seed.ok_or_else(|| bad("seed", "a whole number of 0 or more"))?,
            duration_s: duration_s
                .filter(|&duration_s| duration_s > 0.0 && duration_s <= 1e6)
                .ok_or_else(|| bad("duration_s", "a number of seconds up to 1e6"))?,
            hidden: hidden.collect::<Result<_, _>>()?,
        })
    }
}

impl InjectedEffect {
    fn table(&self) -> Table {
        let mut table = Table::new();
        table["origin"] = value(self.origin.name());
        table["code"] = value(self.code());
        if let Some(formula) = self.formula() {
            table["formula"] = value(formula);
        }
        table["gyros"] = value(names(&self.gyros).into_iter().collect::<Array>());
        let parameters =
            self.hypothesis.parameters().into_iter().map(|number| (number.name, Value::from(number.value)));
        table["parameters"] = value(parameters.collect::<InlineTable>());
        for (name, number) in [("sigma", self.sigma), ("strength", self.strength)] {
            if let Some(number) = number {
                table[name] = value(number);
            }
        }
        if let Some((code, cosine)) = &self.nearest {
            let of = [("code", Value::from(code)), ("cosine", Value::from(*cosine))];
            table["nearest"] = value(of.into_iter().collect::<InlineTable>());
        }
        table["assignments"] = value(self.assignments.iter().collect::<Array>());
        table
    }

    /// Reads one; else the field that is wrong and what was expected of it.
    fn read(table: &Table) -> Result<InjectedEffect, (&'static str, &'static str)> {
        let text = |name: &str| table.get(name).and_then(Item::as_str).map(str::to_owned);
        let origin = text("origin").and_then(|name| Origin::ALL.into_iter().find(|origin| origin.name() == name));
        let texts = |name: &str| -> Option<Vec<String>> {
            let array = table.get(name)?.as_array()?;
            array.iter().map(|text| text.as_str().map(str::to_owned)).collect()
        };
        let gyros = texts("gyros").and_then(|names| named(&names.iter().map(String::as_str).collect::<Vec<_>>()));
        let parameters = table.get("parameters").and_then(Item::as_inline_table);
        let numbers = parameters.map(|numbers| {
            numbers.iter().map(|(name, number)| Some((name.to_owned(), number.as_float()?))).collect::<Option<Vec<_>>>()
        });
        let nearest = table
            .get("nearest")
            .and_then(Item::as_inline_table)
            .and_then(|nearest| Some((nearest.get("code")?.as_str()?.to_owned(), nearest.get("cosine")?.as_float()?)));
        let code = text("code").ok_or(("code", "a code of the model"))?;
        let origin = origin.ok_or(("origin", "catalogue, noise, wiring or unknown"))?;
        let gyros = gyros.ok_or(("gyros", "one or more of GYRX, GYRY, GYRZA, GYRZB"))?;
        let numbers: Vec<(String, f64)> = numbers.flatten().ok_or(("parameters", "numbers by name"))?;
        let number = |name: &str| numbers.iter().find(|(own, _)| own == name).map(|(_, value)| *value);
        let hypothesis = Hypothesis::from_numbers(&code, text("formula").as_deref(), gyros, number);
        let mut hypothesis = hypothesis.ok_or(("code", "a code and parameters of the model, within their limits"))?;
        // A configuration names an exchange of two gyros at the one that is not its value.
        if let Some(other) = hypothesis.amplitude.gyro_named(hypothesis.value) {
            hypothesis.gyros[other as usize] = false;
        }
        Ok(InjectedEffect {
            hypothesis,
            origin,
            gyros,
            sigma: table.get("sigma").and_then(Item::as_float),
            strength: table.get("strength").and_then(Item::as_float),
            nearest,
            assignments: texts("assignments").ok_or(("assignments", "PATH=VALUE"))?,
        })
    }
}
