//! The data: windows, each with the mean rate of every gyro, the reference magnitude and a group.

use geu_model::package::dot;

use crate::model::norm;

/// Product of two unit vectors from which axes are not perpendicular.
const PERPENDICULAR: f64 = 1e-3;

/// A gyro.
#[derive(Debug, Clone, PartialEq)]
pub struct Gyro {
    pub name: String,
    /// Sensitive axis, of length 1.
    pub input: [f64; 3],
}

/// One window.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Index of the group.
    pub group: usize,
    /// Mean rate of each gyro.
    pub rates_arcsec_s: Vec<f64>,
    /// The independent magnitude of the rate.
    pub magnitude_arcsec_s: f64,
}

/// Windows, in time order within each group.
#[derive(Debug, Clone, PartialEq)]
pub struct Windows {
    pub gyros: Vec<Gyro>,
    /// Names of the groups.
    pub groups: Vec<String>,
    windows: Vec<Window>,
}

/// Rates that cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MagnitudeError {
    /// Only perpendicular gyros sense the whole rate, and all errors of it.
    #[error("a reference of magnitudes: expected a unit of three gyros with perpendicular axes, got {got}")]
    Axes {
        /// The gyros.
        got: String,
    },
    /// Too few windows to estimate the noise.
    #[error("expected {expected} windows or more, to separate noise from errors; got {got}")]
    TooFew { expected: usize, got: usize },
}

impl Windows {
    /// Without a window.
    ///
    /// # Errors
    /// [`MagnitudeError::Axes`].
    pub fn new(gyros: Vec<Gyro>) -> Result<Windows, MagnitudeError> {
        let pairs = [(0, 1), (1, 2), (2, 0)];
        let dot = |(one, other): (usize, usize)| dot(gyros[one].input, gyros[other].input).abs();
        if gyros.len() != 3 || pairs.into_iter().map(dot).any(|product| product > PERPENDICULAR) {
            let axis =
                |gyro: &Gyro| format!("{} about {}", gyro.name, gyro.input.map(|part| format!("{part:.2}")).join(" "));
            return Err(MagnitudeError::Axes { got: gyros.iter().map(axis).collect::<Vec<_>>().join(", ") });
        }
        Ok(Windows { gyros, groups: Vec::new(), windows: Vec::new() })
    }

    /// Appends a window with finite rates to the group of that name.
    pub fn push(&mut self, group: &str, rates_arcsec_s: &[f64], magnitude_arcsec_s: f64) {
        let place = self.groups.iter().position(|name| name == group).unwrap_or(self.groups.len());
        if place == self.groups.len() {
            self.groups.push(group.to_owned());
        }
        self.windows.push(Window { group: place, rates_arcsec_s: rates_arcsec_s.to_vec(), magnitude_arcsec_s });
    }

    /// All windows.
    pub fn all(&self) -> &[Window] {
        &self.windows
    }

    /// Checks that the windows suffice for a noise estimate with `spare` of them.
    ///
    /// # Errors
    /// [`MagnitudeError::TooFew`].
    pub(crate) fn check(&self, spare: usize) -> Result<(), MagnitudeError> {
        let expected = self.groups.len() + self.parameters().len() + spare;
        match self.windows.len() {
            got if got < expected => Err(MagnitudeError::TooFew { expected, got }),
            _ => Ok(()),
        }
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

    /// Indices of the windows of each group that has any.
    pub(crate) fn by_group(&self) -> Vec<Vec<usize>> {
        let mut groups = vec![Vec::new(); self.groups.len()];
        self.windows.iter().enumerate().for_each(|(index, window)| groups[window.group].push(index));
        groups.retain(|windows| !windows.is_empty());
        groups
    }

    /// Largest rate of a gyro, arcsec/s.
    pub(crate) fn max_arcsec_s(&self) -> f64 {
        self.windows.iter().flat_map(|window| &window.rates_arcsec_s).fold(0.0, |max, rate| rate.abs().max(max))
    }

    /// The windows, and `count` windows of a spin of which the gyros measure these rates, as a group.
    pub(crate) fn with_spin(&self, spin_arcsec_s: [f64; 3], rates_arcsec_s: &[f64], count: usize) -> Windows {
        let mut with = self.clone();
        let (group, magnitude_arcsec_s) = (self.groups.len(), norm(&spin_arcsec_s));
        let window = Window { group, rates_arcsec_s: rates_arcsec_s.to_vec(), magnitude_arcsec_s };
        with.groups.push("manoeuvre".to_owned());
        with.windows.extend(std::iter::repeat_n(window, count));
        with
    }
}
