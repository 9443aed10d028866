//! The list of the faults of links: one entry per fault, with all that a plan, the schema and the catalogue need. A file of the
//! same name in the recorder, `link_model/fault/NAME.rs`, changes the bytes of a link.

use super::{Bound, FaultAction, FaultSpec, Scope, Transport, from_values};
use crate::parameter_spec::numbers;

const CAN: &[Transport] = &[Transport::Can];
const BYTE_STREAMS: &[Transport] = &[Transport::Pty, Transport::Serial, Transport::Tcp];

const NO_FRAMES: &str = "a CAN frame carries nothing but its own bytes: babble sends more frames";
const NO_BAUD_CAN: &str = "a controller at another bit rate sees error frames, which software cannot send: set another bitrate with ip link, or use a CAN disturbance generator";
const NO_BAUD_TCP: &str = "TCP has no baud rate: use a pty or a serial port";
const NO_PARITY_PTY: &str = "a pty carries bytes, not bits on a line, so it has neither parity nor framing: a serial port with a disturbance box (or a USB adapter set to another format at the far end) has";
const NO_PARITY_SERIAL: &str = "the driver sends every byte with the format that was set: a disturbance box in the line, or an UART driven by a microcontroller, can break single bits";
const NO_PARITY_TCP: &str =
    "TCP carries bytes, not bits on a line: a serial port with a disturbance box has parity and framing";
const NO_PARITY_CAN: &str = "CAN has no parity: bit-flip changes data, and a CAN disturbance generator (such as CANstress) breaks bits on the bus";
const NO_BUS: &str = "is a state of a CAN controller: use --can";
const NO_BUS_CAN: &str = "software cannot make it on a real bus, and a virtual one has none: a CAN disturbance generator (such as CANstress), or a shorted bus, can";
const NO_BUS_LINKS: [(Transport, &str); 4] =
    [(Transport::Pty, NO_BUS), (Transport::Serial, NO_BUS), (Transport::Can, NO_BUS_CAN), (Transport::Tcp, NO_BUS)];
const NO_LINE_LINKS: [(Transport, &str); 4] = [
    (Transport::Pty, NO_PARITY_PTY),
    (Transport::Serial, NO_PARITY_SERIAL),
    (Transport::Can, NO_PARITY_CAN),
    (Transport::Tcp, NO_PARITY_TCP),
];

