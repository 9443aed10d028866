//! The recursive-descent parser of conditions.

use geu_protocol::Gyro;
use geu_protocol::command::COMMANDS;

use super::{FUNCTIONS, LEVELS, MAX_DEPTH, Node, OPERATORS, Sort, Takes, VARIABLES, vocabulary};
use crate::device::Device;

pub(super) struct Reader<'a> {
    pub text: &'a str,
    pub device: &'a Device,
    pub place: usize,
    pub depth: usize,
}

impl<'a> Reader<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.place..]
    }

    pub fn skip_space(&mut self) {
        self.place = self.text.len() - self.rest().trim_start().len();
    }

    pub fn expected(&self, what: &str) -> String {
        let rest: String = self.rest().chars().take(20).collect();
        let at = if rest.is_empty() { "at the end".to_owned() } else { format!("at {rest:?}") };
        format!("{what} {at} of the condition")
    }

    /// Takes `token` if it stands next; a word only whole.
    fn accept(&mut self, token: &str) -> bool {
        self.skip_space();
        let Some(after) = self.rest().strip_prefix(token) else { return false };
        let is_word = token.ends_with(|c: char| c.is_ascii_alphanumeric());
        if is_word && after.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_') {
            return false;
        }
        self.place += token.len();
        true
    }

    fn deeper<T>(&mut self, read: impl FnOnce(&mut Self) -> Result<T, String>) -> Result<T, String> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(format!("at most {MAX_DEPTH} brackets within each other"));
        }
        let result = read(self);
        self.depth -= 1;
        result
    }

    /// Operators of this level and tighter.
    pub fn level(&mut self, level: usize) -> Result<(Node, Sort), String> {
        if level == LEVELS {
            return self.primary();
        }
        let (mut left, mut sort) = self.level(level + 1)?;
        loop {
            let own = OPERATORS.iter().enumerate().filter(|(_, operator)| operator.0 == level);
            let Some((index, operator)) = own.clone().find(|(_, operator)| self.accept(operator.1)) else {
                return Ok((left, sort));
            };
            let (_, name, takes, gives, _) = *operator;
            let place = self.place;
            let (right, right_sort) = self.level(level + 1)?;
            if sort != takes || right_sort != takes {
                self.place = place - name.len();
                return Err(self.expected(match takes {
                    Sort::Number => "numbers on both sides of the operator",
                    Sort::Condition => "conditions on both sides of the operator",
                }));
            }
            if matches!(name, "/" | "%") && right == Node::Constant(0.0) {
                self.place = place;
                return Err(self.expected("a divisor other than 0"));
            }
            (left, sort) = (Node::Operation(Box::new(left), index, Box::new(right)), gives);
        }
    }

    fn primary(&mut self) -> Result<(Node, Sort), String> {
        if self.accept("(") {
            let inner = self.deeper(|reader| reader.level(0))?;
            return if self.accept(")") { Ok(inner) } else { Err(self.expected("a closing bracket")) };
        }
        if self.accept("not") {
            let place = self.place;
            // Binds tighter than `and`, looser than a comparison.
            let (node, sort) = self.deeper(|reader| reader.level(2))?;
            if sort != Sort::Condition {
                self.place = place;
                return Err(self.expected("a condition behind `not`"));
            }
            return Ok((Node::Not(Box::new(node)), sort));
        }
        if self.accept("-") {
            let place = self.place;
            let (node, sort) = self.deeper(Reader::primary)?;
            if sort != Sort::Number {
                self.place = place;
                return Err(self.expected("a number behind `-`"));
            }
            return Ok((Node::Negated(Box::new(node)), sort));
        }
        self.skip_space();
        let rest = self.rest();
        let length = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_' && c != '.').unwrap_or(rest.len());
        let word = &rest[..length];
        if word.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
            // An exponent's sign is part of the number.
            let mut length = length;
            if word.ends_with(['e', 'E']) && rest[length..].starts_with(['+', '-']) {
                let digits = rest[length + 1..].bytes().take_while(u8::is_ascii_digit).count();
                length += 1 + digits;
            }
            let value: Option<f64> = rest[..length].parse().ok().filter(|value: &f64| value.is_finite());
            let value = value.ok_or_else(|| self.expected("a number"))?;
            self.place += length;
            return Ok((Node::Constant(value), Sort::Number));
        }
        if let Some(index) = VARIABLES.iter().position(|variable| variable.0 == word) {
            self.place += length;
            return Ok((Node::Variable(index), Sort::Number));
        }
        let Some((name, takes, gives, _)) = FUNCTIONS.iter().find(|function| function.0 == word) else {
            let names: Vec<String> = vocabulary().into_iter().map(|(name, _)| name).collect();
            return Err(self.expected(&format!("a number, or one of {},", names.join(", "))));
        };
        self.place += length;
        if !self.accept("(") {
            return Err(self.expected(&format!("a bracket behind {name}")));
        }
        let node = self.deeper(|reader| reader.argument(name, *takes))?;
        if self.accept(")") { Ok((node, *gives)) } else { Err(self.expected("a closing bracket")) }
    }

    fn argument(&mut self, function: &str, takes: Takes) -> Result<Node, String> {
        if takes == Takes::Number {
            let (node, sort) = self.level(0)?;
            return match sort {
                Sort::Number => Ok(Node::Magnitude(Box::new(node))),
                Sort::Condition => Err(format!("a number in the brackets of {function}")),
            };
        }
        self.skip_space();
        let rest = self.rest();
        let (name, length) = match rest.strip_prefix('"') {
            Some(quoted) => {
                let end = quoted.find('"').ok_or_else(|| self.expected("a closing quote"))?;
                (&quoted[..end], end + 2)
            }
            None => {
                let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_' && c != '-').unwrap_or(rest.len());
                (&rest[..end], end)
            }
        };
        let node = match takes {
            Takes::Gyro => {
                let gyro = self.device.gyro(name).ok_or_else(|| {
                    let names: Vec<&str> = self.device.gyros().map(Gyro::name).collect();
                    self.expected(&format!("one of {}", names.join(", ")))
                })?;
                match function {
                    "count" => Node::Count(gyro),
                    "valid" => Node::Valid(gyro),
                    _ => Node::Saturated(gyro),
                }
            }
            Takes::Command => {
                let names: Vec<&str> = COMMANDS.iter().map(|command| command.name).collect();
                let command = COMMANDS.iter().find(|command| command.name == name);
                Node::Command(command.ok_or_else(|| self.expected(&format!("one of {}", names.join(", "))))?.opcode)
            }
            Takes::Fault | Takes::Number if name.is_empty() => {
                return Err(self.expected("a fault's identifier"));
            }
            Takes::Fault | Takes::Number => Node::Active(name.to_owned()),
        };
        self.place += length;
        Ok(node)
    }
}
