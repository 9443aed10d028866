//! The faults that have a name: of a gyro's head, of the whole unit, of a link. Those of a link are carried out by the
//! daemon, on bytes; here stands what they are, on which links they can be, and what else could do what no link can.

use geu_protocol::Gyro;

use crate::fault::{ParameterRef, shape};
use crate::number::{DefaultValue, ParameterSpec, ValueFormat, named_gyro, number};

/// A kind of link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Transport {
    /// A pty.
    Pty,
    /// A serial port.
    Serial,
    /// A CAN interface.
    Can,
    /// TCP.
    Tcp,
}

impl Transport {
    /// All, in the order of [`Transport::NAMES`].
    pub const ALL: [Transport; 4] = [Transport::Pty, Transport::Serial, Transport::Can, Transport::Tcp];
    /// Names in plans and on the command line.
    pub const NAMES: [&str; 4] = ["pty", "serial", "can", "tcp"];

    /// Its name.
    pub fn name(self) -> &'static str {
        Transport::NAMES[self as usize]
    }

    /// The kind of that name.
    pub fn named(name: &str) -> Option<Transport> {
        Transport::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Whom a fault is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// One gyro.
    Gyro,
    /// The whole unit.
    Unit,
    /// Links.
    Link,
}

impl Scope {
    /// Its name.
    pub fn name(self) -> &'static str {
        ["gyro", "unit", "link"][self as usize]
    }
}

/// What a fault of a gyro does to its counts, after rounding and wiring, before clipping.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum GyroFault {
    Dead,
    StuckCount { counts: f64 },
    WrongLsb { factor: f64 },
    Spike { counts: f64, law: SpikeLaw },
    Garbage,
    Saturated { is_negative: bool },
    SpinDown { coast_s: f64 },
}

/// How the size of a spike is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum SpikeLaw {
    Constant,
    Alternating,
    Uniform,
    Normal,
}

impl SpikeLaw {
    const NAMES: &[&str] = &["constant", "alternating", "uniform", "normal"];

    fn at(index: f64) -> SpikeLaw {
        [SpikeLaw::Constant, SpikeLaw::Alternating, SpikeLaw::Uniform, SpikeLaw::Normal][index as usize]
    }
}

/// What a fault of the unit does.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)]
pub enum UnitFault {
    Reset,
    BrownOut,
    BootDelay,
    FlipFlags { gyro_flags: u8, unit_flags: u8 },
    ClockJump { cycles: i64 },
    HeaterLost,
}

/// The list of the faults of links: hands each to the macro `$with`, with its numbers and the module of the daemon that says
/// what it does to the bytes of a link.
#[macro_export]
macro_rules! link_faults {
    ($with:ident) => {
        $with! {
            drop: Drop {},
            duplicate: Duplicate { copies: u64 },
            reorder: Reorder {},
            delay: Delay { delay_s: f64 },
            jitter: Jitter { jitter_s: f64 },
            truncate: Truncate { bytes: u64 },
            split: Split { byte: u64, gap_s: f64 },
            merge: Merge { frames: u64 },
            extra_bytes: ExtraBytes { bytes: u64 },
            bit_flip: BitFlip { bits: u64, is_after_crc: bool },
            sequence_stuck: SequenceStuck {},
            sequence_jump: SequenceJump { by: i64 },
            stale_repeat: StaleRepeat {},
            wrong_length: WrongLength { length: u64 },
            wrong_identifier: WrongIdentifier { identifier: u64 },
            babble: Babble { amount: u64 },
            silence: Silence {},
            baud_mismatch: BaudMismatch { baud: f64 },
            reply_late: ReplyLate { delay_s: f64 },
            reply_missing: ReplyMissing {},
        }
    };
}

