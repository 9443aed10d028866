//! Numbers of a configuration: each told once (name, default, limits, meaning, source) beside the struct that holds it.
//!
//! Everything that reads, writes, describes or moves a configuration's numbers goes through [`Numbers`].

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

/// What is said of one number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Number {
    /// Key in the configuration, unit last.
    pub name: &'static str,
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
        limits(self.least, self.greatest)
    }
}

/// Limits in words.
pub fn limits(least: f64, greatest: f64) -> String {
    match (least.is_finite(), greatest.is_finite()) {
        (true, true) if least == -greatest => format!("a number within ±{greatest}"),
        (true, true) => format!("a number within {least}…{greatest}"),
        (true, false) => format!("{least} or more"),
        (false, true) => format!("{greatest} or less"),
        (false, false) => "any number".to_owned(),
    }
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
    (@default required) => { $crate::number::Default::Required };
    (@default absent) => { $crate::number::Default::Absent };
    (@default $value:expr) => { $crate::number::Default::Value($value) };
    ($(#[doc = $doc:literal])* pub struct $type:ident {
        $($(#[doc = $meaning:literal])* $field:ident: $default:tt, $least:literal ..= $greatest:expr;)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $type { $($(#[doc = $meaning])* pub $field: f64),* }

        impl $type {
            /// What is said of each number, in order.
            pub const NUMBERS: &[$crate::number::Number] = &[$($crate::number::Number {
                name: stringify!($field),
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
