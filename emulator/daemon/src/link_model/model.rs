//! A link without a device.

use geu_model::fault::FaultKind;
use geu_model::fault::acting::ActiveFault;
use geu_model::fault::catalogue::Transport;
use geu_protocol::serial::DEFAULT_BAUD;
use geu_protocol::{CanIdMap, Reply, Sample};

use super::fault::{self, ActiveLinkFault, Blocked};
use super::transmission::{Encoding, Transmission, WireData};

/// A link without a device.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkModel {
    /// Its kind, which faults name.
    pub kind: Transport,
    /// How it encodes messages.
    pub encoding: Encoding,
}

impl LinkModel {
    /// A link of bytes at the default rate.
    pub fn serial(kind: Transport) -> LinkModel {
        LinkModel { kind, encoding: Encoding::Serial { baud: DEFAULT_BAUD } }
    }

    /// A CAN interface.
    pub fn can(plan: CanIdMap) -> LinkModel {
        LinkModel { kind: Transport::Can, encoding: Encoding::Can(plan) }
    }

    /// A sample as it is sent without faults.
    pub fn plain(&self, sample: &Sample) -> Vec<WireData> {
        self.encoding.sample(sample)
    }

    /// The reply to a command as it is sent without faults.
    pub fn plain_reply(&self, reply: &Reply) -> WireData {
        self.encoding.reply(reply)
    }

    /// What is sent with the faults that act on this link: `sample`, `None` where none is sent cyclically, and noise.
    pub fn carry(&self, sample: Option<&Sample>, frame: u64, acting: &[ActiveFault]) -> Vec<Transmission> {
        let faults = self.faults(acting);
        if faults.is_empty() {
            let plain = sample.map_or_else(Vec::new, |sample| self.plain(sample));
            return plain.into_iter().map(|data| Transmission::on_time(frame, data)).collect();
        }
        if faults.iter().any(|fault| fault.blocked() == Blocked::Everything) {
            return Vec::new();
        }
        let mut transmissions = fault::sample(self.encoding, sample, frame, &faults);
        fault::add_noise(self.encoding, &mut transmissions, frame, &faults);
        transmissions
    }

    /// The reply to a command, and how late; `None` where a fault withholds it.
    pub fn reply(&self, reply: &Reply, acting: &[ActiveFault]) -> Option<Transmission> {
        let on_time = Transmission::on_time(0, self.plain_reply(reply));
        self.faults(acting).iter().try_fold(on_time, |reply, fault| fault.reply(reply))
    }

    /// The sample that follows the reply to a POLL; empty without a reply. It cannot be held for a later sample, and noise is
    /// no part of it.
    pub fn polled(&self, polled: &Sample, reply: &Reply, acting: &[ActiveFault]) -> Vec<Transmission> {
        let Some(reply) = self.reply(reply, acting) else { return Vec::new() };
        let mut transmissions = fault::sample(self.encoding, Some(polled), 0, &self.faults(acting));
        transmissions.iter_mut().for_each(|it| (it.frame, it.after_ns) = (0, it.after_ns + reply.after_ns));
        transmissions
    }

    /// Whether a fault that acts keeps all samples from this link.
    pub fn blocks_samples(&self, acting: &[ActiveFault]) -> bool {
        self.faults(acting).iter().any(|fault| fault.blocked() != Blocked::Nothing)
    }

    /// The faults of links that act on this one.
    pub(crate) fn faults<'a>(&self, acting: &'a [ActiveFault]) -> Vec<ActiveLinkFault<'a>> {
        let on_this = acting.iter().filter(|acting| self.has(acting));
        on_this.filter_map(|acting| Some(ActiveLinkFault { acting, fault: acting.on_link()? })).collect()
    }

    /// Identifiers of all faults that act and can change what this link carries.
    pub fn touching<'a>(&self, acting: &'a [ActiveFault]) -> Vec<&'a str> {
        let on_this = acting.iter().filter(|acting| acting.on_link().is_none() || self.has(acting));
        on_this.map(|acting| acting.fault.id.as_str()).collect()
    }

    /// Whether a fault of links is on this one: it names its kind or none, and such a link can have it.
    fn has(&self, acting: &ActiveFault) -> bool {
        let is_able = match &acting.fault.action {
            FaultKind::Named { spec, .. } => spec.unable_on(self.kind).is_none(),
            FaultKind::Parameter { .. } => false,
        };
        is_able && acting.fault.link.is_none_or(|kind| kind == self.kind)
    }
}
