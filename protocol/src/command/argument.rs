//! Arguments of a command as text: numbers, or the names in the help.

use super::{ArgumentSpec, CommandSpec};
use crate::field::Gyro;
use crate::suggestion::did_you_mean;

/// Names of a mask of all gyros and of no gyro.
const ALL: &str = "all";
const NONE: &str = "none";

impl ArgumentSpec {
    /// Values and their names, if `meaning` lists them; empty for a number or a mask.
    pub fn choices(&self) -> Vec<(i64, &'static str)> {
        let choice = |part: &'static str| {
            let (value, name) = part.split_once(' ')?;
            Some((value.parse().ok()?, name))
        };
        self.meaning.split(", ").map(choice).collect::<Option<_>>().unwrap_or_default()
    }

    /// Names accepted beside numbers, each with its value; several gyros are separated by commas.
    pub fn names(&self) -> Vec<(i64, &'static str)> {
        if !self.is_mask_of_gyros() {
            return self.choices();
        }
        let gyros = Gyro::ALL.map(|gyro| (i64::from(gyro.bit()), gyro.name()));
        let (min, max) = self.range;
        let whole = [(max, ALL), (0, NONE)].into_iter().filter(|(value, _)| *value >= min);
        gyros.into_iter().chain(whole).collect()
    }

    /// Accepted values, for a help text: `1…15: mask of gyros under test, bit 0 GYRX; or GYRX, …`.
    pub fn usage(&self) -> String {
        let (min, max) = self.range;
        let text = format!("{min}…{max}: {}", self.meaning);
        if !self.is_mask_of_gyros() {
            return text;
        }
        let names: Vec<&str> = self.names().into_iter().map(|(_, name)| name).collect();
        format!("{text}; or {}; several as GYRX,GYRY", names.join(", "))
    }

    fn is_mask_of_gyros(&self) -> bool {
        self.name == "gyros"
    }

    /// Reads a number, decimal or 0x…, or a name in upper or lower case.
    fn read(&self, command: &CommandSpec, text: &str) -> Result<i64, String> {
        if let Some(value) = number(text) {
            return Ok(value);
        }
        let names = self.names();
        let one = |part: &str| {
            let named = names.iter().find(|(_, name)| name.eq_ignore_ascii_case(part.trim()));
            named.map(|(value, _)| *value).ok_or_else(|| {
                let hint = did_you_mean(part, names.iter().map(|(_, name)| name));
                let or_name = if names.is_empty() { "" } else { ", or a name" };
                let (command, name, usage) = (command.name, self.name.to_uppercase(), self.usage());
                let shown: String = part.chars().take(100).collect();
                format!(
                    "{command} {name}: {hint}expected a number, decimal or 0x…, of at most 32 bits{or_name} ({usage}), got {shown:?}"
                )
            })
        };
        if self.is_mask_of_gyros() {
            text.split(',').try_fold(0, |mask, part| Ok(mask | one(part)?))
        } else {
            one(text)
        }
    }
}

/// The payload of the command of this name with arguments as text; see [`super::from_name`].
///
/// # Errors
/// An error of [`super::from_name`], or an argument that is neither a number nor an accepted name.
pub fn written(name: &str, arguments: &[String]) -> Result<Vec<u8>, String> {
    let spec = super::spec(name)?;
    super::expect_count(spec, arguments.len())?;
    let values = spec.arguments.iter().zip(arguments).map(|(argument, text)| argument.read(spec, text));
    super::payload_of(spec, &values.collect::<Result<Vec<_>, _>>()?)
}

fn number(text: &str) -> Option<i64> {
    let (sign, digits) = text.strip_prefix('-').map_or((1, text), |digits| (-1, digits));
    let magnitude = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => u32::from_str_radix(hex, 16).ok()?,
        None => digits.parse().ok()?,
    };
    Some(sign * i64::from(magnitude))
}

#[cfg(test)]
mod tests {
    use super::super::{COMMANDS, Command, parse};
    use super::*;

    fn payload(name: &str, arguments: &[&str]) -> Result<Vec<u8>, String> {
        written(name, &arguments.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn numbers_are_read_in_all_spellings() {
        assert_eq!(["0x0F", "-100", "-0X1", "7"].map(number), [Some(15), Some(-100), Some(-1), Some(7)]);
        assert_eq!(["", "x", "--1", "0x", "5000000000"].map(number), [None; 5]);
    }

    #[test]
    fn every_name_of_the_help_is_accepted_and_in_range() {
        for spec in COMMANDS {
            for (place, argument) in spec.arguments.iter().enumerate() {
                for (value, name) in argument.names() {
                    assert!(argument.usage().contains(name), "{name}");
                    for text in [name.to_owned(), name.to_lowercase()] {
                        let mut arguments: Vec<String> =
                            spec.arguments.iter().map(|argument| argument.range.1.to_string()).collect();
                        arguments[place] = text;
                        let bytes = written(spec.name, &arguments).expect("a name that is listed");
                        assert!(parse(&bytes).is_ok(), "{} {arguments:?}", spec.name);
                        arguments[place] = value.to_string();
                        assert_eq!(written(spec.name, &arguments), Ok(bytes));
                    }
                }
            }
        }
    }

    #[test]
    fn names_of_gyros_are_joined_to_a_mask() {
        assert_eq!(payload("HEATER", &["off"]), Ok(vec![7, 0]));
        assert_eq!(payload("set-mode", &["Polled"]), Ok(vec![2, 1]));
        let test = payload("SELF_TEST", &["GYRX,gyrzb", "-100", "9"]).expect("two gyros");
        assert_eq!(parse(&test), Ok(Command::SelfTest { gyros: 9, counts: -100, samples: 9 }));
        assert_eq!(payload("GYRO_POWER", &["none"]), Ok(vec![6, 0]));
        assert_eq!(payload("GYRO_POWER", &["all"]), Ok(vec![6, 15]));
    }

    #[test]
    fn unknown_names_are_rejected_with_a_suggestion_and_all_names() {
        for (name, arguments, expected) in [
            ("PNIG", &[][..], "did you mean `PING`?"),
            ("HEATER", &["of"], "did you mean `off`?"),
            ("SELF_TEST", &["GYRXX", "1", "1"], "did you mean `GYRX`?"),
            ("SELF_TEST", &["none", "1", "1"], "GYRX, GYRY, GYRZA, GYRZB, all;"),
            ("SELF_TEST", &["GYRX,", "1", "1"], "got \"\""),
            ("SELF_TEST", &["GYRX", "many", "1"], "SELF_TEST COUNTS: expected a number"),
            ("SELF_TEST", &["GYRX"], "got 1 argument"),
            ("PING", &["1"], "expected no arguments"),
        ] {
            let refused = payload(name, arguments).expect_err(name);
            assert!(refused.contains(expected), "{name} {arguments:?}: {refused}");
        }
    }
}
