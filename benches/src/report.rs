//! `geu-bench report`: all benchmarks, and the page with their tables.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use clap::{Args, ValueEnum};

use crate::Result;
use crate::process::python_text;
use crate::rounds::Rounds;
use crate::table::tables;

/// The page without its tables; a line `<!-- table NAME -->` is the place of each.
const TEMPLATE: &str = include_str!("../benchmarks.md");

/// Versions of Python packages for the page.
const PACKAGES: &str = "
import importlib.metadata, platform
print('Python ' + platform.python_version())
for name in ('numpy', 'python-can', 'cantools', 'asammdf', 'bsk', 'gnss-ins-sim', 'filterpy', 'statsmodels', 'pysindy'):
    try:
        print(name + ' ' + importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        print(name + ' not installed')
";

/// Arguments of `geu-bench report`.
#[derive(Args)]
pub struct Arguments {
    /// Measure these parts alone and print their tables; the page is not written
    #[arg(long, value_name = "PART,…", value_delimiter = ',', value_enum)]
    only: Vec<Part>,
    #[command(flatten)]
    rounds: Rounds,
    /// Time of the cadence
    #[arg(long, value_name = "DURATION", default_value = "2m")]
    duration: String,
    /// Browser for the control interface [default: an event client in its place]
    #[arg(long, value_name = "PROGRAM")]
    browser: Option<String>,
    /// The page
    #[arg(long, value_name = "FILE", default_value = "docs/benchmarks.md")]
    out: PathBuf,
}

/// Parts of the page, each a subcommand.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Part {
    Decode,
    Model,
    Calibrate,
    Diagnose,
    Growth,
    Control,
    Cadence,
}

impl Part {
    fn arguments(self, arguments: &Arguments) -> Vec<String> {
        let name = self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
        let options = match self {
            Part::Cadence => vec!["--duration".to_owned(), arguments.duration.clone()],
            Part::Control => {
                let browser = arguments.browser.iter().flat_map(|program| ["--browser".to_owned(), program.clone()]);
                ["--duration", "30", "--runs", &arguments.rounds.count().to_string()]
                    .map(str::to_owned)
                    .into_iter()
                    .chain(browser)
                    .collect()
            }
            _ => vec!["--runs".to_owned(), arguments.rounds.count().to_string()],
        };
        [name].into_iter().chain(options).collect()
    }
}

/// Measures all parts, each in a process of its own, and writes the page.
///
/// # Errors
/// A part fails, or has not all tables of the page.
pub fn run(arguments: &Arguments) -> Result {
    let parts = if arguments.only.is_empty() { Part::value_variants() } else { &arguments.only };
    let mut found = BTreeMap::new();
    for part in parts {
        let own = part.arguments(arguments);
        eprintln!("geu-bench {}", own.join(" "));
        let mut command = Command::new(std::env::current_exe()?);
        let output = command.args(&own).stdin(Stdio::null()).stderr(Stdio::inherit()).output()?;
        let text = String::from_utf8_lossy(&output.stdout);
        print!("{text}");
        if !output.status.success() {
            return Err(format!("{}: failed", own.join(" ")).into());
        }
        found.extend(tables(&text));
    }
    if arguments.only.is_empty() {
        fs::write(&arguments.out, page(TEMPLATE, &found, &machine())?)?;
    }
    Ok(())
}

/// The template with its tables, and the machine in place of `<!-- machine -->`.
fn page(template: &str, tables: &BTreeMap<String, String>, machine: &str) -> Result<String> {
    let mut page = String::new();
    for line in template.lines() {
        match line.strip_prefix("<!-- table ").and_then(|rest| rest.strip_suffix(" -->")) {
            Some(name) => page += tables.get(name).ok_or_else(|| format!("expected the table {name}, got none"))?,
            None if line == "<!-- machine -->" => page += machine,
            None => {
                page += line;
                page.push('\n');
            }
        }
    }
    Ok(page)
}

/// Machine and versions, without names of hosts and paths.
fn machine() -> String {
    let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
    let value = |text: &str, key: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
        line.trim_start_matches([' ', '\t', ':']).trim().to_owned()
    };
    let of = |program: &str, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).output().ok().filter(|output| output.status.success());
        output.map_or_else(String::new, |output| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let memory_kb: f64 = value(&read("/proc/meminfo"), "MemTotal").trim_end_matches(" kB").parse().unwrap_or(0.0);
    let python = python_text(PACKAGES).unwrap_or_else(|reason| format!("no Python: {reason}"));
    let rows = [
        ("processor", format!("{}, {cores} cores", value(&read("/proc/cpuinfo"), "model name"))),
        ("memory", format!("{:.0} GB", memory_kb * 1024e-9)),
        (
            "system",
            format!(
                "{} {}",
                std::env::consts::OS,
                read("/proc/sys/kernel/osrelease").trim().split('-').next().unwrap_or("")
            ),
        ),
        ("compiler", of("rustc", &["--version"])),
        ("commit", of("git", &["describe", "--always", "--dirty", "--abbrev=10"])),
        ("others", python.lines().collect::<Vec<_>>().join(", ")),
    ];
    let rows = rows.map(|(name, value)| format!("| {name} | {value} |\n"));
    format!("| | |\n|---|---|\n{}", rows.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_its_tables_or_is_an_error() {
        let tables = BTreeMap::from([("a".to_owned(), "| 1 |\n".to_owned())]);
        let template = "# T\n<!-- machine -->\n<!-- table a -->\nend\n";
        assert_eq!(page(template, &tables, "M\n").expect("a page"), "# T\nM\n| 1 |\nend\n");
        assert!(page("<!-- table b -->\n", &tables, "").is_err());
    }

    #[test]
    fn every_table_of_the_template_is_named_once() {
        let names: Vec<&str> = TEMPLATE.lines().filter(|line| line.starts_with("<!-- table ")).collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert!(!names.is_empty() && names.len() == unique.len());
    }
}
