//! `received.csv`: the truth that was used in a run on a truth from outside, and makes the same run again.
//!
//! A row ends a piece of constant rates: true time since the start, rotation about the control axes since then with all its
//! digits, and what the piece rests on; where the source tells the sun, θ and ψ at the row's time and the turns about X and Y
//! that the sun sensor sees beside them ([`Sun`]). Nothing comes from the wall clock.

use std::io::{self, Write};

use geu_model::attitude::{Knot, SampleQuality, StreamedAttitude, Sun};
use geu_protocol::excerpt::excerpt;

/// Its name beside `run.toml`.
pub const NAME: &str = "received.csv";
/// Its first line, without the sun.
const HEADER: &str = "t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis";
/// What its first line has more where the source tells the sun.
const SUN_HEADER: &str = ",theta_rad,psi_rad,turn_x_arcsec,turn_y_arcsec";
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
        "{name}: line {line}: expected {HEADER}, and {SUN_HEADER} in all lines or in none, with times that rise, got {got:?}; the file is as a run wrote it, or not usable"
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

/// Writes the first line.
///
/// # Errors
/// Those of the file.
pub fn write_header(file: &mut impl Write, tells_sun: bool) -> io::Result<()> {
    writeln!(file, "{HEADER}{}", if tells_sun { SUN_HEADER } else { "" })
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
    let word = SampleQuality::WORDS.iter().find(|(basis, _)| *basis == knot.basis).map_or("", |(_, word)| word);
    write!(file, ",{word}")?;
    if let Some(Sun { theta_rad, psi_rad, departure_control_arcsec: [turn_x, turn_y] }) = knot.sun {
        for number in [theta_rad, psi_rad, turn_x, turn_y] {
            file.write_all(b",")?;
            file.write_all(digits.format(number).as_bytes())?;
        }
    }
    writeln!(file)
}

/// Whether a file with this first line is such a file.
pub fn is_received(first_line: &str) -> bool {
    tells_sun(first_line).is_some()
}

/// Of a first line, whether the sun stands in the rows; nothing of another line.
fn tells_sun(line: &str) -> Option<bool> {
    match line.trim().strip_prefix(HEADER)? {
        "" => Some(false),
        SUN_HEADER => Some(true),
        _ => None,
    }
}

/// Reads a file's lines; errors call it `name`.
///
/// # Errors
/// The first line that is no row, or cannot be read.
pub fn parse(name: &str, lines: impl Iterator<Item = io::Result<String>>) -> Result<StreamedAttitude, ReceivedError> {
    let (truth, mut has_sun) = (StreamedAttitude::default(), None);
    for (index, line) in lines.enumerate() {
        let line = line.map_err(|source| ReceivedError::Read { name: name.to_owned(), source })?;
        let is_good = match has_sun {
            None => {
                has_sun = tells_sun(&line);
                has_sun.is_some()
            }
            Some(has_sun) => append(&truth, &line, has_sun).is_some(),
        };
        if !is_good {
            let got = excerpt(&line).into_owned();
            return Err(ReceivedError::Line { name: name.to_owned(), line: index + 1, got });
        }
    }
    Ok(truth)
}

fn append(truth: &StreamedAttitude, line: &str, has_sun: bool) -> Option<()> {
    let mut fields = line.trim().split(',');
    let [t_s, x, y, z] = four_numbers(&mut fields)?;
    let word = fields.next()?;
    let &(basis, _) = SampleQuality::WORDS.iter().find(|(_, known)| *known == word)?;
    let sun = match has_sun {
        false => None,
        true => {
            let [theta_rad, psi_rad, turn_x, turn_y] = four_numbers(&mut fields)?;
            Some(Sun { theta_rad, psi_rad, departure_control_arcsec: [turn_x, turn_y] })
        }
    };
    let is_row = fields.next().is_none() && t_s > truth.end_s();
    is_row.then(|| truth.append(Knot { t_s, angle_control_arcsec: [x, y, z], basis, sun }))
}

fn four_numbers<'a>(fields: &mut impl Iterator<Item = &'a str>) -> Option<[f64; 4]> {
    let mut numbers = [0.0; 4];
    for number in &mut numbers {
        *number = fields.next()?.parse().ok().filter(|number: &f64| number.abs() <= MOST)?;
    }
    Some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_text(text: &str) -> Result<StreamedAttitude, ReceivedError> {
        parse("received.csv", text.lines().map(|line| Ok(line.to_owned())))
    }

    #[test]
    fn what_was_written_reads_back_to_the_last_bit() {
        for has_sun in [false, true] {
            let knots: Vec<Knot> = (1..=100)
                .map(|index| {
                    let t_s = f64::from(index) * 0.1;
                    let basis = SampleQuality::WORDS[index as usize % 3].0;
                    let sun = Sun { theta_rad: t_s.cos(), psi_rad: -t_s, departure_control_arcsec: [t_s.exp(), 1e-9] };
                    let angle_control_arcsec = [t_s.sin() * 1e6, 1.0 / t_s, -0.0];
                    Knot { t_s, angle_control_arcsec, basis, sun: has_sun.then_some(sun) }
                })
                .collect();
            let mut file = Vec::new();
            write_header(&mut file, has_sun).expect("memory");
            knots.iter().for_each(|knot| write_row(&mut file, knot).expect("memory"));
            let text = str::from_utf8(&file).expect("text");
            assert!(is_received(text.lines().next().expect("a line")));
            assert_eq!(parse_text(text).expect("good rows").knots_from(1), knots);
        }
    }

    #[test]
    fn a_line_that_is_no_row_is_told_with_its_number() {
        for (row, line) in [
            ("0.5,1,2,3", 3),
            ("0.1,1,2,3,told", 3),
            ("0.5,1,nan,3,told", 3),
            ("0.5,1,2,3,guessed", 3),
            ("0.5,1,2,3,told,1,0,0,0", 3),
        ] {
            let text = format!("{HEADER}\n0.1,0,0,0,told\n{row}\n");
            let message = parse_text(&text).expect_err(row).to_string();
            assert!(message.starts_with(&format!("received.csv: line {line}: expected t_s,")), "{message}");
        }
    }
}
