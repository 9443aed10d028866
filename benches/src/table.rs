//! Results as Markdown: each table follows a line with its name, by which `geu-bench report` finds it.

use std::collections::BTreeMap;
use std::fmt;

use crate::rounds::{Results, Spread};

/// Rows of text under columns.
pub struct Table {
    /// Name in the template of the page.
    name: &'static str,
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    pub fn new(name: &'static str, columns: &[&str]) -> Table {
        Table { name, columns: columns.iter().map(|&column| column.to_owned()).collect(), rows: Vec::new() }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let mut cells: Vec<String> = cells.into_iter().collect();
        cells.resize(self.columns.len(), String::new());
        self.rows.push(cells);
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "<!-- table {} -->", self.name)?;
        writeln!(f, "| {} |", self.columns.join(" | "))?;
        writeln!(f, "|{}", "---|".repeat(self.columns.len()))?;
        self.rows.iter().try_for_each(|row| writeln!(f, "| {} |", row.join(" | ")))
    }
}

/// The tables of a text by their names.
pub fn tables(text: &str) -> BTreeMap<String, String> {
    let mut tables = BTreeMap::<String, String>::new();
    let mut open = None;
    for line in text.lines() {
        if let Some(name) = line.strip_prefix("<!-- table ").and_then(|rest| rest.strip_suffix(" -->")) {
            open = Some(tables.entry(name.to_owned()).or_default());
        } else if let Some(table) = open.as_mut().filter(|_| line.starts_with('|')) {
            **table += line;
            table.push('\n');
        } else {
            open = None;
        }
    }
    tables
}

/// A contender's time beside others: name, time, and by how much ours, of this name, takes less.
pub fn compared(table: &mut Table, results: &[Results<f64>], name: &str, ours: &[(&str, &str)], decimals: usize) {
    let runs_of = |name: &str| results.iter().find(|one| one.name == name).and_then(|one| one.runs.as_ref().ok());
    let Some(result) = results.iter().find(|one| one.name == name) else { return };
    let runs = match &result.runs {
        Ok(runs) => runs,
        Err(reason) => return table.row([name.to_owned(), format!("skipped: {reason}")]),
    };
    let ratios = ours.iter().filter_map(|(own, label)| {
        let ratio = Spread::of_ratios(runs, runs_of(own)?);
        Some(format!("{label} is {ratio:.1} times as fast"))
    });
    let time_s = Spread::new(runs.iter().copied());
    table.row([name.to_owned(), format!("{time_s:.decimals$}"), ratios.collect::<Vec<_>>().join("; ")]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_found_by_their_names_in_other_text() {
        let (mut first, mut second) = (Table::new("first", &["a", "b"]), Table::new("second", &["c"]));
        first.row(["1".to_owned()]);
        second.row(["2".to_owned()]);
        let found = tables(&format!("before\n{first}after\n{second}"));
        assert_eq!(found["first"], "| a | b |\n|---|---|\n| 1 |  |\n");
        assert_eq!(found["second"], "| c |\n|---|\n| 2 |\n");
    }

    #[test]
    fn a_ratio_is_that_of_the_times_within_each_round() {
        let result = |name: &str, runs| Results { name: name.to_owned(), runs };
        let results = [
            result("geu", Ok(vec![1.0, 2.0])),
            result("other", Ok(vec![4.0, 8.0])),
            result("absent", Err("not installed".to_owned())),
        ];
        let mut table = Table::new("t", &["", "s", ""]);
        for name in ["geu", "other", "absent"] {
            let ours: &[(&str, &str)] = if name == "geu" { &[] } else { &[("geu", "GEU")] };
            compared(&mut table, &results, name, ours, 1);
        }
        let text = table.to_string();
        assert!(text.contains("| other | 6.0 (4.0…8.0) | GEU is 4.0 (4.0…4.0) times as fast |"), "{text}");
        assert!(text.contains("| absent | skipped: not installed |  |"), "{text}");
    }
}
