//! Which link a recording is of, and which links its faults are on.

use geu_model::Configuration;
use geu_model::configuration::WireForm;
use geu_model::fault::catalogue::LinkKind;
use geu_protocol::CanPlan;
use geu_protocol::serial::DEFAULT_BAUD;

use crate::carriage::{Carrier, Form};

/// The form of a link.
fn form(carrier: &Carrier) -> WireForm {
    match carrier.form {
        Form::Can(_) => WireForm::Can,
        Form::Serial { .. } => WireForm::Serial,
    }
}

/// The form that is recorded beside links: the one asked for, else that of the first link.
pub(crate) fn form_beside(asked: Option<WireForm>, links: &[Carrier]) -> WireForm {
    asked.or(links.first().map(form)).unwrap_or_default()
}

/// The link that a recording of this form is of: the first such one among `links`, else one of the default kind.
pub(crate) fn recorded(wire: WireForm, configuration: &Configuration, links: &[Carrier]) -> Carrier {
    let default = || match wire {
        WireForm::Can => Carrier::can(can_plan(configuration)),
        WireForm::Serial => Carrier::serial(LinkKind::Pty),
    };
    links.iter().find(|carrier| form(carrier) == wire).cloned().unwrap_or_else(default)
}

/// The links of a run that has none: those of the run that is made again, else those that its faults name, each as its
/// kind has them by default; a serial port at its rate, CAN with its base.
pub(super) fn without_links(configuration: &Configuration) -> Vec<Carrier> {
    let run = &configuration.run;
    let mut kinds = run.links.clone();
    if kinds.is_empty() {
        kinds.extend(configuration.faults.iter().filter_map(|fault| fault.link));
        kinds.sort_unstable();
        kinds.dedup();
    }
    let carrier = |kind| match (kind, run.serial_baud) {
        (LinkKind::Can, _) => Carrier::can(can_plan(configuration)),
        (LinkKind::Serial, Some(baud)) => Carrier { kind, form: Form::Serial { baud } },
        (kind, _) => Carrier::serial(kind),
    };
    kinds.into_iter().map(carrier).collect()
}

/// Why a fault of a run without open links would be seen on none of the links that its recording tells; nothing where
/// all are.
pub fn misses(configuration: &Configuration, wire: WireForm) -> Option<String> {
    let links = without_links(configuration);
    let mut told: Vec<LinkKind> = links.iter().map(|carrier| carrier.kind).collect();
    told.push(recorded(wire, configuration, &links).kind);
    told.sort_unstable();
    told.dedup();
    configuration.faults.iter().find_map(|fault| fault.misses(&told))
}

/// The identifiers of CAN that the run had.
fn can_plan(configuration: &Configuration) -> CanPlan {
    configuration.run.can_base.and_then(CanPlan::with_base).unwrap_or_default()
}

/// The rate of a serial port among the links, where it is not the default.
pub(super) fn serial_baud(links: &[Carrier]) -> Option<u32> {
    links.iter().find_map(|carrier| match carrier.form {
        Form::Serial { baud } if carrier.kind == LinkKind::Serial && baud != DEFAULT_BAUD => Some(baud),
        _ => None,
    })
}

/// The base of CAN, where it is not the default: of the recorded link, else of the first CAN link.
pub(super) fn can_base(recorded: &Carrier, links: &[Carrier]) -> Option<u16> {
    let base = std::iter::once(recorded).chain(links).find_map(|carrier| match carrier.form {
        Form::Can(plan) => Some(plan.base()),
        Form::Serial { .. } => None,
    });
    base.filter(|&base| base != CanPlan::default().base())
}
