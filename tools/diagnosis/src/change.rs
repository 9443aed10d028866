//! A number of the model moved: which amplitude, with which course in time, on which gyros, by how much.
//!
//! Amplitudes, their courses and their shapes are walked through the model's own lists; none is named here, so that an effect is
//! looked for on the day it is written.

use geu_model::Configuration;
use geu_model::course::{Course, KINDS, Law, Size};
use geu_model::effect::discovered::{self, Formula, Regressor, Term};
use geu_model::effect::{Configured, EffectSpec, Effects, HeadEffects, UnitEffects};
use geu_model::number::{Form, Number};
use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;

/// Which of the four gyros.
pub type Gyros = [bool; 4];

/// All four, as an effect of the unit has them.
pub const ALL_GYROS: Gyros = [true; 4];

/// Which list of the model an effect stands in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Place {
    /// Of the whole unit.
    Unit,
    /// Of one gyro.
    Head,
    /// The terms of one gyro that stand in no list.
    Discovered,
}

/// An amplitude of the model, constant or with a course.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Amplitude {
    /// The list.
    pub place: Place,
    /// Index of the effect in the list.
    pub effect: usize,
    /// Index of the amplitude among the effect's numbers.
    pub amplitude: usize,
    /// Index of the course in [`KINDS`].
    pub kind: Option<usize>,
    /// What a discovered term follows.
    pub formula: Option<Formula>,
}

/// Name of the shape that is an onset.
pub const ONSET: &str = "time_s";
/// Name of the shape of a wave that says where it begins: one of any phase is a sum of two.
pub const PHASE: &str = "phase_rad";

/// What is said of the terms that are data.
const DISCOVERED: EffectSpec = EffectSpec {
    code: discovered::CODE,
    title: discovered::TITLE,
    amplitudes: &[geu_model::effect::Amplitude { per_day: 0.0, per_k: 0.0 }],
    paper: "",
    source: "a diagnosis",
};

impl Amplitude {
    /// Every amplitude that has a signature, constant; in the order of the lists.
    pub fn all() -> Vec<Amplitude> {
        fn of<E: Effects>(place: Place) -> Vec<Amplitude> {
            let list = E::default();
            let of_effect = |effect: usize| {
                let amplitudes = 0..list.specs()[effect].amplitudes.len();
                amplitudes.map(move |amplitude| Amplitude { place, effect, amplitude, kind: None, formula: None })
            };
            (0..list.specs().len()).filter(|&effect| !list.is_noise(effect)).flat_map(of_effect).collect()
        }
        [of::<UnitEffects>(Place::Unit), of::<HeadEffects>(Place::Head)].concat()
    }

    /// Every product of one or two of the regressors, and the cube of each: as many terms as may be in nobody's catalogue. Courses in
    /// time are for effects; a term that goes on growing is none.
    pub fn formulas() -> Vec<Amplitude> {
        let regressors = Regressor::ALL.into_iter().filter(|regressor| regressor.name() != "time");
        let regressors: Vec<Regressor> = regressors.collect();
        let singles = regressors.iter().map(|one| vec![*one]);
        let pairs = (0..regressors.len())
            .flat_map(|one| (one..regressors.len()).map(move |other| (one, other)))
            .map(|(one, other)| vec![regressors[one], regressors[other]]);
        let cubes = regressors.iter().map(|one| vec![*one; 3]);
        let mut formulas: Vec<Formula> =
            singles.chain(pairs).chain(cubes).filter_map(|factors| Formula::new(&factors).ok()).collect();
        formulas.sort();
        formulas.dedup();
        let of = |formula| Amplitude {
            place: Place::Discovered,
            effect: 0,
            amplitude: 0,
            kind: None,
            formula: Some(formula),
        };
        formulas.into_iter().map(of).collect()
    }

    /// The same with this course; nothing where it can have none. What happens at one time and is over has none that could be told:
    /// it is another size.
    pub fn with(self, kind: usize) -> Option<Amplitude> {
        if self.place == Place::Discovered || self.own_shapes().iter().any(|number| number.name == ONSET) {
            return None;
        }
        KINDS[kind].size(self.spec(), self.numbers(), self.amplitude)?;
        Some(Amplitude { kind: Some(kind), ..self })
    }

