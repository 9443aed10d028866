//! The link that is recorded, and the links of its faults.

use geu_model::Configuration;
use geu_model::configuration::LinkLogFormat;
use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_protocol::CanIdMap;
use geu_protocol::serial::DEFAULT_BAUD;

use crate::link_model::{Encoding, LinkModel};

/// Encoding of a link.
fn wire_of(model: &LinkModel) -> LinkLogFormat {
    if model.encoding.is_can() { LinkLogFormat::Can } else { LinkLogFormat::Serial }
}

/// The encoding recorded beside links: as requested, else as the first link, else as the unit has it.
pub fn wire_beside(asked: Option<LinkLogFormat>, links: &[LinkModel], device: &Device) -> LinkLogFormat {
    let only = if device.serial.is_some() && device.can.is_none() { LinkLogFormat::Serial } else { LinkLogFormat::Can };
    asked.or(links.first().map(wire_of)).unwrap_or(only)
}

/// The recorded link: the first with this encoding among `links`, else a default one.
pub fn recorded(wire: LinkLogFormat, configuration: &Configuration, links: &[LinkModel]) -> LinkModel {
    let default = || match wire {
        LinkLogFormat::Can => {
            LinkModel::of_unit(&configuration.device, Transport::Can, None, Some(can_plan(configuration)))
        }
        LinkLogFormat::Serial => LinkModel::of_unit(&configuration.device, Transport::Pty, None, None),
    };
    links.iter().find(|model| wire_of(model) == wire).cloned().unwrap_or_else(default)
}

/// The links of a run without open links: from the run that is repeated, else from its faults; with the recorded baud rate
/// and CAN base, else the defaults.
pub(crate) fn without_links(configuration: &Configuration) -> Vec<LinkModel> {
    let run = &configuration.run;
    let mut kinds = run.links.clone();
    if kinds.is_empty() {
        kinds.extend(configuration.faults.iter().filter_map(|fault| fault.link));
        kinds.sort_unstable();
        kinds.dedup();
    }
    let model = |kind| {
        let baud = run.serial_baud.filter(|_| kind == Transport::Serial);
        LinkModel::of_unit(&configuration.device, kind, baud, Some(can_plan(configuration)))
    };
    kinds.into_iter().map(model).collect()
}

/// Reason why a fault of a run without open links cannot act on any of its recorded links, if there is one.
pub fn misses(configuration: &Configuration, wire: LinkLogFormat) -> Option<String> {
    let links = without_links(configuration);
    let mut recorded_on: Vec<Transport> = links.iter().map(|model| model.kind).collect();
    recorded_on.push(recorded(wire, configuration, &links).kind);
    recorded_on.sort_unstable();
    recorded_on.dedup();
    configuration.faults.iter().find_map(|fault| fault.misses(&recorded_on))
}

/// CAN identifiers of the run.
fn can_plan(configuration: &Configuration) -> CanIdMap {
    configuration.run.can_base.and_then(CanIdMap::with_base).unwrap_or_default()
}

/// Baud rate of the serial port among the links, unless it is the default.
pub(crate) fn serial_baud(links: &[LinkModel]) -> Option<u32> {
    let ports = links.iter().filter(|model| model.kind == Transport::Serial);
    let own = |model: &LinkModel| model.encoding.device().and_then(|device| Some(device.serial.as_ref()?.baud));
    let given = |model: &LinkModel| model.encoding.baud().filter(|baud| *baud != own(model).unwrap_or(DEFAULT_BAUD));
    ports.filter_map(given).next()
}

/// CAN base of the recorded link, else of the first CAN link, unless it is the default.
pub(crate) fn can_base(recorded: &LinkModel, links: &[LinkModel]) -> Option<u16> {
    let base = std::iter::once(recorded).chain(links).find_map(|model| match model.encoding {
        Encoding::Can(plan) => Some(plan.base()),
        _ => None,
    });
    base.filter(|&base| base != CanIdMap::default().base())
}
