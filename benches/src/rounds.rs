//! Contenders measured in rounds: each round runs every contender once, so that all have the same number of runs under the
//! same load. The result of a contender is the minimum, median and maximum of its runs; of two, the ratios within the rounds.

use std::fmt;

use clap::{Args, value_parser};

use crate::Result;

/// Number of rounds.
#[derive(Args, Clone, Copy)]
pub struct Rounds {
    /// Runs of every contender, one after another in turn
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = value_parser!(u32).range(1..))]
    runs: u32,
}

/// A run, or the reason for which it is not possible.
type Run<'a, T> = Box<dyn FnMut() -> Result<T, String> + 'a>;

/// A measured program.
pub struct Contender<'a, T> {
    /// Printed name.
    pub name: String,
    /// Other tools are left out if they fail; ours may not fail.
    is_ours: bool,
    run: Run<'a, T>,
}

/// Results of a contender, one for each round, or the reason for which there are none.
pub struct Results<T> {
    pub name: String,
    /// In the order of the rounds.
    pub runs: Result<Vec<T>, String>,
}

impl<'a, T> Contender<'a, T> {
    /// A part of GEU.
    pub fn ours(name: impl Into<String>, run: impl FnMut() -> Result<T, String> + 'a) -> Contender<'a, T> {
        Contender { name: name.into(), is_ours: true, run: Box::new(run) }
    }

    /// Another tool, which may not be installed.
    pub fn other(name: impl Into<String>, run: impl FnMut() -> Result<T, String> + 'a) -> Contender<'a, T> {
        Contender { name: name.into(), is_ours: false, run: Box::new(run) }
    }
}

impl Rounds {
    pub fn count(self) -> u32 {
        self.runs
    }

    /// Runs every contender in each round; each round starts with another contender.
    ///
    /// # Errors
    /// A run of ours fails.
    pub fn measure<T>(self, mut contenders: Vec<Contender<T>>) -> Result<Vec<Results<T>>> {
        let count = contenders.len();
        let mut results: Vec<Results<T>> =
            contenders.iter().map(|one| Results { name: one.name.clone(), runs: Ok(Vec::new()) }).collect();
        for round in 0..self.runs as usize {
            for position in 0..count {
                let index = (round + position) % count;
                let Ok(runs) = &mut results[index].runs else { continue };
                match (contenders[index].run)() {
                    Ok(result) => runs.push(result),
                    Err(reason) if contenders[index].is_ours => {
                        return Err(format!("{}: {reason}", contenders[index].name).into());
                    }
                    Err(reason) => results[index].runs = Err(reason),
                }
            }
        }
        Ok(results)
    }
}

impl fmt::Display for Rounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} runs each in turn; median (min…max)", self.runs)
    }
}

/// Minimum, median and maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    pub min: f64,
    pub median: f64,
    pub max: f64,
}

impl Spread {
    /// Spread of `values`; NaN if there are none.
    pub fn new(values: impl IntoIterator<Item = f64>) -> Spread {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let (middle, last) = (values.len() / 2, values.len().saturating_sub(1));
        let median = if values.len() % 2 == 1 { at(middle) } else { 0.5 * (at(last / 2) + at(middle)) };
        Spread { min: at(0), median, max: at(last) }
    }

    /// Spread of the ratios of two contenders within each round, under the same load.
    pub fn of_ratios(over: &[f64], under: &[f64]) -> Spread {
        Spread::new(over.iter().zip(under).map(|(over, under)| over / under))
    }
}

impl fmt::Display for Spread {
    /// `median (min…max)`, with the precision and the width of the format.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decimals = f.precision().unwrap_or(1);
        let text = match f.sign_plus() {
            true => format!("{:+.decimals$} ({:+.decimals$}…{:+.decimals$})", self.median, self.min, self.max),
            false => format!("{:.decimals$} ({:.decimals$}…{:.decimals$})", self.median, self.min, self.max),
        };
        match f.width() {
            Some(width) => write!(f, "{text:>width$}"),
            None => f.write_str(&text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn contenders_run_once_in_each_round_and_absent_ones_are_tried_once() {
        let order = RefCell::new(String::new());
        let run = |letter: char| {
            let order = &order;
            move || {
                order.borrow_mut().push(letter);
                if letter == 'c' { Err("not installed".to_owned()) } else { Ok(letter) }
            }
        };
        let contenders =
            vec![Contender::ours("a", run('a')), Contender::ours("b", run('b')), Contender::other("c", run('c'))];
        let results = Rounds { runs: 4 }.measure(contenders).expect("ours do not fail");
        assert_eq!(*order.borrow(), "abc".to_owned() + "ba" + "ab" + "ab");
        let runs: Vec<_> = results.iter().map(|one| one.runs.clone()).collect();
        assert_eq!(runs, [Ok(vec!['a'; 4]), Ok(vec!['b'; 4]), Err("not installed".to_owned())]);
    }

    #[test]
    fn failure_of_ours_is_an_error() {
        let contenders = vec![Contender::<f64>::ours("a", || Err("broken".to_owned()))];
        assert!(Rounds { runs: 1 }.measure(contenders).is_err());
    }

    #[test]
    fn spread_has_min_median_max_and_ratios_are_within_a_round() {
        assert_eq!(Spread::new([3.0, 1.0, 2.0]), Spread { min: 1.0, median: 2.0, max: 3.0 });
        assert_eq!(Spread::new([4.0, 1.0, 2.0, 3.0]).median, 2.5);
        assert!(Spread::new([]).median.is_nan());
        // The second round has twice the load and the same ratio.
        assert_eq!(Spread::of_ratios(&[4.0, 8.0], &[1.0, 2.0]), Spread { min: 4.0, median: 4.0, max: 4.0 });
        assert_eq!(format!("{:>18.2}", Spread::new([1.0, 2.0])), "  1.50 (1.00…2.00)");
    }
}
