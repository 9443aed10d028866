//! The list of the faults of links: one entry per fault, with all that a plan, the schema and the catalogue need. A file of the
//! same name in the recorder, `link_model/fault/NAME.rs`, changes the bytes of a link.

use super::{
    Bound, CAN, DefaultValue, FaultAction, FaultSpec, ONE, ParameterSpec, REAL, REQUIRED, Scope, Transport,
    ValueFormat, WHOLE,
};
use crate::parameter_spec::number;

/// The shortest delay that can be observed, s.
const MIN_DELAY_S: f64 = 0.001;
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
/// `numbers` are the keys of the fault in a plan: name, type, and the arguments of [`number`](crate::parameter_spec::number). Any
/// other field of [`FaultSpec`] can follow; its default applies if it is absent.
#[macro_export]
macro_rules! link_faults {
    ($with:ident) => {
        $with! {
            drop: Drop { code: "drop", meaning: "samples are not sent", numbers: {} }
            duplicate: Duplicate {
                code: "duplicate",
                meaning: "samples are sent more than once",
                numbers: { copies: u64 = ("", WHOLE, ONE, 1.0, 16.0, "how often more") }
            }
            reorder: Reorder {
                code: "reorder",
                meaning: "of each two samples the second is sent before the first",
                numbers: {}
            }
            delay: Delay {
                code: "delay",
                meaning: "samples are sent late",
                numbers: { delay_s: f64 = ("s", REAL, REQUIRED, MIN_DELAY_S, 60.0, "how late") }
            }
            jitter: Jitter {
                code: "jitter",
                meaning: "samples are sent late, each by a delay drawn evenly",
                numbers: { jitter_s: f64 = ("s", REAL, REQUIRED, MIN_DELAY_S, 60.0, "the longest") }
            }
            truncate: Truncate {
                code: "truncate",
                meaning: "the last bytes are missing; on CAN every message is shorter, and one without bytes left is not sent",
                numbers: { bytes: u64 = ("byte", WHOLE, ONE, 1.0, 27.0, "how many") },
                bounds: &[Bound { number: "bytes", links: CAN, most: 8.0, what: "on CAN" }]
            }
            split: Split {
                code: "split",
                meaning: "a gap within the sample interval: behind this byte of a frame, on CAN behind this message",
                numbers: {
                    byte: u64 = ("", WHOLE, ONE, 1.0, 27.0, "bytes, on CAN messages, before the gap"),
                    gap_s: f64 = ("s", REAL, DefaultValue::Value(0.05), MIN_DELAY_S, 10.0, "how long")
                },
                bounds: &[Bound { number: "byte", links: CAN, most: 2.0, what: "messages on CAN" }]
            }
            merge: Merge {
                code: "merge",
                meaning: "samples are held and sent together",
                numbers: { frames: u64 = ("", WHOLE, DefaultValue::Value(2.0), 2.0, 64.0, "how many at once") }
            }
            extra_bytes: ExtraBytes {
                code: "extra-bytes",
                meaning: "bytes that mean nothing stand before each sample",
                numbers: { bytes: u64 = ("byte", WHOLE, ONE, 1.0, 64.0, "how many") },
                unable: &[(Transport::Can, NO_FRAMES)]
            }
            bit_flip: BitFlip {
                code: "bit-flip",
                meaning: "bits of the data are changed: before the CRC, which then is right, or after it",
                numbers: {
                    bits: u64 = ("bit", WHOLE, ONE, 1.0, 64.0, "how many, anywhere in the data"),
                    crc: u64 = (
                        "",
                        ValueFormat::Choice(&["after", "before"]),
                        DefaultValue::Value(0.0),
                        0.0,
                        1.0,
                        "after or before the CRC"
                    )
                }
            }
            sequence_stuck: SequenceStuck {
                code: "sequence-stuck",
                meaning: "the sequence stands still, the CRC is right",
                numbers: {}
            }
            sequence_jump: SequenceJump {
                code: "sequence-jump",
                meaning: "the sequence is off by so much, the CRC is right",
                numbers: { by: i64 = ("", WHOLE, REQUIRED, -32768.0, 32767.0, "how much") },
                neutral: Some(("by", 0.0))
            }
            stale_repeat: StaleRepeat {
                code: "stale-repeat",
                meaning: "the last good sample is sent again and again",
                numbers: {}
            }
            wrong_length: WrongLength {
                code: "wrong-length",
                meaning: "the length told is not that of the data; on CAN every message has this length",
                numbers: { length: u64 = ("", WHOLE, REQUIRED, 0.0, 255.0, "length told; on CAN 0…8") },
                bounds: &[Bound { number: "length", links: CAN, most: 8.0, what: "on CAN" }]
            }
            wrong_identifier: WrongIdentifier {
                code: "wrong-identifier",
                meaning: "messages go out under another identifier: the frame's type, on CAN the identifier of INCREMENTS, the others behind it",
                numbers: { identifier: u64 = ("", WHOLE, REQUIRED, 0.0, 2045.0, "type 0…255, on CAN 0…2045") },
                bounds: &[Bound { number: "identifier", links: BYTE_STREAMS, most: 255.0, what: "on a link of bytes" }]
            }
            babble: Babble {
                code: "babble",
                meaning: "nonsense between the samples: bytes, on CAN frames of any identifier",
                numbers: {
                    amount: u64 = ("", WHOLE, DefaultValue::Value(16.0), 1.0, 1000.0, "bytes or frames in each sample interval")
                }
            }
            silence: Silence { code: "silence", meaning: "neither data nor replies", numbers: {} }
            baud_mismatch: BaudMismatch {
                code: "baud-mismatch",
                meaning: "the bytes that a receiver at the link's rate reads when they are sent at another",
                numbers: { baud: f64 = ("baud", REAL, REQUIRED, 50.0, 4e6, "rate of the sender") },
                unable: &[(Transport::Can, NO_BAUD_CAN), (Transport::Tcp, NO_BAUD_TCP)]
            }
            reply_late: ReplyLate {
                code: "reply-late",
                meaning: "replies, and what was polled, are late",
                numbers: { delay_s: f64 = ("s", REAL, REQUIRED, MIN_DELAY_S, 60.0, "how late") }
            }
            reply_missing: ReplyMissing {
                code: "reply-missing",
                meaning: "commands act, and get no reply",
                numbers: {}
            }
        }
    };
}

