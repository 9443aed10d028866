//! How the unit, its links and its faults stand, as JSON.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_model::CompletedSample;
use geu_model::fault::acting::FaultStatus;
use geu_model::fault::catalogue::Transport;
use geu_model::units::{RAD_PER_DEG, on_board_s};
use serde_json::{Value, json};

use super::events::{SampleEvent, end_s};
use crate::control;
use crate::lateness::CadenceMonitor;
use crate::link::LinkStatistics;
use crate::link_model::{Encoding, LinkModel, WireData};
use crate::shared_unit::SharedUnit;

/// What is known once the links are open.
pub(super) struct StatusSource {
    pub unit: Arc<SharedUnit>,
    links: Vec<(Transport, Arc<LinkStatistics>)>,
    /// Kind of link that a recording is of.
    recorded: Option<Transport>,
    monitor: Arc<CadenceMonitor>,
    serial: LinkModel,
    can: LinkModel,
}

impl StatusSource {
    pub fn new(
        unit: &Arc<SharedUnit>,
        links: &[(LinkModel, Arc<LinkStatistics>)],
        recorded: Option<Transport>,
        monitor: &Arc<CadenceMonitor>,
    ) -> StatusSource {
        let of = |is_can: bool| {
            let mut models = links.iter().map(|(model, _)| model);
            models.find(|model| matches!(model.encoding, Encoding::Can(_)) == is_can).cloned()
        };
        StatusSource {
            unit: unit.clone(),
            serial: of(false).unwrap_or(LinkModel::serial(Transport::Pty)),
            can: of(true).unwrap_or(LinkModel::can(geu_protocol::CanIdMap::default())),
            links: links.iter().map(|(model, statistics)| (model.kind, statistics.clone())).collect(),
            recorded,
            monitor: monitor.clone(),
        }
    }

    /// Kinds of the links that are open.
    pub fn open(&self) -> Vec<Transport> {
        self.links.iter().map(|(kind, _)| *kind).collect()
    }

    /// Kinds of the links that a fault is on which names none.
    pub fn told_links(&self) -> Vec<Transport> {
        [self.open(), self.recorded.into_iter().collect()].concat()
    }

    pub fn sample(&self, told: &SampleEvent) -> Value {
        let SampleEvent { ended, true_arcsec, departure_arcsec, now, knows_sun, injected } = told;
        let sample = &ended.sample;
        let acting = injected.as_ref().map_or(&[][..], |injected| &injected.acting);
        let carried = |model: &LinkModel| -> Vec<WireData> {
            let transmissions = model.carry(Some(sample).filter(|_| ended.cyclic || is_polled(ended)), 0, acting);
            transmissions
                .into_iter()
                .filter(|transmission| (transmission.frame, transmission.after_ns) == (0, 0))
                .map(|transmission| transmission.content)
                .collect()
        };
        let angle = |rad: f64| if *knows_sun { json!(rad / RAD_PER_DEG) } else { Value::Null };
        let counts = self.monitor.counts();
        let us = |ns: u64| ns as f64 * 1e-3;
        let more = json!({
            "t_s": end_s(ended),
            "half_second": self.unit.running().0,
            "true_arcsec": true_arcsec,
            "departure_arcsec": departure_arcsec,
            "rate_arcsec_s": now.rate_control_arcsec_s,
            "theta_deg": angle(now.theta_rad),
            "psi_deg": angle(now.psi_rad),
            "cyclic": ended.cyclic,
            "wire": {
                "serial": carried(&self.serial).iter().map(WireData::to_string).collect::<String>(),
                "can": carried(&self.can).iter().map(WireData::to_string).collect::<Vec<_>>(),
            },
            "links": self.links(),
            "lateness": {
                "count": counts.lateness.count(), "p50_us": us(counts.lateness.percentile_ns(0.5)),
                "p99_us": us(counts.lateness.percentile_ns(0.99)), "max_us": us(counts.lateness.max_ns()),
            },
            "late": counts.late,
            "missed": counts.missed,
            "faults": self.faults_now(),
        });
        let mut shown = control::told(sample);
        if let (Value::Object(shown), Value::Object(more)) = (&mut shown, more) {
            shown.extend(more);
        }
        shown
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

    /// Every fault.
    pub fn faults(&self) -> Value {
        let now_s = on_board_s(self.unit.running().0);
        self.unit.faults().planned.iter().map(|planned| stands(planned, now_s)).collect()
    }

    /// Those that act, or still may.
    pub fn faults_now(&self) -> Value {
        let (now_s, planned) = self.unit.faults_now();
        planned.iter().map(|planned| stands(planned, now_s)).collect()
    }
}

/// Whether a sample that is not sent by itself is there to be polled.
fn is_polled(ended: &CompletedSample) -> bool {
    ended.sample.unit_flags & geu_protocol::field::unit_flag("polled") != 0
}

/// How a fault stands.
fn stands(planned: &FaultStatus, now_s: f64) -> Value {
    let fault = &planned.fault;
    let state = match planned.since() {
        Some(_) => "active",
        None if planned.is_over_by(now_s) => "over",
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
        "started": planned.started,
        "since_s": planned.since().map(on_board_s),
        "ends_s": planned.end().map(on_board_s),
    })
}
