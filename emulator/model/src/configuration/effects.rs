//! The effects of a configuration: tables of their codes, their time courses and the discovered terms.

use geu_protocol::Gyro;
use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::schema::{self, limited, object};
use super::tree::{Part, describe, has, inline, line, named_effect, one, show_numbers};
use crate::device::Device;
use crate::effect::discovered::{self, Formula, Regressor, Term};
use crate::effect::{EffectConfiguration, EffectSpec, Effects};
use crate::package::Axes;
use crate::time_profile::{COURSES, Size, TimeCourse, TimeProfileSpec};

/// The effects of a list: `code = { … }`, and `code-suffix = { … }` for time courses.
pub(super) struct EffectTables<'a, E> {
    pub configured: &'a mut EffectConfiguration<E>,
    /// Axes of the gyro; `None` for effects of the unit.
    pub axes: Option<Axes>,
    pub device: &'a Device,
}

impl<E: Effects> EffectTables<'_, E> {
    /// The amplitudes of an effect that can have the time course, each with its size.
    fn sizes(&self, effect: usize, kind: &TimeProfileSpec) -> Vec<(usize, Size)> {
        let (spec, numbers) = (&self.effects()[effect], self.configured.constant.numbers(effect).specs());
        (0..spec.amplitudes.len())
            .filter(|&amplitude| has(self.axes.as_ref(), numbers[amplitude].name))
            .filter_map(|amplitude| Some((amplitude, kind.size(spec, numbers, amplitude)?)))
            .collect()
    }

    fn read_course(&mut self, table: &Node, effect: usize, kind: &'static TimeProfileSpec) -> Read<()> {
        let sizes = self.sizes(effect, kind);
        let keys = sizes.iter().map(|(_, size)| size.name.as_str());
        table.only(&keys.chain(kind.shapes.iter().map(|shape| shape.name)).collect::<Vec<_>>())?;
        let shapes = kind.shapes.iter().map(|shape| table.number(shape)).collect::<Read<Vec<f64>>>()?;
        for (amplitude, Size { name, form, min, max }) in sizes {
            let spec = &self.configured.constant.numbers(effect).specs()[amplitude];
            let (min, max) = self.device.widening().limits(spec, min, max);
            let size = table.value(&name, form, min, max)?.unwrap_or(0.0);
            if size != 0.0 {
                self.configured.courses.push(TimeCourse { effect, amplitude, size, profile: kind.with(&shapes) });
            }
        }
        Ok(())
    }

    /// Time courses of one effect: those with the same profile share a key.
    fn show_courses(&self, text: &mut String, effect: usize) {
        let gyros: Vec<Gyro> = self.device.gyros().collect();
        let spec = &self.effects()[effect];
        let specs = self.configured.constant.numbers(effect).specs();
        let own: Vec<_> = self.configured.courses.iter().filter(|course| course.effect == effect).collect();
        for (index, course) in own.iter().enumerate() {
            if own[..index].iter().any(|other| other.profile == course.profile) {
                continue;
            }
            let kind = course.profile.spec;
            let sizes = own
                .iter()
                .filter(|other| other.profile == course.profile)
                .filter_map(|other| Some((kind.size(spec, specs, other.amplitude)?, other.size)))
                .map(|(size, value)| format!("{} = {}", size.name, size.form.written_of(value, &gyros)));
            let shapes = kind.shapes.iter().zip(course.profile.shapes());
            let shapes = shapes.map(|(shape, value)| format!("{} = {value:?}", shape.name));
            let pairs: Vec<String> = sizes.chain(shapes).collect();
            line!(text, "{}{} = {{ {} }}", spec.code, kind.name, pairs.join(", "));
        }
    }
}

