//! A link without a device.

use std::sync::Arc;

use geu_model::CompletedSample;
use geu_model::device::Device;
use geu_model::fault::FaultKind;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::engine::ActiveFault;
use geu_protocol::serial::DEFAULT_BAUD;
use geu_protocol::{CanIdMap, Reply};

use super::fault::{self, ActiveLinkFault, Blocked};
use super::transmission::{Encoding, Transmission};

/// A link without a device.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkModel {
    /// Transport.
    pub kind: Transport,
    /// Encoding of messages.
    pub encoding: Encoding,
}

impl LinkModel {
    /// A byte stream at the default rate.
    pub fn serial(kind: Transport) -> LinkModel {
        LinkModel { kind, encoding: Encoding::Serial { baud: DEFAULT_BAUD } }
    }

    /// A CAN interface.
    pub fn can(plan: CanIdMap) -> LinkModel {
        LinkModel { kind: Transport::Can, encoding: Encoding::Can(plan) }
    }

    /// The link of a unit: of the default one at this baud rate or with these identifiers, if there are any.
    pub fn of_unit(device: &Arc<Device>, kind: Transport, baud: Option<u32>, plan: Option<CanIdMap>) -> LinkModel {
        let encoding = match (device.is_iras(), kind) {
            (true, Transport::Can) => Encoding::Can(plan.unwrap_or_default()),
            (true, _) => Encoding::Serial { baud: baud.unwrap_or(DEFAULT_BAUD) },
            (false, Transport::Can) => Encoding::DescribedCan(device.clone()),
            (false, _) => {
                let own = device.serial.as_ref().map_or(DEFAULT_BAUD, |serial| serial.baud);
                Encoding::DescribedSerial { device: device.clone(), baud: baud.unwrap_or(own) }
            }
        };
        LinkModel { kind, encoding }
    }

    /// The transmissions of a sample interval with the active faults: of `sample`, `None` if none is sent cyclically, and noise.
    pub fn carry(&self, sample: Option<&CompletedSample>, frame: u64, acting: &[ActiveFault]) -> Vec<Transmission> {
        let faults = self.faults(acting);
        if faults.iter().any(|fault| fault.blocked() == Blocked::Everything) {
            return Vec::new();
        }
        let mut transmissions = fault::sample(&self.encoding, sample, frame, &faults);
        fault::add_noise(&self.encoding, &mut transmissions, frame, &faults);
        transmissions
    }

    /// The reply to a command with its delay; `None` if a fault suppresses it.
    pub fn reply(&self, reply: &Reply, acting: &[ActiveFault]) -> Option<Transmission> {
        let on_time = Transmission::on_time(0, self.encoding.reply(reply));
        self.faults(acting).iter().try_fold(on_time, |reply, fault| fault.reply(reply))
    }

    /// The sample that follows the reply to a POLL; empty without a reply. It is not delayed to a later sample, and has no
    /// noise.
    pub fn polled(&self, polled: &CompletedSample, reply: &Reply, acting: &[ActiveFault]) -> Vec<Transmission> {
        let Some(reply) = self.reply(reply, acting) else { return Vec::new() };
        let mut transmissions = fault::sample(&self.encoding, Some(polled), 0, &self.faults(acting));
        transmissions.iter_mut().for_each(|it| (it.frame, it.after_ns) = (0, it.after_ns + reply.after_ns));
        transmissions
    }

    /// True if an active fault suppresses all samples.
    pub fn blocks_samples(&self, acting: &[ActiveFault]) -> bool {
        self.faults(acting).iter().any(|fault| fault.blocked() != Blocked::Nothing)
    }

    /// Active faults of links on this one.
    pub(crate) fn faults<'a>(&self, acting: &'a [ActiveFault]) -> Vec<ActiveLinkFault<'a>> {
        let on_this = acting.iter().filter(|acting| self.has(acting));
        on_this.filter_map(|acting| Some(ActiveLinkFault { acting, fault: acting.on_link()? })).collect()
    }

    /// Identifiers of all active faults that can change the data of this link.
    pub fn touching<'a>(&self, acting: &'a [ActiveFault]) -> Vec<&'a str> {
        let on_this = acting.iter().filter(|acting| acting.on_link().is_none() || self.has(acting));
        on_this.map(|acting| acting.fault.id.as_str()).collect()
    }

    /// True if a fault is on this link: its `link` is this transport or absent, and the transport supports it.
    fn has(&self, acting: &ActiveFault) -> bool {
        let is_able = match &acting.fault.action {
            FaultKind::Named { spec, .. } => {
                let device = self.encoding.device();
                spec.unable_on(self.kind).is_none()
                    && device.is_none_or(|device| device.unable(spec.code, self.encoding.is_can()).is_none())
            }
            FaultKind::Parameter { .. } => false,
        };
        is_able && acting.fault.link.is_none_or(|kind| kind == self.kind)
    }
}