macro_rules! declare {
    ($($module:ident: $fault:ident { $($number:ident: $type:ty),* }),* $(,)?) => {
        /// The faults of links.
        #[allow(missing_docs)]
        pub mod link_fault {
            $(
                #[derive(Debug, Clone, Copy, PartialEq)]
                pub struct $fault { $(pub $number: $type),* }

                impl From<$fault> for super::FaultAction {
                    fn from(fault: $fault) -> super::FaultAction { super::FaultAction::Link(super::LinkFault::$fault(fault)) }
                }
            )*
        }

        /// A fault of a link.
        #[derive(Debug, Clone, Copy, PartialEq)]
        #[allow(missing_docs)]
        pub enum LinkFault { $($fault(link_fault::$fault)),* }
    };
}

link_faults!(declare);

/// What a named fault does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultAction {
    /// Moves a parameter of an effect, as a fault of that parameter would.
    Parameter {
        /// Which.
        target: ParameterRef,
        /// Size.
        size: f64,
        /// Course.
        course: shape::FaultProfile,
    },
    /// On one gyro.
    Head(GyroFault),
    /// On the unit.
    Unit(UnitFault),
    /// On links.
    Link(LinkFault),
}

/// What is said of a named fault.
pub struct FaultSpec {
    /// Its name in a plan.
    pub code: &'static str,
    /// Whom it is on.
    pub scope: Scope,
    /// What it does.
    pub meaning: &'static str,
    /// Its numbers.
    pub numbers: &'static [ParameterSpec],
    /// How long it acts where nothing is said; without end where that is nothing.
    pub for_s: Option<f64>,
    /// For a fault of a link: where it cannot be done, why, and what could.
    pub unable: &'static [(Transport, &'static str)],
    /// For a fault of a link: what some links hold its numbers to.
    pub bounds: &'static [Bound],
    law: fn(&[f64]) -> FaultAction,
}

/// What some links hold a number to.
#[derive(Debug)]
pub struct Bound {
    /// The number's name.
    pub number: &'static str,
    /// The links.
    pub links: &'static [Transport],
    /// The largest value there.
    pub most: f64,
    /// What it counts there.
    what: &'static str,
}

impl PartialEq for FaultSpec {
    fn eq(&self, other: &FaultSpec) -> bool {
        self.code == other.code
    }
}

impl std::fmt::Debug for FaultSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.code)
    }
}

impl FaultSpec {
    /// The fault of that name.
    pub fn named(code: &str) -> Option<&'static FaultSpec> {
        CATALOGUE.iter().find(|spec| spec.code == code)
    }

    /// Its law with these values of [`FaultSpec::numbers`].
    pub fn law(&self, numbers: &[f64]) -> FaultAction {
        (self.law)(numbers)
    }

    /// Why a link cannot have it; nothing where it can.
    pub fn unable_on(&self, link: Transport) -> Option<&'static str> {
        self.unable.iter().find(|(kind, _)| *kind == link).map(|(_, reason)| *reason)
    }

    /// A number with which it would change nothing, and what was expected of it.
    pub fn neutral(&self, numbers: &[f64], gyro: Option<Gyro>) -> Option<(&'static str, String)> {
        let other = |value: &str, number| Some((number, format!("another than {value}, with which nothing changes,")));
        match self.law(numbers) {
            FaultAction::Head(GyroFault::Spike { counts: 0.0, .. }) => other("0", "counts"),
            FaultAction::Head(GyroFault::WrongLsb { factor: 1.0 }) => other("1", "factor"),
            FaultAction::Unit(UnitFault::ClockJump { cycles: 0 }) => other("0", "cycles"),
            FaultAction::Link(LinkFault::SequenceJump(link_fault::SequenceJump { by: 0 })) => other("0", "by"),
            FaultAction::Unit(UnitFault::FlipFlags { gyro_flags: 0, unit_flags: 0 }) => {
                Some(("gyro_flags", "a mask with at least one bit, here or in `unit_flags`,".to_owned()))
            }
            FaultAction::Parameter { size, .. }
                if gyro.is_some() && named_gyro(size) == gyro && self.code == "axis-swap" =>
            {
                other("its own gyro", "with")
            }
            _ => None,
        }
    }

    /// A number that cannot be on any of these links, which the fault is on, and what was expected of it.
    pub fn misfit(&self, numbers: &[f64], links: &[Transport]) -> Option<(&'static str, String)> {
        let is_beyond = |bound: &Bound| {
            let mut values = self.numbers.iter().zip(numbers);
            values.any(|(number, &value)| number.name == bound.number && value > bound.most)
                && bound.links.iter().any(|link| links.contains(link))
        };
        let Bound { number, most, what, .. } = self.bounds.iter().find(|bound| is_beyond(bound))?;
        Some((number, format!("at most {most} {what}, or another `link`,")))
    }

    /// Links that can have it.
    pub fn links(&self) -> Vec<Transport> {
        Transport::ALL.into_iter().filter(|&kind| self.unable_on(kind).is_none()).collect()
    }
}

