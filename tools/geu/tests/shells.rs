//! Completions, man pages and the schema: each has every command.

use std::fs;
use std::path::Path;
use std::process::Command;

fn geu(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_geu")).args(arguments).output().expect("geu runs");
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).expect("text")
}

/// The commands that this help lists, without `help`.
fn commands(arguments: &[&str]) -> Vec<String> {
    let help = geu(&[arguments, &["--help"]].concat());
    let listed = help.split("\nCommands:\n").nth(1).unwrap_or("").split("\n\n").next().unwrap_or("");
    let names = listed.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").map(str::to_owned).collect()
}

#[test]
fn each_shell_completes_every_command() {
    let names = commands(&[]);
    assert!(names.len() > 20, "{names:?}");
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = geu(&["completions", shell]);
        for part in names.iter().map(String::as_str).chain(["campaign", "pty-group"]) {
            assert!(script.contains(part), "{part} is not in the script of {shell}");
        }
    }
}

#[test]
fn each_command_has_a_man_page() {
    let parent = tempfile::tempdir().expect("a directory");
    let directory = parent.path().join("man");
    geu(&["man", "--out", directory.to_str().expect("text")]);
    let page = |name: &str| fs::read_to_string(directory.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let all = page("geu.1");
    for name in commands(&[]) {
        assert!(page(&format!("geu-{name}.1")).contains("Exit codes:"), "{name}");
        assert!(all.contains(&format!("geu\\-{name}(1)")), "{name} is not in geu.1");
    }
    for name in commands(&["blind"]) {
        page(&format!("geu-blind-{name}.1"));
    }
    assert!(!Path::new(&directory).join("geu-help.1").exists());
}

#[test]
fn a_shown_configuration_names_the_schema_that_editors_read_and_is_valid() {
    let shown = geu(&["config", "show"]);
    assert!(shown.starts_with("#:schema ./geu.schema.json\n"), "{shown}");
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("unit.toml");
    fs::write(&path, &shown).expect("written");
    let path = path.to_str().expect("text");
    assert_eq!(geu(&["config", "show", path]), shown);
    let of_unit = geu(&["config", "schema", "--device", "stim300"]);
    assert!(of_unit.contains(":stim300\"") && of_unit != geu(&["config", "schema"]));
}
