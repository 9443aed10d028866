//! Conditions as text: `abs(rate_y) > 700 and not valid(GYRX)`. What starts and ends a fault, and what is expected.
//!
//! Numbers with `+ - * / %`, compared by `< <= > >= == !=`; conditions joined by `not`, `and`, `or`; brackets. What a name
//! means stands once, in the tables of variables and functions. It is evaluated at the start of a sample interval.

mod reader;

use std::fmt;

use geu_protocol::Gyro;

use crate::device::Device;
use crate::gyro_unit::Outputs;
use reader::Reader;

const MAX_LENGTH: usize = 500;
/// Most brackets and signs within each other.
const MAX_DEPTH: usize = 40;

/// Inputs of a condition at the start of a sample interval.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ConditionInputs {
    /// On-board time since the start of the run.
    pub t_s: f64,
    /// Index of the sample that begins, from 0.
    pub frame: u64,
    /// Sequence of the sample that begins.
    pub sequence: u16,
    /// Inertial rates about the control axes.
    pub rate_arcsec_s: [f64; 3],
    /// Solar aspect angle; NaN if the truth does not have it.
    pub theta_deg: f64,
    /// Angle about the sun vector; NaN if the truth does not have it.
    pub psi_deg: f64,
    pub electronics_c: f64,
    pub sensor_c: f64,
    pub is_polled: bool,
    /// Outputs of the sample that ended last.
    pub outputs: Outputs,
    /// Opcodes of the commands that it brought.
    pub commands: Vec<u8>,
    /// Identifiers of the faults that acted in it.
    pub active: Vec<String>,
}

/// Type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sort {
    Number,
    Condition,
}

/// Names, what they mean, and their values.
type Variable = (&'static str, &'static str, fn(&ConditionInputs) -> f64);

