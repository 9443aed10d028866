//! State of the unit, its links and its faults as JSON.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_model::CompletedSample;
use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::engine::FaultStatus;
use geu_model::units::RAD_PER_DEG;
use serde_json::{Map, Value, json};

use super::events::SampleEvent;
use crate::control;
use crate::lateness::CadenceMonitor;
use crate::link::LinkStatistics;
use crate::shared_unit::SharedUnit;
use geu_recorder::link_model::LinkModel;

/// The running unit and its open links.
pub(crate) struct StatusSource {
    pub unit: Arc<SharedUnit>,
    links: Vec<(Transport, Arc<LinkStatistics>)>,
    recorded: Option<Transport>,
    monitor: Arc<CadenceMonitor>,
    serial: LinkModel,
    can: LinkModel,
}

impl StatusSource {
    /// `recorded` is the transport of the recorded link.
    pub fn new(
        unit: &Arc<SharedUnit>,
        links: &[(LinkModel, Arc<LinkStatistics>)],
        recorded: Option<Transport>,
        monitor: &Arc<CadenceMonitor>,
    ) -> StatusSource {
        let first = |is_can: bool| {
            let mut models = links.iter().map(|(model, _)| model);
            models.find(|model| model.encoding.is_can() == is_can).cloned()
        };
        StatusSource {
            unit: unit.clone(),
            serial: first(false).unwrap_or_else(|| LinkModel::of_unit(&unit.device, Transport::Pty, None, None)),
            can: first(true).unwrap_or_else(|| LinkModel::of_unit(&unit.device, Transport::Can, None, None)),
            links: links.iter().map(|(model, statistics)| (model.kind, statistics.clone())).collect(),
            recorded,
            monitor: monitor.clone(),
        }
    }

    /// Transports of the open links.
    pub fn open(&self) -> Vec<Transport> {
        self.links.iter().map(|(kind, _)| *kind).collect()
    }

    /// Transports that a fault without `link` applies to.
    pub fn open_or_recorded(&self) -> Vec<Transport> {
        [self.open(), self.recorded.into_iter().collect()].concat()
    }

    pub(super) fn sample(&self, event: &SampleEvent) -> Value {
        let SampleEvent { ended, history, now, knows_sun, injected } = event;
        let acting = injected.as_ref().map_or(&[][..], |injected| &injected.acting);
        let is_sent = ended.cyclic || is_polled(ended);
        let sent = |model: &LinkModel| -> Vec<String> {
            let transmissions = model.carry(Some(ended).filter(|_| is_sent), 0, acting).into_iter();
            let undelayed = transmissions.filter(|transmission| (transmission.frame, transmission.after_ns) == (0, 0));
            undelayed.map(|transmission| transmission.content.to_string()).collect()
        };
        let angle_deg = |rad: f64| knows_sun.then_some(rad / RAD_PER_DEG);
        let counts = self.monitor.counts();
        let us = |ns: u64| ns as f64 * 1e-3;
        let status = json!({
            "rate_arcsec_s": now.rate_control_arcsec_s,
            "theta_deg": angle_deg(now.theta_rad),
            "psi_deg": angle_deg(now.psi_rad),
            "cyclic": ended.cyclic,
            "wire": { "serial": sent(&self.serial).concat(), "can": sent(&self.can) },
            "links": self.links(),
            "lateness": {
                "count": counts.lateness.count(), "p50_us": us(counts.lateness.percentile_ns(0.5)),
                "p99_us": us(counts.lateness.percentile_ns(0.99)), "max_us": us(counts.lateness.max_ns()),
            },
            "late": counts.late,
            "missed": counts.missed,
            "faults": self.faults_now(),
        });
        let parts = [control::sample(&ended.sample), json!(history), status];
        parts.into_iter().filter_map(|part| serde_json::from_value::<Map<_, _>>(part).ok()).flatten().collect()
    }

    pub fn links(&self) -> Value {
        let link = |(kind, statistics): &(Transport, Arc<LinkStatistics>)| {
            json!({
                "name": statistics.name, "kind": kind.name(), "clients": statistics.clients.load(Relaxed),
                "sent": statistics.sent.load(Relaxed), "dropped": statistics.dropped.load(Relaxed),
                "replies": statistics.replies.load(Relaxed), "unread": statistics.unread.load(Relaxed),
            })
        };
        self.links.iter().map(link).collect()
    }

    /// All faults.
    pub fn faults(&self) -> Value {
        let now_s = self.unit.device.on_board_s(self.unit.running().0);
        self.unit.faults().planned.iter().map(|fault| fault_state(&self.unit.device, fault, now_s)).collect()
    }

    /// The faults that are active or armed.
    pub fn faults_now(&self) -> Value {
        let (now_s, faults) = self.unit.faults_now();
        faults.iter().map(|fault| fault_state(&self.unit.device, fault, now_s)).collect()
    }
}

/// True if a sample that is not sent cyclically can be polled.
fn is_polled(ended: &CompletedSample) -> bool {
    ended.sample.unit_flags & geu_protocol::field::unit_flag("polled") != 0
}

fn fault_state(device: &Device, status: &FaultStatus, now_s: f64) -> Value {
    let fault = &status.fault;
    let state = match status.since() {
        Some(_) => "active",
        None if status.is_over_by(now_s) => "over",
        None => "armed",
    };
    json!({
        "id": fault.id,
        "what": fault.action.name(),
        "gyro": fault.gyro.map(|gyro| gyro.name()),
        "link": fault.link.map(Transport::name),
        "state": state,
        "trigger": fault.trigger(),
        "by_hand": fault.by_hand,
        "started": status.started,
        "since_s": status.since().map(|sample| device.on_board_s(sample)),
        "ends_s": status.end().map(|sample| device.on_board_s(sample)),
    })
}
