//! External truth: a simulator sends the attitude of the unit over a socket while the unit runs.
//!
//! [`ExternalTruth`] connects the tasks that read the source (`source`) with the cadence thread, which needs the truth just
//! before it ends a sample. `synchroniser` handles late and missing samples and jumps, by on-board time alone. The used truth
//! is a [`StreamedAttitude`](geu_model::attitude::StreamedAttitude), which a recording contains (`received.csv`).
//!
//! Dependencies run one way: `source` (sockets) uses `external_truth`, `json`, `forty_two` and `lines`; `external_truth` uses
//! `synchroniser` and `reports`. No model of the unit, no recorder.

mod address;
mod external_truth;
mod forty_two;
mod json;
mod lines;
mod reports;
mod source;
mod synchroniser;

use std::sync::Arc;

pub use address::{TruthAddress, TruthError};
pub use external_truth::ExternalTruth;
pub(crate) use reports::{Handed, SampleReport};
pub use synchroniser::TruthStatistics;

/// Opens the listener or the connection to the server, within the runtime. `is_held_back`: the run waits for its clients.
pub(crate) fn open(live: &Arc<ExternalTruth>, is_held_back: bool) -> Result<(), TruthError> {
    live.state().is_early = is_held_back;
    source::open(live).map_err(|source| TruthError { address: live.address().clone(), source })
}

/// Feeds a synchroniser with what a source sends in these parts. A sample of the unit ends after every other line.
#[cfg(fuzzing)]
pub(crate) fn fuzzed(
    is_forty_two: bool,
    parts: &[&[u8]],
    truth: &Arc<geu_model::attitude::StreamedAttitude>,
    numbers: geu_model::attitude::TruthNumbers,
) -> TruthStatistics {
    let mut synchroniser = synchroniser::TruthSynchroniser::new(truth.clone(), numbers);
    let (mut lines, mut message, mut end_s) = (lines::Lines::default(), forty_two::Message::default(), 0.0);
    for part in parts {
        lines.push(part, |number, line| {
            let read = match (line, is_forty_two) {
                (Ok(line), true) => message.line(line),
                (Ok(line), false) => json::line(line).map(|line| line.sample).transpose(),
                (Err(error), _) => Some(Err(error)),
            };
            match read {
                Some(Ok(sample)) => drop(synchroniser.push(sample)),
                Some(Err(_)) => synchroniser.counts.bad_lines += 1,
                None => {}
            }
            if number % 2 == 0 && synchroniser.has_begun() {
                end_s += geu_model::units::SAMPLE_INTERVAL_S;
                synchroniser.finish(end_s);
            }
        });
    }
    synchroniser.counts
}
