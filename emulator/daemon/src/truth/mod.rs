//! Truth from outside: a simulator tells over a socket where the unit points, while the unit runs.
//!
//! [`Live`] stands between the runtime's tasks, which read the source (`source`), and the thread that keeps time: that asks
//! for the truth just before it ends a half second. What is used when samples are late, missing or jump is decided in
//! `follow`, on on-board time alone; what was used is a [`Stepped`] truth, which a recording keeps ([`received`]).

mod follow;
mod forty_two;
mod json;
mod lines;
pub mod received;
mod source;

use std::fmt;
use std::io;
use std::str::FromStr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use geu_model::Truth;
use geu_model::attitude::Stepped;
use geu_model::units::HALF_SECOND_S;
use tokio::sync::Notify;

pub use follow::Counts;
use follow::{Follower, Sample};

use crate::console;

/// A run that waits for its source gives each half second so long, wall clock; then the source is late.
pub const PATIENCE: Duration = Duration::from_secs(2);
/// In real time the first half second begins so long after the first sample: so much a sample may lag behind the source's own
/// pace and still be on time.
const GRACE: Duration = Duration::from_millis(100);
/// Between two looks whether the run was stopped.
const LOOK_AGAIN: Duration = Duration::from_millis(50);
/// Pieces that are remembered: 1200 s, more than may wait to be written.
const PIECES: usize = 12_000;
/// Of bad lines and of jumps so many are told one by one; more are only counted.
const MOST_TOLD: u64 = 3;

/// Where the truth comes from, and how it is spoken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LiveAddress {
    /// JSON lines in datagrams to this address.
    Udp(String),
    /// JSON lines from a server.
    Tcp(String),
    /// The socket text of 42 from a server.
    FortyTwo(String),
}

impl LiveAddress {
    /// Whether a truth of that name comes from a socket, well spelt or not.
    pub fn is_meant(name: &str) -> bool {
        name.contains("://")
    }
}

impl FromStr for LiveAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<LiveAddress, String> {
        let wrong = || format!("--truth: expected udp://HOST:PORT, tcp://HOST:PORT or 42://HOST:PORT, got {text}");
        let (scheme, address) = text.split_once("://").ok_or_else(wrong)?;
        let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
        if host.is_empty() || port.parse::<u16>().is_err() {
            return Err(wrong());
        }
        match scheme {
            "udp" => Ok(LiveAddress::Udp(address.to_owned())),
            "tcp" => Ok(LiveAddress::Tcp(address.to_owned())),
            "42" => Ok(LiveAddress::FortyTwo(address.to_owned())),
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for LiveAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LiveAddress::Udp(address) => write!(f, "udp://{address}"),
            LiveAddress::Tcp(address) => write!(f, "tcp://{address}"),
            LiveAddress::FortyTwo(address) => write!(f, "42://{address}"),
        }
    }
}

/// An address that cannot be listened at.
#[derive(Debug, thiserror::Error)]
#[error("--truth {address}: cannot be listened at: {source}; expected a free port of this machine")]
pub struct TruthError {
    address: LiveAddress,
    source: io::Error,
}

/// A truth that is being told.
#[derive(Debug)]
pub struct Live {
    address: LiveAddress,
    truth: Arc<Stepped>,
    state: Mutex<State>,
    /// A sample came.
    came: Condvar,
    /// More is wanted than was.
    wanted: Notify,
}

#[derive(Debug)]
struct State {
    follower: Follower,
    /// On-board time up to which the truth is needed next.
    wanted_s: f64,
    /// The run waits for clients, and the source does not wait for the run.
    is_early: bool,
}

impl Live {
    /// A truth from `address`, before its first sample.
    pub fn new(address: LiveAddress) -> Arc<Live> {
        let truth = Arc::new(Stepped::remembering(PIECES));
        let state = State { follower: Follower::new(truth.clone()), wanted_s: HALF_SECOND_S, is_early: false };
        Arc::new(Live { address, truth, state: Mutex::new(state), came: Condvar::new(), wanted: Notify::new() })
    }

    /// What moves the unit.
    pub fn truth(&self) -> Truth {
        Truth::Stepped(self.truth.clone())
    }

    /// What became of the samples.
    pub fn counts(&self) -> Counts {
        self.state().follower.counts
    }

