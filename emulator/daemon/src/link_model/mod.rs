//! What goes over a link: half seconds and replies as bytes or CAN frames, with what the faults of links make of them.
//!
//! A [`LinkModel`] is a link without a device: pure, so that a recording holds what every link of its kind carried. It makes
//! [`Transmission`]s; an queue says when each is due.

mod baud;
mod fault;
mod transmit_queue;

use geu_model::fault::Action;
use geu_model::fault::acting::Acting;
use geu_model::fault::catalogue::{LinkKind, LinkLaw};
use geu_protocol::command::hex;
use geu_protocol::serial::{DEFAULT_BAUD, Kind, data_frame, frame};
use geu_protocol::{CanFrame, CanPlan, HalfSecond, Reply};

pub(crate) use transmit_queue::TransmitQueue;

/// How a link writes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Encoding {
    /// Frames in a stream of bytes, at this rate.
    Serial {
        /// Baud.
        baud: u32,
    },
    /// CAN frames.
    Can(CanPlan),
}

/// Bytes of a stream, or a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum WireData {
    /// Of a stream.
    Bytes(Vec<u8>),
    /// On a bus.
    Frame(CanFrame),
}

/// As a log writes it: hexadecimal; a CAN frame as candump does.
impl std::fmt::Display for WireData {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let data = match self {
            WireData::Bytes(bytes) => bytes,
            WireData::Frame(frame) => {
                write!(f, "{:03X}#", frame.id())?;
                frame.data()
            }
        };
        f.write_str(&hex(data))
    }
}

/// Something that is sent, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transmission {
    /// Index of the half second with which it is sent.
    pub frame: u64,
    /// On-board time after the end of that, ns.
    pub after_ns: i64,
    /// What.
    pub content: WireData,
    /// Whether the next transmission is the rest of the same frame of a stream: nothing comes between.
    pub more_fragments: bool,
}

impl Transmission {
    /// One that is sent with the end of half second `frame`.
    pub fn on_time(frame: u64, content: WireData) -> Transmission {
        Transmission { frame, after_ns: 0, content, more_fragments: false }
    }
}

/// A link without a device.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkModel {
    /// Its kind: whom a fault is on.
    pub kind: LinkKind,
    /// How it writes.
    pub encoding: Encoding,
}

impl LinkModel {
    /// A link of bytes at the default rate.
    pub fn serial(kind: LinkKind) -> LinkModel {
        LinkModel { kind, encoding: Encoding::Serial { baud: DEFAULT_BAUD } }
    }

    /// A CAN interface.
    pub fn can(plan: CanPlan) -> LinkModel {
        LinkModel { kind: LinkKind::Can, encoding: Encoding::Can(plan) }
    }

    /// A half second as it goes out without faults.
    pub fn plain(&self, half_second: &HalfSecond) -> Vec<WireData> {
        match self.encoding {
            Encoding::Serial { .. } => vec![WireData::Bytes(data_frame(half_second).to_vec())],
            Encoding::Can(plan) => plan.frames(half_second).into_iter().map(WireData::Frame).collect(),
        }
    }

    /// A half second, or nothing where none is sent by itself, and noise, with the faults that act on this link.
    pub fn carry(&self, half_second: Option<&HalfSecond>, frame: u64, acting: &[Acting]) -> Vec<Transmission> {
        let own = self.own(acting);
        if own.is_empty() {
            let plain = half_second.into_iter().flat_map(|it| self.plain(it));
            return plain.map(|content| Transmission::on_time(frame, content)).collect();
        }
        if own.iter().any(|(_, law)| *law == LinkLaw::Silence) {
            return Vec::new();
        }
        let mut transmissions = fault::half_second(self, half_second, frame, &own);
        fault::add_noise(self, &mut transmissions, frame, &own);
        transmissions
    }

    /// The reply to a command, and how late; nothing where a fault keeps it back.
    pub fn reply(&self, reply: &Reply, acting: &[Acting]) -> Option<Transmission> {
        let mut transmission = Transmission::on_time(0, self.plain_reply(reply));
        for (_, law) in self.own(acting) {
            match law {
                LinkLaw::Silence | LinkLaw::ReplyMissing => return None,
                LinkLaw::ReplyLate { delay_s } => transmission.after_ns += ns(delay_s),
                _ => {}
            }
        }
        Some(transmission)
    }

    /// The half second that follows the reply to a POLL; nothing without one. It cannot be held back for another, and
    /// noise is no part of it.
    pub fn polled(&self, polled: &HalfSecond, reply: &Reply, acting: &[Acting]) -> Vec<Transmission> {
        let Some(reply) = self.reply(reply, acting) else { return Vec::new() };
        let mut transmissions = fault::half_second(self, Some(polled), 0, &self.own(acting));
        transmissions.iter_mut().for_each(|transmission| {
            (transmission.frame, transmission.after_ns) = (0, transmission.after_ns + reply.after_ns)
        });
        transmissions
    }

    /// The reply to a command as it goes out without faults.
    pub fn plain_reply(&self, reply: &Reply) -> WireData {
        match self.encoding {
            Encoding::Serial { .. } => WireData::Bytes(frame(Kind::Reply, reply.bytes())),
            Encoding::Can(plan) => WireData::Frame(plan.reply(reply)),
        }
    }

    /// The faults of links that act on this one.
    pub fn own<'a>(&self, acting: &'a [Acting]) -> Vec<(&'a Acting, LinkLaw)> {
        let on_this = acting.iter().filter(|acting| self.has(acting));
        on_this.filter_map(|acting| Some((acting, acting.on_link()?))).collect()
    }

    /// Identifiers of all faults that act and can change what this link carries.
    pub fn touching<'a>(&self, acting: &'a [Acting]) -> Vec<&'a str> {
        let on_this = acting.iter().filter(|acting| acting.on_link().is_none() || self.has(acting));
        on_this.map(|acting| acting.fault.id.as_str()).collect()
    }

    /// Whether a fault of links is on this one: it names its kind or none, and such a link can have it.
    fn has(&self, acting: &Acting) -> bool {
        let can_be = match &acting.fault.action {
            Action::Named { spec, .. } => spec.unable_on(self.kind).is_none(),
            Action::Parameter { .. } => false,
        };
        can_be && acting.fault.link.is_none_or(|kind| kind == self.kind)
    }
}

/// A time in s as ns.
fn ns(time_s: f64) -> i64 {
    (time_s * 1e9).round() as i64
}