    /// What is said of the effect.
    pub fn spec(&self) -> &'static EffectSpec {
        match self.place {
            Place::Unit => &UnitEffects::SPECS[self.effect],
            Place::Head => &HeadEffects::SPECS[self.effect],
            Place::Discovered => &DISCOVERED,
        }
    }

    /// The effect's numbers: its amplitudes, then its shapes.
    fn numbers(&self) -> &'static [Number] {
        match self.place {
            Place::Unit => UnitEffects::default().numbers(self.effect).specs(),
            Place::Head => HeadEffects::default().numbers(self.effect).specs(),
            Place::Discovered => const { &[discovered::COEFFICIENT] },
        }
    }

    /// Its code, with the suffix of its course.
    pub fn code(&self) -> String {
        self.spec().code.to_owned() + self.kind.map_or("", |kind| KINDS[kind].suffix)
    }

    /// Key and limits of its size.
    pub fn size(&self) -> Size {
        let number = &self.numbers()[self.amplitude];
        let constant =
            Size { name: number.name.to_owned(), form: number.form, least: number.least, greatest: number.greatest };
        self.kind.and_then(|kind| KINDS[kind].size(self.spec(), self.numbers(), self.amplitude)).unwrap_or(constant)
    }

    /// The effect's own shapes.
    pub fn own_shapes(&self) -> &'static [Number] {
        &self.numbers()[self.spec().amplitudes.len()..]
    }

    /// The effect's own shapes as a configuration has them, where it has the effect at all.
    pub fn configured_shapes(&self, configuration: &Configuration) -> Option<Vec<f64>> {
        fn of<E: Effects>(configured: &Configured<E>, effect: usize) -> Option<Vec<f64>> {
            let (numbers, amplitudes) =
                (configured.constant.numbers(effect), configured.constant.specs()[effect].amplitudes.len());
            let has = (0..amplitudes).any(|index| numbers.value(index) != 0.0)
                || configured.courses.iter().any(|course| course.effect == effect);
            has.then(|| (amplitudes..numbers.specs().len()).map(|index| numbers.value(index)).collect())
        }
        match self.place {
            Place::Unit => of(&configuration.unit, self.effect),
            Place::Head => configuration.gyros.iter().find_map(|gyro| of(&gyro.effects, self.effect)),
            Place::Discovered => None,
        }
    }

    /// The shapes of its course.
    pub fn course_shapes(&self) -> &'static [Number] {
        self.kind.map_or(&[], |kind| KINDS[kind].shapes)
    }

    /// The gyros that can have it.
    pub fn gyros(&self) -> Gyros {
        let name = self.numbers()[self.amplitude].name;
        Gyro::ALL.map(|gyro| self.place != Place::Head || Axes::of(gyro).has_number(name))
    }
}

/// An amplitude moved.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Which.
    pub amplitude: Amplitude,
    /// By how much.
    pub size: f64,
    /// Values of the effect's own shapes.
    pub own_shapes: Vec<f64>,
    /// Values of its course's shapes.
    pub course_shapes: Vec<f64>,
    /// On which gyros; all four for an effect of the unit.
    pub gyros: Gyros,
}

impl Change {
    /// The law of its course; nothing of what is constant.
    pub fn law(&self) -> Option<Law> {
        self.amplitude.kind.map(|kind| KINDS[kind].law(&self.course_shapes))
    }

    /// Moves the amplitude in a configuration.
    pub fn apply(&self, configuration: &mut Configuration) {
        match self.amplitude.place {
            Place::Unit => self.put(&mut configuration.unit),
            Place::Head => {
                for (gyro, _) in configuration.gyros.iter_mut().zip(self.gyros).filter(|(_, has)| *has) {
                    self.put(&mut gyro.effects);
                }
            }
            Place::Discovered => {
                let formula = self.amplitude.formula.expect("a discovered term has one");
                for (gyro, _) in configuration.gyros.iter_mut().zip(self.gyros).filter(|(_, has)| *has) {
                    match gyro.discovered.iter_mut().find(|term| term.formula == formula) {
                        Some(term) => term.coefficient += self.size,
                        None => gyro.discovered.push(Term { formula, coefficient: self.size }),
                    }
                }
            }
        }
    }

    fn put<E: Effects>(&self, configured: &mut Configured<E>) {
        let Amplitude { effect, amplitude, kind, .. } = self.amplitude;
        let amplitudes = configured.constant.specs()[effect].amplitudes.len();
        let numbers = configured.constant.numbers_mut(effect);
        for (index, value) in self.own_shapes.iter().enumerate() {
            *numbers.value_mut(amplitudes + index) = *value;
        }
        let Some(kind) = kind else {
            *numbers.value_mut(amplitude) += self.size;
            return;
        };
        let law = KINDS[kind].law(&self.course_shapes);
        let same = configured
            .courses
            .iter_mut()
            .find(|course| (course.effect, course.amplitude, course.law) == (effect, amplitude, law));
        match same {
            Some(course) => course.size += self.size,
            None => configured.courses.push(Course { effect, amplitude, size: self.size, law }),
        }
    }