impl<E: Effects> Part for EffectTables<'_, E> {
    fn effects(&self) -> &'static [EffectSpec] {
        self.configured.constant.specs()
    }

    fn read(&mut self, node: &Node, _key: &str) -> Read<()> {
        for key in node.keys() {
            let Some((effect, kind)) = named_effect(key, self.effects()) else { continue };
            let table = node.table(key)?.expect("a key of the table");
            match kind {
                Some(kind) => self.read_course(&table, effect, kind)?,
                None => table.fill(
                    self.configured.constant.numbers_mut(effect),
                    |name| has(self.axes.as_ref(), name),
                    &[],
                )?,
            }
        }
        let has_output = self.axes.is_none_or(|axes| axes.output().is_some());
        let absent = E::default();
        for key in node.keys() {
            let Some((effect, _)) = named_effect(key, self.effects()) else { continue };
            if !has_output && self.configured.has(effect) && absent.needs_output_axis(effect) {
                return Err(node.error(key, format!("expected an effect of a gyro without an output axis, got {key}")));
            }
        }
        let largest = self.configured.largest();
        for key in node.keys() {
            let Some((effect, None)) = named_effect(key, self.effects()) else { continue };
            if let Some((number, expected)) = largest.consistency_error(effect) {
                return Err(node.table(key)?.expect("a key of the table").unexpected(number, &expected));
            }
        }
        Ok(())
    }

    fn show(&self, _key: &str, complete: bool, text: &mut String) {
        let absent = E::default();
        for (index, spec) in self.effects().iter().enumerate() {
            let present = self.configured.constant.numbers(index);
            let has = |name: &str| has(self.axes.as_ref(), name);
            let is_absent = inline(present, has, self.device) == inline(absent.numbers(index), has, self.device);
            if complete || !is_absent {
                let key = format!("{}{}", if is_absent { "# " } else { "" }, spec.code);
                show_numbers(text, complete, &key, &title(spec), present, has, self.device);
            }
            self.show_courses(text, index);
        }
    }

    fn schema(&self, _key: &str) -> Map<String, Json> {
        let mut properties = Map::new();
        for (effect, spec) in self.effects().iter().enumerate() {
            let mut schema =
                schema::table(self.configured.constant.numbers(effect), &|name| has(self.axes.as_ref(), name));
            schema["description"] = json!(title(spec));
            properties.insert(spec.code.to_owned(), schema);
            for kind in COURSES {
                let sizes = self.sizes(effect, kind);
                if sizes.is_empty() {
                    continue;
                }
                let sizes = sizes
                    .into_iter()
                    .map(|(_, Size { name, form, min, max })| (name, limited(form, min, max, kind.meaning)));
                let shapes = kind.shapes.iter().map(|shape| (shape.name.to_owned(), schema::number(shape)));
                let schema = object(sizes.chain(shapes).collect(), &schema::required(kind.shapes));
                properties.insert(format!("{}{}", spec.code, kind.name), schema);
            }
        }
        properties
    }
}

fn title(spec: &EffectSpec) -> String {
    format!("{}; paper: {} ({})", spec.title, spec.paper, spec.source)
}

/// The discovered effect.
impl Part for &mut Vec<Term> {
    fn read(&mut self, node: &Node, key: &str) -> Read<()> {
        let terms = node.tables(key)?;
        if terms.len() > discovered::MAX_TERMS {
            let (path, max) = (node.path_of(key), discovered::MAX_TERMS);
            return Err(node.error(key, format!("expected at most {max} terms in `{path}`, got {}", terms.len())));
        }
        for node in terms {
            node.only(&["formula", discovered::COEFFICIENT.name])?;
            let formula: Result<Formula, _> = node.text("formula")?.parse();
            let formula = formula.map_err(|error| node.unexpected("formula", &error.expected))?;
            self.push(Term { formula, coefficient: node.number(&discovered::COEFFICIENT)? });
        }
        Ok(())
    }

    fn show(&self, key: &str, complete: bool, text: &mut String) {
        let coefficient = discovered::COEFFICIENT;
        if complete {
            line!(text, "# {}; at most {} terms", discovered::TITLE, discovered::MAX_TERMS);
            line!(text, "#   formula: {}:", discovered::FORMULA_MEANING);
            for regressor in Regressor::ALL {
                line!(text, "#     {}: {} ({})", regressor.name(), regressor.meaning(), regressor.unit());
            }
            describe(text, [&coefficient]);
        }
        let term = |Term { formula, coefficient: value }: &Term| {
            format!("{{ formula = \"{formula}\", {} = {value:?} }}", coefficient.name)
        };
        if !self.is_empty() {
            line!(text, "{key} = [{}]", self.iter().map(term).collect::<Vec<_>>().join(", "));
        } else if complete {
            line!(text, "# {key} = []");
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let names = Regressor::ALL.map(|regressor| regressor.name().replace('(', "\\(").replace(')', "\\)")).join("|");
        let factor = format!(" *({names}) *(\\^ *[123] *)?");
        let formula = json!({
            "type": "string",
            "description": discovered::FORMULA_MEANING,
            "pattern": format!("^{factor}(\\*{factor})*$"),
        });
        let coefficient = discovered::COEFFICIENT;
        let term = [("formula", formula), (coefficient.name, schema::number(&coefficient))];
        let items = schema::properties(term, &["formula", coefficient.name]);
        let max = discovered::MAX_TERMS;
        one(key, json!({ "type": "array", "description": discovered::TITLE, "maxItems": max, "items": items }))
    }
}
