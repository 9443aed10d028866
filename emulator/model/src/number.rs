//! Numbers of a configuration: each told once (name, default, limits, meaning, source) beside the struct that holds it.
//!
//! Everything that reads, writes, describes or moves a configuration's numbers goes through [`Numbers`].

use geu_protocol::Gyro;

/// What stands where a configuration does not name the number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Default {
    /// This value.
    Value(f64),
    /// Nothing: it must be named.
    Required,
    /// Nothing: it need not be named; the field is then NaN.
    Absent,
}

impl Default {
    /// The field's value before anything is read.
    pub const fn initial(self) -> f64 {
        match self {
            Default::Value(value) => value,
            Default::Required | Default::Absent => f64::NAN,
        }
    }
}

/// How a number is written in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
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

/// What is said of one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number {
    /// Key in the configuration, unit last.
    pub name: &'static str,
    /// How it is written.
    pub form: Form,
    /// Value where none is named.
    pub default: Default,
    /// Smallest value accepted.
    pub least: f64,
    /// Largest value accepted.
    pub greatest: f64,
    /// Meaning, with its source.
    pub meaning: &'static str,
}

impl Number {
    /// The limits in words.
    pub fn limits(&self) -> String {
        self.form.limits(self.least, self.greatest)
    }

    /// `value` as a configuration writes it.
    pub fn written(&self, value: f64) -> String {
        self.form.written(value)
    }
}

impl Form {
    /// `value` as a configuration writes it.
    pub fn written(self, value: f64) -> String {
        match self {
            Form::Real => format!("{value:?}"),
            Form::Flag => (value != 0.0).to_string(),
            Form::Gyro => format!("{:?}", named_gyro(value).map_or("", Gyro::name)),
            Form::Whole => format!("{value:.0}"),
            Form::Choice(names) => format!("{:?}", names.get(value as usize).copied().unwrap_or_default()),
        }
    }

    /// Limits in words.
    pub fn limits(self, least: f64, greatest: f64) -> String {
        match (self, least.is_finite(), greatest.is_finite()) {
            (Form::Flag, ..) => "true or false".to_owned(),
            (Form::Gyro, ..) => format!("one of {}", Gyro::ALL.map(|gyro| format!("{:?}", gyro.name())).join(", ")),
            (Form::Choice(names), ..) => format!("one of {}", names.join(", ")),
            (Form::Whole, ..) => format!("a whole number within {least}…{greatest}"),
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
    form: Form,
    default: Default,
    least: f64,
    greatest: f64,
    meaning: &'static str,
) -> Number {
    Number { name, form, default, least, greatest, meaning }
}

/// The gyro that a number of form [`Form::Gyro`] means.
pub fn named_gyro(value: f64) -> Option<Gyro> {
    (value as usize).checked_sub(1).and_then(|index| Gyro::ALL.get(index).copied())
}

/// A struct of numbers that knows what is said of each.
pub trait Numbers {
    /// One entry per number, in order.
    fn specs(&self) -> &'static [Number];
    /// The number at `index` of [`Numbers::specs`].
    fn value(&self, index: usize) -> f64;
    /// The place of the number at `index` of [`Numbers::specs`].
    fn value_mut(&mut self, index: usize) -> &mut f64;
}

/// Declares a struct of numbers: `field: default, least..=greatest;`, the default `required`, `absent` or a value.
macro_rules! numbers {
    (@form) => { $crate::number::Form::Real };
    (@form $form:ident) => { $crate::number::Form::$form };
    (@default required) => { $crate::number::Default::Required };
    (@default absent) => { $crate::number::Default::Absent };
    (@default $value:expr) => { $crate::number::Default::Value($value) };
    ($(#[doc = $doc:literal])* pub struct $type:ident {
        $($(#[doc = $meaning:literal])* $field:ident: $default:tt, $least:literal ..= $greatest:expr $(, $form:ident)?;)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $type { $($(#[doc = $meaning])* pub $field: f64),* }

        impl $type {
            /// What is said of each number, in order.
            pub const NUMBERS: &[$crate::number::Number] = &[$($crate::number::Number {
                name: stringify!($field),
                form: $crate::number::numbers!(@form $($form)?),
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

        impl $crate::number::Numbers for $type {
            fn specs(&self) -> &'static [$crate::number::Number] { Self::NUMBERS }
            fn value(&self, index: usize) -> f64 { [$(self.$field),*][index] }
            fn value_mut(&mut self, index: usize) -> &mut f64 { [$(&mut self.$field),*].into_iter().nth(index).expect("index of NUMBERS") }
        }
    };
}
pub(crate) use numbers;