    /// The numbers of the change: what each is called, its value and its limits; the size first.
    pub fn parameters(&self) -> Vec<Parameter> {
        let size = self.amplitude.size();
        let shape = |(number, value): (&Number, &f64)| Parameter {
            name: number.name.to_owned(),
            value: *value,
            least: number.least,
            greatest: number.greatest,
        };
        let size = Parameter { name: size.name, value: self.size, least: size.least, greatest: size.greatest };
        let own = self.amplitude.own_shapes().iter().zip(&self.own_shapes).map(shape);
        let course = self.amplitude.course_shapes().iter().zip(&self.course_shapes).map(shape);
        std::iter::once(size).chain(own).chain(course).collect()
    }

    /// Puts a value in the place of the parameter at `index` of [`Change::parameters`].
    pub fn set(&mut self, index: usize, value: f64) {
        let own = self.own_shapes.len();
        match index {
            0 => self.size = value,
            index if index <= own => self.own_shapes[index - 1] = value,
            index => self.course_shapes[index - 1 - own] = value,
        }
    }

    /// Whether the value found is one that a configuration accepts.
    pub fn is_within_limits(&self) -> bool {
        self.parameters().iter().all(|parameter| (parameter.least..=parameter.greatest).contains(&parameter.value))
    }

    /// What [`Configuration::edited`] takes to have it in the text of `configuration`, which has it already.
    pub fn assignments(&self, configuration: &Configuration) -> Vec<String> {
        let gyros = Gyro::ALL.into_iter().filter(|gyro| self.gyros[*gyro as usize]);
        let of_gyro = |gyro: Gyro| {
            let (path, own) = (format!("gyro.{}", gyro.name()), &configuration.gyros[gyro as usize]);
            if self.amplitude.place == Place::Head {
                return self.values(&path, self.total(&own.effects));
            }
            // A list is given whole.
            let terms = own.discovered.iter().map(|term| {
                let Term { formula, coefficient } = term;
                format!("{{ formula = \"{formula}\", coefficient = {coefficient:?} }}")
            });
            vec![format!("{path}.{} = [{}]", discovered::CODE, terms.collect::<Vec<_>>().join(", "))]
        };
        match self.amplitude.place {
            Place::Unit => self.values("unit", self.total(&configuration.unit)),
            Place::Head | Place::Discovered => gyros.flat_map(of_gyro).collect(),
        }
    }

    /// The assignments below one table.
    fn values(&self, path: &str, total: f64) -> Vec<String> {
        let (code, base, size) = (self.amplitude.code(), self.amplitude.spec().code, self.amplitude.size().name);
        let own = self.amplitude.own_shapes().iter().zip(&self.own_shapes);
        let course = self.amplitude.course_shapes().iter().zip(&self.course_shapes);
        std::iter::once(format!("{path}.{code}.{size} = {total:?}"))
            .chain(own.map(|(number, value)| format!("{path}.{base}.{} = {value:?}", number.name)))
            .chain(course.map(|(number, value)| format!("{path}.{code}.{} = {value:?}", number.name)))
            .collect()
    }

    fn total<E: Effects>(&self, configured: &Configured<E>) -> f64 {
        let Amplitude { effect, amplitude, kind, .. } = self.amplitude;
        let Some(kind) = kind else { return configured.constant.numbers(effect).value(amplitude) };
        let law = KINDS[kind].law(&self.course_shapes);
        let same = |course: &&Course| (course.effect, course.amplitude, course.law) == (effect, amplitude, law);
        configured.courses.iter().find(same).map_or(0.0, |course| course.size)
    }
}

/// A number of a change.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Key in the configuration.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Least accepted.
    pub least: f64,
    /// Greatest accepted.
    pub greatest: f64,
}

/// The sixteen: gyro and index among [`Calibration::NUMBERS`], of those that mean something.
pub fn sixteen() -> Vec<(Gyro, usize)> {
    let of_gyro = |gyro: Gyro| {
        let has = move |index: &usize| Axes::of(gyro).has_number(Calibration::NUMBERS[*index].name);
        (0..Calibration::NUMBERS.len()).filter(has).map(move |index| (gyro, index))
    };
    Gyro::ALL.into_iter().flat_map(of_gyro).collect()
}

/// Whether a number can be moved by little.
pub fn is_real(amplitude: &Amplitude) -> bool {
    amplitude.size().form == Form::Real
}
