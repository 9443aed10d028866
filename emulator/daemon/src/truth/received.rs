//! `received.csv`: the truth that was used in a run on a truth from outside, and makes the same run again.
//!
//! A row ends a piece of constant rates: true time since the start, rotation about the control axes since then with all its
//! digits, and what the piece rests on. Nothing comes from the wall clock.

use std::io::{self, Write};

use geu_model::attitude::{Basis, Knot, Stepped};
use geu_protocol::excerpt::excerpt;

/// Its name beside `run.toml`.
pub const NAME: &str = "received.csv";
/// Its first line.
pub const HEADER: &str = "t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis";
/// A number of it that is beyond this is none.
const MOST: f64 = 1e15;

/// Why a file is no such truth.
#[derive(Debug, thiserror::Error)]
pub enum ReceivedError {
    /// It cannot be read to its end.
    #[error("{name}: cannot be read: {source}; expected the received.csv of a run")]
    Read {
        /// The file.
        name: String,
        /// The reason.
        source: io::Error,
    },
    /// A line that is no row.
    #[error(
        "{name}: line {line}: expected {HEADER} with times that rise, got {got:?}; the file is as a run wrote it, or not usable"
    )]
    Line {
        /// The file.
        name: String,
        /// Line, from 1.
        line: usize,
        /// What stands there.
        got: String,
    },
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

/// Whether a file with this first line is such a file.
pub fn is_received(first_line: &str) -> bool {
    first_line.trim() == HEADER
}

/// Reads a file's lines; errors call it `name`.
///
/// # Errors
/// The first line that is no row, or cannot be read.
pub fn parse(name: &str, lines: impl Iterator<Item = io::Result<String>>) -> Result<Stepped, ReceivedError> {
    let truth = Stepped::default();
    for (index, line) in lines.enumerate() {
        let line = line.map_err(|source| ReceivedError::Read { name: name.to_owned(), source })?;
        let is_good = if index == 0 { is_received(&line) } else { append(&truth, &line).is_some() };
        if !is_good {
            let got = excerpt(&line).into_owned();
            return Err(ReceivedError::Line { name: name.to_owned(), line: index + 1, got });
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

    fn parse_text(text: &str) -> Result<Stepped, ReceivedError> {
        parse("received.csv", text.lines().map(|line| Ok(line.to_owned())))
    }

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
        let truth = parse_text(str::from_utf8(&file).expect("text")).expect("good rows");
        assert_eq!(truth.knots_from(1), knots);
    }

    #[test]
    fn a_line_that_is_no_row_is_told_with_its_number() {
        for (row, line) in [("0.5,1,2,3", 3), ("0.1,1,2,3,told", 3), ("0.5,1,nan,3,told", 3), ("0.5,1,2,3,guessed", 3)]
        {
            let text = format!("{HEADER}\n0.1,0,0,0,told\n{row}\n");
            let message = parse_text(&text).expect_err(row).to_string();
            assert!(message.starts_with(&format!("received.csv: line {line}: expected t_s,")), "{message}");
        }
    }
}
