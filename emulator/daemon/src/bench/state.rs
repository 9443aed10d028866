//! How the unit, its links and its faults stand, as JSON.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_model::Ended;
use geu_model::fault::acting::Planned;
use geu_model::fault::catalogue::LinkKind;
use geu_model::units::{RAD_PER_DEG, on_board_s};
use serde_json::{Value, json};

use super::told::{HalfSecond, end_s};
use crate::carriage::{Carrier, Content, Form};
use crate::control;
use crate::desk::Desk;
use crate::link::Tally;
use crate::run::Timing;

/// What is known once the links are open.
pub(super) struct Known {
    pub desk: Arc<Desk>,
    links: Vec<(LinkKind, Arc<Tally>)>,
    /// Kind of link that a recording is of.
    recorded: Option<LinkKind>,
    timing: Arc<Timing>,
    serial: Carrier,
    can: Carrier,
}

impl Known {
    pub fn new(
        desk: &Arc<Desk>,
        links: &[(Carrier, Arc<Tally>)],
        recorded: Option<LinkKind>,
        timing: &Arc<Timing>,
    ) -> Known {
        let of = |is_can: bool| {
            let mut carriers = links.iter().map(|(carrier, _)| carrier);
            carriers.find(|carrier| matches!(carrier.form, Form::Can(_)) == is_can).cloned()
        };
        Known {
            desk: desk.clone(),
            serial: of(false).unwrap_or(Carrier::serial(LinkKind::Pty)),
            can: of(true).unwrap_or(Carrier::can(geu_protocol::CanPlan::default())),
            links: links.iter().map(|(carrier, tally)| (carrier.kind, tally.clone())).collect(),
            recorded,
            timing: timing.clone(),
        }
    }

    /// Kinds of the links that are open.
    pub fn open(&self) -> Vec<LinkKind> {
        self.links.iter().map(|(kind, _)| *kind).collect()
    }

    /// Kinds of the links that a fault is on which names none.
    pub fn told_links(&self) -> Vec<LinkKind> {
        [self.open(), self.recorded.into_iter().collect()].concat()
    }

    pub fn half_second(&self, told: &HalfSecond) -> Value {
        let HalfSecond { ended, true_arcsec, departure_arcsec, now, knows_sun, injected } = told;
        let half_second = &ended.half_second;
        let acting = injected.as_ref().map_or(&[][..], |injected| &injected.acting);
        let carried = |carrier: &Carrier| -> Vec<Content> {
            let pieces = carrier.carry(Some(half_second).filter(|_| ended.cyclic || is_polled(ended)), 0, acting);
            pieces
                .into_iter()
                .filter(|piece| (piece.frame, piece.after_ns) == (0, 0))
                .map(|piece| piece.content)
                .collect()
        };
        let angle = |rad: f64| if *knows_sun { json!(rad / RAD_PER_DEG) } else { Value::Null };
        let counts = self.timing.counts();
        let us = |ns: u64| ns as f64 * 1e-3;
        let more = json!({
            "t_s": end_s(ended),
            "half_second": self.desk.running().0,
            "true_arcsec": true_arcsec,
            "departure_arcsec": departure_arcsec,
            "rate_arcsec_s": now.rate_control_arcsec_s,
            "theta_deg": angle(now.theta_rad),
            "psi_deg": angle(now.psi_rad),
            "cyclic": ended.cyclic,
            "wire": {
                "serial": carried(&self.serial).iter().map(Content::to_string).collect::<String>(),
                "can": carried(&self.can).iter().map(Content::to_string).collect::<Vec<_>>(),
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
        let mut shown = control::told(half_second);
        if let (Value::Object(shown), Value::Object(more)) = (&mut shown, more) {
            shown.extend(more);
        }
        shown
    }

    pub fn links(&self) -> Value {
        let link = |(kind, tally): &(LinkKind, Arc<Tally>)| {
            json!({
                "name": tally.name, "kind": kind.name(), "clients": tally.clients.load(Relaxed),
                "sent": tally.sent.load(Relaxed), "dropped": tally.dropped.load(Relaxed),
                "replies": tally.replies.load(Relaxed), "unread": tally.unread.load(Relaxed),
            })
        };
        self.links.iter().map(link).collect()
    }

    /// Every fault.
    pub fn faults(&self) -> Value {
        let now_s = on_board_s(self.desk.running().0);
        self.desk.faults().planned.iter().map(|planned| stands(planned, now_s)).collect()
    }

    /// Those that act, or still may.
    pub fn faults_now(&self) -> Value {
        let (now_s, planned) = self.desk.faults_now();
        planned.iter().map(|planned| stands(planned, now_s)).collect()
    }
}

/// Whether a half second that is not sent by itself is there to be polled.
fn is_polled(ended: &Ended) -> bool {
    ended.half_second.unit_flags & geu_protocol::field::unit_flag("polled") != 0
}

/// How a fault stands.
fn stands(planned: &Planned, now_s: f64) -> Value {
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
        "link": fault.link.map(LinkKind::name),
        "state": state,
        "trigger": fault.trigger(),
        "by_hand": fault.by_hand,
        "started": planned.started,
        "since_s": planned.since().map(on_board_s),
        "ends_s": planned.end().map(on_board_s),
    })
}
