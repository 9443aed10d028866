//! A recording as the source of the emulator in place of the unit: records with order and time, and the samples in them.

mod bytes;
mod clock;
mod frames;
mod report;
mod source;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use geu_model::device::Device;
use geu_protocol::CanIdMap;
use geu_recording::{Decode, DecodeSummary, Decoder, DecoderOptions, DeviceDecoder, InputError, InputReader, Stop};

pub use report::ReplayReport;
pub use source::ReplaySource;

/// Capacity of the queue of batches: with the batches of the source, some minutes of a recording.
pub const QUEUE: usize = 16;

/// The part of a recording to send.
#[derive(Debug, Clone)]
pub struct ReplaySelection {
    pub device: Arc<Device>,
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
    let device = source.device.clone();
    loop {
        let (is_cut, result, summary, ending) = match device.is_iras() {
            true => read_once(Decoder::new(options), &mut source, names, options, stop),
            false => read_once(DeviceDecoder::new(&device, options), &mut source, names, options, stop),
        };
        let is_stopped = stop.load(Ordering::Relaxed);
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

/// Reads the recordings once. Returns whether the source ended it, its result, and the summary with the end.
fn read_once<D: Decode>(
    decoder: D,
    source: &mut ReplaySource,
    names: &[String],
    options: &DecoderOptions,
    stop: &AtomicBool,
) -> (bool, Result<(), InputError>, DecodeSummary, Result<(), InputError>) {
    let options = DecoderOptions { reads_no_archives: true, ..options.clone() };
    let mut reader = InputReader::with(decoder, options, Stop { flag: Some(stop), deadline: None });
    let mut result = Ok(());
    for name in names {
        result = reader.read(name, source);
        if result.is_err() || source.is_over() {
            break;
        }
    }
    let is_cut = source.is_over();
    let (summary, ending) = reader.finish(source);
    (is_cut, result, summary, ending)
}
