//! Identifiers of faults and of expectations: each its own, made up where a table gives none.
//!
//! A plan may have thousands of them, so nothing here looks at all of them for each.

use std::collections::HashSet;

use geu_protocol::suggestion::{did_you_mean, listed};

use super::document::{ConfigurationError, Node};

const MAX_LENGTH: usize = 64;

/// Assigns identifiers to the tables of a list.
pub(super) struct Identifiers<'a> {
    prefix: &'static str,
    /// Existing identifiers and those read so far.
    taken: HashSet<String>,
    /// Identifiers in tables of the list: none of these is generated.
    named: HashSet<&'a str>,
    /// The last generated number: the search continues from here.
    last: usize,
}

impl<'a> Identifiers<'a> {
    /// Identifiers of `nodes`, generated with `prefix` if absent, that differ from those `taken`.
    pub fn new<'b>(prefix: &'static str, taken: impl Iterator<Item = &'b str>, nodes: &[Node<'a>]) -> Identifiers<'a> {
        let has_own = nodes.iter().filter(|node| node.keys().contains(&"id"));
        let named = has_own.filter_map(|node| node.text("id").ok()).collect();
        Identifiers { prefix, taken: taken.map(str::to_owned).collect(), named, last: 0 }
    }

    /// The identifier of this table, which none after it gets.
    ///
    /// # Errors
    /// An invalid or taken identifier.
    pub fn read(&mut self, node: &Node) -> Result<String, ConfigurationError> {
        let id = if node.keys().contains(&"id") { self.given(node)? } else { self.made_up() };
        self.taken.insert(id.clone());
        Ok(id)
    }

    fn made_up(&mut self) -> String {
        loop {
            self.last += 1;
            let id = format!("{}-{}", self.prefix, self.last);
            if !self.taken.contains(&id) && !self.named.contains(id.as_str()) {
                return id;
            }
        }
    }

    fn given(&self, node: &Node) -> Result<String, ConfigurationError> {
        let id = node.text("id")?;
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        // `all` means every fault where one is cleared, and dots alone mean directories in an address.
        let is_taken_otherwise = id == "all" || id.chars().all(|c| c == '.');
        if id.is_empty() || id.len() > MAX_LENGTH || !id.chars().all(is_plain) || is_taken_otherwise {
            let expected = format!("1 to {MAX_LENGTH} letters, digits, `-`, `_` or `.`, not `all` and not dots alone,");
            return Err(node.unexpected("id", &expected));
        }
        if self.taken.contains(id) {
            return Err(node.unexpected("id", "an identifier of its own, not taken by another,"));
        }
        Ok(id.to_owned())
    }
}

/// The faults that a condition may ask about.
pub(super) struct FaultIds<'a> {
    /// In their order, as messages list them.
    listed: Vec<&'a str>,
    ids: HashSet<&'a str>,
}

impl<'a> FaultIds<'a> {
    pub fn new(ids: impl Iterator<Item = &'a str>) -> FaultIds<'a> {
        let listed: Vec<&str> = ids.collect();
        FaultIds { ids: listed.iter().copied().collect(), listed }
    }

    /// Refuses to ask about a fault that is not there.
    ///
    /// # Errors
    /// The first unknown fault at `key`.
    pub fn check<'b>(
        &self,
        node: &Node,
        key: &str,
        asked: impl IntoIterator<Item = &'b str>,
    ) -> Result<(), ConfigurationError> {
        match asked.into_iter().find(|id| !self.ids.contains(id)) {
            None => Ok(()),
            Some(id) => {
                let (hint, there) = (did_you_mean(id, &self.listed), listed(&self.listed));
                let expected = format!("the identifier of a fault ({hint}{there}) in place of {id:?}");
                Err(node.unexpected(key, &expected))
            }
        }
    }
}