/// Passes the faults of links to the macro `$with`: module in the recorder, type, and specification.
///
/// In brackets the code and any other field of [`FaultSpec`] that is not the default; in braces the numbers, the keys of the
/// fault in a plan.
#[macro_export]
macro_rules! link_faults {
    ($with:ident) => {
        $with! {
            /// samples are not sent
            drop: Drop ("drop") {}
            /// samples are sent more than once
            duplicate: Duplicate ("duplicate") {
                /// how often more
                copies: 1.0, 1.0..=16.0, "", Whole;
            }
            /// of each two samples the second is sent before the first
            reorder: Reorder ("reorder") {}
            /// samples are sent late
            delay: Delay ("delay") {
                /// how late
                delay_s: required, 0.001..=60.0, "s";
            }
            /// samples are sent late, each by a delay drawn evenly
            jitter: Jitter ("jitter") {
                /// the longest
                jitter_s: required, 0.001..=60.0, "s";
            }
            /// the last bytes are missing; on CAN every message is shorter, and one without bytes left is not sent
            truncate: Truncate ("truncate", bounds: &[Bound { number: "bytes", links: CAN, most: 8.0, what: "on CAN" }]) {
                /// how many
                bytes: 1.0, 1.0..=27.0, "byte", Whole;
            }
            /// a gap within the sample interval: behind this byte of a frame, on CAN behind this message
            split: Split ("split", bounds: &[Bound { number: "byte", links: CAN, most: 2.0, what: "messages on CAN" }]) {
                /// bytes, on CAN messages, before the gap
                byte: 1.0, 1.0..=27.0, "", Whole;
                /// how long
                gap_s: 0.05, 0.001..=10.0, "s";
            }
            /// samples are held and sent together
            merge: Merge ("merge") {
                /// how many at once
                frames: 2.0, 2.0..=64.0, "", Whole;
            }
            /// bytes that mean nothing stand before each sample
            extra_bytes: ExtraBytes ("extra-bytes", unable: &[(Transport::Can, NO_FRAMES)]) {
                /// how many
                bytes: 1.0, 1.0..=64.0, "byte", Whole;
            }
            /// bits of the data are changed: before the CRC, which then is right, or after it
            bit_flip: BitFlip ("bit-flip") {
                /// how many, anywhere in the data
                bits: 1.0, 1.0..=64.0, "bit", Whole;
                /// after or before the CRC
                crc: 0.0, 0.0..=1.0, "", Choice(&["after", "before"]);
            }
            /// the sequence stands still, the CRC is right
            sequence_stuck: SequenceStuck ("sequence-stuck") {}
            /// the sequence is off by so much, the CRC is right
            sequence_jump: SequenceJump ("sequence-jump", neutral: Some(("by", 0.0))) {
                /// how much
                by: required, -32768.0..=32767.0, "", Whole;
            }
            /// the last good sample is sent again and again
            stale_repeat: StaleRepeat ("stale-repeat") {}
            /// the length told is not that of the data; on CAN every message has this length
            wrong_length: WrongLength ("wrong-length", bounds: &[Bound { number: "length", links: CAN, most: 8.0, what: "on CAN" }]) {
                /// length told; on CAN 0…8
                length: required, 0.0..=255.0, "", Whole;
            }
            /// messages go out under another identifier: the frame's type, on CAN the identifier of INCREMENTS, the others behind it
            wrong_identifier: WrongIdentifier ("wrong-identifier", bounds: &[Bound { number: "identifier", links: BYTE_STREAMS, most: 255.0, what: "on a link of bytes" }]) {
                /// type 0…255, on CAN 0…2045
                identifier: required, 0.0..=2045.0, "", Whole;
            }
            /// nonsense between the samples: bytes, on CAN frames of any identifier
            babble: Babble ("babble") {
                /// bytes or frames in each sample interval
                amount: 16.0, 1.0..=1000.0, "", Whole;
            }
            /// neither data nor replies
            silence: Silence ("silence") {}
            /// the bytes that a receiver at the link's rate reads when they are sent at another
            baud_mismatch: BaudMismatch ("baud-mismatch", unable: &[(Transport::Can, NO_BAUD_CAN), (Transport::Tcp, NO_BAUD_TCP)]) {
                /// rate of the sender
                baud: required, 50.0..=4e6, "baud";
            }
            /// replies, and what was polled, are late
            reply_late: ReplyLate ("reply-late") {
                /// how late
                delay_s: required, 0.001..=60.0, "s";
            }
            /// commands act, and get no reply
            reply_missing: ReplyMissing ("reply-missing") {}
        }
    };
}

macro_rules! declare {
    ($($(#[doc = $meaning:literal])* $module:ident: $fault:ident ($code:literal $(, $field:ident: $value:expr)*) {
        $($numbers:tt)*
    })*) => {
        $(
            numbers! { $(#[doc = $meaning])* pub struct $fault { $($numbers)* } }
        )*

        /// A fault of a link.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum LinkFault {
            $($(#[doc = $meaning])* $fault($fault)),*
        }

        /// The faults that links can have.
        pub(super) const POSSIBLE: &[FaultSpec] = &[$(FaultSpec {
            $($field: $value,)*
            ..FaultSpec::new(Scope::Link, $code, concat!($($meaning),*).trim_ascii(), $fault::NUMBERS, |values| {
                FaultAction::Link(LinkFault::$fault(from_values(values)))
            })
        }),*];
    };
}

link_faults!(declare);

/// The faults that no link can have, with the alternatives.
pub(super) const IMPOSSIBLE: &[FaultSpec] = &[
    impossible("parity-error", "bytes with wrong parity", &NO_LINE_LINKS),
    impossible("framing-error", "bytes without a stop bit", &NO_LINE_LINKS),
    impossible("bus-off", "the controller leaves the bus", &NO_BUS_LINKS),
    impossible("bit-error", "a bit on the bus is overwritten: error frames", &NO_BUS_LINKS),
];

const fn impossible(
    code: &'static str,
    meaning: &'static str,
    unable: &'static [(Transport, &'static str)],
) -> FaultSpec {
    FaultSpec { unable, ..FaultSpec::new(Scope::Link, code, meaning, &[], |_| unreachable!("refused on every link")) }
}
