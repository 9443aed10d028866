//! The data: windows, each with the mean rate of every gyro, a reference rate and a group.

/// A gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct Gyro {
    /// Name.
    pub name: String,
    /// Sensitive axis: 0 X, 1 Y, 2 Z.
    pub axis: usize,
}

/// The independent rate of a window, arcsec/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reference {
    /// Magnitude.
    Magnitude(f64),
    /// About X, Y and Z.
    Vector([f64; 3]),
}

/// One window.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Index of the group.
    pub group: usize,
    /// Mean rate of each gyro.
    pub rates_arcsec_s: Vec<f64>,
    /// The independent rate.
    pub reference: Reference,
}

/// Windows, in time order within each group.
#[derive(Debug, Clone, PartialEq)]
pub struct Windows {
    /// The gyros.
    pub gyros: Vec<Gyro>,
    /// Names of the groups.
    pub groups: Vec<String>,
    windows: Vec<Window>,
}

/// Rates that cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RatesError {
    /// An invalid window.
    #[error("window {window}: expected {expected}, got {got}")]
    Window {
        /// From 1.
        window: usize,
        /// Expected content.
        expected: String,
        /// Actual content.
        got: String,
    },
    /// A magnitude as reference needs gyros that together sense the whole rate.
    #[error("a reference that is a magnitude: expected one gyro about each of X, Y and Z, got {got}")]
    Axes {
        /// The gyros.
        got: String,
    },
    /// Too few windows to estimate the noise.
    #[error("expected {expected} windows or more, to separate noise from errors; got {got}")]
    TooFew {
        /// Minimum.
        expected: usize,
        /// Given.
        got: usize,
    },
}

const MAX_RATE_ARCSEC_S: f64 = 1e12;

impl Windows {
    /// Without a window.
    pub fn new(gyros: Vec<Gyro>, groups: Vec<String>) -> Windows {
        Windows { gyros, groups, windows: Vec::new() }
    }

    /// Appends a window.
    ///
    /// # Errors
    /// [`RatesError::Window`]: another number of gyros, an unknown group, a reference of the other kind, a rate that is not finite.
    pub fn push(&mut self, group: usize, rates_arcsec_s: &[f64], reference: Reference) -> Result<(), RatesError> {
        let rejected =
            |expected: String, got: String| Err(RatesError::Window { window: self.windows.len() + 1, expected, got });
        if rates_arcsec_s.len() != self.gyros.len() {
            return rejected(
                format!("a rate for each of {} gyros", self.gyros.len()),
                rates_arcsec_s.len().to_string(),
            );
        }
        if group >= self.groups.len() {
            return rejected(format!("a group of {}", self.groups.len()), format!("group {}", group + 1));
        }
        let references = match reference {
            Reference::Magnitude(rate) => vec![rate],
            Reference::Vector(rates) => rates.to_vec(),
        };
        if !self.windows.is_empty() && self.is_magnitude() != (references.len() == 1) {
            return rejected("a reference like that of the first".to_owned(), format!("{reference:?}"));
        }
        let is_invalid = |rate: &&f64| !(-MAX_RATE_ARCSEC_S..=MAX_RATE_ARCSEC_S).contains(*rate);
        if let Some(rate) = rates_arcsec_s.iter().chain(&references).find(is_invalid) {
            return rejected("rates that are numbers, within 1e12 arcsec/s".to_owned(), rate.to_string());
        }
        self.windows.push(Window { group, rates_arcsec_s: rates_arcsec_s.to_vec(), reference });
        Ok(())
    }

    /// All windows.
    pub fn all(&self) -> &[Window] {
        &self.windows
    }

    /// The windows of one group, and all other windows.
    #[must_use]
    pub(crate) fn split(&self, group: usize) -> [Windows; 2] {
        let (own, others) = self.windows.iter().cloned().partition(|window| window.group == group);
        [own, others].map(|windows| Windows { windows, ..self.clone() })
    }

    /// Cuts a single group into `parts` consecutive groups, so that each can be held out; several groups stay as they are.
    #[must_use]
    pub fn cut(&self, parts: usize) -> Windows {
        let mut cut = self.clone();
        if let [name] = &self.groups[..] {
            cut.groups = (1..=parts).map(|part| format!("{name}, part {part} of {parts}")).collect();
            let count = cut.windows.len().max(1);
            cut.windows.iter_mut().enumerate().for_each(|(index, window)| window.group = index * parts / count);
        }
        cut
    }

    /// True if the reference is a magnitude.
    pub fn is_magnitude(&self) -> bool {
        matches!(self.windows.first(), Some(Window { reference: Reference::Magnitude(_), .. }))
    }

    /// Number of residuals of a window: one for a magnitude, otherwise one for each gyro.
    pub(crate) fn channels(&self) -> usize {
        if self.is_magnitude() { 1 } else { self.gyros.len() }
    }

    /// Number of residuals.
    pub(crate) fn residuals(&self) -> usize {
        self.channels() * self.windows.len()
    }

    /// Number of windows of a group.
    pub(crate) fn count(&self, group: usize) -> usize {
        self.windows.iter().filter(|window| window.group == group).count()
    }

    /// Largest rate of a gyro, arcsec/s.
    pub(crate) fn max_arcsec_s(&self) -> f64 {
        self.windows.iter().flat_map(|window| &window.rates_arcsec_s).fold(0.0, |max, rate| rate.abs().max(max))
    }
}
