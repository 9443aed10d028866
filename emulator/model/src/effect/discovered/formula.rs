//! Products of regressors, each with one spelling.

use std::fmt;
use std::str::FromStr;

use super::FORMULA_MEANING;
use super::regressor::{MAGNITUDES, Regressor};

/// Different factors that a formula can have.
pub const MAX_FACTORS: usize = 3;
/// The highest power of a factor.
pub const MAX_POWER: usize = 3;
/// Unit of what a term adds to.
const SENSED_UNIT: &str = "arcsec/s";

/// A product of at most three regressors, each in its power. Formulas that are the same function compare equal, in whatever
/// order and spelling they were written.
///
/// ```
/// use geu_model::effect::discovered::Formula;
/// let formula: Formula = "rate_z * abs(rate_y)^2".parse().expect("two factors that there are");
/// assert_eq!(formula.to_string(), "rate_y^2*rate_z");
/// assert_eq!(formula.unit(), "1/(arcsec/s)^2");
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Formula {
    /// In the order of [`Regressor::ALL`], the empty places behind.
    factors: [Option<Factor>; MAX_FACTORS],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Factor {
    regressor: Regressor,
    power: usize,
}

/// Why something is no formula.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}")]
pub struct NotAFormula {
    /// The expected form.
    pub expected: String,
}

impl NotAFormula {
    fn as_a_whole() -> NotAFormula {
        NotAFormula { expected: format!("a {FORMULA_MEANING}") }
    }
}

impl Formula {
    /// Every product of up to three regressors, a repeated one as a power.
    pub fn all() -> Vec<Formula> {
        let mut products: Vec<Vec<Regressor>> = vec![Vec::new()];
        for _ in 0..MAX_FACTORS {
            let with_one_more = |product: &Vec<Regressor>| {
                let product = product.clone();
                Regressor::ALL.into_iter().map(move |factor| [&product[..], &[factor]].concat())
            };
            let longer: Vec<Vec<Regressor>> = products.iter().flat_map(with_one_more).collect();
            products.extend(longer);
        }
        let mut formulas: Vec<Formula> = products.iter().filter_map(|factors| Formula::new(factors).ok()).collect();
        formulas.sort();
        formulas.dedup();
        formulas
    }

    /// The product of the factors; a repeated factor becomes a power.
    ///
    /// # Errors
    /// None at all, more than three different ones, one in a higher power than the third.
    pub fn new(regressors: &[Regressor]) -> Result<Formula, NotAFormula> {
        let mut powers = [0; Regressor::COUNT];
        regressors.iter().for_each(|regressor| powers[regressor.index()] += 1);
        if powers.iter().any(|&power| power > MAX_POWER) {
            return Err(NotAFormula::as_a_whole());
        }
        // A magnitude squared is the rate squared: the spelling with the smallest number of factors remains.
        for (rate, magnitude) in MAGNITUDES {
            (powers[rate], powers[magnitude]) = match (powers[rate], powers[magnitude]) {
                (0, 2) => (2, 0),
                (1, 2) => (3, 0),
                (1, 3) => (3, 1),
                (2, 1) => (0, 3),
                written => written,
            };
        }
        let mut factors = [None; MAX_FACTORS];
        let given = Regressor::ALL.into_iter().zip(powers).filter(|(_, power)| *power > 0);
        for (index, (regressor, power)) in given.enumerate() {
            *factors.get_mut(index).ok_or_else(NotAFormula::as_a_whole)? = Some(Factor { regressor, power });
        }
        if factors[0].is_none() { Err(NotAFormula::as_a_whole()) } else { Ok(Formula { factors }) }
    }

    /// True if a factor is the time.
    pub fn follows_time(&self) -> bool {
        self.factors.iter().flatten().any(|factor| factor.regressor.name() == "time")
    }

    /// Control axes of the rates and accelerations among the factors.
    pub fn axes(&self) -> impl Iterator<Item = usize> {
        self.factors.iter().flatten().filter_map(|factor| factor.regressor.axis())
    }

    /// Value for these values of the regressors.
    #[inline]
    pub fn value(&self, value: impl Fn(Regressor) -> f64) -> f64 {
        let mut product = 1.0;
        for Factor { regressor, power } in self.factors.iter().flatten() {
            let value = value(*regressor);
            // Products, not `powi`: they are the same on every host.
            (0..*power).for_each(|_| product *= value);
        }
        product
    }

    /// Evaluates [`Formula::value`] for several values of the regressors.
    pub fn values<'a>(&self, values: impl Fn(Regressor) -> &'a [f64], products: &mut [f64]) {
        products.fill(1.0);
        for Factor { regressor, power } in self.factors.iter().flatten() {
            let values = values(*regressor);
            for _ in 0..*power {
                products.iter_mut().zip(values).for_each(|(product, value)| *product *= value);
            }
        }
    }

    /// Unit of a coefficient, which makes a sensed rate of it: `1/(arcsec/s)` for `rate_y^2`.
    pub fn unit(&self) -> String {
        let mut powers: Vec<(&str, usize)> = Vec::new();
        for Factor { regressor, power } in self.factors.iter().flatten() {
            match powers.iter_mut().find(|(unit, _)| *unit == regressor.unit()) {
                Some((_, sum)) => *sum += power,
                None => powers.push((regressor.unit(), *power)),
            }
        }
        let own = powers.iter_mut().find(|(unit, _)| *unit == SENSED_UNIT);
        let over = own.map_or(SENSED_UNIT, |(_, power)| {
            *power -= 1;
            "1"
        });
        let under = powers.iter().filter(|(_, power)| *power > 0).map(|(unit, power)| {
            let unit = if unit.contains('/') { format!("({unit})") } else { (*unit).to_owned() };
            format!("/{unit}{}", raised(*power))
        });
        std::iter::once(over.to_owned()).chain(under).collect()
    }
}

