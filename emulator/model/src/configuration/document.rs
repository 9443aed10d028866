//! A TOML document read strictly: every key is known, every number within its limits, every error points at its place.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use geu_protocol::Gyro;
use geu_protocol::excerpt::{MAX_QUOTED, excerpt};
use geu_protocol::suggestion::did_you_mean;
use toml_edit::{Document, Item, TableLike};

use crate::device::Device;
use crate::parameter_spec::{DefaultValue, ParameterSet, ParameterSpec, ValueFormat};

/// An error of a configuration with its place.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfigurationError {
    /// File, or whatever else the text came from.
    pub name: String,
    /// Line, from 1.
    pub line: usize,
    /// Column, from 1.
    pub column: usize,
    /// The line itself; of a long one what stands around the place.
    pub text: String,
    /// Number of characters before the marked text.
    pub indent: usize,
    /// Number of marked characters.
    pub width: usize,
    /// Expected and actual value.
    pub message: String,
}

impl std::error::Error for ConfigurationError {}

impl fmt::Display for ConfigurationError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { name, line, column, text, indent, width, message } = self;
        writeln!(f, "{name}:{line}:{column}: {message}")?;
        let number = line.to_string();
        let margin = " ".repeat(number.len());
        writeln!(f, "{margin} |\n{number} | {text}")?;
        write!(f, "{margin} | {}{}", " ".repeat(*indent), "^".repeat((*width).max(1)))
    }
}

pub struct ConfigText {
    name: String,
    document: Document<String>,
    /// The unit that the text is about.
    device: Arc<Device>,
}

impl ConfigText {
    /// Parses `text`.
    ///
    /// # Errors
    /// Text that is not TOML.
    pub fn parse(name: &str, text: &str) -> Result<ConfigText, ConfigurationError> {
        match Document::parse(text.to_owned()) {
            Ok(document) => Ok(ConfigText { name: name.to_owned(), document, device: Device::iras() }),
            Err(error) => {
                let message = format!("expected TOML: {}", error.message().replace('\n', "; "));
                Err(locate(name, text, error.span(), message))
            }
        }
    }

    /// The text, about another unit.
    pub fn about(self, device: &Arc<Device>) -> ConfigText {
        ConfigText { device: device.clone(), ..self }
    }

    pub fn root(&self) -> Node<'_> {
        Node { source: self, table: self.document.as_table(), path: String::new(), span: None }
    }
}

pub(super) fn locate(name: &str, text: &str, span: Option<Range<usize>>, message: String) -> ConfigurationError {
    let start = span.as_ref().map_or(0, |span| span.start.min(text.len()));
    let line_start = text[..start].rfind('\n').map_or(0, |end| end + 1);
    let line_text = text[line_start..].lines().next().unwrap_or_default();
    let line = text[..line_start].matches('\n').count() + 1;
    let column = text[line_start..start].chars().count() + 1;
    let (text_around, indent) = around(line_text, start - line_start);
    let meant =
        span.map_or(1, |span| text.get(span).unwrap_or_default().lines().next().unwrap_or_default().chars().count());
    let width = meant.min(text_around.chars().count().saturating_sub(indent));
    ConfigurationError { name: name.to_owned(), line, column, text: text_around, indent, width, message }
}

/// A line, of a long one the [`MAX_QUOTED`] bytes around a place in it; and how many characters of that stand before the place.
fn around(line: &str, place: usize) -> (String, usize) {
    let place = place.min(line.len());
    if line.len() <= MAX_QUOTED {
        return (line.to_owned(), line[..place].chars().count());
    }
    let boundary = |at: usize| (0..=at.min(line.len())).rev().find(|&at| line.is_char_boundary(at)).unwrap_or(0);
    let from = boundary(place.saturating_sub(MAX_QUOTED / 2));
    let to = boundary(from + MAX_QUOTED).max(place);
    let before = if from > 0 { "…" } else { "" };
    let after = if to < line.len() { "…" } else { "" };
    let indent = before.chars().count() + line[from..place].chars().count();
    (format!("{before}{}{after}", &line[from..to]), indent)
}

