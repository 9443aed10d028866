//! A recording as what the emulator sends in place of the unit: records in their order and time, and which of them make a sample.

mod clock;
mod report;
mod source;
#[cfg(test)]
mod tests;

use std::sync::atomic::{AtomicBool, Ordering};

use geu_protocol::CanIdMap;
use geu_recording::{DecodeSummary, DecoderOptions, InputError, InputReader, Stop};

pub use report::ReplayReport;
pub use source::ReplaySource;

/// Batches of items that may wait to be sent: with those of the source, some minutes of a recording.
pub const QUEUE: usize = 16;

/// What of a recording is sent.
#[derive(Debug, Clone)]
pub struct ReplaySelection {
    pub plan: CanIdMap,
    pub interface: Option<Vec<u8>>,
    pub is_only: bool,
    pub from_ns: i64,
    pub to_ns: i64,
    pub longest_gap_ns: i64,
    /// Whether links carry frames, and bytes, as they were recorded.
    pub carries: (bool, bool),
}

/// The report on the last pass, and how reading ended.
pub type ReadResult = (ReplayReport, DecodeSummary, Result<(), InputError>);

/// Reads the recordings to their end, or over and over, until nobody takes more.
pub fn read(
    mut source: ReplaySource,
    names: &[String],
    options: &DecoderOptions,
    is_loop: bool,
    stop: &AtomicBool,
) -> ReadResult {
    loop {
        let mut reader = InputReader::new(options.clone(), Stop { flag: Some(stop), deadline: None });
        let mut result = Ok(());
        for name in names {
            result = reader.read(name, &mut source);
            if result.is_err() || source.is_over() {
                break;
            }
        }
        let (is_cut, is_stopped) = (source.is_over(), stop.load(Ordering::Relaxed));
        let (summary, ending) = reader.finish(&mut source);
        let has_sent = source.end_pass();
        // Cut before its first frame, a serial recording is not one without any.
        let result = if is_cut { result } else { result.and(ending) };
        if result.is_ok() && has_sent {
            source.begin();
        }
        if result.is_err() || !is_loop || !has_sent || source.is_disconnected() || stop.load(Ordering::Relaxed) {
            return (source.finish(is_stopped), summary, result);
        }
    }
}
