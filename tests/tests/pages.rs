//! The commands of the README and of `docs/tasks` run as printed, figures equal the output of their command, and links lead to a page.
//!
//! A block ```` ```sh ```` is a script, all blocks of a page in one directory. A block ```` ```text ```` after it is its output, in which
//! `…` is any text. A comment before the block is an exception: `<!-- not run: REASON -->`, `<!-- exit CODE -->`, or `<!-- background -->`:
//! it runs until the next such block or the end of the page.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::net::TcpListener;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

use geu_tests::{geu_obc, root};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// A command takes a second or two; on a loaded machine a build beside it may take all the rest.
const TIMEOUT: Duration = Duration::from_secs(120);
/// The port of the pages; a free one takes its place.
const PORT: &str = "4700";

/// A script of a page.
struct Block {
    place: String,
    script: String,
    output: Option<String>,
    exception: Option<String>,
}

/// The scripts of a page, with their outputs.
fn blocks(name: &str, text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut before = "";
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            let content: String =
                lines.by_ref().take_while(|(_, line)| *line != "```").map(|(_, line)| format!("{line}\n")).collect();
            match (language, blocks.last_mut()) {
                ("sh", _) => blocks.push(Block {
                    place: format!("{name}:{}", index + 1),
                    script: content,
                    output: None,
                    exception: before
                        .strip_prefix("<!-- ")
                        .map(|comment| comment.strip_suffix(" -->").expect("a comment of one line").to_owned()),
                }),
                ("text", Some(Block { output: output @ None, .. })) => *output = Some(content),
                ("text", _) => panic!("{name}:{}: an output without a script", index + 1),
                _ => {}
            }
        }
        assert!(!line.starts_with("    geu"), "{name}:{}: a command outside of a block ```sh", index + 1);
        before = line;
    }
    blocks
}

/// True if a text is the expected one, in which `…` is any text.
fn matches(expected: &str, text: &str) -> bool {
    let parts: Vec<_> = expected.trim_end().split('…').collect();
    let (first, last) = (parts[0], parts[parts.len() - 1]);
    let text = text.trim_end();
    if parts.len() == 1 {
        return text == first;
    }
    let Some(rest) = text.strip_prefix(first).and_then(|rest| rest.strip_suffix(last)) else { return false };
    let mut rest = Some(rest);
    for part in &parts[1..parts.len() - 1] {
        rest = rest.and_then(|text| text.split_once(part)).map(|(_, after)| after);
    }
    rest.is_some()
}

/// A directory with what the pages take from the root of the project, and the programs of this build.
struct Scratch {
    directory: tempfile::TempDir,
    path: String,
    port: String,
}