const VARIABLES: &[Variable] = &[
    ("t_s", "on-board time since the start", |now| now.t_s),
    ("frame", "index of the sample that begins, from 0", |now| now.frame as f64),
    ("sequence", "its sequence number", |now| f64::from(now.sequence)),
    ("rate_x", "true rate about X, arcsec/s", |now| now.rate_arcsec_s[0]),
    ("rate_y", "true rate about Y, arcsec/s", |now| now.rate_arcsec_s[1]),
    ("rate_z", "true rate about Z, arcsec/s", |now| now.rate_arcsec_s[2]),
    ("theta_deg", "solar aspect angle", |now| now.theta_deg),
    ("psi_deg", "angle about the sun vector", |now| now.psi_deg),
    ("electronics_c", "electronics temperature, degC", |now| now.electronics_c),
    ("sensor_c", "sensor temperature, degC", |now| now.sensor_c),
    ("polled", "1 in polled mode, else 0", |now| f64::from(u8::from(now.is_polled))),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Takes {
    Number,
    Gyro,
    Command,
    Fault,
}

/// Every function: name, what it takes and gives, meaning.
const FUNCTIONS: &[(&str, Takes, Sort, &str)] = &[
    ("abs", Takes::Number, Sort::Number, "magnitude"),
    ("count", Takes::Gyro, Sort::Number, "the gyro's last increment"),
    ("valid", Takes::Gyro, Sort::Condition, "whether its last increment was flagged valid"),
    ("saturated", Takes::Gyro, Sort::Condition, "whether it was flagged saturated"),
    ("command", Takes::Command, Sort::Condition, "whether the last sample brought this command, valid or not"),
    ("active", Takes::Fault, Sort::Condition, "whether the fault of this identifier acted in the last sample interval"),
];

/// The names that an expression may hold, each with its meaning.
pub fn vocabulary() -> Vec<(String, &'static str)> {
    let variables = VARIABLES.iter().map(|(name, meaning, _)| ((*name).to_owned(), *meaning));
    let functions = FUNCTIONS.iter().map(|(name, takes, _, meaning)| {
        let argument = match takes {
            Takes::Number => "number",
            Takes::Gyro => "GYRX",
            Takes::Command => "SET_MODE",
            Takes::Fault => "\"fault-1\"",
        };
        (format!("{name}({argument})"), *meaning)
    });
    variables.chain(functions).collect()
}

#[derive(Debug, Clone, PartialEq)]
enum Node {
    Constant(f64),
    Variable(usize),
    Negated(Box<Node>),
    Not(Box<Node>),
    Operation(Box<Node>, usize, Box<Node>),
    Magnitude(Box<Node>),
    Count(Gyro),
    Valid(Gyro),
    Saturated(Gyro),
    Command(u8),
    Active(String),
}

/// A condition, and the text it was read from.
#[derive(Debug, Clone, PartialEq)]
pub struct Expression {
    text: String,
    root: Node,
}

impl fmt::Display for Expression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// Precedence, text, type of the operands, type of the result, and function. A condition is 1, 0, or NaN if
/// it depends on an unknown value.
type Operator = (usize, &'static str, Sort, Sort, fn(f64, f64) -> f64);

/// Operators by how tightly they bind, the loosest first.
const OPERATORS: &[Operator] = &[
    (0, "or", Sort::Condition, Sort::Condition, either),
    (1, "and", Sort::Condition, Sort::Condition, |a, b| not(either(not(a), not(b)))),
    (2, "<=", Sort::Number, Sort::Condition, |a, b| compared(a, b, a <= b)),
    (2, ">=", Sort::Number, Sort::Condition, |a, b| compared(a, b, a >= b)),
    (2, "==", Sort::Number, Sort::Condition, |a, b| compared(a, b, a == b)),
    (2, "!=", Sort::Number, Sort::Condition, |a, b| compared(a, b, a != b)),
    (2, "<", Sort::Number, Sort::Condition, |a, b| compared(a, b, a < b)),
    (2, ">", Sort::Number, Sort::Condition, |a, b| compared(a, b, a > b)),
    (3, "+", Sort::Number, Sort::Number, |a, b| a + b),
    (3, "-", Sort::Number, Sort::Number, |a, b| a - b),
    (4, "*", Sort::Number, Sort::Number, |a, b| a * b),
    (4, "/", Sort::Number, Sort::Number, |a, b| a / b),
    (4, "%", Sort::Number, Sort::Number, |a, b| a % b),
];
const LEVELS: usize = 5;

fn truth(value: bool) -> f64 {
    f64::from(u8::from(value))
}

fn compared(a: f64, b: f64, holds: bool) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { truth(holds) }
}

fn not(condition: f64) -> f64 {
    1.0 - condition
}

/// True if either is true, even if the other is unknown.
fn either(a: f64, b: f64) -> f64 {
    if a == 1.0 || b == 1.0 { 1.0 } else { a + b }
}

impl Expression {
    /// True if it holds for certain; a condition with an unknown value does not hold, nor does its negation.
    pub fn holds(&self, now: &ConditionInputs) -> bool {
        self.root.value(now) == 1.0
    }

    /// Identifiers of the faults that it asks about.
    pub fn faults(&self) -> Vec<&str> {
        let ids = self.root.all().into_iter().filter_map(|node| match node {
            Node::Active(id) => Some(id.as_str()),
            _ => None,
        });
        ids.collect()
    }

    /// Names of the variables that it asks about, and `command` where it asks about one.
    pub fn asks_about(&self) -> Vec<&'static str> {
        let names = self.root.all().into_iter().filter_map(|node| match node {
            Node::Variable(index) => Some(VARIABLES[*index].0),
            Node::Command(_) => Some("command"),
            _ => None,
        });
        names.collect()
    }
}

impl Node {
    fn value(&self, now: &ConditionInputs) -> f64 {
        match self {
            Node::Constant(value) => *value,
            Node::Variable(index) => VARIABLES[*index].2(now),
            Node::Negated(node) => -node.value(now),
            Node::Not(node) => not(node.value(now)),
            Node::Operation(left, index, right) => OPERATORS[*index].4(left.value(now), right.value(now)),
            Node::Magnitude(node) => node.value(now).abs(),
            Node::Count(gyro) => now.outputs.counts[gyro.index()],
            Node::Valid(gyro) => truth(now.outputs.valid & gyro.bit() != 0),
            Node::Saturated(gyro) => truth(now.outputs.saturated & gyro.bit() != 0),
            Node::Command(opcode) => truth(now.commands.contains(opcode)),
            Node::Active(id) => truth(now.active.contains(id)),
        }
    }

    /// Itself and everything within it, from left to right.
    fn all(&self) -> Vec<&Node> {
        let mut all = vec![self];
        match self {
            Node::Negated(node) | Node::Not(node) | Node::Magnitude(node) => all.extend(node.all()),
            Node::Operation(left, _, right) => {
                all.extend(left.all());
                all.extend(right.all());
            }
            _ => {}
        }
        all
    }
}

impl std::str::FromStr for Expression {
    /// The expected text and its place.
    type Err = String;

    /// A condition about the default unit.
    fn from_str(text: &str) -> Result<Expression, String> {
        Expression::about(text, &Device::iras())
    }
}

