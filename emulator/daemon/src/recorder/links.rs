//! Which link a recording is of, and which links its faults are on.

use geu_model::Configuration;
use geu_model::configuration::LinkLogFormat;
use geu_model::fault::catalogue::Transport;
use geu_protocol::CanIdMap;
use geu_protocol::serial::DEFAULT_BAUD;

use crate::link_model::{Encoding, LinkModel};

/// The form of a link.
fn form(model: &LinkModel) -> LinkLogFormat {
    match model.encoding {
        Encoding::Can(_) => LinkLogFormat::Can,
        Encoding::Serial { .. } => LinkLogFormat::Serial,
    }
}

/// The form that is recorded beside links: the one asked for, else that of the first link.
pub(crate) fn form_beside(asked: Option<LinkLogFormat>, links: &[LinkModel]) -> LinkLogFormat {
    asked.or(links.first().map(form)).unwrap_or_default()
}

/// The link that a recording of this form is of: the first such one among `links`, else one of the default kind.
pub(crate) fn recorded(wire: LinkLogFormat, configuration: &Configuration, links: &[LinkModel]) -> LinkModel {
    let default = || match wire {
        LinkLogFormat::Can => LinkModel::can(can_plan(configuration)),
        LinkLogFormat::Serial => LinkModel::serial(Transport::Pty),
    };
    links.iter().find(|model| form(model) == wire).cloned().unwrap_or_else(default)
}

/// The links of a run that has none: those of the run that is made again, else those that its faults name, each as its
/// kind has them by default; a serial port at its rate, CAN with its base.
pub(super) fn without_links(configuration: &Configuration) -> Vec<LinkModel> {
    let run = &configuration.run;
    let mut kinds = run.links.clone();
    if kinds.is_empty() {
        kinds.extend(configuration.faults.iter().filter_map(|fault| fault.link));
        kinds.sort_unstable();
        kinds.dedup();
    }
    let model = |kind| match (kind, run.serial_baud) {
        (Transport::Can, _) => LinkModel::can(can_plan(configuration)),
        (Transport::Serial, Some(baud)) => LinkModel { kind, encoding: Encoding::Serial { baud } },
        (kind, _) => LinkModel::serial(kind),
    };
    kinds.into_iter().map(model).collect()
}

/// Why a fault of a run without open links would be seen on none of the links that its recording tells; nothing where
/// all are.
pub fn misses(configuration: &Configuration, wire: LinkLogFormat) -> Option<String> {
    let links = without_links(configuration);
    let mut told: Vec<Transport> = links.iter().map(|model| model.kind).collect();
    told.push(recorded(wire, configuration, &links).kind);
    told.sort_unstable();
    told.dedup();
    configuration.faults.iter().find_map(|fault| fault.misses(&told))
}

/// The identifiers of CAN that the run had.
fn can_plan(configuration: &Configuration) -> CanIdMap {
    configuration.run.can_base.and_then(CanIdMap::with_base).unwrap_or_default()
}

/// The rate of a serial port among the links, where it is not the default.
pub(super) fn serial_baud(links: &[LinkModel]) -> Option<u32> {
    links.iter().find_map(|model| match model.encoding {
        Encoding::Serial { baud } if model.kind == Transport::Serial && baud != DEFAULT_BAUD => Some(baud),
        _ => None,
    })
}

/// The base of CAN, where it is not the default: of the recorded link, else of the first CAN link.
pub(super) fn can_base(recorded: &LinkModel, links: &[LinkModel]) -> Option<u16> {
    let base = std::iter::once(recorded).chain(links).find_map(|model| match model.encoding {
        Encoding::Can(plan) => Some(plan.base()),
        Encoding::Serial { .. } => None,
    });
    base.filter(|&base| base != CanIdMap::default().base())
}
