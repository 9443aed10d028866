//! Specifications of numbers of a configuration (name, unit, default, limits, meaning, source) beside the struct with them.
//!
//! Everything that reads, writes, describes or moves a configuration's numbers goes through [`ParameterSet`].

use geu_protocol::Gyro;

/// Default of a number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DefaultValue {
    /// This value.
    Value(f64),
    /// The number is required.
    Required,
    /// The number is optional; an absent one is NaN.
    Absent,
}

impl DefaultValue {
    /// The field's value before anything is read.
    pub const fn initial(self) -> f64 {
        match self {
            DefaultValue::Value(value) => value,
            DefaultValue::Required | DefaultValue::Absent => f64::NAN,
        }
    }
}

/// Format of a number in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueFormat {
    /// A number.
    Real,
    /// `true` (1) or `false` (0).
    Flag,
    /// Name of a gyro (1…4 in wire order); 0 for no gyro.
    Gyro,
    /// A number without a fraction.
    Whole,
    /// A word, by index.
    Choice(&'static [&'static str]),
}

/// Role of a number in an effect, a time course or a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// An amplitude, or a number without another role.
    Amplitude,
    /// An amplitude in counts: a whole number.
    Count,
    /// The time from which something holds.
    Onset,
    /// A duration.
    Duration,
    /// A period.
    Period,
    /// A phase: a wave of any phase is a sum of two.
    Phase,
    /// A time constant.
    TimeConstant,
    /// A width within which something changes.
    Width,
    /// The value that something returns to.
    PreferredValue,
}

/// Specification of a number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// Key in the configuration, unit last.
    pub name: &'static str,
    /// Unit as displays write it; empty for a number without unit.
    pub unit: &'static str,
    pub form: ValueFormat,
    pub role: Role,
    /// Value where none is named.
    pub default: DefaultValue,
    /// Smallest value accepted.
    pub min: f64,
    /// Largest value accepted.
    pub max: f64,
    /// Meaning, with its source.
    pub meaning: &'static str,
}

impl ParameterSpec {
    /// The limits in words.
    pub fn limits(&self) -> String {
        self.form.limits(self.min, self.max)
    }

    /// `value` as a configuration writes it.
    pub fn written(&self, value: f64) -> String {
        self.form.written(value)
    }
}

/// Limits of a unit against the default unit: a factor for rates, and the smallest limits of relative errors, ppm, and of misalignments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Widening {
    pub rate_factor: f64,
    pub ppm: f64,
    pub misalignment_arcsec: f64,
}

impl Default for Widening {
    fn default() -> Widening {
        Widening { rate_factor: 1.0, ppm: 0.0, misalignment_arcsec: 0.0 }
    }
}

/// Projections of an input axis on the control axes.
pub const MISALIGNMENTS: [&str; 3] = ["x_arcsec", "y_arcsec", "z_arcsec"];

impl Widening {
    /// Limits of a number, or of its time course, which are these for the default unit.
    pub fn limits(self, number: &ParameterSpec, min: f64, max: f64) -> (f64, f64) {
        let ParameterSpec { name, unit, .. } = *number;
        let is_rate = ["arcsec/s", "arcsec/h", "arcsec/√s"].iter().any(|rate| unit.starts_with(rate));
        let largest = match unit {
            "ppm" => max.max(self.ppm),
            _ if is_rate => max * self.rate_factor,
            _ if MISALIGNMENTS.contains(&name) => max.max(self.misalignment_arcsec),
            _ => max,
        };
        (if min < 0.0 { min.min(-largest) } else { min }, largest)
    }
}

impl ValueFormat {
    /// `value` as a configuration writes it.
    pub fn written(self, value: f64) -> String {
        self.written_of(value, &Gyro::ALL)
    }

    /// `value` as a configuration of a unit with these gyros writes it.
    pub fn written_of(self, value: f64, gyros: &[Gyro]) -> String {
        match self {
            ValueFormat::Real => format!("{value:?}"),
            ValueFormat::Flag => (value != 0.0).to_string(),
            ValueFormat::Gyro => {
                let gyro = (value as usize).checked_sub(1).and_then(|index| gyros.get(index));
                format!("{:?}", gyro.map_or("", |gyro| gyro.name()))
            }
            ValueFormat::Whole => format!("{value:.0}"),
            ValueFormat::Choice(names) => format!("{:?}", names.get(value as usize).copied().unwrap_or_default()),
        }
    }

