//! A hypothesis: an amplitude of the model, its time course, gyros and value.

use geu_model::Configuration;
use geu_model::effect::discovered::{self, Term};
use geu_model::effect::{EffectConfiguration, Effects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::parameter_spec::{ParameterSet, ParameterSpec, Role};
use geu_model::time_profile::{COURSES, Size, TimeCourse, TimeProfile};
use geu_protocol::{Gyro, Gyros};

use crate::amplitude::{AmplitudeRef, AmplitudeSource, configured};

/// An amplitude with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// The amplitude.
    pub amplitude: AmplitudeRef,
    /// Added to what is configured; of a noise and of a wiring fault the value itself.
    pub value: f64,
    /// Values of the effect's own shape parameters.
    pub own_shapes: Vec<f64>,
    /// Values of the time course's shape parameters.
    pub course_shapes: Vec<f64>,
    /// The gyros; all of them for an effect of the unit.
    pub gyros: Gyros,
}

impl Hypothesis {
    /// A constant amplitude that has no shape parameters, or keeps those configured.
    pub fn constant(amplitude: AmplitudeRef, value: f64, gyros: Gyros) -> Hypothesis {
        Hypothesis { amplitude, value, own_shapes: Vec::new(), course_shapes: Vec::new(), gyros }
    }

    /// The hypothesis with this code, formula and parameters by name; `None` if the model has none or not within its limits.
    pub fn from_numbers(
        code: &str,
        formula: Option<&str>,
        gyros: Gyros,
        value: impl Fn(&str) -> Option<f64>,
    ) -> Option<Hypothesis> {
        let is_own = |one: &AmplitudeRef| one.code() == code && value(&one.size().name).is_some();
        let amplitude = match formula.and_then(|formula| formula.parse().ok()) {
            Some(formula) => AmplitudeRef::term(formula),
            None => AmplitudeRef::every().flat_map(AmplitudeRef::with_courses).find(is_own)?,
        };
        let shapes = |numbers: &[ParameterSpec], names: Vec<String>| -> Vec<f64> {
            let shapes = numbers.iter().zip(names);
            shapes.map(|(number, name)| value(&name).unwrap_or(number.default.initial())).collect()
        };
        let [own_names, course_names] = amplitude.shape_names();
        let own_shapes = if amplitude.has_signature() { shapes(amplitude.own_shapes(), own_names) } else { Vec::new() };
        let hypothesis = Hypothesis {
            amplitude,
            value: value(&amplitude.size().name)?,
            own_shapes,
            course_shapes: shapes(amplitude.course_shapes(), course_names),
            gyros,
        };
        hypothesis.is_within_limits().then_some(hypothesis)
    }

    /// Time profile; `None` for a constant amplitude.
    pub fn profile(&self) -> Option<TimeProfile> {
        self.amplitude.kind.map(|kind| COURSES[kind].with(&self.course_shapes))
    }

    /// True if its amplitude follows the electronics temperature.
    pub fn follows_temperature(&self) -> bool {
        self.amplitude.kind.is_some_and(|kind| COURSES[kind].follows_temperature)
    }

    /// Adds it to a configuration.
    pub fn apply(&self, configuration: &mut Configuration) {
        self.put(configuration, |_| true);
    }

    /// Adds it to a configuration that is written as text, which has one time course of each kind: it replaces that one.
    pub fn replace(&self, configuration: &mut Configuration) {
        let own = self.profile().map(|profile| profile.spec);
        self.put(configuration, |profile| Some(profile) == self.profile() || Some(profile.spec) != own);
    }