const WHOLE: ValueFormat = ValueFormat::Whole;
const REAL: ValueFormat = ValueFormat::Real;
/// What is later by less cannot be seen.
const LEAST_DELAY_S: f64 = 0.001;
const ONE: DefaultValue = DefaultValue::Value(1.0);
const REQUIRED: DefaultValue = DefaultValue::Required;

const fn head(
    code: &'static str,
    meaning: &'static str,
    numbers: &'static [ParameterSpec],
    law: fn(&[f64]) -> FaultAction,
) -> FaultSpec {
    FaultSpec { code, scope: Scope::Gyro, meaning, numbers, for_s: None, unable: &[], bounds: &[], law }
}

const fn unit(
    code: &'static str,
    meaning: &'static str,
    numbers: &'static [ParameterSpec],
    for_s: Option<f64>,
    law: fn(&[f64]) -> FaultAction,
) -> FaultSpec {
    FaultSpec { code, scope: Scope::Unit, meaning, numbers, for_s, unable: &[], bounds: &[], law }
}

const fn link(
    code: &'static str,
    meaning: &'static str,
    numbers: &'static [ParameterSpec],
    unable: &'static [(Transport, &'static str)],
    law: fn(&[f64]) -> FaultAction,
) -> FaultSpec {
    FaultSpec { code, scope: Scope::Link, meaning, numbers, for_s: None, unable, bounds: &[], law }
}

const CAN: &[Transport] = &[Transport::Can];
const OF_BYTES: &[Transport] = &[Transport::Pty, Transport::Serial, Transport::Tcp];

const fn bound(number: &'static str, links: &'static [Transport], most: f64, what: &'static str) -> Bound {
    Bound { number, links, most, what }
}

fn moved(parameter: &str, size: f64, course: shape::FaultProfile) -> FaultAction {
    FaultAction::Parameter { target: ParameterRef::named(parameter).expect("a number of an effect"), size, course }
}

/// A fault that no link can have.
const fn impossible(
    code: &'static str,
    meaning: &'static str,
    unable: &'static [(Transport, &'static str)],
) -> FaultSpec {
    link(code, meaning, &[], unable, |_| unreachable!("refused on every link"))
}

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

