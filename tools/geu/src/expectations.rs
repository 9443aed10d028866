//! What became of a plan: faults that never came, and what it expected of the on-board computer: said, written as JUnit
//! XML, and the exit code.

use std::fmt::Write;
use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};

use clap::Args;
use geu_model::fault::acting::Faults;
use geu_model::fault::expectation::{Verdict, Watch, Window};
use geu_model::units::on_board_s;

use crate::failure::{Failure, note};

/// Where the verdicts go.
#[derive(Args, Debug, Clone, Default)]
pub struct Report {
    /// Writes what became of the plan's expectations as JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
}

impl Report {
    /// Looks, before a run, whether its end can be written.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn check(&self) -> Result<(), Failure> {
        let Some(path) = &self.junit else { return Ok(()) };
        let above = path.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (got, is_there) = (path.display(), path.exists());
        let expected = match fs::metadata(above) {
            _ if path.is_dir() => "a file, got a directory",
            Ok(above) if !above.is_dir() => "a file in a directory; what stands above is none",
            Err(_) => "a file in a directory that is there",
            Ok(_) if is_there && OpenOptions::new().append(true).open(path).is_err() => "a file that may be written",
            Ok(_) => return Ok(()),
        };
        Err(Failure::failed(format!("--junit {got}: expected {expected}")))
    }

    /// Tells the faults that never started, and the verdicts.
    ///
    /// # Errors
    /// A file that cannot be written; an expectation that was not met, or whose window had not ended.
    pub fn tell(&self, faults: &Faults) -> Result<(), Failure> {
        for planned in faults.planned.iter().filter(|planned| planned.started == 0) {
            note(format_args!("fault        {}: never started ({})\n", planned.fault.id, planned.fault.trigger()));
        }
        let watches = &faults.watches;
        for watch in watches {
            note(format_args!("expectation  {}: {}\n", watch.expectation.id, verdict(watch)));
        }
        if let Some(path) = &self.junit {
            write(path, watches)?;
        }
        let failed = watches.iter().filter(|watch| !matches!(watch.verdict, Verdict::Met(_))).count();
        if failed > 0 {
            return Err(Failure::failed(format!("{failed} of {} expectations were not met", watches.len())));
        }
        Ok(())
    }
}

fn write(path: &Path, watches: &[Watch]) -> Result<(), Failure> {
    fs::write(path, junit(watches)).map_err(|error| {
        Failure::failed(format!("--junit {}: {error}; expected a file that may be written", path.display()))
    })
}

/// A verdict in words.
fn verdict(watch: &Watch) -> String {
    let condition = &watch.expectation.condition;
    let window = match watch.expectation.window {
        Window::Within(length_s) => format!("within {length_s} s"),
        Window::Throughout(length_s) => format!("throughout {length_s} s"),
    };
    match watch.verdict {
        Verdict::Met(t_s) => format!("met at {t_s} s ({condition} {window})"),
        Verdict::NotMet(t_s) => format!("not met at {t_s} s: expected {condition} {window}"),
        Verdict::Open(since) => format!(
            "not decided: the run ended before, its window began at {} s; expected {condition} {window}",
            on_board_s(since)
        ),
        Verdict::Waiting => match &watch.expectation.after {
            Some(fault) => format!("not decided: fault {fault} never started; expected {condition} {window}"),
            None => {
                format!("not decided: the run ended before {} s; expected {condition} {window}", watch.expectation.at_s)
            }
        },
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn junit(watches: &[Watch]) -> String {
    let count = |is: fn(&Verdict) -> bool| watches.iter().filter(|watch| is(&watch.verdict)).count();
    let failures = count(|verdict| matches!(verdict, Verdict::NotMet(_)));
    let errors = count(|verdict| matches!(verdict, Verdict::Open(_) | Verdict::Waiting));
    let mut text = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
    let tests = watches.len();
    let _ = writeln!(
        text,
        "<testsuites><testsuite name=\"geu\" tests=\"{tests}\" failures=\"{failures}\" errors=\"{errors}\">"
    );
    for watch in watches {
        let (id, message) = (escaped(&watch.expectation.id), escaped(&verdict(watch)));
        let _ = match watch.verdict {
            Verdict::Met(t_s) => writeln!(text, "<testcase name=\"{id}\" classname=\"expect\" time=\"{t_s}\"/>"),
            Verdict::NotMet(t_s) => writeln!(
                text,
                "<testcase name=\"{id}\" classname=\"expect\" time=\"{t_s}\"><failure message=\"{message}\"/></testcase>"
            ),
            _ => {
                writeln!(text, "<testcase name=\"{id}\" classname=\"expect\"><error message=\"{message}\"/></testcase>")
            }
        };
    }
    text + "</testsuite></testsuites>\n"
}
