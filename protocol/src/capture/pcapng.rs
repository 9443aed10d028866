//! pcapng: blocks of type, length, body and length again. Sections may differ in byte order; each interface has its own link
//! type, name and time unit. No library is used: the existing one allocates for each packet and lacks binary time units.

use super::binary::{BinaryFormat, MAX_LENGTH, Next, Order, reader};
use super::socketcan::packet_record;
use super::{CaptureRecord, Detection, Format, MAX_RECORD, Timestamp};

pub(super) const FORMATS: &[Format] = &[Format {
    name: "pcapng",
    title: "pcapng",
    suffixes: &["pcapng"],
    detection: Detection::Signature(|head| head.starts_with(&SECTION.to_be_bytes()) && byte_order(head).is_some()),
    new_reader: Some(reader::<Pcapng>),
}];

/// A section's header; the same in both byte orders.
const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const OLD_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const PACKET: u32 = 6;
/// Type, length and the length again.
const FRAME: usize = 12;
/// Interfaces of one section that are kept; a capture has a handful.
const MAX_INTERFACES: usize = 4096;

const NAME: u16 = 2;
const RESOLUTION: u16 = 9;
const OFFSET: u16 = 14;

#[derive(Debug, Default)]
struct Pcapng {
    order: Order,
    interfaces: Vec<Interface>,
}

#[derive(Debug, Default)]
struct Interface {
    link: u32,
    name: Vec<u8>,
    per_second: u64,
    digits: u8,
    offset_s: i64,
}

fn byte_order(block: &[u8]) -> Option<Order> {
    match block.get(8..12)? {
        [0x4D, 0x3C, 0x2B, 0x1A] => Some(Order::Little),
        [0x1A, 0x2B, 0x3C, 0x4D] => Some(Order::Big),
        _ => None,
    }
}

impl BinaryFormat for Pcapng {
    fn next(&mut self, bytes: &[u8]) -> Next {
        if bytes.len() < FRAME {
            return Next::Incomplete;
        }
        if bytes.starts_with(&SECTION.to_be_bytes()) {
            let Some(order) = byte_order(bytes) else {
                return Next::Lost;
            };
            self.order = order;
        }
        let length = self.order.u32(bytes, 4);
        if length < FRAME as u32 || !length.is_multiple_of(4) || length > MAX_LENGTH {
            return Next::Lost;
        }
        let is_whole = length as usize <= bytes.len().min(MAX_RECORD);
        if is_whole && self.order.u32(bytes, length as usize - 4) != length {
            return Next::Lost;
        }
        Next::Record(length.into())
    }

    fn read<'a>(&'a mut self, record: &'a [u8]) -> CaptureRecord<'a> {
        self.block(record).unwrap_or(CaptureRecord::broken(record, false))
    }
}

impl Pcapng {
    fn block<'a>(&'a mut self, block: &'a [u8]) -> Option<CaptureRecord<'a>> {
        let order = self.order;
        let body = &block[8..block.len() - 4];
        let (index, ticks, length, data) = match order.u32(block, 0) {
            SECTION => {
                self.interfaces.clear();
                return Some(CaptureRecord::Remark);
            }
            INTERFACE => {
                if self.interfaces.len() < MAX_INTERFACES {
                    self.interfaces.push(Interface::read(order, body.get(..8)?, &body[8..]));
                }
                return Some(CaptureRecord::Remark);
            }
            kind @ (PACKET | OLD_PACKET) => {
                let header = body.get(..20)?;
                let index = if kind == PACKET { order.u32(header, 0) } else { order.u16(header, 0).into() };
                let ticks = u64::from(order.u32(header, 4)) << 32 | u64::from(order.u32(header, 8));
                (index, Some(ticks), order.u32(header, 12), &body[20..])
            }
            SIMPLE_PACKET => (0, None, order.u32(body.get(..4)?, 0).min(body.len() as u32 - 4), &body[4..]),
            _ => return Some(CaptureRecord::Remark),
        };
        let interface = self.interfaces.get(index as usize)?;
        let time = ticks.and_then(|ticks| interface.time(ticks));
        packet_record(interface.link, order, time, &interface.name, data.get(..length as usize)?)
    }
}

impl Interface {
    fn read(order: Order, header: &[u8], mut options: &[u8]) -> Interface {
        let mut interface =
            Interface { link: order.u16(header, 0).into(), per_second: 1_000_000, digits: 6, ..Interface::default() };
        while options.len() >= 4 {
            let (code, length) = (order.u16(options, 0), usize::from(order.u16(options, 2)));
            let Some(value) = options.get(4..4 + length) else { break };
            match (code, value) {
                (NAME, name) => interface.name = name.to_vec(),
                (RESOLUTION, &[exponent]) if exponent & 0x80 == 0 && exponent <= 18 => {
                    (interface.per_second, interface.digits) = (10u64.pow(exponent.into()), exponent.min(9));
                }
                (RESOLUTION, &[exponent]) if exponent & 0x80 != 0 && exponent & 0x7F < 63 => {
                    (interface.per_second, interface.digits) = (1 << (exponent & 0x7F), 9);
                }
                (OFFSET, value) if value.len() == 8 => {
                    let (a, b) = (u64::from(order.u32(value, 0)), u64::from(order.u32(value, 4)));
                    interface.offset_s = if order == Order::Big { a << 32 | b } else { b << 32 | a } as i64;
                }
                _ => {}
            }
            options = options.get(4 + length.next_multiple_of(4)..).unwrap_or_default();
        }
        interface
    }

    fn time(&self, ticks: u64) -> Option<Timestamp> {
        let whole = i64::try_from(ticks / self.per_second).ok()?.checked_add(self.offset_s)?;
        let fraction_ns = u128::from(ticks % self.per_second) * 1_000_000_000 / u128::from(self.per_second);
        let t_ns = whole.checked_mul(1_000_000_000)?.checked_add(fraction_ns as i64)?;
        Some(Timestamp { t_ns, digits: self.digits.into() })
    }
}
