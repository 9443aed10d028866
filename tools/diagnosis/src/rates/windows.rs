//! The data: windows with mean rates, a reference, a group.

/// A gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct Gyro {
    /// Its name.
    pub name: String,
    /// Axis about which it senses: 0 X, 1 Y, 2 Z.
    pub axis: usize,
}

/// The independent rate of a window, arcsec/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reference {
    /// Its magnitude.
    Magnitude(f64),
    /// About X, Y and Z.
    Vector([f64; 3]),
}

/// One window.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Index of its group.
    pub group: usize,
    /// Mean rate of each gyro.
    pub rates_arcsec_s: Vec<f64>,
    /// The independent rate.
    pub reference: Reference,
}

/// Windows, in the order of time within each group.
#[derive(Debug, Clone, PartialEq)]
pub struct Windows {
    /// The gyros.
    pub gyros: Vec<Gyro>,
    /// Names of the groups.
    pub groups: Vec<String>,
    windows: Vec<Window>,
}

/// Why rates cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RatesError {
    /// A window that is none.
    #[error("window {window}: expected {expected}, got {got}")]
    Window {
        /// From 1.
        window: usize,
        /// What a window has.
        expected: String,
        /// What this one has.
        got: String,
    },
    /// A magnitude says nothing of gyros that do not sense all of the rate.
    #[error("a reference that is a magnitude: expected one gyro about each of X, Y and Z, got {got}")]
    Axes {
        /// The gyros.
        got: String,
    },
    /// Too few to know the noise.
    #[error("expected at least {expected} windows, so that noise can be told from errors; got {got}")]
    TooFew {
        /// Least.
        expected: usize,
        /// Given.
        got: usize,
    },
}

impl Windows {
    /// None yet.
    pub fn new(gyros: Vec<Gyro>, groups: Vec<String>) -> Windows {
        Windows { gyros, groups, windows: Vec::new() }
    }

    /// Appends one.
    ///
    /// # Errors
    /// Another number of gyros, a group that is none, a reference of the other kind, a number that is not finite.
    pub fn push(&mut self, group: usize, rates_arcsec_s: &[f64], reference: Reference) -> Result<(), RatesError> {
        let refused =
            |expected: String, got: String| Err(RatesError::Window { window: self.windows.len() + 1, expected, got });
        if rates_arcsec_s.len() != self.gyros.len() {
            return refused(format!("a rate for each of {} gyros", self.gyros.len()), rates_arcsec_s.len().to_string());
        }
        if group >= self.groups.len() {
            return refused(format!("one of {} groups", self.groups.len()), format!("group {}", group + 1));
        }
        let is_magnitude = |reference: &Reference| matches!(reference, Reference::Magnitude(_));
        if self.windows.first().is_some_and(|first| is_magnitude(&first.reference) != is_magnitude(&reference)) {
            return refused("a reference like that of the first".to_owned(), format!("{reference:?}"));
        }
        let references = match reference {
            Reference::Magnitude(rate) => vec![rate],
            Reference::Vector(rates) => rates.to_vec(),
        };
        let limit = 1e12;
        if let Some(rate) = rates_arcsec_s.iter().chain(&references).find(|rate| !(-limit..=limit).contains(*rate)) {
            return refused("rates that are numbers, within 1e12 arcsec/s".to_owned(), rate.to_string());
        }
        self.windows.push(Window { group, rates_arcsec_s: rates_arcsec_s.to_vec(), reference });
        Ok(())
    }

    /// All of them.
    pub fn all(&self) -> &[Window] {
        &self.windows
    }

    /// Those of which `keep` holds.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(&Window) -> bool) -> Windows {
        let windows = self.windows.iter().filter(|window| keep(window)).cloned().collect();
        Windows { windows, ..self.clone() }
    }

    /// The same, cut into `parts` groups, one after the other, where there is but one: what is held out of a single group.
    #[must_use]
    pub fn cut(&self, parts: usize) -> Windows {
        if self.groups.len() != 1 {
            return self.clone();
        }
        let mut cut = self.clone();
        cut.groups = (1..=parts).map(|part| format!("{}, part {part} of {parts}", self.groups[0])).collect();
        let count = cut.windows.len().max(1);
        cut.windows.iter_mut().enumerate().for_each(|(index, window)| window.group = index * parts / count);
        cut
    }

    /// Whether the reference is a magnitude.
    pub fn is_magnitude(&self) -> bool {
        matches!(self.windows.first(), Some(Window { reference: Reference::Magnitude(_), .. }))
    }

    /// How many residuals a window has: one for a magnitude, else one for each gyro.
    pub(crate) fn channels(&self) -> usize {
        if self.is_magnitude() { 1 } else { self.gyros.len() }
    }

    /// Greatest rate that a gyro told, arcsec/s.
    pub(crate) fn greatest_arcsec_s(&self) -> f64 {
        self.windows.iter().flat_map(|window| &window.rates_arcsec_s).fold(0.0, |most, rate| rate.abs().max(most))
    }
}
