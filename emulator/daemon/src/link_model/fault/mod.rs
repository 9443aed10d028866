//! What the faults of links do to a sample: one file per fault, which the list `link_faults` of the model names.
//!
//! A fault acts in steps: on the sample, on its encoded bytes, on how often and when they are sent, on what precedes them, on
//! what else is on the link. Within a step faults act in the order of the plan. The modules are declared by a macro, where
//! `cargo fmt` does not look: `rustfmt emulator/daemon/src/link_model/fault/*.rs`.

#[cfg(test)]
mod tests;

use geu_model::fault::acting::ActiveFault;
use geu_model::fault::catalogue::LinkFault;
use geu_model::noise::NoiseStream;
use geu_protocol::Sample;
use geu_protocol::serial::{self, OVERHEAD};

use super::transmission::{Encoding, Transmission, WireData};

macro_rules! modules {
    ($($module:ident: $fault:ident { $($number:ident: $type:ty),* }),* $(,)?) => {
        $(mod $module;)*

        fn behaviour(fault: &LinkFault) -> &dyn LinkBehaviour {
            match fault {
                $(LinkFault::$fault(fault) => fault),*
            }
        }
    };
}

geu_model::link_faults!(modules);

/// Transmissions of one sample interval: about as many as the fastest bus has room for, frames without data at 1 Mbit/s. What
/// many faults together would send beyond is not sent.
const MAX_TRANSMISSIONS: usize = 10_000;

/// What a fault does to what a link carries. Each step leaves it as it is unless the fault says otherwise.
trait LinkBehaviour {
    /// What it keeps from the link.
    fn blocked(&self) -> Blocked {
        Blocked::Nothing
    }

    /// The sample that is encoded in place of this one; `None`: no sample is sent.
    fn sample(&self, sample: Sample, _acting: &ActiveFault) -> Option<Sample> {
        Some(sample)
    }

    /// Changes the encoded sample.
    fn encoded(&self, _data: &mut Vec<WireData>, _context: &Context) {}

    /// Changes how often and when it is sent.
    fn schedule(&self, _schedule: &mut Schedule, _context: &Context) {}

    /// Changes the first data of the sample, behind all that is scheduled.
    fn first(&self, _data: &mut WireData, _context: &Context) {}

    /// Adds what else is on the link, whether a sample is sent or not.
    fn noise(&self, _transmissions: &mut Vec<Transmission>, _frame: u64, _context: &Context) {}

    /// The reply to a command; `None` where it is withheld.
    fn reply(&self, reply: Transmission) -> Option<Transmission> {
        Some(reply)
    }
}

/// What a fault keeps from a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Blocked {
    Nothing,
    Samples,
    /// Samples, noise and replies.
    Everything,
}

/// The transmissions of a sample, and how often they contain it.
struct Schedule {
    transmissions: Vec<Transmission>,
    repeats: usize,
}

impl Schedule {
    fn delay(&mut self, by_ns: i64) {
        self.transmissions.iter_mut().for_each(|it| it.after_ns += by_ns);
    }
}

/// Where a fault acts.
struct Context<'a> {
    encoding: Encoding,
    acting: &'a ActiveFault,
    /// No fault of the same code acts behind it.
    is_last_of_its_code: bool,
}

impl Context<'_> {
    /// The random numbers of this fault on links in this sample interval.
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

    /// Whether a reply is not sent as it would be without this fault.
    pub fn changes_replies(&self) -> bool {
        self.blocked() == Blocked::Everything || changes_replies(&self.fault)
    }
}

fn changes_replies(fault: &LinkFault) -> bool {
    let reply = Transmission::on_time(0, WireData::Bytes(Vec::new()));
    behaviour(fault).reply(reply.clone()) != Some(reply)
}

/// Whether a fault changes nothing but replies to commands.
pub(crate) fn acts_on_replies_alone(fault: &LinkFault) -> bool {
    changes_replies(fault)
}

/// The transmissions of a sample; none where none is sent.
pub(super) fn sample(
    encoding: Encoding,
    sample: Option<&Sample>,
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
    let changed = |sample: &Sample| all().try_fold(*sample, |sample, (it, context)| it.sample(sample, context.acting));
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

/// Adds what else is on the link in this sample interval.
pub(super) fn add_noise(
    encoding: Encoding,
    transmissions: &mut Vec<Transmission>,
    frame: u64,
    faults: &[ActiveLinkFault],
) {
    for ActiveLinkFault { acting, fault } in faults {
        behaviour(fault).noise(transmissions, frame, &Context { encoding, acting, is_last_of_its_code: true });
    }
}

/// Changes the headers of whole frames of a stream; their CRC is right again.
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

/// A time in s as ns.
fn ns(time_s: f64) -> i64 {
    (time_s * 1e9).round() as i64
}
