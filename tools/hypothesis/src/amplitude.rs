//! The parameter of the model that a hypothesis changes.
//!
//! Amplitudes, their time courses and their shape parameters come from the model's lists, so that a new effect is searched without a
//! change of the diagnosis.

use geu_model::Configuration;
use geu_model::device::{Device, MAX_HEADS};
use geu_model::effect::discovered::{self, Formula};
use geu_model::effect::{EffectSpec, Effects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::parameter_spec::{ParameterSet, ParameterSpec, Role, ValueFormat, Widening, named_gyro};
use geu_model::time_profile::{COURSES, Size, TimeCourse};
use geu_protocol::{Gyro, Gyros};

/// A number of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AmplitudeSource {
    /// An effect.
    Effect(ParameterRef),
    /// The coefficient of a discovered term.
    Term(Formula),
}

/// Index of a step in [`COURSES`], of a ramp and of a pulse.
pub const STEP: usize = 0;
pub const RAMP: usize = 1;
pub const PULSE: usize = 5;

/// An amplitude of the model, constant or with a time course.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AmplitudeRef {
    /// The constant amplitude.
    pub parameter: AmplitudeSource,
    /// Index of the time course in [`COURSES`].
    pub kind: Option<usize>,
    /// Limits of the unit.
    pub widening: Widening,
}

/// Specification of the discovered terms.
const DISCOVERED: EffectSpec = EffectSpec {
    code: discovered::CODE,
    title: discovered::TITLE,
    amplitudes: &[geu_model::effect::Amplitude { per_day: 0.0, per_k: 0.0 }],
    paper: "",
    source: "a diagnosis",
};

impl AmplitudeRef {
    /// The amplitude of an effect, with the time course of this index in [`COURSES`].
    pub fn new(target: ParameterRef, kind: Option<usize>) -> AmplitudeRef {
        AmplitudeRef { parameter: AmplitudeSource::Effect(target), kind, widening: Widening::default() }
    }

    /// Every amplitude of every effect, constant, in the order of the lists; noises and wiring faults, which have no signature, too.
    pub fn every() -> impl Iterator<Item = AmplitudeRef> {
        let targets = ParameterRef::all().into_iter().filter(|target| target.number < target.effect().amplitudes.len());
        targets.map(|target| AmplitudeRef::new(target, None))
    }

    /// Every amplitude that has a signature on a unit, constant; in the order of the lists.
    pub fn all(device: &Device) -> Vec<AmplitudeRef> {
        let of_unit = |amplitude| AmplitudeRef { widening: device.widening(), ..amplitude };
        let has = |amplitude: &AmplitudeRef| amplitude.has_signature() && !amplitude.gyros(device).is_empty();
        AmplitudeRef::every().filter(has).map(of_unit).collect()
    }

    /// The coefficient of a discovered term.
    pub fn term(formula: Formula) -> AmplitudeRef {
        AmplitudeRef { parameter: AmplitudeSource::Term(formula), kind: None, widening: Widening::default() }
    }

    /// Returns the amplitude without a time course.
    #[must_use]
    pub fn constant(self) -> AmplitudeRef {
        AmplitudeRef { kind: None, ..self }
    }

    /// Returns the amplitude with this time course; `None` if it has none. A time course of an effect with an onset is not
    /// distinguishable from another amplitude.
    pub fn with(self, kind: usize) -> Option<AmplitudeRef> {
        if self.formula().is_some() || self.own_shapes().iter().any(|number| number.role == Role::Onset) {
            return None;
        }
        COURSES[kind].size(self.spec(), self.numbers(), self.index())?;
        Some(AmplitudeRef { kind: Some(kind), ..self })
    }

    /// The amplitude itself, then with each time course.
    pub fn with_courses(self) -> impl Iterator<Item = AmplitudeRef> {
        std::iter::once(self).chain((0..COURSES.len()).filter_map(move |kind| self.with(kind)))
    }

    /// True for a formula that contains the time.
    pub fn is_formula_of_time(&self) -> bool {
        self.formula().is_some_and(|formula| formula.follows_time())
    }

    /// The formula of a discovered term.
    pub fn formula(&self) -> Option<Formula> {
        match self.parameter {
            AmplitudeSource::Term(formula) => Some(formula),
            AmplitudeSource::Effect(_) => None,
        }
    }

    /// True if it acts on the whole unit.
    pub fn is_of_unit(&self) -> bool {
        self.list() == Some(EffectList::Unit)
    }

    fn list(&self) -> Option<EffectList> {
        match self.parameter {
            AmplitudeSource::Effect(target) => Some(target.list),
            AmplitudeSource::Term(_) => None,
        }
    }

    /// True if its contribution to the counts is nearly proportional to it, unlike that of a noise or a wiring fault.
    pub fn has_signature(&self) -> bool {
        match self.parameter {
            AmplitudeSource::Effect(target) => target.list != EffectList::Wiring && !target.is_noise(),
            AmplitudeSource::Term(_) => true,
        }
    }

    /// True if its effect withholds small motions.
    pub fn filters_motion(&self) -> bool {
        matches!(self.parameter, AmplitudeSource::Effect(target) if target.filters_motion())
    }

    /// Index among the effect's numbers.
    fn index(&self) -> usize {
        match self.parameter {
            AmplitudeSource::Effect(target) => target.number,
            AmplitudeSource::Term(_) => 0,
        }
    }

