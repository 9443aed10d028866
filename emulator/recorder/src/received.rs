//! `received.csv`: the truth used in a run with external truth; it reproduces the run.
//!
//! A row ends an interval of constant rates: true time since the start, rotation about the control axes since then with all
//! digits, and the basis of the interval; if the source sends the sun, also θ and ψ at this time and the rotations about X
//! and Y that the sun sensor sees ([`Sun`]). No value depends on the wall clock.

use std::io::{self, Write};

use geu_model::attitude::{Knot, SampleQuality, StreamedAttitude, Sun};
use geu_protocol::excerpt::excerpt;

/// File name in a recording.
pub const NAME: &str = "received.csv";
/// First line, without the sun.
const HEADER: &str = "t_s,angle_x_arcsec,angle_y_arcsec,angle_z_arcsec,basis";
/// Rest of the first line if the source sends the sun.
const SUN_HEADER: &str = ",theta_rad,psi_rad,turn_x_arcsec,turn_y_arcsec";
/// Maximum absolute value.
const MAX_VALUE: f64 = 1e15;

/// A file that is no `received.csv`.
#[derive(Debug, thiserror::Error)]
pub enum ReceivedError {
    /// The file cannot be read.
    #[error("{name}: cannot be read: {source}; expected the received.csv of a run")]
    Read {
        /// The file.
        name: String,
        /// The reason.
        source: io::Error,
    },
    /// An invalid line.
    #[error(
        "{name}: line {line}: expected {HEADER}, and {SUN_HEADER} in all lines or in none, with times that rise, got {got:?}; the file is as a run wrote it, or not usable"
    )]
    Line {
        /// The file.
        name: String,
        /// Line, from 1.
        line: usize,
        /// The line.
        got: String,
    },
}

/// Writes the first line.
///
/// # Errors
/// Those of the file.
pub fn write_header(file: &mut impl Write, has_sun: bool) -> io::Result<()> {
    writeln!(file, "{HEADER}{}", if has_sun { SUN_HEADER } else { "" })
}

/// Writes a row.
///
/// # Errors
/// Those of the file.
pub fn write_row(file: &mut impl Write, knot: &Knot) -> io::Result<()> {
    let mut digits = zmij::Buffer::new();
    let [x, y, z] = knot.angle_control_arcsec;
    for number in [knot.t_s, x, y, z] {
        file.write_all(digits.format(number).as_bytes())?;
        file.write_all(b",")?;
    }
    let word = SampleQuality::WORDS.iter().find(|(basis, _)| *basis == knot.basis).map_or("", |(_, word)| word);
    file.write_all(word.as_bytes())?;
    if let Some(Sun { theta_rad, psi_rad, departure_control_arcsec: [turn_x, turn_y] }) = knot.sun {
        for number in [theta_rad, psi_rad, turn_x, turn_y] {
            file.write_all(b",")?;
            file.write_all(digits.format(number).as_bytes())?;
        }
    }
    writeln!(file)
}

/// True if this is the first line of a `received.csv`.
pub fn is_received(first_line: &str) -> bool {
    has_sun(first_line).is_some()
}

/// True if the rows contain the sun; `None` if `line` is no first line.
fn has_sun(line: &str) -> Option<bool> {
    match line.trim().strip_prefix(HEADER)? {
        "" => Some(false),
        SUN_HEADER => Some(true),
        _ => None,
    }
}

/// Reads the lines of the file `name`.
///
/// # Errors
/// The first invalid or unreadable line.
pub fn parse(name: &str, lines: impl Iterator<Item = io::Result<String>>) -> Result<StreamedAttitude, ReceivedError> {
    let (truth, mut with_sun) = (StreamedAttitude::default(), None);
    for (index, line) in lines.enumerate() {
        let line = line.map_err(|source| ReceivedError::Read { name: name.to_owned(), source })?;
        let is_valid = match with_sun {
            None => {
                with_sun = has_sun(&line);
                with_sun.is_some()
            }
            Some(with_sun) => append(&truth, &line, with_sun).is_some(),
        };
        if !is_valid {
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
        *number = fields.next()?.parse().ok().filter(|number: &f64| number.abs() <= MAX_VALUE)?;
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
    fn rows_read_back_to_the_last_bit() {
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
    fn invalid_lines_are_reported_with_their_number() {
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
