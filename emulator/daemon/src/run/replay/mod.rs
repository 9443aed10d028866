//! A recording in place of the unit: sends recorded data over the links, at any speed.
//!
//! The reader of the recording passes [`ReplayItem`]s. A link with the recorded encoding sends the contents unchanged. A link
//! with the other encoding, and any link with an active fault, encodes the sample itself.

mod item;
mod player;
#[cfg(test)]
mod tests;

use std::fmt;
use std::future::Future;
use std::io;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};

use geu_model::CompletedSample;
use geu_model::fault::catalogue::FaultAction;
use geu_model::fault::engine::FaultEngine;
use geu_model::fault::expectation::Expectation;
use geu_model::fault::{Fault, FaultKind, unsatisfiable_condition};

use super::error::RunError;
use super::output::LinkOutput;
use super::session::{Session, await_readers};
use crate::cadence::Speed;
use crate::console;
use crate::host;
use crate::lateness::Histogram;
use crate::link::LinkStatistics;
use crate::shared_unit::SharedUnit;
use geu_recorder::link_model::changes_replies;
pub use item::{ReplayItem, ReplayItemKind, ReplayOptions, Steps, TrafficOrigin};
use player::{Player, ReplayCounts};

/// Variables of conditions that a recording does not contain.
const UNAVAILABLE: [&str; 6] = ["rate_x", "rate_y", "rate_z", "theta_deg", "psi_deg", "command"];

/// Reason why a plan cannot act on a recording, if there is one: a fault, or a condition that would never hold.
pub fn refused(faults: &[Fault], expectations: &[Expectation]) -> Option<String> {
    let misplaced = faults.iter().find_map(misplaced);
    misplaced.or_else(|| unsatisfiable_condition(faults, expectations, "a recording", &UNAVAILABLE))
}

/// Reason why a fault cannot act on a recording, if there is one.
fn misplaced(fault: &Fault) -> Option<String> {
    let on = match (&fault.action, fault.law()) {
        (_, FaultAction::Link(law)) if changes_replies(&law) => "replies, and a recording sends none".to_owned(),
        (_, FaultAction::Link(_)) => return None,
        (FaultKind::Parameter { .. }, _) => "a parameter of the model, which does not run in a replay".to_owned(),
        (FaultKind::Named { spec, .. }, _) => format!("the {}, and its counts are recorded already", spec.scope.name()),
    };
    Some(format!(
        "fault {:?}: {} acts on {on}; expected only faults of links (`geu faults list --link tcp` shows them): remove it, or run the unit with `geu run --faults`",
        fault.id,
        fault.action.name(),
    ))
}

/// Result of a replay.
pub struct ReplaySummary {
    counts: ReplayCounts,
    lateness: Histogram,
    late: u64,
    commands: u64,
    rejected: u64,
    links: Vec<Arc<LinkStatistics>>,
    /// Final state of faults and expectations.
    pub faults: FaultEngine,
}

impl fmt::Display for ReplaySummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ReplayCounts { samples, faulted, unit_frames, unit_bytes, other, stalled } = self.counts;
        write!(f, "samples {samples} of the recording, {} contents late", self.late)?;
        if faulted > 0 {
            write!(f, ", {faulted} with faults")?;
        }
        writeln!(f)?;
        if stalled > 0 {
            writeln!(f, "stalled      {stalled} times; the replay waited")?;
        }
        if self.lateness.count() > 0 {
            writeln!(f, "lateness     {}", self.lateness)?;
        }
        if unit_frames + unit_bytes + other > 0 {
            writeln!(
                f,
                "left out     on links of the other encoding: {unit_frames} frames and {unit_bytes} bytes outside of complete samples, {other} of commands and other traffic"
            )?;
        }
        if self.commands + self.rejected > 0 {
            writeln!(f, "commands     {} without a reply, {} frames dropped", self.commands, self.rejected)?;
        }
        self.links.iter().try_for_each(|link| writeln!(f, "link         {link}"))
    }
}

/// Sends `items` over the links to their end or until `shutdown` resolves; with `steps`, each sample when a step allows it.
///
/// # Errors
/// A link that cannot be opened.
pub fn replay(
    settings: &ReplayOptions,
    items: Receiver<Vec<ReplayItem>>,
    steps: Option<Steps>,
    shutdown: impl Future<Output = io::Result<()>>,
) -> Result<ReplaySummary, RunError> {
    let speed = if steps.is_some() { Speed::Max } else { settings.speed };
    let session = Session::new(&settings.links, speed, settings.wait_for_client)?;
    let ended = session.block_on(shutdown, replay_items(&session, settings, items, steps));
    console::finish();
    ended
}

async fn replay_items(
    session: &Session,
    settings: &ReplayOptions,
    items: Receiver<Vec<ReplayItem>>,
    steps: Option<Steps>,
) -> Result<ReplaySummary, RunError> {
    let unit = Arc::new(SharedUnit::replay(&settings.plan, session.speed));
    let links = session.open_links(&settings.links, &unit)?;
    links.iter().filter(|link| link.is_ready()).for_each(|link| console::ready(&link.info().statistics.name));
    let statistics: Vec<_> = links.iter().map(|link| link.info().statistics.clone()).collect();
    let links = links.into_iter().map(|link| LinkOutput::new(link, unit.device.interval_ns())).collect();
    let shown = Arc::new(Mutex::new(None::<geu_protocol::Sample>));
    let last_sample = || host::lock(&shown).map(CompletedSample::from);
    let (own_session, own_settings, own_shown) = (session.clone(), settings.clone(), shown.clone());
    let work = move || {
        let mut player = Player::new(&own_settings, links, items, steps, own_session, own_shown);
        player.play();
        player
    };
    let player = session.keep_cadence(&statistics, &unit.device, last_sample, work).await?;
    await_readers(&player.links.outputs).await;
    console::clear_status();
    let cadence = session.monitor.counts();
    Ok(ReplaySummary {
        counts: player.counts,
        lateness: cadence.lateness,
        late: cadence.late,
        commands: unit.commands.load(Relaxed),
        rejected: unit.rejected.load(Relaxed),
        links: statistics,
        faults: player.faults,
    })
}
