//! Effects of the faults of links on samples and replies: one file per fault of the list `link_faults` of the model.
//!
//! A fault acts in steps: on the sample, on its encoded bytes, on their schedule, on the data before them, on other data of
//! the link. Within a step faults act in the order of the plan. A macro declares the modules, which `cargo fmt` does not
//! follow: `rustfmt emulator/recorder/src/link_model/fault/*.rs`.

#[cfg(test)]
mod tests;

use geu_model::CompletedSample;
use geu_model::fault::catalogue::LinkFault;
use geu_model::fault::engine::ActiveFault;
use geu_model::noise::NoiseStream;
use geu_protocol::serial::{self, OVERHEAD};

use super::transmission::{Encoding, Transmission, WireData};

macro_rules! modules {
    ($($(#[$doc:meta])* $module:ident: $fault:ident $spec:tt $numbers:tt)*) => {
        $(mod $module;)*

        fn behaviour(fault: &LinkFault) -> &dyn LinkBehaviour {
            match fault {
                $(LinkFault::$fault(fault) => fault),*
            }
        }
    };
}

geu_model::link_faults!(modules);

/// Maximum number of transmissions in one sample interval: about the capacity of the fastest bus, frames without data at
/// 1 Mbit/s. Many faults together send no more.
const MAX_TRANSMISSIONS: usize = 10_000;

/// Effect of a fault on a link. By default a step changes nothing.
trait LinkBehaviour {
    /// The data that it suppresses.
    fn blocked(&self) -> Blocked {
        Blocked::Nothing
    }

    /// The sample to encode in place of this one; `None`: no sample is sent.
    fn sample(&self, sample: CompletedSample, _acting: &ActiveFault) -> Option<CompletedSample> {
        Some(sample)
    }

    /// Changes the encoded sample.
    fn encoded(&self, _data: &mut Vec<WireData>, _context: &Context) {}

    /// Changes its number of copies and their times.
    fn schedule(&self, _schedule: &mut Schedule, _context: &Context) {}

    /// Changes the first data of the sample, after all changes of the schedule.
    fn first(&self, _data: &mut WireData, _context: &Context) {}

    /// Adds other data on the link, with or without a sample.
    fn noise(&self, _transmissions: &mut Vec<Transmission>, _frame: u64, _context: &Context) {}

    /// The reply to a command; `None` if it is suppressed.
    fn reply(&self, reply: Transmission) -> Option<Transmission> {
        Some(reply)
    }
}

/// Data that a fault suppresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Blocked {
    Nothing,
    Samples,
    /// Samples, noise and replies.
    Everything,
}

/// The transmissions of a sample, and its number of copies among them.
struct Schedule {
    transmissions: Vec<Transmission>,
    repeats: usize,
}

impl Schedule {
    fn delay(&mut self, by_ns: i64) {
        self.transmissions.iter_mut().for_each(|it| it.after_ns += by_ns);
    }
}

/// Context of a fault on a link.
struct Context<'a> {
    encoding: &'a Encoding,
    acting: &'a ActiveFault,
    /// No fault of the same code acts after it.
    is_last_of_its_code: bool,
}

impl Context<'_> {
    /// Random numbers of this fault on links in this sample interval.
    fn draw(&self) -> NoiseStream {
        self.acting.draw().at("link", self.acting.frame)
    }
}

/// A fault that acts on a link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ActiveLinkFault<'a> {
    pub acting: &'a ActiveFault,
    pub fault: LinkFault,
}

impl ActiveLinkFault<'_> {
    pub fn blocked(&self) -> Blocked {
        behaviour(&self.fault).blocked()
    }

    pub fn reply(&self, reply: Transmission) -> Option<Transmission> {
        match self.blocked() {
            Blocked::Everything => None,
            Blocked::Nothing | Blocked::Samples => behaviour(&self.fault).reply(reply),
        }
    }

    /// True if this fault changes or suppresses replies.
    pub fn changes_replies(&self) -> bool {
        self.blocked() == Blocked::Everything || changes_replies(&self.fault)
    }
}

/// True if a fault changes replies to commands; such a fault changes nothing else, unless it suppresses everything.
pub fn changes_replies(fault: &LinkFault) -> bool {
    let reply = Transmission::on_time(0, WireData::Bytes(Vec::new()));
    behaviour(fault).reply(reply.clone()) != Some(reply)
}

/// The transmissions of a sample; empty if none is sent.
pub(super) fn sample(
    encoding: &Encoding,
    sample: Option<&CompletedSample>,
    frame: u64,
    faults: &[ActiveLinkFault],
) -> Vec<Transmission> {
    if faults.iter().any(|fault| fault.blocked() != Blocked::Nothing) {
        return Vec::new();
    }
    let all = || {
        faults.iter().enumerate().map(|(index, ActiveLinkFault { acting, fault })| {
            let code = std::mem::discriminant(fault);
            let is_last_of_its_code =
                faults[index + 1..].iter().all(|other| std::mem::discriminant(&other.fault) != code);
            (behaviour(fault), Context { encoding, acting, is_last_of_its_code })
        })
    };
    let changed =
        |sample: &CompletedSample| all().try_fold(*sample, |sample, (it, context)| it.sample(sample, context.acting));
    let Some(sample) = sample.and_then(changed) else { return Vec::new() };
    let mut data = encoding.sample(&sample);
    all().for_each(|(it, context)| it.encoded(&mut data, &context));
    let transmissions = data.into_iter().map(|data| Transmission::on_time(frame, data)).collect();
    let mut schedule = Schedule { transmissions, repeats: 1 };
    all().for_each(|(it, context)| it.schedule(&mut schedule, &context));
    if let Some(first) = schedule.transmissions.first_mut() {
        all().for_each(|(it, context)| it.first(&mut first.content, &context));
    }
    schedule.transmissions
}

/// Adds other data on the link in this sample interval.
pub(super) fn add_noise(
    encoding: &Encoding,
    transmissions: &mut Vec<Transmission>,
    frame: u64,
    faults: &[ActiveLinkFault],
) {
    for ActiveLinkFault { acting, fault } in faults {
        behaviour(fault).noise(transmissions, frame, &Context { encoding, acting, is_last_of_its_code: true });
    }
}

/// Changes the headers of complete frames of a stream, and updates their CRC.
fn change_headers(data: &mut [WireData], change: impl Fn(&mut [u8])) {
    for data in data {
        if let WireData::Bytes(bytes) = data
            && bytes.len() >= OVERHEAD
        {
            change(bytes);
            serial::update_crc(bytes);
        }
    }
}

/// Converts s to ns.
fn ns(time_s: f64) -> i64 {
    (time_s * 1e9).round() as i64
}