    /// Begins to listen, or to look for the server; within the runtime. Where the run is held back for its clients, the
    /// samples until then are the past.
    pub(crate) fn open(self: &Arc<Live>, is_held_back: bool) -> Result<(), TruthError> {
        self.state().is_early = is_held_back;
        source::open(self).map_err(|source| TruthError { address: self.address.clone(), source })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("nothing panics with the truth")
    }

    /// Waits for the first sample, which sets on-board time 0; in real time a moment longer.
    pub(crate) fn await_first(&self, waits_for_source: bool, is_stopped: impl Fn() -> bool) {
        self.state().is_early = false;
        if !self.state().follower.has_begun() {
            console::say(format_args!("waits for the first sample of {}", self.address));
        }
        self.wait(None, &is_stopped, Follower::has_begun);
        if !waits_for_source {
            self.wait(Some(GRACE), &is_stopped, |_| false);
        }
    }

    /// Makes the truth final up to `needed_s`: as it is known now, or, in a run that waits for its source, as soon as samples
    /// cover it. Says whether it did: not where the run was stopped while it waited.
    pub(crate) fn finish(&self, needed_s: f64, waits_for_source: bool, is_stopped: impl Fn() -> bool) -> bool {
        if waits_for_source {
            self.want(needed_s);
            self.wait(Some(PATIENCE), &is_stopped, |follower| follower.covers(needed_s));
            if is_stopped() {
                return false;
            }
        }
        let note = self.state().follower.finish(needed_s);
        self.want(needed_s + HALF_SECOND_S);
        if let Some(note) = note {
            console::say(format_args!("truth {}: {note}", self.address));
        }
        true
    }

    fn want(&self, until_s: f64) {
        self.state().wanted_s = until_s;
        self.wanted.notify_waiters();
    }

    /// Waits until `is_enough`, the patience is over, or the run is stopped.
    fn wait(&self, patience: Option<Duration>, is_stopped: &impl Fn() -> bool, is_enough: impl Fn(&Follower) -> bool) {
        let start = Instant::now();
        let mut state = self.state();
        while !is_enough(&state.follower) && !is_stopped() {
            let left = patience.map_or(LOOK_AGAIN, |patience| patience.saturating_sub(start.elapsed()));
            if left.is_zero() {
                break;
            }
            state = self.came.wait_timeout(state, left.min(LOOK_AGAIN)).expect("nothing panics with the truth").0;
        }
    }

    /// Takes a sample, or counts a line of `place` that is none.
    fn take(&self, place: fmt::Arguments<'_>, read: Result<Sample, String>) {
        let mut state = self.state();
        let (note, so_far) = match read {
            Ok(sample) => {
                let note = state.follower.take(sample);
                (note, state.follower.counts.jumps)
            }
            Err(wrong) => {
                state.follower.counts.bad_lines += 1;
                (Some(format!("{place}: {wrong}")), state.follower.counts.bad_lines)
            }
        };
        if let Some(note) = note.filter(|_| so_far <= MOST_TOLD) {
            let more = if so_far == MOST_TOLD { "; more of the kind are only counted" } else { "" };
            console::say(format_args!("truth {}: {note}{more}", self.address));
        }
        if state.is_early {
            state.follower.forget_the_past();
        }
        drop(state);
        self.came.notify_all();
    }

    /// Whether a source that told something once is missing.
    fn is_missing(&self) -> bool {
        self.state().follower.is_missing()
    }

    fn is_wanted(&self, ahead_s: f64) -> bool {
        let state = self.state();
        state.is_early || !state.follower.covers(state.wanted_s + ahead_s)
    }

    /// Waits until samples are wanted further than `ahead_s` before those that came.
    async fn until_wanted(&self, ahead_s: f64) {
        loop {
            // Made before the look, so that what is wanted in between is not slept through.
            let wanted = self.wanted.notified();
            if self.is_wanted(ahead_s) {
                return;
            }
            wanted.await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_its_scheme_host_and_port() {
        for text in ["udp://127.0.0.1:4701", "tcp://simulator:10001", "42://[::1]:10001"] {
            assert_eq!(text.parse::<LiveAddress>().expect(text).to_string(), text);
        }
        for text in
            ["udp://", "udp://:1", "udp://host", "udp://host:99999", "http://host:80", "://host:1", "tcp:host:1"]
        {
            let message = text.parse::<LiveAddress>().expect_err(text);
            assert!(message.contains("expected udp://HOST:PORT") && message.contains(text), "{message}");
        }
    }
}
