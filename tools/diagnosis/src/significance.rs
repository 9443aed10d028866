//! Levels of significance that several decisions of a diagnosis share. A decision with another level has a constant of its own.

/// A difference or an amplitude in sigmas that is taken for real: noise exceeds it in 0.3 % of all cases.
pub const THREE_SIGMAS: f64 = 3.0;
/// χ² of that: of a further or rejected hypothesis, of a temperature lag, of a proposed manoeuvre, and of a cross-validation.
pub const THREE_SIGMA_CHI2: f64 = THREE_SIGMAS * THREE_SIGMAS;
/// Level of what is tested often, or not quite normal: a changed calibration parameter, one false alarm in 1000 recordings of 16 of them; the
/// kurtosis, which is skewed; a whole number of counts; a larger walk; an alternative that is excluded.
pub const FOUR_SIGMAS: f64 = 4.0;
/// χ² of that.
pub const FOUR_SIGMA_CHI2: f64 = FOUR_SIGMAS * FOUR_SIGMAS;
/// χ² of two sigma for a decision that excludes nothing: a shape parameter, an exchange, the limits of an onset.
pub const TWO_SIGMA_CHI2: f64 = 4.0;
/// Median of the absolute value of a standard normal variable.
pub const MEDIAN_OF_NORMAL: f64 = 0.674_489_750_196_081_7;
