//! Which number of the model a hypothesis moves.
//!
//! Amplitudes, their time courses and their shape parameters come from the model's own lists; none is named here, so that a new
//! effect is searched without a change of the diagnosis.

use geu_model::Configuration;
use geu_model::course::{KINDS, Size, TimeCourse};
use geu_model::effect::discovered::{self, Formula, Regressor};
use geu_model::effect::{EffectSpec, Effects};
use geu_model::fault::{EffectList, ParameterRef};
use geu_model::number::{ParameterSet, ParameterSpec, Role, ValueFormat, named_gyro};
use geu_model::package::{Axes, Calibration};
use geu_protocol::Gyro;

use crate::gyros::Gyros;

/// A number of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AmplitudeSource {
    /// Of an effect.
    Effect(ParameterRef),
    /// The coefficient of a discovered term.
    Term(Formula),
}

/// Index of a step in [`KINDS`].
pub const STEP: usize = 0;

/// An amplitude of the model, constant or with a time course.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AmplitudeRef {
    /// The constant amplitude.
    pub parameter: AmplitudeSource,
    /// Index of the time course in [`KINDS`].
    pub kind: Option<usize>,
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
    /// Of an effect, with the time course of this index in [`KINDS`].
    pub fn of(target: ParameterRef, kind: Option<usize>) -> AmplitudeRef {
        AmplitudeRef { parameter: AmplitudeSource::Effect(target), kind }
    }

    /// Every amplitude of every effect, constant, in the order of the lists; noises and wiring faults, which have no signature, too.
    pub fn every() -> impl Iterator<Item = AmplitudeRef> {
        let targets = ParameterRef::all().into_iter().filter(|target| target.number < target.effect().amplitudes.len());
        targets.map(|target| AmplitudeRef::of(target, None))
    }

    /// Every amplitude that has a signature, constant; in the order of the lists.
    pub fn all() -> Vec<AmplitudeRef> {
        AmplitudeRef::every().filter(AmplitudeRef::has_signature).collect()
    }

    /// Of a discovered term.
    pub fn term(formula: Formula) -> AmplitudeRef {
        AmplitudeRef { parameter: AmplitudeSource::Term(formula), kind: None }
    }

    /// Every product of one or two of the regressors, and the cube of each. Time is none of them: time courses are for effects.
    pub fn formulas() -> Vec<AmplitudeRef> {
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
        formulas.into_iter().map(AmplitudeRef::term).collect()
    }

    /// The same without a time course.
    #[must_use]
    pub fn constant(self) -> AmplitudeRef {
        AmplitudeRef { kind: None, ..self }
    }

    /// The same with this time course; none where it can have none. An effect with an onset of its own has none that could be
    /// distinguished from another amplitude.
    pub fn with(self, kind: usize) -> Option<AmplitudeRef> {
        if self.formula().is_some() || self.own_shapes().iter().any(|number| number.role == Role::Onset) {
            return None;
        }
        KINDS[kind].size(self.spec(), self.numbers(), self.index())?;
        Some(AmplitudeRef { kind: Some(kind), ..self })
    }

    /// The same and all that it can be with a time course.
    pub fn with_courses(self) -> impl Iterator<Item = AmplitudeRef> {
        std::iter::once(self).chain((0..KINDS.len()).filter_map(move |kind| self.with(kind)))
    }

    /// The formula of a discovered term.
    pub fn formula(&self) -> Option<Formula> {
        match self.parameter {
            AmplitudeSource::Term(formula) => Some(formula),
            AmplitudeSource::Effect(_) => None,
        }
    }

    /// Whether it acts on the whole unit.
    pub fn is_of_unit(&self) -> bool {
        self.list() == Some(EffectList::Unit)
    }

    fn list(&self) -> Option<EffectList> {
        match self.parameter {
            AmplitudeSource::Effect(target) => Some(target.list),
            AmplitudeSource::Term(_) => None,
        }
    }

    /// Whether it adds something to the counts that is proportional to it, or nearly; a noise and a wiring fault do not.
    pub fn has_signature(&self) -> bool {
        match self.parameter {
            AmplitudeSource::Effect(target) => target.list != EffectList::Wiring && !target.is_noise(),
            AmplitudeSource::Term(_) => true,
        }
    }

    /// Whether both are amplitudes of one effect.
    pub fn is_of_same_effect(&self, other: &AmplitudeRef) -> bool {
        match (self.parameter, other.parameter) {
            (AmplitudeSource::Effect(one), AmplitudeSource::Effect(other)) => {
                (one.list, one.effect) == (other.list, other.effect)
            }
            (AmplitudeSource::Term(_), AmplitudeSource::Term(_)) => true,
            _ => false,
        }
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
        self.spec().code.to_owned() + self.kind.map_or("", |kind| KINDS[kind].suffix)
    }

    /// Key and limits of its value.
    pub fn size(&self) -> Size {
        let number = self.number();
        let constant =
            Size { name: number.name.to_owned(), form: number.form, least: number.least, greatest: number.greatest };
        self.kind.and_then(|kind| KINDS[kind].size(self.spec(), self.numbers(), self.index())).unwrap_or(constant)
    }

    /// The other gyro that a value of it names.
    pub fn gyro_named(&self, value: f64) -> Option<Gyro> {
        if self.number().form == ValueFormat::Gyro { named_gyro(value) } else { None }
    }

    /// Whether its value is a whole number of counts.
    pub fn is_count(&self) -> bool {
        self.number().role == Role::Count
    }

    /// The effect's own shape parameters.
    pub fn own_shapes(&self) -> &'static [ParameterSpec] {
        &self.numbers()[self.spec().amplitudes.len()..]
    }

    /// The effect's own shape parameters as a configuration has them, where it has the effect at all.
    pub fn configured_shapes(&self, configuration: &Configuration) -> Option<Vec<f64>> {
        let AmplitudeSource::Effect(target) = self.parameter else { return None };
        let amplitudes = self.spec().amplitudes.len();
        let has = |(numbers, courses): &(&dyn ParameterSet, &[TimeCourse])| {
            (0..amplitudes).any(|index| numbers.value(index) != 0.0)
                || courses.iter().any(|course| course.effect == target.effect)
        };
        let (numbers, _) = Gyro::ALL.into_iter().map(|gyro| configured(target, gyro, configuration)).find(has)?;
        Some((amplitudes..numbers.specs().len()).map(|index| numbers.value(index)).collect())
    }

    /// The shape parameters of its time course.
    pub fn course_shapes(&self) -> &'static [ParameterSpec] {
        self.kind.map_or(&[], |kind| KINDS[kind].shapes)
    }

    /// The gyros that can have it.
    pub fn gyros(&self) -> Gyros {
        Gyro::ALL.map(|gyro| self.list() != Some(EffectList::Head) || Axes::of(gyro).has_number(self.number().name))
    }
}

