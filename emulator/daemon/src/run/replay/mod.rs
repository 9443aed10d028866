//! A recording in place of the unit: what was recorded goes out over the links, at its own pace or another.
//!
//! Whoever reads the recording hands it over as [`ReplayItem`]s; here is what becomes of each on each link. A link of the
//! recorded form carries the contents as they are. On one of the other form, and where a fault of links acts, the half
//! second goes out as the link itself writes it.

mod item;
mod player;
#[cfg(test)]
mod tests;

use std::fmt;
use std::future::Future;
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::Receiver;

use geu_model::fault::acting::FaultEngine;
use geu_model::fault::catalogue::FaultAction;
use geu_model::fault::expectation::Expectation;
use geu_model::fault::{Fault, FaultKind, unsatisfiable_condition};

use super::error::RunError;
use super::output::LinkOutput;
use super::session::{Session, await_readers};
use crate::cadence::Speed;
use crate::console;
use crate::lateness::Histogram;
use crate::link::LinkStatistics;
use crate::link_model::acts_on_replies_alone;
use crate::shared_unit::SharedUnit;
pub use item::{ReplayItem, ReplayItemKind, ReplayOptions, Steps, TrafficOrigin};
use player::{Counts, Player};

/// What a condition can ask about and a recording does not tell.
const UNTOLD: [&str; 6] = ["rate_x", "rate_y", "rate_z", "theta_deg", "psi_deg", "command"];

/// What of a plan cannot act on a recording, in words: a fault, or a condition that would never hold.
pub fn refused(faults: &[Fault], expectations: &[Expectation]) -> Option<String> {
    let misplaced = faults.iter().find_map(misplaced);
    misplaced.or_else(|| unsatisfiable_condition(faults, expectations, "a recording", &UNTOLD))
}

/// Why a fault cannot act on a recording.
fn misplaced(fault: &Fault) -> Option<String> {
    let on = match (&fault.action, fault.law()) {
        (_, FaultAction::Link(law)) if acts_on_replies_alone(&law) => "replies, and a recording gives none".to_owned(),
        (_, FaultAction::Link(_)) => return None,
        (FaultKind::Parameter { .. }, _) => "a parameter of the model, which a recording has passed".to_owned(),
        (FaultKind::Named { spec, .. }, _) => format!("the {}, whose counts are recorded already", spec.scope.name()),
    };
    Some(format!(
        "fault {:?}: {} acts on {on}; expected faults of links alone (`geu faults list --link tcp` shows them): take it out, or run the unit with `geu run --faults`",
        fault.id,
        fault.action.name(),
    ))
}

/// What a replay has done.
pub struct ReplaySummary {
    counts: Counts,
    lateness: Histogram,
    late: u64,
    commands: u64,
    rejected: u64,
    links: Vec<Arc<LinkStatistics>>,
    /// How the faults and expectations of the plan stand.
    pub faults: FaultEngine,
}

impl fmt::Display for ReplaySummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Counts { samples, faulted, unit_frames, unit_bytes, other, held_up } = self.counts;
        write!(f, "samples {samples} of the recording, {} contents late", self.late)?;
        if faulted > 0 {
            write!(f, ", {faulted} with faults")?;
        }
        writeln!(f)?;
        if held_up > 0 {
            writeln!(f, "held up      {held_up} times; the recording waited")?;
        }
        if self.lateness.count() > 0 {
            writeln!(f, "lateness     {}", self.lateness)?;
        }
        if unit_frames + unit_bytes + other > 0 {
            writeln!(
                f,
                "left out     on links of the other form: {unit_frames} frames and {unit_bytes} bytes that make no whole sample, {other} of commands and other traffic"
            )?;
        }
        if self.commands + self.rejected > 0 {
            writeln!(f, "commands     {} without an answer, {} frames dropped", self.commands, self.rejected)?;
        }
        self.links.iter().try_for_each(|link| writeln!(f, "link         {link}"))
    }
}

/// Sends `items` over the links until they are over or `shutdown` resolves, each sample when a step allows it
/// where there are `steps`.
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
    let unit = Arc::new(SharedUnit::of_recording(session.speed));
    let links = session.open_links(&settings.links, &unit)?;
    links.iter().filter(|link| link.is_ready()).for_each(|link| console::ready(&link.info().statistics.name));
    let statistics: Vec<_> = links.iter().map(|link| link.info().statistics.clone()).collect();
    let links = links.into_iter().map(LinkOutput::new).collect();
    let mut player = Player::new(settings, links, items, steps, session.clone());
    let shown = player.shown.clone();
    let last_sample = || *shown.lock().expect("nothing panics with it");
    let work = move || {
        player.play();
        player
    };
    let player = session.keep_cadence(&statistics, last_sample, work).await?;
    await_readers(&player.links).await;
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