macro_rules! declare {
    ($($module:ident: $fault:ident {
        code: $code:literal,
        meaning: $meaning:literal,
        numbers: {
            $($number:ident: $type:ty = ($unit:literal, $form:expr, $default:expr, $min:expr, $max:expr, $text:literal)),*
        }
        $(, $field:ident: $value:expr)*
    })*) => {
        $(
            #[doc = $meaning]
            #[derive(Debug, Clone, Copy, PartialEq)]
            pub struct $fault {
                $(#[doc = $text] pub $number: $type),*
            }

            impl $fault {
                fn action(numbers: &[f64]) -> FaultAction {
                    let mut _numbers = numbers.iter();
                    FaultAction::Link(LinkFault::$fault($fault { $($number: next(&mut _numbers) as $type),* }))
                }
            }
        )*

        /// A fault of a link.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum LinkFault {
            $(#[doc = $meaning] $fault($fault)),*
        }

        /// The faults that links can have.
        pub(super) const POSSIBLE: &[FaultSpec] = &[$(FaultSpec {
            $($field: $value,)*
            ..link(
                $code,
                $meaning,
                &[$(number(stringify!($number), $unit, $form, $default, $min, $max, $text)),*],
                $fault::action,
            )
        }),*];
    };
}

link_faults!(declare);

fn next(numbers: &mut std::slice::Iter<f64>) -> f64 {
    *numbers.next().expect("a value for each number")
}

const fn link(
    code: &'static str,
    meaning: &'static str,
    numbers: &'static [ParameterSpec],
    law: fn(&[f64]) -> FaultAction,
) -> FaultSpec {
    FaultSpec { scope: Scope::Link, ..FaultSpec::new(code, meaning, numbers, law) }
}

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
    FaultSpec { unable, ..link(code, meaning, &[], |_| unreachable!("refused on every link")) }
}