/// Numbers and time courses of an effect in a configuration, of the unit or at this gyro.
pub fn configured(
    target: ParameterRef,
    gyro: Gyro,
    configuration: &Configuration,
) -> (&dyn ParameterSet, &[TimeCourse]) {
    let own = &configuration.gyros[gyro as usize];
    match target.list {
        EffectList::Unit => (configuration.unit.constant.numbers(target.effect), &configuration.unit.courses),
        EffectList::Head => (own.effects.constant.numbers(target.effect), &own.effects.courses),
        EffectList::Wiring => (own.wiring.constant.numbers(target.effect), &own.wiring.courses),
    }
}

/// The calibration parameters: gyro and index among [`Calibration::NUMBERS`], of those that a gyro has.
pub fn calibration_parameters() -> Vec<(Gyro, usize)> {
    let of_gyro = |gyro: Gyro| {
        let has = move |index: &usize| Axes::of(gyro).has_number(Calibration::NUMBERS[*index].name);
        (0..Calibration::NUMBERS.len()).filter(has).map(move |index| (gyro, index))
    };
    Gyro::ALL.into_iter().flat_map(of_gyro).collect()
}

/// Whether a number can be moved by little.
pub fn is_real(amplitude: &AmplitudeRef) -> bool {
    amplitude.size().form == ValueFormat::Real
}
