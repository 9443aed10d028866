//! pcap: a header of 24 bytes, then packets, each behind 16 bytes of time and length.

use super::binary::{BinaryFormat, MAX_LENGTH, Next, Order, reader};
use super::socketcan::packet_record;
use super::{CaptureRecord, Detection, Format, Timestamp};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "pcap",
    title: "pcap",
    suffixes: &["pcap"],
    detection: Detection::Signature(|head| byte_order(head).is_some()),
    new_reader: Some(reader::<Pcap>),
}];

const HEADER: usize = 24;
const PACKET_HEADER: usize = 16;

#[derive(Debug, Default)]
struct Pcap {
    is_begun: bool,
    order: Order,
    is_nanoseconds: bool,
    link: u32,
}

/// Byte order, and true for times in nanoseconds.
fn byte_order(bytes: &[u8]) -> Option<(Order, bool)> {
    match bytes.first_chunk()? {
        [0xD4, 0xC3, 0xB2, 0xA1] => Some((Order::Little, false)),
        [0xA1, 0xB2, 0xC3, 0xD4] => Some((Order::Big, false)),
        [0x4D, 0x3C, 0xB2, 0xA1] => Some((Order::Little, true)),
        [0xA1, 0xB2, 0x3C, 0x4D] => Some((Order::Big, true)),
        _ => None,
    }
}

impl BinaryFormat for Pcap {
    fn next(&mut self, bytes: &[u8]) -> Next {
        if bytes.len() < if self.is_begun { PACKET_HEADER } else { HEADER } {
            return Next::Incomplete;
        }
        if self.is_begun {
            let length = self.order.u32(bytes, 8);
            return if length > MAX_LENGTH {
                Next::Lost
            } else {
                Next::Record(PACKET_HEADER as u64 + u64::from(length))
            };
        }
        let Some((order, is_nanoseconds)) = byte_order(bytes) else {
            return Next::Lost;
        };
        // The bits above the link type describe a check sequence.
        *self = Pcap { is_begun: true, order, is_nanoseconds, link: order.u32(bytes, 20) & 0x0FFF_FFFF };
        Next::Header(HEADER)
    }

    fn read<'a>(&'a mut self, record: &'a [u8]) -> CaptureRecord<'a> {
        let (header, packet) = record.split_at(PACKET_HEADER);
        let (seconds, fraction) = (i64::from(self.order.u32(header, 0)), i64::from(self.order.u32(header, 4)));
        let (unit_ns, digits) = if self.is_nanoseconds { (1, 9) } else { (1_000, 6) };
        let time = Timestamp { t_ns: seconds * 1_000_000_000 + fraction * unit_ns, digits };
        packet_record(self.link, self.order, Some(time), b"", packet).unwrap_or(CaptureRecord::broken(packet, false))
    }
}
