//! Serial bytes: in one part and in three they are the same, and the account covers every byte.

use geu_protocol::serial::data_frame;
use geu_recording::{Decoder, DecoderOptions, DeviceDecoder};

use crate::decoded::serial;
use crate::{device, parts};

/// Serial bytes of the default unit.
pub fn unit(data: &[u8]) {
    let (content, parts) = parts(data);
    let decode = |parts: &[&[u8]]| serial(Decoder::new(&DecoderOptions::default()), parts);
    let whole = decode(&[content]);
    assert_eq!(whole, decode(&parts));
    // A sample is written as the frame that it was read from.
    for row in whole.rows {
        let frame = data_frame(&row.sample);
        assert!(content.windows(frame.len()).any(|bytes| bytes == frame), "{row:?}");
    }
}

/// Serial bytes of the known unit that the first byte selects.
pub fn described(data: &[u8]) {
    const NAMES: [&str; 6] = ["hg4930", "kvh-1750", "mti-100", "stim300", "stim300-increment", "tetrad"];
    let Some((first, data)) = data.split_first() else { return };
    let device = device::known(NAMES[usize::from(*first) % NAMES.len()]);
    let (content, parts) = parts(data);
    let decode = |parts: &[&[u8]]| serial(DeviceDecoder::new(device, &DecoderOptions::default()), parts);
    assert_eq!(decode(&[content]), decode(&parts));
}
