//! Raw serial bytes: a stream without records.

use super::{Detection, Format};
use crate::serial::{Deframer, DeframerEvent};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "serial",
    title: "serial frames EB 90 …",
    suffixes: &["bin"],
    detection: Detection::Frames(has_frame),
    new_reader: None,
}];

fn has_frame(head: &[u8]) -> bool {
    let mut found = false;
    Deframer::default().consume(head, &mut |event| found |= matches!(event, DeframerEvent::Frame { .. }));
    found
}