impl Expression {
    /// A condition about a unit.
    ///
    /// # Errors
    /// The expected text and its place.
    pub fn about(text: &str, device: &Device) -> Result<Expression, String> {
        if text.len() > MAX_LENGTH {
            return Err(format!("a condition of at most {MAX_LENGTH} characters"));
        }
        let mut reader = Reader { text, device, place: 0, depth: 0 };
        let (root, sort) = reader.level(0)?;
        reader.skip_space();
        if reader.place < text.len() {
            return Err(reader.expected("an operator or the end"));
        }
        match sort {
            Sort::Condition => Ok(Expression { text: text.to_owned(), root }),
            Sort::Number => Err("a condition such as abs(rate_y) > 700, not a number".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment() -> ConditionInputs {
        ConditionInputs {
            t_s: 12.5,
            frame: 25,
            sequence: 24,
            rate_arcsec_s: [1.0, -720.0, 0.25],
            theta_deg: 90.0,
            psi_deg: f64::NAN,
            outputs: Outputs {
                valid: 0xE,
                saturated: 1,
                counts: [7.0, -360.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                ..Outputs::default()
            },
            commands: vec![2],
            active: vec!["pivot".to_owned()],
            ..ConditionInputs::default()
        }
    }

    #[test]
    fn conditions_are_read_as_they_are_meant() {
        for (text, expected) in [
            ("abs(rate_y) > 700", true),
            ("rate_y > 700", false),
            ("t_s >= 12.5 and frame == 25", true),
            ("t_s < 12.5 or frame % 10 == 5", true),
            ("not t_s < 12.5 and 1 + 2 * 3 == 7", true),
            ("not (t_s >= 12.5 and frame == 25)", false),
            ("(1 + 2) * 3 == 9 and -2 - -3 == 1", true),
            ("valid(GYRX) or not valid(GYRY)", false),
            ("saturated(GYRX) and count(GYRX) == 7", true),
            ("command(SET_MODE) and not command(POLL)", true),
            ("active(pivot) and not active(\"a b\")", true),
            ("psi_deg < 1e+9", false),
            ("not psi_deg < 1e+9", false),
            ("psi_deg != 5", false),
            ("psi_deg > 5 or frame == 25", true),
            ("psi_deg > 5 or frame == 26", false),
            ("not (psi_deg > 5 and frame == 26)", true),
            ("psi_deg > 5 and frame == 25", false),
            ("2.5e-1 == rate_z", true),
            ("1 == 1 or 1 == 2 and 1 == 3", true),
        ] {
            let expression: Expression = text.parse().unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!(expression.holds(&moment()), expected, "{text}");
            assert_eq!(expression.to_string(), text);
        }
    }

    #[test]
    fn an_invalid_condition_is_rejected_with_its_place() {
        for (text, expected) in [
            ("", "a number, or one of t_s, frame,"),
            ("rate_y", "a condition such as"),
            ("rate_q > 1", "at \"rate_q > 1\""),
            ("rate_y >", "at the end"),
            ("(rate_y > 1", "a closing bracket"),
            ("rate_y > 1 rate_x", "an operator or the end"),
            ("valid(GYRQ)", "one of GYRX, GYRY, GYRZA, GYRZB"),
            ("command(FLY)", "one of PING, SET_MODE"),
            ("rate_y and rate_x", "conditions on both sides"),
            ("(rate_y > 1) + 1 > 0", "numbers on both sides"),
            ("not rate_y", "a condition behind `not`"),
            ("1e999 > 1", "a number at"),
            ("frame % 0 == 0", "a divisor other than 0 at \" 0 == 0\""),
            ("active()", "a fault's identifier"),
            ("abs(1 > 2) == 1", "a number in the brackets"),
            ("ü > 1", "a number, or one of"),
        ] {
            let error = text.parse::<Expression>().expect_err(text);
            assert!(error.contains(expected), "{text}: {error}");
        }
        assert!("(".repeat(1000).parse::<Expression>().is_err());
        assert!("-".repeat(400).parse::<Expression>().is_err());
    }

    #[test]
    fn the_faults_that_it_asks_about_are_known() {
        let expression: Expression = "active(a) and not (active(b) or t_s > 1)".parse().expect("a condition");
        assert_eq!(expression.faults(), ["a", "b"]);
        assert_eq!(expression.asks_about(), ["t_s"]);
        let expression: Expression = "abs(rate_x - 3) > -psi_deg and command(PING)".parse().expect("a condition");
        assert_eq!(expression.asks_about(), ["rate_x", "psi_deg", "command"]);
    }
}