/// Every named fault.
pub static CATALOGUE: &[FaultSpec] = &[
    head("dead", "reads 0, not valid", &[], |_| FaultAction::Head(GyroFault::Dead)),
    head(
        "stuck-count",
        "every increment is the same, flagged as if it were right",
        &[number("counts", WHOLE, REQUIRED, -32768.0, 32767.0, "the increment")],
        |n| FaultAction::Head(GyroFault::StuckCount { counts: n[0] }),
    ),
    head("stuck-rate", "the last increment is repeated", &[], |_| {
        moved("stuck-output.on", 1.0, shape::FaultProfile::Step)
    }),
    head("sign-flip", "counts have the other sign", &[], |_| {
        moved("sign-inversion.on", 1.0, shape::FaultProfile::Step)
    }),
    head(
        "axis-swap",
        "counts of two gyros stand in each other's place",
        &[number("with", ValueFormat::Gyro, REQUIRED, 1.0, 4.0, "the other gyro")],
        |n| moved("axis-swap.with", n[0], shape::FaultProfile::Step),
    ),
    head(
        "wrong-lsb",
        "counts are of another size",
        &[number("factor", REAL, REQUIRED, -256.0, 256.0, "counts told for one that is meant")],
        |n| FaultAction::Head(GyroFault::WrongLsb { factor: n[0] }),
    ),
    FaultSpec {
        for_s: Some(0.5),
        ..head(
            "spike",
            "counts are added in each sample interval",
            &[
                number("counts", REAL, REQUIRED, -65535.0, 65535.0, "size: the value, the largest, or the deviation"),
                number(
                    "law",
                    ValueFormat::Choice(SpikeLaw::NAMES),
                    DefaultValue::Value(0.0),
                    0.0,
                    3.0,
                    "how the size is drawn",
                ),
            ],
            |n| FaultAction::Head(GyroFault::Spike { counts: n[0], law: SpikeLaw::at(n[1]) }),
        )
    },
    head("garbage", "any 16 bits, flagged as if they were right", &[], |_| FaultAction::Head(GyroFault::Garbage)),
    head(
        "saturated",
        "the largest increment, flagged saturated",
        &[number(
            "negative",
            ValueFormat::Flag,
            DefaultValue::Value(0.0),
            0.0,
            1.0,
            "whether it is the most negative one",
        )],
        |n| FaultAction::Head(GyroFault::Saturated { is_negative: n[0] != 0.0 }),
    ),
    head(
        "noise-growth",
        "the angle random walk grows and stays",
        &[
            number("arcsec_per_sqrt_s", REAL, REQUIRED, 1e-6, 100.0, "what the walk grows by"),
            number("over_s", REAL, REQUIRED, 0.5, 1e9, "how long it grows"),
        ],
        |n| moved("angle-random-walk.arcsec_per_sqrt_s", n[0], shape::FaultProfile::Ramp { over_s: n[1] }),
    ),
    head(
        "spin-down",
        "the spin motor coasts: counts fade, not valid, not synchronous; 60 s of spin-up when it is over",
        &[number("coast_s", REAL, DefaultValue::Value(30.0), 0.5, 1e6, "time constant of the coast")],
        |n| FaultAction::Head(GyroFault::SpinDown { coast_s: n[0] }),
    ),
    unit("heater-lost", "the sensor's heater gives nothing, whatever is commanded", &[], None, |_| {
        FaultAction::Unit(UnitFault::HeaterLost)
    }),
    unit(
        "reset",
        "the electronics restart: silent meanwhile, then sequence and clock from 0, cyclic, no self-test; gyros run on",
        &[],
        Some(2.0),
        |_| FaultAction::Unit(UnitFault::Reset),
    ),
    unit(
        "brown-out",
        "power is lost: silent meanwhile, then as after a reset, heater on, and the gyros spin up again",
        &[],
        Some(2.0),
        |_| FaultAction::Unit(UnitFault::BrownOut),
    ),
    unit(
        "boot-delay",
        "silent until it is over, then sequence and clock from 0; on from the start, the unit boots late",
        &[],
        Some(2.0),
        |_| FaultAction::Unit(UnitFault::BootDelay),
    ),
    unit(
        "flip-flags",
        "flags contradict the data: these bits are told the wrong way",
        &[
            number("gyro_flags", WHOLE, DefaultValue::Value(0.0), 0.0, 255.0, "mask"),
            number("unit_flags", WHOLE, DefaultValue::Value(0.0), 0.0, 255.0, "mask"),
        ],
        None,
        |n| FaultAction::Unit(UnitFault::FlipFlags { gyro_flags: n[0] as u8, unit_flags: n[1] as u8 }),
    ),
    unit(
        "clock-jump",
        "the clock count jumps once and goes on from there",
        &[number("cycles", WHOLE, REQUIRED, -1e12, 1e12, "cycles of the unit clock")],
        Some(0.5),
        |n| FaultAction::Unit(UnitFault::ClockJump { cycles: n[0] as i64 }),
    ),
    link("drop", "samples are not sent", &[], &[], |_| link_fault::Drop {}.into()),
    link(
        "duplicate",
        "samples are sent more than once",
        &[number("copies", WHOLE, ONE, 1.0, 16.0, "how often more")],
        &[],
        |n| link_fault::Duplicate { copies: n[0] as u64 }.into(),
    ),
    link("reorder", "of each two samples the second is sent before the first", &[], &[], |_| {
        link_fault::Reorder {}.into()
    }),
    link(
        "delay",
        "samples are sent late",
        &[number("delay_s", REAL, REQUIRED, LEAST_DELAY_S, 60.0, "how late")],
        &[],
        |n| link_fault::Delay { delay_s: n[0] }.into(),
    ),
    link(
        "jitter",
        "samples are sent late, each by a delay drawn evenly",
        &[number("jitter_s", REAL, REQUIRED, LEAST_DELAY_S, 60.0, "the longest")],
        &[],
        |n| link_fault::Jitter { jitter_s: n[0] }.into(),
    ),
    FaultSpec {
        bounds: &[bound("bytes", CAN, 8.0, "on CAN")],
        ..link(
            "truncate",
            "the last bytes are missing; on CAN every message is shorter, and one without bytes left is not sent",
            &[number("bytes", WHOLE, ONE, 1.0, 27.0, "how many")],
            &[],
            |n| link_fault::Truncate { bytes: n[0] as u64 }.into(),
        )
    },
    FaultSpec {
        bounds: &[bound("byte", CAN, 2.0, "messages on CAN")],
        ..link(
            "split",
            "a gap within the sample interval: behind this byte of a frame, on CAN behind this message",
            &[
                number("byte", WHOLE, ONE, 1.0, 27.0, "bytes, on CAN messages, before the gap"),
                number("gap_s", REAL, DefaultValue::Value(0.05), LEAST_DELAY_S, 10.0, "how long"),
            ],
            &[],
            |n| link_fault::Split { byte: n[0] as u64, gap_s: n[1] }.into(),
        )
    },
    link(
        "merge",
        "samples are held and sent together",
        &[number("frames", WHOLE, DefaultValue::Value(2.0), 2.0, 64.0, "how many at once")],
        &[],
        |n| link_fault::Merge { frames: n[0] as u64 }.into(),
    ),
    link(
        "extra-bytes",
        "bytes that mean nothing stand before each sample",
        &[number("bytes", WHOLE, ONE, 1.0, 64.0, "how many")],
        &[(Transport::Can, NO_FRAMES)],
        |n| link_fault::ExtraBytes { bytes: n[0] as u64 }.into(),
    ),
    link(
        "bit-flip",
        "bits of the data are changed: before the CRC, which then is right, or after it",
        &[
            number("bits", WHOLE, ONE, 1.0, 64.0, "how many, anywhere in the data"),
            number(
                "crc",
                ValueFormat::Choice(&["after", "before"]),
                DefaultValue::Value(0.0),
                0.0,
                1.0,
                "after or before the CRC",
            ),
        ],
        &[],
        |n| link_fault::BitFlip { bits: n[0] as u64, is_after_crc: n[1] == 0.0 }.into(),
    ),
    link("sequence-stuck", "the sequence stands still, the CRC is right", &[], &[], |_| {
        link_fault::SequenceStuck {}.into()
    }),
    link(
        "sequence-jump",
        "the sequence is off by so much, the CRC is right",
        &[number("by", WHOLE, REQUIRED, -32768.0, 32767.0, "how much")],
        &[],
        |n| link_fault::SequenceJump { by: n[0] as i64 }.into(),
    ),
    link("stale-repeat", "the last good sample is sent again and again", &[], &[], |_| {
        link_fault::StaleRepeat {}.into()
    }),
    FaultSpec {
        bounds: &[bound("length", CAN, 8.0, "on CAN")],
        ..link(
            "wrong-length",
            "the length told is not that of the data; on CAN every message has this length",
            &[number("length", WHOLE, REQUIRED, 0.0, 255.0, "length told; on CAN 0…8")],
            &[],
            |n| link_fault::WrongLength { length: n[0] as u64 }.into(),
        )
    },
    FaultSpec {
        bounds: &[bound("identifier", OF_BYTES, 255.0, "on a link of bytes")],
        ..link(
            "wrong-identifier",
            "messages go out under another identifier: the frame's type, on CAN the identifier of INCREMENTS, the others behind it",
            &[number("identifier", WHOLE, REQUIRED, 0.0, 2045.0, "type 0…255, on CAN 0…2045")],
            &[],
            |n| link_fault::WrongIdentifier { identifier: n[0] as u64 }.into(),
        )
    },
    link(
        "babble",
        "nonsense between the samples: bytes, on CAN frames of any identifier",
        &[number("amount", WHOLE, DefaultValue::Value(16.0), 1.0, 1000.0, "bytes or frames in each sample interval")],
        &[],
        |n| link_fault::Babble { amount: n[0] as u64 }.into(),
    ),
    link("silence", "neither data nor replies", &[], &[], |_| link_fault::Silence {}.into()),
    link(
        "baud-mismatch",
        "the bytes that a receiver at the link's rate reads when they are sent at another",
        &[number("baud", REAL, REQUIRED, 50.0, 4e6, "rate of the sender")],
        &[(Transport::Can, NO_BAUD_CAN), (Transport::Tcp, NO_BAUD_TCP)],
        |n| link_fault::BaudMismatch { baud: n[0] }.into(),
    ),
    link(
        "reply-late",
        "replies, and what was polled, are late",
        &[number("delay_s", REAL, REQUIRED, LEAST_DELAY_S, 60.0, "how late")],
        &[],
        |n| link_fault::ReplyLate { delay_s: n[0] }.into(),
    ),
    link("reply-missing", "commands act, and get no reply", &[], &[], |_| link_fault::ReplyMissing {}.into()),
    impossible("parity-error", "bytes with wrong parity", &NO_LINE_LINKS),
    impossible("framing-error", "bytes without a stop bit", &NO_LINE_LINKS),
    impossible("bus-off", "the controller leaves the bus", &NO_BUS_LINKS),
    impossible("bit-error", "a bit on the bus is overwritten: error frames", &NO_BUS_LINKS),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_numbers_within_their_limits() {
        for (index, spec) in CATALOGUE.iter().enumerate() {
            assert!(CATALOGUE[..index].iter().all(|other| other.code != spec.code), "{}", spec.code);
            assert!(spec.scope == Scope::Link || spec.unable.is_empty(), "{}", spec.code);
            for number in spec.numbers {
                assert!(number.least <= number.greatest, "{} {}", spec.code, number.name);
                if let DefaultValue::Value(value) = number.default {
                    assert!((number.least..=number.greatest).contains(&value), "{} {}", spec.code, number.name);
                }
            }
        }
    }

    #[test]
    fn what_no_link_can_do_says_what_could_on_each() {
        for spec in CATALOGUE.iter().filter(|spec| spec.scope == Scope::Link) {
            let is_impossible = ["parity-error", "framing-error", "bus-off", "bit-error"].contains(&spec.code);
            assert_eq!(spec.links().is_empty(), is_impossible, "{}", spec.code);
            assert!(spec.unable.iter().all(|(_, reason)| reason.len() > 20), "{}", spec.code);
        }
    }
}