    /// Specification of the effect.
    pub fn spec(&self) -> &'static EffectSpec {
        match self.parameter {
            AmplitudeSource::Effect(target) => target.effect(),
            AmplitudeSource::Term(_) => &DISCOVERED,
        }
    }

    /// The effect's numbers: its amplitudes, then its shape parameters.
    fn numbers(&self) -> &'static [ParameterSpec] {
        match self.parameter {
            AmplitudeSource::Effect(target) => target.numbers(),
            AmplitudeSource::Term(_) => const { &[discovered::COEFFICIENT] },
        }
    }

    /// The constant amplitude's number.
    pub fn number(&self) -> &'static ParameterSpec {
        &self.numbers()[self.index()]
    }

    /// Code of the effect, with the suffix of the time course.
    pub fn code(&self) -> String {
        self.spec().code.to_owned() + self.kind.map_or("", |kind| COURSES[kind].name)
    }

    /// Key and limits of its value.
    pub fn size(&self) -> Size {
        let number = self.number();
        let constant = Size { name: number.name.to_owned(), form: number.form, min: number.min, max: number.max };
        let of_course = |kind: usize| COURSES[kind].size(self.spec(), self.numbers(), self.index());
        let size = self.kind.and_then(of_course).unwrap_or(constant);
        let (min, max) = self.widening.limits(number, size.min, size.max);
        Size { min, max, ..size }
    }

    /// Limits of its value.
    pub fn limits(&self) -> (f64, f64) {
        let number = self.number();
        let of_course = |kind: usize| COURSES[kind].size_limits(self.spec(), self.numbers(), self.index());
        let (min, max) = self.kind.and_then(of_course).unwrap_or((number.min, number.max));
        self.widening.limits(number, min, max)
    }

    /// The other gyro that a value of it names.
    pub fn gyro_named(&self, value: f64) -> Option<Gyro> {
        if self.number().form == ValueFormat::Gyro { named_gyro(value) } else { None }
    }

    /// True if its value is a whole number of counts.
    pub fn is_count(&self) -> bool {
        self.number().role == Role::Count
    }

    /// The effect's own shape parameters.
    pub fn own_shapes(&self) -> &'static [ParameterSpec] {
        &self.numbers()[self.spec().amplitudes.len()..]
    }

    /// The effect's own shape parameters in a configuration; `None` if it does not contain the effect.
    pub fn configured_shapes(&self, configuration: &Configuration) -> Option<Vec<f64>> {
        let AmplitudeSource::Effect(target) = self.parameter else { return None };
        let amplitudes = self.spec().amplitudes.len();
        let has = |(numbers, courses): &(&dyn ParameterSet, &[TimeCourse])| {
            (0..amplitudes).any(|index| numbers.value(index) != 0.0)
                || courses.iter().any(|course| course.effect == target.effect)
        };
        let (numbers, _) =
            configuration.device.gyros().map(|gyro| configured(target, gyro, configuration)).find(has)?;
        Some((amplitudes..numbers.specs().len()).map(|index| numbers.value(index)).collect())
    }

    /// The constant amplitude in a configuration, on each gyro.
    pub fn configured_value(&self, configuration: &Configuration) -> [f64; MAX_HEADS] {
        let mut values = [0.0; MAX_HEADS];
        if let AmplitudeSource::Effect(target) = self.parameter {
            let gyros = configuration.device.gyros();
            gyros
                .for_each(|gyro| values[gyro.index()] = configured(target, gyro, configuration).0.value(target.number));
        }
        values
    }

    /// The shape parameters of its time course.
    pub fn course_shapes(&self) -> &'static [ParameterSpec] {
        self.kind.map_or(&[], |kind| COURSES[kind].shapes)
    }

    /// Names of the shape parameters of the effect and of its time course; the latter begin with its name if the effect has the same
    /// one.
    pub fn shape_names(&self) -> [Vec<String>; 2] {
        let own: Vec<String> = self.own_shapes().iter().map(|number| number.name.to_owned()).collect();
        let course = |number: &ParameterSpec| match self.kind {
            Some(kind) if own.iter().any(|own| own == number.name) => {
                format!("{}_{}", COURSES[kind].name.trim_start_matches('-'), number.name)
            }
            _ => number.name.to_owned(),
        };
        let course = self.course_shapes().iter().map(course).collect();
        [own, course]
    }

    /// The gyros of a unit that can have it.
    pub fn gyros(&self, device: &Device) -> Gyros {
        let all = device.all_gyros();
        match self.parameter {
            AmplitudeSource::Effect(target) if target.list == EffectList::Head => {
                let own = target.gyros(device);
                all.filter(|gyro| own.iter().any(|own| own.index() == gyro))
            }
            _ => all,
        }
    }
}

/// Numbers and time courses of an effect in a configuration, of the unit or at this gyro.
pub fn configured(
    target: ParameterRef,
    gyro: Gyro,
    configuration: &Configuration,
) -> (&dyn ParameterSet, &[TimeCourse]) {
    let own = &configuration.gyros[gyro.index()];
    match target.list {
        EffectList::Unit => (configuration.unit.constant.numbers(target.effect), &configuration.unit.courses),
        EffectList::Head => (own.effects.constant.numbers(target.effect), &own.effects.courses),
        EffectList::Wiring => (own.wiring.constant.numbers(target.effect), &own.wiring.courses),
    }
}

/// True if small changes of a value are possible.
pub fn is_real(amplitude: &AmplitudeRef) -> bool {
    amplitude.size().form == ValueFormat::Real
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_of_courses_have_their_names() {
        assert_eq!([STEP, RAMP, PULSE].map(|kind| COURSES[kind].name), ["-step", "-ramp", "-pulse"]);
    }
}
