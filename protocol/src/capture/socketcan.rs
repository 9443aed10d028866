//! CAN frames as packets of pcap and pcapng.

use super::binary::Order;
use super::{CaptureRecord, Frame, Timestamp, is_identifier};

/// LINKTYPE_CAN_SOCKETCAN: the frame as the kernel gives it, its identifier big-endian.
const SOCKETCAN: u32 = 227;
/// LINKTYPE_LINUX_SLL and LINKTYPE_LINUX_SLL2: the frame behind a header with the protocol.
const LINUX_SLL: u32 = 113;
const LINUX_SLL2: u32 = 276;
/// LINKTYPE_WIRESHARK_UPPER_PDU: what Wireshark writes for a candump log. Tags of type, length and value precede the frame;
/// a tag names the protocol.
const UPPER_PDU: u32 = 252;
const TAG_END: u16 = 0;
const TAG_PROTOCOL: u16 = 12;
const SLL_HEADER: usize = 16;
const SLL2_HEADER: usize = 20;
const PROTOCOL_CAN: u16 = 0x000C;
const PROTOCOL_CAN_FD: u16 = 0x000D;
const PROTOCOL_CAN_XL: u16 = 0x000E;

const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
/// In the sixth byte: a frame in the FD format.
const FD_FORMAT: u8 = 0x04;
/// Identifier, length, flags, two reserved bytes.
const HEADER: usize = 8;

/// Reads a packet of a link of type `link`; `None` if it is shorter than it claims.
pub fn packet_record<'a>(
    link: u32,
    order: Order,
    time: Option<Timestamp>,
    interface: &'a [u8],
    packet: &'a [u8],
) -> Option<CaptureRecord<'a>> {
    let (protocol, frame) = match link {
        SOCKETCAN => return socketcan_record(Order::Big.u32(packet, 0), time, interface, packet),
        UPPER_PDU => return upper_pdu(order, time, interface, packet),
        LINUX_SLL => (Order::Big.u16(packet.get(..SLL_HEADER)?, 14), &packet[SLL_HEADER..]),
        LINUX_SLL2 => (Order::Big.u16(packet.get(..SLL2_HEADER)?, 0), &packet[SLL2_HEADER..]),
        _ => return Some(CaptureRecord::Remark),
    };
    match protocol {
        // Behind a cooked header the identifier is in the order of the machine that wrote it; some tools swap it.
        PROTOCOL_CAN => {
            let id = [order, order.other()].map(|order| order.u32(frame, 0));
            let id = if id[0] > 0x7FF && id[1] <= 0x7FF { id[1] } else { id[0] };
            socketcan_record(id, time, interface, frame)
        }
        PROTOCOL_CAN_FD | PROTOCOL_CAN_XL => Some(CaptureRecord::Fd),
        _ => Some(CaptureRecord::Remark),
    }
}

fn upper_pdu<'a>(
    order: Order,
    time: Option<Timestamp>,
    interface: &'a [u8],
    mut packet: &'a [u8],
) -> Option<CaptureRecord<'a>> {
    let mut protocol: &[u8] = b"";
    loop {
        let (tag, length) = (Order::Big.u16(packet.get(..4)?, 0), usize::from(Order::Big.u16(packet, 2)));
        let value = packet.get(4..4 + length)?;
        packet = &packet[4 + length..];
        match tag {
            TAG_END => break,
            TAG_PROTOCOL => protocol = value.trim_ascii_end().split(|&byte| byte == 0).next()?,
            _ => {}
        }
    }
    match protocol {
        b"can-hostendian" => socketcan_record(order.u32(packet, 0), time, interface, packet),
        b"can-bigendian" => socketcan_record(Order::Big.u32(packet, 0), time, interface, packet),
        b"canfd" | b"canxl" => Some(CaptureRecord::Fd),
        _ => Some(CaptureRecord::Remark),
    }
}

/// Reads a SocketCAN frame from its identifier with flags, in this machine's byte order, and all its bytes; `None` if it is
/// shorter than it claims, or its identifier longer than its flags claim.
pub fn socketcan_record<'a>(
    id: u32,
    time: Option<Timestamp>,
    interface: &'a [u8],
    frame: &'a [u8],
) -> Option<CaptureRecord<'a>> {
    let (header, data) = frame.split_at_checked(HEADER)?;
    let length = usize::from(header[4]);
    if id & ERROR != 0 {
        return Some(CaptureRecord::Error);
    }
    if length > 8 || header[5] & FD_FORMAT != 0 {
        return Some(CaptureRecord::Fd);
    }
    if id & REMOTE != 0 {
        return Some(CaptureRecord::Remote);
    }
    let (extended, id) = (id & EXTENDED != 0, id & 0x1FFF_FFFF);
    let data = data.get(..length).filter(|_| is_identifier(id, extended))?;
    Some(CaptureRecord::Frame(Frame { time, interface, id, extended, data }))
}