impl Scratch {
    fn new() -> Scratch {
        let directory = tempfile::tempdir().expect("a directory");
        for name in ["configs", "examples", "protocol", "tests"] {
            symlink(root().join(name), directory.path().join(name)).expect("a link");
        }
        let program = PathBuf::from(geu_obc().get_program());
        let programs = program.parent().expect("a directory").display();
        let path = format!("{programs}:{}", std::env::var("PATH").unwrap_or_default());
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("an address").port().to_string();
        Scratch { directory, path, port }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn start(&self, script: &str, output: &str) -> Running {
        let output = fs::File::create(self.file(output)).expect("a file");
        let mut shell = Command::new("sh");
        shell.args(["-e", "-c", &script.replace(PORT, &self.port)]).current_dir(self.directory.path());
        shell
            .env("PATH", &self.path)
            .env("XDG_RUNTIME_DIR", self.directory.path())
            .env("XDG_CACHE_HOME", self.file("cache"));
        shell.env_remove("GEU_CONTROL_TOKEN").stdin(Stdio::null());
        shell.stderr(output.try_clone().expect("a file")).stdout(output);
        Running(shell.spawn().expect("sh starts"))
    }

    fn output(&self, name: &str) -> String {
        fs::read_to_string(self.file(name)).unwrap_or_default().replace(&self.port, PORT)
    }

    /// Runs a script to its end.
    fn run(&self, block: &Block) {
        let began = Instant::now();
        let expected = match block.exception.as_deref() {
            None => 0,
            Some(exception) => {
                exception.strip_prefix("exit ").and_then(|code| code.parse().ok()).unwrap_or_else(|| {
                    panic!("{}: {exception:?}: expected `not run: REASON`, `exit CODE` or `background`", block.place)
                })
            }
        };
        let mut script = self.start(&block.script, "output");
        let code = ended(&mut script, TIMEOUT);
        let output = self.output("output");
        assert_eq!(code, Some(expected), "{}:\n{}{output}", block.place, block.script);
        block.assert_output(&output);
        println!("{:6.1} s  {}", began.elapsed().as_secs_f64(), block.place);
    }

    /// Starts a script that does not end by itself, and waits until its links are ready.
    fn start_background(&self, block: &Block) -> Running {
        let mut running = self.start(&format!("exec {}", block.script), "background");
        let began = Instant::now();
        // A replay has no control interface.
        let is_ready = if block.script.starts_with("geu replay") { "ready" } else { "ready control" };
        while !self.output("background").contains(is_ready) {
            let code = running.0.try_wait().expect("a process");
            assert!(
                code.is_none() && began.elapsed() < TIMEOUT,
                "{}: ended with {code:?}: {}",
                block.place,
                self.output("background")
            );
            sleep(Duration::from_millis(20));
        }
        running
    }

    fn end_background(&self, block: &Block, mut running: Running) {
        // It may have ended by itself.
        let _ = kill(Pid::from_raw(running.0.id() as i32), Signal::SIGTERM);
        let code = ended(&mut running, TIMEOUT);
        let output = self.output("background");
        assert_eq!(code, Some(0), "{}: {output}", block.place);
        block.assert_output(&output);
    }
}

impl Block {
    fn assert_output(&self, output: &str) {
        let Some(expected) = &self.output else { return };
        assert!(matches(expected, output), "{}: expected\n{expected}got\n{output}", self.place);
    }
}

/// A running command, ended on drop.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Waits for the end; returns the exit code, or `None` after the time `within`.
fn ended(child: &mut Running, within: Duration) -> Option<i32> {
    let start = Instant::now();
    loop {
        if let Some(status) = child.0.try_wait().expect("a process") {
            return Some(status.code().unwrap_or(-1));
        }
        if start.elapsed() > within {
            return None;
        }
        sleep(Duration::from_millis(20));
    }
}

/// Runs all scripts of a page, and says which ones it left out.
fn run_page(name: &str) -> Scratch {
    let scratch = Scratch::new();
    let text = fs::read_to_string(root().join(name)).expect("a page");
    let blocks = blocks(name, &text);
    let mut background: Option<(&Block, Running)> = None;
    let mut left_out = Vec::new();
    for block in &blocks {
        match block.exception.as_deref() {
            Some(exception) if exception.starts_with("not run: ") => {
                left_out.push(format!("{} {exception}", block.place))
            }
            Some("background") => {
                background.into_iter().for_each(|(block, running)| scratch.end_background(block, running));
                background = Some((block, scratch.start_background(block)));
            }
            _ => scratch.run(block),
        }
    }
    background.into_iter().for_each(|(block, running)| scratch.end_background(block, running));
    let mut summary = format!("{name}: {} blocks run, {} not run\n", blocks.len() - left_out.len(), left_out.len());
    left_out.iter().for_each(|line| summary.push_str(&format!("  {line}\n")));
    // Not eprintln!, which the test harness keeps to itself when a test passes.
    let _ = std::io::stderr().write_all(summary.as_bytes());
    scratch
}

/// Names of the Markdown files of a folder and its folders.
fn markdown(folder: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for entry in fs::read_dir(root().join(folder)).expect("a folder") {
        let name = format!("{folder}/{}", entry.expect("an entry").file_name().display());
        if root().join(&name).is_dir() {
            names.append(&mut markdown(&name));
        } else if name.ends_with(".md") {
            names.insert(name);
        }
    }
    names
}

/// The targets of the links of a page that are not in code.
fn links(text: &str) -> Vec<String> {
    let prose: String = text.split("```").step_by(2).collect();
    prose.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target.to_owned()).collect()
}