    /// Limits of a gyro's name in words.
    pub fn limits_of(names: &[&str]) -> String {
        format!("one of {}", names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", "))
    }

    /// Limits in words.
    pub fn limits(self, min: f64, max: f64) -> String {
        match (self, min.is_finite(), max.is_finite()) {
            (ValueFormat::Flag, ..) => "true or false".to_owned(),
            (ValueFormat::Gyro, ..) => ValueFormat::limits_of(&Gyro::NAMES),
            (ValueFormat::Choice(names), ..) => format!("one of {}", names.join(", ")),
            (ValueFormat::Whole, ..) => format!("a whole number within {min}…{max}"),
            (_, true, true) if min == -max => format!("a number within ±{max}"),
            (_, true, true) => format!("a number within {min}…{max}"),
            (_, true, false) => format!("{min} or more"),
            (_, false, true) => format!("{max} or less"),
            (_, false, false) => "any number".to_owned(),
        }
    }
}

pub const REAL: ValueFormat = ValueFormat::Real;
pub const WHOLE: ValueFormat = ValueFormat::Whole;
pub const REQUIRED: DefaultValue = DefaultValue::Required;
pub const ABSENT: DefaultValue = DefaultValue::Absent;

/// A number that belongs to no struct.
pub const fn number(
    name: &'static str,
    unit: &'static str,
    form: ValueFormat,
    default: DefaultValue,
    min: f64,
    max: f64,
    meaning: &'static str,
) -> ParameterSpec {
    ParameterSpec { name, unit, form, role: Role::Amplitude, default, min, max, meaning }
}

/// The gyro that a number of form [`ValueFormat::Gyro`] means.
pub fn named_gyro(value: f64) -> Option<Gyro> {
    (value as usize).checked_sub(1).and_then(|index| Gyro::ALL.get(index).copied())
}

/// A struct of numbers that knows what is said of each.
pub trait ParameterSet {
    /// One entry per number, in order.
    fn specs(&self) -> &'static [ParameterSpec];
    /// The number at `index` of [`ParameterSet::specs`].
    fn value(&self, index: usize) -> f64;
    /// The place of the number at `index` of [`ParameterSet::specs`].
    fn value_mut(&mut self, index: usize) -> &mut f64;
}

/// Declares a struct of numbers: `field: default, min..=max, "unit";`, the default `required`, `absent` or a value, and after the
/// unit a format other than `Real` or a role other than `Amplitude`.
macro_rules! numbers {
    (@form Flag) => { $crate::parameter_spec::ValueFormat::Flag };
    (@form Gyro) => { $crate::parameter_spec::ValueFormat::Gyro };
    (@form Whole) => { $crate::parameter_spec::ValueFormat::Whole };
    (@form Choice($names:expr)) => { $crate::parameter_spec::ValueFormat::Choice($names) };
    (@form $($role:ident)?) => { $crate::parameter_spec::ValueFormat::Real };
    (@role Flag) => { $crate::parameter_spec::Role::Amplitude };
    (@role Gyro) => { $crate::parameter_spec::Role::Amplitude };
    (@role Whole) => { $crate::parameter_spec::Role::Amplitude };
    (@role Choice($names:expr)) => { $crate::parameter_spec::Role::Amplitude };
    (@role) => { $crate::parameter_spec::Role::Amplitude };
    (@role $role:ident) => { $crate::parameter_spec::Role::$role };
    (@default required) => { $crate::parameter_spec::DefaultValue::Required };
    (@default absent) => { $crate::parameter_spec::DefaultValue::Absent };
    (@default $value:expr) => { $crate::parameter_spec::DefaultValue::Value($value) };
    ($(#[doc = $doc:literal])* $vis:vis struct $type:ident {
        $($(#[doc = $meaning:literal])* $field:ident: $default:tt, $min:literal ..= $max:expr, $unit:literal $(, $form_or_role:ident $(($names:expr))?)?;)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        $vis struct $type { $($(#[doc = $meaning])* pub $field: f64),* }

        impl $type {
            /// Specifications in order.
            pub const NUMBERS: &[$crate::parameter_spec::ParameterSpec] = &[$($crate::parameter_spec::ParameterSpec {
                name: stringify!($field),
                unit: $unit,
                form: $crate::parameter_spec::numbers!(@form $($form_or_role $(($names))?)?),
                role: $crate::parameter_spec::numbers!(@role $($form_or_role $(($names))?)?),
                default: $crate::parameter_spec::numbers!(@default $default),
                min: $min,
                max: $max,
                meaning: concat!($($meaning),*).trim_ascii(),
            }),*];
        }

        impl ::core::default::Default for $type {
            fn default() -> Self {
                $type { $($field: $crate::parameter_spec::numbers!(@default $default).initial()),* }
            }
        }

        impl $crate::parameter_spec::ParameterSet for $type {
            fn specs(&self) -> &'static [$crate::parameter_spec::ParameterSpec] { Self::NUMBERS }
            fn value(&self, index: usize) -> f64 { [$(self.$field),*][index] }
            fn value_mut(&mut self, index: usize) -> &mut f64 { [$(&mut self.$field),*].into_iter().nth(index).expect("index of NUMBERS") }
        }
    };
}
pub(crate) use numbers;
