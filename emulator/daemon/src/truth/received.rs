//! `received.csv`: the truth that was used in a run on a truth from outside, and makes the same run again.
//!
//! A row ends a piece of constant rates: true time since the start, rotation about the control axes since then with all its
//! digits, and what the piece rests on. Nothing comes from the wall clock.

use std::io::{self, Write};

use geu_model::attitude::{Basis, Knot, Stepped};

/// Its name beside `run.toml`.
pub const NAME: &str = "received.csv";
/// Its first line.
pub const HEADER: &str = "t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis";
/// A number of it that is beyond this is none.
const MOST: f64 = 1e15;

/// A line that is no row.
#[derive(Debug, thiserror::Error)]
#[error(
    "{name}: line {line}: expected {HEADER} with times that rise, got {got:?}; the file is as a run wrote it, or not usable"
)]
pub struct ReceivedError {
    name: String,
    line: usize,
    got: String,
}

/// Writes a row.
///
/// # Errors
/// Those of the file.
pub fn write_row(file: &mut impl Write, knot: &Knot) -> io::Result<()> {
    let mut digits = zmij::Buffer::new();
    file.write_all(digits.format(knot.t_s).as_bytes())?;
    for angle in knot.angle_control_arcsec {
        file.write_all(b",")?;
        file.write_all(digits.format(angle).as_bytes())?;
    }
    let word = Basis::WORDS.iter().find(|(basis, _)| *basis == knot.basis).map_or("", |(_, word)| word);
    writeln!(file, ",{word}")
}

/// Whether a text begins as such a file does.
pub fn is_received(text: &str) -> bool {
    text.lines().next().is_some_and(|line| line.trim() == HEADER)
}

/// Reads a file's text; errors call it `name`.
///
/// # Errors
/// The first line that is no row.
pub fn parse(name: &str, text: &str) -> Result<Stepped, ReceivedError> {
    let truth = Stepped::default();
    for (index, line) in text.lines().enumerate() {
        let is_good = if index == 0 { line.trim() == HEADER } else { append(&truth, line).is_some() };
        if !is_good {
            let got = line.chars().take(80).collect();
            return Err(ReceivedError { name: name.to_owned(), line: index + 1, got });
        }
    }
    Ok(truth)
}

fn append(truth: &Stepped, line: &str) -> Option<()> {
    let mut fields = line.trim().split(',');
    let mut numbers = [0.0; 4];
    for number in &mut numbers {
        *number = fields.next()?.parse().ok().filter(|number: &f64| number.abs() <= MOST)?;
    }
    let [t_s, x, y, z] = numbers;
    let word = fields.next().filter(|_| fields.next().is_none())?;
    let &(basis, _) = Basis::WORDS.iter().find(|(_, known)| *known == word)?;
    (t_s > truth.end_s()).then(|| truth.append(Knot { t_s, angle_control_arcsec: [x, y, z], basis }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_reads_back_to_the_last_bit() {
        let knots: Vec<Knot> = (1..=100)
            .map(|index| {
                let t_s = f64::from(index) * 0.1;
                let basis = Basis::WORDS[index as usize % 3].0;
                Knot { t_s, angle_control_arcsec: [t_s.sin() * 1e6, 1.0 / t_s, -0.0], basis }
            })
            .collect();
        let mut file = format!("{HEADER}\n").into_bytes();
        knots.iter().for_each(|knot| write_row(&mut file, knot).expect("memory"));
        let truth = parse("received.csv", str::from_utf8(&file).expect("text")).expect("good rows");
        assert_eq!(truth.knots_from(1), knots);
    }

    #[test]
    fn a_line_that_is_no_row_is_told_with_its_number() {
        for (row, line) in [("0.5,1,2,3", 3), ("0.1,1,2,3,told", 3), ("0.5,1,nan,3,told", 3), ("0.5,1,2,3,guessed", 3)]
        {
            let text = format!("{HEADER}\n0.1,0,0,0,told\n{row}\n");
            let message = parse("received.csv", &text).expect_err(row).to_string();
            assert!(message.starts_with(&format!("received.csv: line {line}: expected t_s,")), "{message}");
        }
    }
}