    fn put(&self, configuration: &mut Configuration, is_kept: impl Fn(TimeProfile) -> bool) {
        let amplitudes = self.amplitude.spec().amplitudes.len();
        let total = |before: f64| if self.amplitude.has_signature() { before + self.value } else { self.value };
        match self.amplitude.parameter {
            AmplitudeSource::Effect(target) => {
                let ParameterRef { effect, number: amplitude, .. } = target;
                for (numbers, courses) in self.configured_mut(target, configuration) {
                    for (index, value) in self.own_shapes.iter().enumerate() {
                        *numbers.value_mut(amplitudes + index) = *value;
                    }
                    let Some(profile) = self.profile() else {
                        let value = numbers.value_mut(amplitude);
                        *value = total(*value);
                        continue;
                    };
                    courses.retain(|own| (own.effect, own.amplitude) != (effect, amplitude) || is_kept(own.profile));
                    match courses.iter_mut().find(|course| is_course(course, target, profile)) {
                        Some(course) => course.size = total(course.size),
                        None => courses.push(TimeCourse { effect, amplitude, size: self.value, profile }),
                    }
                }
            }
            AmplitudeSource::Term(formula) => self.gyros.gyros().for_each(|at| {
                let terms = &mut configuration.gyros[at.index()].discovered;
                match terms.iter_mut().find(|term| term.formula == formula) {
                    Some(term) => term.coefficient += self.value,
                    None => terms.push(Term { formula, coefficient: self.value }),
                }
            }),
        }
    }

