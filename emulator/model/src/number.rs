//! Numbers of a configuration: each told once (name, default, limits, meaning, source) beside the struct that holds it.
//!
//! Everything that reads, writes, describes or moves a configuration's numbers goes through [`ParameterSet`].

use geu_protocol::Gyro;

/// What stands where a configuration does not name the number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DefaultValue {
    /// This value.
    Value(f64),
    /// Nothing: it must be named.
    Required,
    /// Nothing: it need not be named; the field is then NaN.
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

/// How a number is written in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueFormat {
    /// As a number.
    Real,
    /// As `true` (1) or `false` (0).
    Flag,
    /// As the name of a gyro (1…4 in wire order); 0 is none.
    Gyro,
    /// As a number without a fraction.
    Whole,
    /// As one of these words, by index.
    Choice(&'static [&'static str]),
}

/// What a number is for in an effect, a time course or a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// An amplitude, or a number without another role.
    Amplitude,
    /// An amplitude in counts: a whole number.
    Count,
    /// The time from which something holds.
    Onset,
    /// A period.
    Period,
    /// A phase: a wave of any phase is a sum of two.
    Phase,
    /// A time constant.
    TimeConstant,
    /// The value that something returns to.
    PreferredValue,
}

/// What is said of one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// Key in the configuration, unit last.
    pub name: &'static str,
    /// How it is written.
    pub form: ValueFormat,
    /// What it is for.
    pub role: Role,
    /// Value where none is named.
    pub default: DefaultValue,
    /// Smallest value accepted.
    pub least: f64,
    /// Largest value accepted.
    pub greatest: f64,
    /// Meaning, with its source.
    pub meaning: &'static str,
}

impl ParameterSpec {
    /// The limits in words.
    pub fn limits(&self) -> String {
        self.form.limits(self.least, self.greatest)
    }

    /// `value` as a configuration writes it.
    pub fn written(&self, value: f64) -> String {
        self.form.written(value)
    }
}

impl ValueFormat {
    /// `value` as a configuration writes it.
    pub fn written(self, value: f64) -> String {
        match self {
            ValueFormat::Real => format!("{value:?}"),
            ValueFormat::Flag => (value != 0.0).to_string(),
            ValueFormat::Gyro => format!("{:?}", named_gyro(value).map_or("", Gyro::name)),
            ValueFormat::Whole => format!("{value:.0}"),
            ValueFormat::Choice(names) => format!("{:?}", names.get(value as usize).copied().unwrap_or_default()),
        }
    }

    /// Limits in words.
    pub fn limits(self, least: f64, greatest: f64) -> String {
        match (self, least.is_finite(), greatest.is_finite()) {
            (ValueFormat::Flag, ..) => "true or false".to_owned(),
            (ValueFormat::Gyro, ..) => {
                format!("one of {}", Gyro::ALL.map(|gyro| format!("{:?}", gyro.name())).join(", "))
            }
            (ValueFormat::Choice(names), ..) => format!("one of {}", names.join(", ")),
            (ValueFormat::Whole, ..) => format!("a whole number within {least}…{greatest}"),
            (_, true, true) if least == -greatest => format!("a number within ±{greatest}"),
            (_, true, true) => format!("a number within {least}…{greatest}"),
            (_, true, false) => format!("{least} or more"),
            (_, false, true) => format!("{greatest} or less"),
            (_, false, false) => "any number".to_owned(),
        }
    }
}

/// A number that belongs to no struct.
pub const fn number(
    name: &'static str,
    form: ValueFormat,
    default: DefaultValue,
    least: f64,
    greatest: f64,
    meaning: &'static str,
) -> ParameterSpec {
    ParameterSpec { name, form, role: Role::Amplitude, default, least, greatest, meaning }
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

/// Declares a struct of numbers: `field: default, least..=greatest;`, the default `required`, `absent` or a value, and after the
/// limits a form that is not `Real` or a role that is not `Amplitude`.
macro_rules! numbers {
    (@form Flag) => { $crate::number::ValueFormat::Flag };
    (@form Gyro) => { $crate::number::ValueFormat::Gyro };
    (@form Whole) => { $crate::number::ValueFormat::Whole };
    (@form $($role:ident)?) => { $crate::number::ValueFormat::Real };
    (@role Flag) => { $crate::number::Role::Amplitude };
    (@role Gyro) => { $crate::number::Role::Amplitude };
    (@role Whole) => { $crate::number::Role::Amplitude };
    (@role) => { $crate::number::Role::Amplitude };
    (@role $role:ident) => { $crate::number::Role::$role };
    (@default required) => { $crate::number::DefaultValue::Required };
    (@default absent) => { $crate::number::DefaultValue::Absent };
    (@default $value:expr) => { $crate::number::DefaultValue::Value($value) };
    ($(#[doc = $doc:literal])* pub struct $type:ident {
        $($(#[doc = $meaning:literal])* $field:ident: $default:tt, $least:literal ..= $greatest:expr $(, $form_or_role:ident)?;)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $type { $($(#[doc = $meaning])* pub $field: f64),* }

        impl $type {
            /// What is said of each number, in order.
            pub const NUMBERS: &[$crate::number::ParameterSpec] = &[$($crate::number::ParameterSpec {
                name: stringify!($field),
                form: $crate::number::numbers!(@form $($form_or_role)?),
                role: $crate::number::numbers!(@role $($form_or_role)?),
                default: $crate::number::numbers!(@default $default),
                least: $least,
                greatest: $greatest,
                meaning: concat!($($meaning),*),
            }),*];
        }

        impl ::core::default::Default for $type {
            fn default() -> Self {
                $type { $($field: $crate::number::numbers!(@default $default).initial()),* }
            }
        }

        impl $crate::number::ParameterSet for $type {
            fn specs(&self) -> &'static [$crate::number::ParameterSpec] { Self::NUMBERS }
            fn value(&self, index: usize) -> f64 { [$(self.$field),*][index] }
            fn value_mut(&mut self, index: usize) -> &mut f64 { [$(&mut self.$field),*].into_iter().nth(index).expect("index of NUMBERS") }
        }
    };
}
pub(crate) use numbers;
