//! A recording as the source of the emulator in place of the unit: records with order and time, and the samples in them.

mod bytes;
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

/// Capacity of the queue of batches: with the batches of the source, some minutes of a recording.
pub const QUEUE: usize = 16;

/// The part of a recording to send.
#[derive(Debug, Clone)]
pub struct ReplaySelection {
    pub plan: CanIdMap,
    pub interface: Option<Vec<u8>>,
    pub is_only: bool,
    pub from_ns: i64,
    pub to_ns: i64,
    pub longest_gap_ns: i64,
    /// True if links send recorded frames, and recorded bytes.
    pub carries: (bool, bool),
}

/// Report of the last pass, and result of reading.
pub type ReadResult = (ReplayReport, DecodeSummary, Result<(), InputError>);

/// Reads the recordings once, or repeatedly, until the receiver is closed.
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
        // A serial recording that is cut before its first frame may have frames.
        let result = if is_cut { result } else { result.and(ending) };
        if result.is_ok() && has_sent {
            source.begin();
        }
        if result.is_err() || !is_loop || !has_sent || source.is_disconnected() || stop.load(Ordering::Relaxed) {
            return (source.finish(is_stopped), summary, result);
        }
    }
}