    /// Numbers and time courses of its effect in a configuration, on each of its gyros.
    fn configured_mut<'a>(
        &self,
        target: ParameterRef,
        configuration: &'a mut Configuration,
    ) -> Vec<(&'a mut dyn ParameterSet, &'a mut Vec<TimeCourse>)> {
        fn parts<E: Effects>(
            own: &mut EffectConfiguration<E>,
            effect: usize,
        ) -> (&mut dyn ParameterSet, &mut Vec<TimeCourse>) {
            (own.constant.numbers_mut(effect), &mut own.courses)
        }
        let gyros = configuration.gyros.iter_mut().enumerate();
        let gyros = gyros.filter_map(|(gyro, own)| self.gyros[gyro].then_some(own));
        match target.list {
            EffectList::Unit => vec![parts(&mut configuration.unit, target.effect)],
            EffectList::Head => gyros.map(|gyro| parts(&mut gyro.effects, target.effect)).collect(),
            EffectList::Wiring => gyros.map(|gyro| parts(&mut gyro.wiring, target.effect)).collect(),
        }
    }

    /// True if it begins at a time of the recording, which no new recording repeats.
    pub fn has_onset(&self) -> bool {
        self.parameters().iter().any(|parameter| parameter.role == Role::Onset)
    }

    /// Numbers: name, value and limits; the amplitude first.
    pub fn parameters(&self) -> Vec<HypothesisParameter> {
        let of = |((number, value), name): ((&ParameterSpec, &f64), String)| HypothesisParameter {
            name,
            role: number.role,
            value: *value,
            min: number.min,
            max: number.max,
        };
        let [own_names, course_names] = self.amplitude.shape_names();
        let Size { name, min, max, .. } = self.amplitude.size();
        let role = self.amplitude.number().role;
        let amplitude = HypothesisParameter { name, role, value: self.value, min, max };
        let own = self.amplitude.own_shapes().iter().zip(&self.own_shapes).zip(own_names).map(of);
        let course = self.amplitude.course_shapes().iter().zip(&self.course_shapes).zip(course_names).map(of);
        std::iter::once(amplitude).chain(own).chain(course).collect()
    }

    /// Sets the parameter at `index` of [`Hypothesis::parameters`].
    pub fn set(&mut self, index: usize, value: f64) {
        let own = self.own_shapes.len();
        match index {
            0 => self.value = value,
            index if index <= own => self.own_shapes[index - 1] = value,
            index => self.course_shapes[index - 1 - own] = value,
        }
    }

    /// True if a configuration cannot contain it beside this amplitude on these gyros.
    pub fn conflicts(&self, amplitude: AmplitudeRef, gyros: &Gyros) -> bool {
        self.amplitude == amplitude && self.gyros.overlaps(gyros)
    }

    /// True if a configuration accepts the parameters.
    pub fn is_within_limits(&self) -> bool {
        let (min, max) = self.amplitude.limits();
        let own = self.amplitude.own_shapes().iter().zip(&self.own_shapes);
        let mut shapes = own.chain(self.amplitude.course_shapes().iter().zip(&self.course_shapes));
        let are_within = shapes.all(|(number, value)| (number.min..=number.max).contains(value));
        are_within && (min..=max).contains(&self.value)
    }

    /// Assignments for [`Configuration::edited`] that write it to the text of `configuration`, which contains it.
    pub fn assignments(&self, configuration: &Configuration) -> Vec<String> {
        let of_gyro = |gyro: Gyro| match self.amplitude.parameter {
            AmplitudeSource::Effect(target) => {
                let path = format!("gyro.{}", gyro.name());
                let path = if target.list == EffectList::Unit { "unit" } else { &path };
                self.values(path, target, configured(target, gyro, configuration))
            }
            // A list is given whole.
            AmplitudeSource::Term(_) => {
                let terms = configuration.gyros[gyro.index()].discovered.iter();
                let terms = terms.map(|Term { formula, coefficient }| {
                    format!("{{ formula = \"{formula}\", coefficient = {coefficient:?} }}")
                });
                let terms = terms.collect::<Vec<_>>().join(", ");
                vec![format!("gyro.{}.{} = [{terms}]", gyro.name(), discovered::CODE)]
            }
        };
        let count = if self.amplitude.is_of_unit() { 1 } else { self.gyros.heads() };
        self.gyros.gyros().take(count).flat_map(of_gyro).collect()
    }

    /// Gyros of the unit.
    pub fn unit_gyros(&self) -> Vec<Gyro> {
        self.gyros.unit().gyros().collect()
    }

    /// The assignments below one table.
    fn values(
        &self,
        path: &str,
        target: ParameterRef,
        (numbers, courses): (&dyn ParameterSet, &[TimeCourse]),
    ) -> Vec<String> {
        let (code, base, size) = (self.amplitude.code(), self.amplitude.spec().code, self.amplitude.size());
        let total = match self.profile() {
            None => numbers.value(target.number),
            Some(profile) => {
                courses.iter().find(|course| is_course(course, target, profile)).map_or(0.0, |course| course.size)
            }
        };
        let own = self.amplitude.own_shapes().iter().zip(&self.own_shapes);
        let course = self.amplitude.course_shapes().iter().zip(&self.course_shapes);
        std::iter::once(format!("{path}.{code}.{} = {}", size.name, size.form.written_of(total, &self.unit_gyros())))
            .chain(own.map(|(number, value)| format!("{path}.{base}.{} = {value:?}", number.name)))
            .chain(course.map(|(number, value)| format!("{path}.{code}.{} = {value:?}", number.name)))
            .collect()
    }
}

fn is_course(course: &TimeCourse, target: ParameterRef, profile: TimeProfile) -> bool {
    (course.effect, course.amplitude, course.profile) == (target.effect, target.number, profile)
}

/// A number of a hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub struct HypothesisParameter {
    /// Key in the configuration.
    pub name: String,
    /// Role in the effect.
    pub role: Role,
    /// Value.
    pub value: f64,
    /// Smallest accepted value.
    pub min: f64,
    /// Largest accepted value.
    pub max: f64,
}

impl HypothesisParameter {
    /// Change of the value for a signature in blocks of this length.
    pub fn step(&self, block_s: f64) -> f64 {
        match self.role {
            // Two blocks, to average over the course within one.
            Role::Onset | Role::Duration => 2.0 * block_s,
            Role::Phase => 0.02,
            _ if self.value != 0.0 => 0.02 * self.value.abs(),
            _ => 2e-3 * self.max.min(1e3),
        }
    }
}