/// A finite number.
fn real(value: &toml_edit::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|value| value as f64)).filter(|value| value.is_finite())
}

#[derive(Clone)]
pub struct Node<'a> {
    source: &'a ConfigText,
    table: &'a dyn TableLike,
    path: String,
    span: Option<Range<usize>>,
}

pub(super) type Read<T> = Result<T, ConfigurationError>;

impl<'a> Node<'a> {
    /// The unit that the text is about.
    pub fn device(&self) -> &'a Arc<Device> {
        &self.source.device
    }

    /// The keys in order.
    pub fn keys(&self) -> Vec<&'a str> {
        self.table.iter().map(|(key, _)| key).collect()
    }

    /// Path of a key, as in `--set`.
    pub fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// An error that points at the key, or at the whole table where it is not there.
    pub fn error(&self, key: &str, message: String) -> ConfigurationError {
        let span = self.table.key(key).and_then(|key| key.span()).or_else(|| self.span.clone());
        locate(&self.source.name, self.source.document.raw(), span, message)
    }

    /// An error that points at the value of the key: what was expected of it, and what was got.
    pub fn unexpected(&self, key: &str, expected: &str) -> ConfigurationError {
        self.refused(key, "", expected)
    }

    /// The same for a text outside `valid`, with the most similar valid one.
    pub fn none_of(&self, key: &str, valid: &[&str]) -> ConfigurationError {
        let text = self.table.get(key).and_then(Item::as_str).unwrap_or_default();
        self.refused(key, &did_you_mean(text, valid), &format!("one of {}", valid.join(", ")))
    }

    fn refused(&self, key: &str, hint: &str, expected: &str) -> ConfigurationError {
        let message = format!("{hint}expected {expected} for `{}`, got {}", self.path_of(key), self.got(key));
        match self.table.get(key).and_then(Item::span) {
            Some(span) => locate(&self.source.name, self.source.document.raw(), Some(span), message),
            None => self.error(key, message),
        }
    }

    /// Refuses keys that are not `valid`.
    ///
    /// # Errors
    /// The first unknown key, with the valid ones.
    pub fn only<S: AsRef<str>>(&self, valid: &[S]) -> Read<()> {
        match self.keys().into_iter().find(|key| !valid.iter().any(|valid| valid.as_ref() == *key)) {
            Some(key) => Err(self.unknown(key, valid)),
            None => Ok(()),
        }
    }

    /// The error for an unknown key: the likeliest meant, and all valid ones.
    pub fn unknown<S: AsRef<str>>(&self, key: &str, valid: &[S]) -> ConfigurationError {
        let names: Vec<&str> = valid.iter().map(AsRef::as_ref).collect();
        let hint = did_you_mean(key, &names);
        let place = if self.path.is_empty() { "at the top level".to_owned() } else { format!("in {}", self.path) };
        let quoted = excerpt(key);
        self.error(key, format!("unknown key `{quoted}` {place}; {hint}expected one of: {}", names.join(", ")))
    }

    fn got(&self, key: &str) -> String {
        self.table.get(key).map_or_else(|| "nothing".to_owned(), |item| excerpt(item.to_string().trim()).into_owned())
    }

    /// A number within its limits; its default where the key is not there.
    ///
    /// # Errors
    /// Not a number, out of limits, or required and not there.
    pub fn number(&self, spec: &ParameterSpec) -> Read<f64> {
        let (min, max) = self.source.device.widening().limits(spec, spec.min, spec.max);
        match (self.value(spec.name, spec.form, min, max)?, spec.default) {
            (Some(value), _) => Ok(value),
            (None, DefaultValue::Required) => {
                let (path, meaning, limits) = (self.path_of(spec.name), spec.meaning, spec.limits());
                Err(self.error(spec.name, format!("expected `{path}` ({meaning}; {limits}), got none")))
            }
            (None, default) => Ok(default.initial()),
        }
    }

    /// All numbers of a set.
    ///
    /// # Errors
    /// As [`Node::number`].
    pub fn numbers<N: ParameterSet + Default>(&self) -> Read<N> {
        let mut numbers = N::default();
        for (index, spec) in numbers.specs().iter().enumerate() {
            *numbers.value_mut(index) = self.number(spec)?;
        }
        Ok(numbers)
    }

    /// A number in this format within limits; `None` if the key is absent.
    ///
    /// # Errors
    /// Another form, or out of limits.
    pub fn value(&self, key: &str, form: ValueFormat, min: f64, max: f64) -> Read<Option<f64>> {
        let Some(item) = self.table.get(key) else { return Ok(None) };
        let value = match form {
            ValueFormat::Real => item.as_float().or_else(|| item.as_integer().map(|value| value as f64)),
            ValueFormat::Flag => item.as_bool().map(f64::from),
            ValueFormat::Gyro => {
                let gyro = item.as_str().and_then(|name| self.source.device.gyro(name));
                gyro.map(|gyro| gyro.index() as f64 + 1.0)
            }
            // JSON knows one kind of number: 3.0 is whole too.
            ValueFormat::Whole => item
                .as_integer()
                .map(|value| value as f64)
                .or_else(|| item.as_float().filter(|value| value.fract() == 0.0)),
            ValueFormat::Choice(names) => {
                item.as_str().and_then(|text| names.iter().position(|name| *name == text)).map(|index| index as f64)
            }
        };
        match value {
            Some(value) if min <= value && value <= max => Ok(Some(value)),
            _ if form == ValueFormat::Gyro => {
                let names: Vec<&str> = self.source.device.gyros().map(Gyro::name).collect();
                Err(self.unexpected(key, &ValueFormat::limits_of(&names)))
            }
            _ => Err(self.unexpected(key, &form.limits(min, max))),
        }
    }

    /// A whole number of 0 or more.
    ///
    /// # Errors
    /// Anything else.
    pub fn whole_number(&self, key: &str) -> Read<Option<u64>> {
        match self.table.get(key) {
            None => Ok(None),
            Some(item) => match item.as_integer().and_then(|value| u64::try_from(value).ok()) {
                Some(value) => Ok(Some(value)),
                None => Err(self.unexpected(key, "a whole number of 0 or more")),
            },
        }
    }

    /// A text from `valid`.
    ///
    /// # Errors
    /// Not there, not a text, or another one.
    pub fn choice(&self, key: &str, valid: &[&str]) -> Read<&'a str> {
        match self.table.get(key).and_then(Item::as_str) {
            Some(text) if valid.contains(&text) => Ok(text),
            _ => Err(self.none_of(key, valid)),
        }
    }

    /// A list of texts from `valid`; empty if the key is absent.
    ///
    /// # Errors
    /// Not a list, or another text in it.
    pub fn choices(&self, key: &str, valid: &[&str]) -> Read<Vec<&'a str>> {
        match self.texts(key)? {
            texts if texts.iter().all(|text| valid.contains(text)) => Ok(texts),
            _ => Err(self.unexpected(key, &format!("a list of {}", valid.join(", ")))),
        }
    }

    /// A list of texts; empty where it is not there.
    ///
    /// # Errors
    /// Not a list of texts.
    pub fn texts(&self, key: &str) -> Read<Vec<&'a str>> {
        let Some(item) = self.table.get(key) else { return Ok(Vec::new()) };
        let texts = item.as_array().and_then(|array| array.iter().map(|value| value.as_str()).collect());
        texts.ok_or_else(|| self.unexpected(key, "a list of texts"))
    }

    /// A text.
    ///
    /// # Errors
    /// Not there, or not a text.
    pub fn text(&self, key: &str) -> Read<&'a str> {
        self.table.get(key).and_then(Item::as_str).ok_or_else(|| self.unexpected(key, "a text"))
    }

    /// Fills `numbers` from the table's keys; `has` selects those that exist.
    ///
    /// # Errors
    /// As [`Node::number`]; ignores keys in `others`, rejects any other unknown key.
    pub fn fill(&self, numbers: &mut dyn ParameterSet, has: impl Fn(&str) -> bool, others: &[&str]) -> Read<()> {
        let specs = numbers.specs();
        let valid: Vec<&str> =
            specs.iter().map(|spec| spec.name).filter(|name| has(name)).chain(others.iter().copied()).collect();
        self.only(&valid)?;
        for (index, spec) in specs.iter().enumerate().filter(|(_, spec)| has(spec.name)) {
            *numbers.value_mut(index) = self.number(spec)?;
        }
        Ok(())
    }

    /// The table under `key`.
    ///
    /// # Errors
    /// Something else than a table.
    pub fn table(&self, key: &str) -> Read<Option<Node<'a>>> {
        let Some(item) = self.table.get(key) else { return Ok(None) };
        match item.as_table_like() {
            Some(table) => Ok(Some(self.child(table, self.path_of(key), key, item.span()))),
            None => Err(self.unexpected(key, "a table, { name = number },")),
        }
    }

    /// The tables of the list under `key`.
    ///
    /// # Errors
    /// Something else than a list of tables.
    pub fn tables(&self, key: &str) -> Read<Vec<Node<'a>>> {
        let tables = match self.table.get(key) {
            None => return Ok(Vec::new()),
            Some(Item::ArrayOfTables(tables)) => {
                Some(tables.iter().map(|table| (table as &dyn TableLike, table.span())).collect::<Vec<_>>())
            }
            Some(item) => item.as_array().and_then(|array| {
                array
                    .iter()
                    .map(|value| value.as_inline_table().map(|table| (table as &dyn TableLike, value.span())))
                    .collect()
            }),
        };
        let tables = tables.ok_or_else(|| self.unexpected(key, &format!("a list of tables, [[{key}]],")))?;
        Ok(tables
            .into_iter()
            .enumerate()
            .map(|(index, (table, span))| self.child(table, self.path_of(&format!("{key}.{index}")), key, span))
            .collect())
    }

    /// The numbers of the list under `key`.
    ///
    /// # Errors
    /// Something else than a list of numbers.
    pub fn reals(&self, key: &str) -> Read<Vec<f64>> {
        let numbers = self.table.get(key).and_then(Item::as_array).and_then(|array| array.iter().map(real).collect());
        numbers.ok_or_else(|| self.unexpected(key, "a list of numbers"))
    }

    /// The pairs of numbers of the list under `key`.
    ///
    /// # Errors
    /// Something else than a list of pairs of numbers.
    pub fn pairs(&self, key: &str) -> Read<Vec<(f64, f64)>> {
        let Some(item) = self.table.get(key) else { return Ok(Vec::new()) };
        let pairs = item.as_array().and_then(|array| {
            array
                .iter()
                .map(|pair| match pair.as_array()?.iter().map(real).collect::<Option<Vec<f64>>>()?.as_slice() {
                    [a, b] => Some((*a, *b)),
                    _ => None,
                })
                .collect::<Option<Vec<_>>>()
        });
        pairs.ok_or_else(|| self.unexpected(key, "a list of pairs of numbers, [[time_s, value], …],"))
    }

    fn child(&self, table: &'a dyn TableLike, path: String, key: &str, span: Option<Range<usize>>) -> Node<'a> {
        let span = span.or_else(|| self.table.key(key).and_then(|key| key.span())).or_else(|| self.span.clone());
        Node { source: self.source, table, path, span }
    }
}
