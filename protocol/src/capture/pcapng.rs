//! pcapng: blocks of a type, a length, a body and the length again; sections may differ in byte order, and every
//! interface has its own link type, name and time unit.
//!
//! Read here and not with a library: the one that exists allocates for each packet and knows no binary time units.

use super::packet::{Order, RecordCursor, event};
use super::{CaptureRecord, MAX_RECORD, RecordPosition, Timestamp, told};

/// A section's header; the same in both byte orders.
const SECTION: u32 = 0x0A0D_0D0A;
const INTERFACE: u32 = 1;
const OLD_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const PACKET: u32 = 6;
/// Type, length and the length again.
const FRAME: usize = 12;
/// A length beyond this is no length.
const MAX_LENGTH: u32 = 1 << 26;
/// Interfaces of one section that are kept; a capture has a handful.
const MAX_INTERFACES: usize = 4096;

const NAME: u16 = 2;
const RESOLUTION: u16 = 9;
const OFFSET: u16 = 14;

#[derive(Debug, Clone, Default)]
pub struct Pcapng {
    pub(super) stream: RecordCursor,
    order: Order,
    interfaces: Vec<Interface>,
}

#[derive(Debug, Clone, Default)]
struct Interface {
    link: u32,
    name: Vec<u8>,
    per_second: u64,
    digits: u8,
    offset_s: i64,
}

/// Whether a capture begins with these bytes.
pub(super) fn magic(bytes: &[u8]) -> bool {
    bytes.starts_with(&SECTION.to_be_bytes()) && byte_order(bytes).is_some()
}

fn byte_order(block: &[u8]) -> Option<Order> {
    match block.get(8..12)? {
        [0x4D, 0x3C, 0x2B, 0x1A] => Some(Order::Little),
        [0x1A, 0x2B, 0x3C, 0x4D] => Some(Order::Big),
        _ => None,
    }
}

impl Pcapng {
    pub(super) fn run(
        &mut self,
        bytes: &[u8],
        last: bool,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) -> usize {
        let mut at = 0;
        loop {
            let rest = &bytes[at..];
            if rest.is_empty() && self.stream.skip == 0 {
                return at;
            }
            let place = RecordPosition::Offset(self.stream.offset);
            if self.stream.lost || self.stream.skip > 0 {
                at += self.stream.advance(rest, if self.stream.lost { rest.len() as u64 } else { self.stream.skip });
                if self.stream.skip > 0 {
                    if last {
                        (self.stream.skip, self.stream.records) = (0, self.stream.records + 1);
                        sink(place, CaptureRecord::Broken { bytes: &[], cut: true });
                    }
                    return at;
                }
                continue;
            }
            let broken = |cut| CaptureRecord::Broken { bytes: told(rest), cut };
            if rest.len() >= FRAME && rest.starts_with(&SECTION.to_be_bytes()) {
                match byte_order(rest) {
                    Some(order) => self.order = order,
                    None => {
                        self.lose(place, broken(false), sink);
                        continue;
                    }
                }
            }
            let length = self.order.u32(rest, 4);
            if rest.len() >= FRAME && (length < FRAME as u32 || !length.is_multiple_of(4) || length > MAX_LENGTH) {
                self.lose(place, broken(false), sink);
                continue;
            }
            if rest.len() >= FRAME && length as usize > MAX_RECORD {
                self.stream.records += 1;
                sink(place, CaptureRecord::Remark);
                at += self.stream.advance(rest, length.into());
                continue;
            }
            if rest.len() < FRAME || rest.len() < length as usize {
                if last {
                    self.stream.records += 1;
                    sink(place, broken(true));
                    at += self.stream.advance(rest, rest.len() as u64);
                }
                return at;
            }
            let block = &rest[..length as usize];
            if self.order.u32(block, block.len() - 4) != length {
                self.lose(place, broken(false), sink);
                continue;
            }
            self.stream.records += 1;
            let event = self.block(block);
            sink(place, event.unwrap_or(CaptureRecord::Broken { bytes: told(block), cut: false }));
            at += self.stream.advance(rest, length.into());
        }
    }

    /// Tells that the blocks cannot be told apart any more.
    fn lose(
        &mut self,
        place: RecordPosition,
        event: CaptureRecord,
        sink: &mut impl FnMut(RecordPosition, CaptureRecord),
    ) {
        self.stream.records += 1;
        sink(place, event);
        self.stream.lost = true;
    }

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
            PACKET => {
                let header = body.get(..20)?;
                let ticks = u64::from(order.u32(header, 4)) << 32 | u64::from(order.u32(header, 8));
                (order.u32(header, 0), Some(ticks), order.u32(header, 12), &body[20..])
            }
            OLD_PACKET => {
                let header = body.get(..20)?;
                let ticks = u64::from(order.u32(header, 4)) << 32 | u64::from(order.u32(header, 8));
                (order.u16(header, 0).into(), Some(ticks), order.u32(header, 12), &body[20..])
            }
            SIMPLE_PACKET => (0, None, order.u32(body.get(..4)?, 0).min(body.len() as u32 - 4), &body[4..]),
            _ => return Some(CaptureRecord::Remark),
        };
        let interface = self.interfaces.get(index as usize)?;
        let time = ticks.and_then(|ticks| interface.time(ticks));
        event(interface.link, order, time, &interface.name, data.get(..length as usize)?)
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
        Some(Timestamp { t_ns, digits: self.digits })
    }
}
