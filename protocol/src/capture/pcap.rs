//! pcap: a header of 24 bytes, then packets, each behind 16 bytes of time and length.

use super::packet::{Order, RecordCursor, event};
use super::{CaptureRecord, MAX_RECORD, RecordPosition, Timestamp, told};

const HEADER: usize = 24;
const PACKET_HEADER: usize = 16;
/// A length beyond this is no length.
const MAX_LENGTH: u32 = 1 << 26;

#[derive(Debug, Clone, Default)]
pub struct Pcap {
    pub(super) stream: RecordCursor,
    header: Option<Header>,
}

#[derive(Debug, Clone, Copy)]
struct Header {
    order: Order,
    nanoseconds: bool,
    link: u32,
}

/// Byte order, and whether times are in nanoseconds.
pub(super) fn magic(bytes: &[u8]) -> Option<(Order, bool)> {
    match bytes.first_chunk()? {
        [0xD4, 0xC3, 0xB2, 0xA1] => Some((Order::Little, false)),
        [0xA1, 0xB2, 0xC3, 0xD4] => Some((Order::Big, false)),
        [0x4D, 0x3C, 0xB2, 0xA1] => Some((Order::Little, true)),
        [0xA1, 0xB2, 0x3C, 0x4D] => Some((Order::Big, true)),
        _ => None,
    }
}

impl Pcap {
    pub(super) fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) -> usize {
        let mut at = 0;
        let stream = &mut self.stream;
        loop {
            let rest = &bytes[at..];
            if rest.is_empty() && stream.skip == 0 {
                return at;
            }
            let place = RecordPosition::Offset(stream.offset);
            if stream.lost || stream.skip > 0 {
                at += stream.advance(rest, if stream.lost { rest.len() as u64 } else { stream.skip });
                if stream.skip > 0 {
                    if last {
                        stream.skip = 0;
                        stream.records += 1;
                        sink(place, CaptureRecord::Broken { bytes: &[], cut: true });
                    }
                    return at;
                }
                continue;
            }
            let Some(header) = self.header else {
                match (rest.len() >= HEADER, magic(rest)) {
                    (true, Some((order, nanoseconds))) => {
                        // Above the link type stand bits about a check sequence.
                        let link = order.u32(rest, 20) & 0x0FFF_FFFF;
                        self.header = Some(Header { order, nanoseconds, link });
                        at += stream.advance(rest, HEADER as u64);
                    }
                    (false, _) if !last => return at,
                    (complete, _) => {
                        stream.records += 1;
                        sink(place, CaptureRecord::Broken { bytes: told(rest), cut: !complete });
                        (stream.lost, stream.offset) = (true, stream.offset + rest.len() as u64);
                        return bytes.len();
                    }
                }
                continue;
            };
            let length = header.order.u32(rest, 8);
            if rest.len() >= PACKET_HEADER && length > MAX_LENGTH {
                stream.records += 1;
                sink(place, CaptureRecord::Broken { bytes: told(rest), cut: false });
                stream.lost = true;
                continue;
            }
            let whole = PACKET_HEADER as u64 + u64::from(length);
            if rest.len() >= PACKET_HEADER && whole > MAX_RECORD as u64 {
                stream.records += 1;
                sink(place, CaptureRecord::Remark);
                at += stream.advance(rest, whole);
                continue;
            }
            if rest.len() < PACKET_HEADER || (rest.len() as u64) < whole {
                if last {
                    stream.records += 1;
                    sink(place, CaptureRecord::Broken { bytes: told(rest), cut: true });
                    at += stream.advance(rest, rest.len() as u64);
                }
                return at;
            }
            let packet = &rest[PACKET_HEADER..whole as usize];
            stream.records += 1;
            let event = event(header.link, header.order, Some(header.time(rest)), b"", packet);
            sink(place, event.unwrap_or(CaptureRecord::Broken { bytes: told(packet), cut: false }));
            at += stream.advance(rest, whole);
        }
    }
}

impl Header {
    fn time(self, packet: &[u8]) -> Timestamp {
        let (seconds, fraction) = (i64::from(self.order.u32(packet, 0)), i64::from(self.order.u32(packet, 4)));
        let (unit_ns, digits) = if self.nanoseconds { (1, 9) } else { (1_000, 6) };
        Timestamp { t_ns: seconds * 1_000_000_000 + fraction * unit_ns, digits }
    }
}