/// The anchors of the headings of a page.
fn anchors(text: &str) -> BTreeSet<String> {
    let prose: String = text.split("```").step_by(2).collect();
    let headings = prose.lines().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    headings
        .map(|heading| {
            let kept = heading.chars().filter(|c| c.is_alphanumeric() || [' ', '-', '_'].contains(c));
            kept.collect::<String>().to_lowercase().replace(' ', "-")
        })
        .collect()
}

/// The path of a link's target from the root.
fn resolved(page: &str, target: &str) -> String {
    let mut parts: Vec<&str> = page.split('/').collect();
    parts.pop();
    for part in target.split('/') {
        match part {
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    parts.join("/")
}

#[test]
fn commands_of_the_tasks_run_as_printed() {
    // Most of the time a page waits for a unit that runs in real time.
    let pages = Mutex::new(markdown("docs/tasks"));
    let next = || pages.lock().expect("no panic while locked").pop_last();
    let run = || {
        while let Some(page) = next() {
            run_task(&page);
        }
    };
    thread::scope(|scope| {
        scope.spawn(run);
        run();
    });
}

/// Runs the scripts of a page of `docs/tasks`, and compares the figures that it makes.
fn run_task(page: &str) {
    let scratch = run_page(page);
    if page.ends_with("record.md") {
        for figure in fs::read_dir(root().join("docs/figures")).expect("a folder") {
            let figure = figure.expect("an entry");
            let made =
                fs::read(scratch.file("figures").join(figure.file_name())).expect("a figure of the page's command");
            assert!(
                made == fs::read(figure.path()).expect("a figure"),
                "{:?} is another one than its command draws",
                figure.path()
            );
        }
    }
}

#[test]
fn commands_of_the_readme_run_as_printed() {
    run_page("README.md");
}

#[test]
fn commands_of_the_workflows_write_a_report() {
    for workflow in ["github.yml", "gitlab.yml"] {
        let scratch = Scratch::new();
        fs::create_dir(scratch.file("geu")).expect("a folder");
        symlink(root().join("examples"), scratch.file("geu/examples")).expect("a link");
        let text = fs::read_to_string(root().join("examples/ci").join(workflow)).expect("a workflow");
        let line = text.lines().find(|line| line.contains("geu/examples/ci/run")).expect("a command");
        let script = line.trim_start().trim_start_matches("- run: ").trim_start_matches("- ").to_owned();
        scratch.run(&Block { place: workflow.to_owned(), script, output: None, exception: None });
        let report = text.lines().find_map(|line| line.split_once("junit: ").or(line.split_once("report_paths: ")));
        let report = fs::read_to_string(scratch.file(report.expect("a report").1)).expect("a report");
        assert!(report.contains("tests=\"3\" failures=\"0\""), "{report}");
    }
}

#[test]
fn links_between_pages_lead_to_a_page_and_a_heading() {
    let mut pages = markdown("docs");
    pages.extend(
        ["README.md", "ARCHITECTURE.md", "CHANGELOG.md", "protocol/ICD.md", "tools/python/README.md"]
            .map(str::to_owned),
    );
    let mut wrong = Vec::new();
    for page in &pages {
        let text = fs::read_to_string(root().join(page)).expect("a page");
        for link in links(&text).iter().filter(|link| !link.contains("://")) {
            let (target, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if target.is_empty() { page.clone() } else { resolved(page, target) };
            let text = fs::read_to_string(root().join(&target)).unwrap_or_default();
            if !Path::new(&root().join(&target)).exists() || (!anchor.is_empty() && !anchors(&text).contains(anchor)) {
                wrong.push(format!("{page}: {link}"));
            }
        }
    }
    assert!(wrong.is_empty(), "no page or heading: {wrong:#?}");
    let book = fs::read_to_string(root().join("docs/SUMMARY.md")).expect("a table of contents");
    let listed: BTreeSet<_> = links(&book).iter().map(|link| resolved("docs/SUMMARY.md", link)).collect();
    pages.retain(|page| page != "docs/SUMMARY.md" && !listed.contains(page));
    assert!(pages.is_empty(), "not in docs/SUMMARY.md: {pages:?}");
}
