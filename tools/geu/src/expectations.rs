//! Results of a fault plan: faults that never started, and expectations of the on-board computer, printed, as JUnit XML and
//! as the exit code.

use std::fmt::Write;

use clap::Args;
use geu_model::fault::engine::FaultEngine;
use geu_model::fault::expectation::{ExpectationMonitor, ExpectationResult, TimeWindow};

use crate::command_error::{CommandError, note};
use crate::outputs::OutputFile;

/// Output of the results.
#[derive(Args, Debug, Clone, Default)]
pub struct ExpectationReport {
    /// Write the results of the plan's expectations as JUnit XML
    #[arg(long, value_name = "FILE")]
    junit: Option<OutputFile>,
}

impl ExpectationReport {
    /// Prints the faults that never started and the results, and writes the file.
    ///
    /// # Errors
    /// The file cannot be written; an expectation was not met, or its window did not end.
    pub fn write(&self, faults: &FaultEngine) -> Result<(), CommandError> {
        for planned in faults.planned.iter().filter(|planned| planned.started == 0) {
            note(format_args!("fault        {}: never started ({})\n", planned.fault.id, planned.fault.trigger()));
        }
        let watches = &faults.watches;
        for watch in watches {
            note(format_args!("expectation  {}: {}\n", watch.expectation.id, verdict(watch, faults.interval_s)));
        }
        if let Some(path) = &self.junit {
            path.write(junit(watches, faults.interval_s))?;
        }
        let failed = watches.iter().filter(|watch| !matches!(watch.verdict, ExpectationResult::Met(_))).count();
        if failed > 0 {
            return Err(CommandError::failed(format!("{failed} of {} expectations were not met", watches.len())));
        }
        Ok(())
    }
}

/// A result as text.
fn verdict(watch: &ExpectationMonitor, interval_s: f64) -> String {
    let condition = &watch.expectation.condition;
    let window = match watch.expectation.window {
        TimeWindow::Within(length_s) => format!("within {length_s} s"),
        TimeWindow::Throughout(length_s) => format!("throughout {length_s} s"),
    };
    match watch.verdict {
        ExpectationResult::Met(t_s) => format!("met at {t_s} s ({condition} {window})"),
        ExpectationResult::NotMet(t_s) => format!("not met at {t_s} s: expected {condition} {window}"),
        ExpectationResult::Open(since) => format!(
            "not decided: the run ended before, its window began at {} s; expected {condition} {window}",
            since as f64 * interval_s
        ),
        ExpectationResult::Waiting => match &watch.expectation.after {
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

fn junit(watches: &[ExpectationMonitor], interval_s: f64) -> String {
    let count = |is: fn(&ExpectationResult) -> bool| watches.iter().filter(|watch| is(&watch.verdict)).count();
    let failures = count(|verdict| matches!(verdict, ExpectationResult::NotMet(_)));
    let errors = count(|verdict| matches!(verdict, ExpectationResult::Open(_) | ExpectationResult::Waiting));
    let mut text = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".to_owned();
    let tests = watches.len();
    let _ = writeln!(
        text,
        "<testsuites><testsuite name=\"geu\" tests=\"{tests}\" failures=\"{failures}\" errors=\"{errors}\">"
    );
    for watch in watches {
        let (id, message) = (escaped(&watch.expectation.id), escaped(&verdict(watch, interval_s)));
        let _ = match watch.verdict {
            ExpectationResult::Met(t_s) => {
                writeln!(text, "<testcase name=\"{id}\" classname=\"expect\" time=\"{t_s}\"/>")
            }
            ExpectationResult::NotMet(t_s) => writeln!(
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
