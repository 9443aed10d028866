//! Contenders measured in rounds: each round runs every contender once, so that all have the same number of runs and meet the same
//! load. What is told of each is the least, the median and the largest of its runs; of two, the ratios within the rounds.

use std::fmt;

use clap::{Args, value_parser};

use crate::failure::CommandError;

/// How often each contender runs.
#[derive(Args, Clone, Copy)]
pub struct Rounds {
    /// Runs of every contender, ours and others alike, one after another in turn
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = value_parser!(u32).range(1..))]
    runs: u32,
}

/// One run, or why it cannot be.
type Run<'a, T> = Box<dyn FnMut() -> Result<T, String> + 'a>;

/// What is measured.
pub struct Contender<'a, T> {
    /// As it is printed.
    pub name: String,
    /// Another tool may be absent, and is left out then; ours may not fail.
    is_ours: bool,
    run: Run<'a, T>,
}

/// What the runs of a contender gave, a result a round; or why there are none.
pub struct Results<T> {
    /// Its name.
    pub name: String,
    /// In the order of the rounds.
    pub runs: Result<Vec<T>, String>,
}

impl<'a, T> Contender<'a, T> {
    /// Of this program.
    pub fn ours(name: impl Into<String>, run: impl FnMut() -> Result<T, String> + 'a) -> Contender<'a, T> {
        Contender { name: name.into(), is_ours: true, run: Box::new(run) }
    }

    /// Another tool, which may not be installed.
    pub fn other(name: impl Into<String>, run: impl FnMut() -> Result<T, String> + 'a) -> Contender<'a, T> {
        Contender { name: name.into(), is_ours: false, run: Box::new(run) }
    }
}

impl Rounds {
    /// How many.
    pub fn count(self) -> u32 {
        self.runs
    }

    /// Runs everybody in each round, each round beginning with another one, so that nobody always follows the same neighbour.
    ///
    /// # Errors
    /// A run of ours that fails.
    pub fn measure<T>(self, mut contenders: Vec<Contender<T>>) -> Result<Vec<Results<T>>, CommandError> {
        let count = contenders.len();
        let mut results: Vec<Results<T>> =
            contenders.iter().map(|one| Results { name: one.name.clone(), runs: Ok(Vec::new()) }).collect();
        for round in 0..self.runs as usize {
            for place in 0..count {
                let index = (round + place) % count;
                let Ok(runs) = &mut results[index].runs else { continue };
                match (contenders[index].run)() {
                    Ok(result) => runs.push(result),
                    Err(reason) if contenders[index].is_ours => {
                        return Err(CommandError::failed(format!("{}: {reason}", contenders[index].name)));
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
        write!(f, "{} runs each in turn; median (least…largest)", self.runs)
    }
}

/// The least, the median and the largest of some numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    pub least: f64,
    pub median: f64,
    pub largest: f64,
}

impl Spread {
    /// Of these; NaN of none.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Spread {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let (middle, last) = (values.len() / 2, values.len().saturating_sub(1));
        let median = if values.len() % 2 == 1 { at(middle) } else { 0.5 * (at(last / 2) + at(middle)) };
        Spread { least: at(0), median, largest: at(last) }
    }

    /// Of the ratios of two contenders, round by round: both met the load of that round.
    pub fn of_ratios(over: &[f64], under: &[f64]) -> Spread {
        Spread::of(over.iter().zip(under).map(|(over, under)| over / under))
    }
}

impl fmt::Display for Spread {
    /// `median (least…largest)`, with the decimals and the width asked for.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let decimals = f.precision().unwrap_or(1);
        let text = format!("{:.decimals$} ({:.decimals$}…{:.decimals$})", self.median, self.least, self.largest);
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
    fn everybody_runs_once_in_each_round_and_who_is_absent_is_asked_once() {
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
    fn ours_that_fails_is_a_failure() {
        let contenders = vec![Contender::<f64>::ours("a", || Err("broken".to_owned()))];
        assert!(Rounds { runs: 1 }.measure(contenders).is_err());
    }

    #[test]
    fn a_spread_is_that_of_its_numbers_and_a_ratio_is_taken_within_a_round() {
        assert_eq!(Spread::of([3.0, 1.0, 2.0]), Spread { least: 1.0, median: 2.0, largest: 3.0 });
        assert_eq!(Spread::of([4.0, 1.0, 2.0, 3.0]).median, 2.5);
        assert!(Spread::of([]).median.is_nan());
        // The second round met twice the load, the ratio did not.
        assert_eq!(Spread::of_ratios(&[4.0, 8.0], &[1.0, 2.0]), Spread { least: 4.0, median: 4.0, largest: 4.0 });
        assert_eq!(format!("{:>18.2}", Spread::of([1.0, 2.0])), "  1.50 (1.00…2.00)");
    }
}