/// A power as it is written.
fn raised(power: usize) -> String {
    if power == 1 { String::new() } else { format!("^{power}") }
}

impl fmt::Display for Formula {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let factors: Vec<String> = self
            .factors
            .iter()
            .flatten()
            .map(|Factor { regressor, power }| format!("{}{}", regressor.name(), raised(*power)))
            .collect();
        f.write_str(&factors.join("*"))
    }
}

impl FromStr for Formula {
    type Err = NotAFormula;

    fn from_str(text: &str) -> Result<Formula, NotAFormula> {
        let mut regressors = Vec::new();
        for factor in text.split('*') {
            let (name, power) = factor.split_once('^').unwrap_or((factor, "1"));
            let Some(regressor) = Regressor::from_name(name.trim()) else {
                let names = Regressor::ALL.map(Regressor::name).join(", ");
                return Err(NotAFormula { expected: format!("one of {names} in place of `{}`", name.trim()) });
            };
            match ["1", "2", "3"].iter().position(|known| *known == power.trim()) {
                Some(index) => regressors.extend(std::iter::repeat_n(regressor, index + 1)),
                None => return Err(NotAFormula { expected: format!("^2, ^3 or nothing behind `{}`", name.trim()) }),
            }
        }
        Formula::new(&regressors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Formula {
        text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    #[test]
    fn what_is_the_same_function_has_one_spelling() {
        for (spellings, expected) in [
            (
                &["rate_y^2", " rate_y ^ 2 ", "rate_y*rate_y", "abs(rate_y)^2", "abs(rate_y)*abs(rate_y)"][..],
                "rate_y^2",
            ),
            (&["rate_z*rate_x", "rate_x*rate_z", "rate_x^1*rate_z"], "rate_x*rate_z"),
            (&["temperature*abs(rate_z)"], "abs(rate_z)*temperature"),
            (&["abs(rate_x)*rate_x"], "rate_x*abs(rate_x)"),
            (&["abs(rate_x)^3", "rate_x^2*abs(rate_x)"], "abs(rate_x)^3"),
            (&["rate_x^3", "rate_x*abs(rate_x)^2"], "rate_x^3"),
            (&["rate_x^3*abs(rate_x)", "rate_x*abs(rate_x)^3"], "rate_x^3*abs(rate_x)"),
            (&["time^3*theta^3*sensor_temperature^3"], "sensor_temperature^3*theta^3*time^3"),
        ] {
            for spelling in spellings {
                assert_eq!(read(spelling).to_string(), expected, "{spelling}");
                assert_eq!(read(spelling), read(expected), "{spelling}");
            }
        }
    }

    /// By trying: formulas of one rate and its magnitude are equal where they are the same function, and only there.
    #[test]
    fn spellings_are_equal_where_functions_are() {
        let [rate, magnitude] = ["rate_x", "abs(rate_x)"].map(|name| Regressor::from_name(name).expect("there"));
        let powers: Vec<(usize, usize)> = (0..16).map(|index| (index / 4, index % 4)).skip(1).collect();
        let formula = |(a, b): (usize, usize)| Formula::new(&[vec![rate; a], vec![magnitude; b]].concat());
        for &(a, b) in &powers {
            for &(c, d) in &powers {
                let same = a + b == c + d && a % 2 == c % 2;
                assert_eq!(formula((a, b)) == formula((c, d)), same, "{a} {b} {c} {d}");
            }
        }
    }

    #[test]
    fn what_is_no_formula_says_what_was_expected() {
        for (text, part) in [
            ("", "one of rate_x, rate_y, rate_z, abs(rate_x)"),
            ("rate_q^2", "sensor_temperature, theta, time in place of `rate_q`"),
            ("rate_x**rate_y", "in place of ``"),
            ("2*rate_x", "in place of `2`"),
            ("rate_x^4", "^2, ^3 or nothing behind `rate_x`"),
            ("rate_x^", "behind `rate_x`"),
            ("rate_x^+2", "behind `rate_x`"),
            ("rate_x^2*rate_x^2", "at most three different factors"),
            ("rate_x*rate_y*rate_z*theta", "at most three different factors"),
        ] {
            let message = text.parse::<Formula>().expect_err(text).to_string();
            assert!(message.starts_with("expected ") && message.contains(part), "{text}: {message}");
        }
        assert!(Formula::new(&[]).is_err());
    }

    #[test]
    fn units_of_coefficients_are_those_worked_out_by_hand() {
        for (formula, unit) in [
            ("rate_y", "1"),
            ("rate_x*rate_z", "1/(arcsec/s)"),
            ("abs(rate_z)*rate_y^2", "1/(arcsec/s)^2"),
            ("temperature", "arcsec/s/K"),
            ("acceleration_x^2*theta", "arcsec/s/(arcsec/s^2)^2/deg"),
            ("abs(rate_z)*temperature*sensor_temperature", "1/K^2"),
        ] {
            assert_eq!(read(formula).unit(), unit, "{formula}");
        }
    }
}
