//! Clients of a link: attentive ones with checked data, and clients of other kinds.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, frame, read_data};

use super::disk::Disk;
use super::port::ClientEnd;
use super::world::Host;
use crate::host as unit_host;
use crate::shared_unit::SharedUnit;

/// Payloads of commands: PING, SELF_TEST, SET_MODE cyclic, POLL in cyclic mode, unknown, malformed.
const PAYLOADS: [&[u8]; 6] = [&[1], &[4], &[2, 0], &[3], &[0x77], &[2, 9, 9]];
/// An attentive client gets its reply in this time: the disk delays it by 10 ms at most, a paced line by some frames.
const REPLY_NS: i64 = 400_000_000;
/// And its sample in this time: the line takes 3 ms for a frame.
const SAMPLE_NS: i64 = 200_000_000;
/// A reader looks again after this time, as it may have missed a notification.
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// Behaviour of a client; all times in ns.
#[derive(Debug, Clone)]
pub(super) struct Habits {
    /// Reads at once, stays, and sends whole commands one after the other: its data is checked completely.
    pub is_attentive: bool,
    pub reads: bool,
    /// Pause before each turn, at most.
    pub pause_ns: i64,
    /// Probability of a command at a turn, and number of commands sent at once, at most.
    pub commands: f64,
    pub burst: i64,
    /// Probabilities at a turn.
    pub garbage: f64,
    pub stalls: f64,
    pub closes: f64,
    pub shuts_down: f64,
    /// Sends its bytes in parts.
    pub dribbles: bool,
}

impl Habits {
    /// One kind of client.
    pub fn draw(host: &Host) -> Habits {
        let quiet = Habits {
            is_attentive: false,
            reads: true,
            pause_ns: 20_000_000,
            commands: 0.1,
            burst: 1,
            garbage: 0.0,
            stalls: 0.0,
            closes: 0.0,
            shuts_down: 0.0,
            dribbles: false,
        };
        match host.draw(0..=6) {
            // With few commands only samples wake the link.
            0 => Habits { is_attentive: true, pause_ns: 2_000_000, commands: 0.005, ..quiet },
            1 => Habits { is_attentive: true, pause_ns: 2_000_000, commands: 0.3, ..quiet },
            // Floods and never reads.
            2 => Habits { reads: false, pause_ns: 400_000, commands: 0.9, burst: 20, closes: 0.0005, ..quiet },
            // Stalls, then reads again.
            3 => Habits { stalls: 0.01, commands: 0.3, burst: 5, ..quiet },
            // Vanishes and comes back.
            4 => Habits { closes: 0.05, pause_ns: 5_000_000, commands: 0.4, burst: 4, garbage: 0.05, ..quiet },
            // Sends nonsense byte by byte.
            5 => Habits { garbage: 0.5, dribbles: true, closes: 0.01, ..quiet },
            // Ends its side and reads on.
            _ => Habits { shuts_down: 0.01, pause_ns: 10_000_000, ..quiet },
        }
    }
}

/// The outcome of all clients.
#[derive(Default)]
pub(super) struct Totals {
    pub samples: AtomicU64,
    pub replies: AtomicU64,
    pub opened: AtomicU64,
}

/// Data that clients share with the run.
pub(super) struct Setting {
    pub host: Host,
    pub totals: Totals,
    pub unit: Arc<SharedUnit>,
    /// The run has ended.
    pub has_ended: AtomicBool,
    /// Samples may wait for readers, and readers may lose samples.
    pub is_faster: bool,
    /// The process stood still: some samples were not sent.
    pub has_stalled: AtomicBool,
    pub disk: Option<Arc<Disk>>,
}

impl Setting {
    /// True if every sample must be on time, and reach its reader.
    pub fn is_exact(&self) -> bool {
        !self.is_faster && !self.has_stalled.load(Relaxed)
    }

    /// True once commands are no longer answered.
    pub fn is_over(&self) -> bool {
        self.has_ended.load(Relaxed) || self.unit.is_closed()
    }
}

/// The link of a connection.
pub(super) struct Endpoint {
    /// Name of the link in recordings.
    pub link: String,
    pub is_pty: bool,
    /// Other clients take bytes of the same pty: nothing can be checked.
    pub is_shared: bool,
}

/// One connection, as its client sees it.
struct Connection<'a> {
    setting: &'a Setting,
    endpoint: &'a Endpoint,
    end: ClientEnd,
    habits: &'a Habits,
    deframer: Deframer,
    partial: Vec<u8>,
    /// Bytes to send.
    waiting: Vec<u8>,
    frames: u64,
    sequence: Option<u16>,
    /// Time since which samples that were sent lack.
    lacking_ns: Option<i64>,
    /// Opcode and time of the command that awaits its reply.
    asked: Option<(u8, i64)>,
}

/// Serves one connection to its end. `replies` counts the replies over the link until now.
pub(super) async fn serve(setting: &Setting, endpoint: &Endpoint, replies: &mut u64, end: ClientEnd, habits: &Habits) {
    setting.totals.opened.fetch_add(1, Relaxed);
    let mut connection = Connection {
        setting,
        endpoint,
        end,
        habits,
        deframer: Deframer::default(),
        partial: Vec::new(),
        waiting: Vec::new(),
        frames: 0,
        sequence: None,
        lacking_ns: None,
        asked: None,
    };
    let host = &setting.host;
    while !setting.is_over() && !connection.end.is_closed_by_unit() {
        if habits.is_attentive {
            unit_host::timeout(LOOK_AGAIN, connection.end.readable()).await;
        }
        let pause_ns = host.draw(100_000..=habits.pause_ns);
        unit_host::sleep(Duration::from_nanos(pause_ns as u64)).await;
        if habits.reads {
            connection.read(replies);
        }
        if host.happens(habits.closes) {
            return;
        }
        if host.happens(habits.stalls) {
            let stall_ns = host.draw(10_000_000..=3_000_000_000);
            unit_host::sleep(Duration::from_nanos(stall_ns as u64)).await;
        }
        if host.happens(habits.shuts_down) {
            connection.end.shut_down();
        }
        connection.send();
    }
}

impl Connection<'_> {
    fn send(&mut self) {
        let (host, habits) = (&self.setting.host, self.habits);
        if self.waiting.is_empty() && self.asked.is_none() && host.happens(habits.commands) {
            for _ in 0..host.draw(1..=habits.burst) {
                let payload = PAYLOADS[host.draw(0..=PAYLOADS.len() as i64 - 1) as usize];
                self.waiting.extend(frame(FrameType::Command, payload));
                if habits.is_attentive {
                    self.asked = Some((payload[0], host.now_ns()));
                }
            }
        }
        if host.happens(habits.garbage) {
            let garbage = (0..host.draw(1..=40)).map(|_| host.draw(0..=255) as u8);
            self.waiting.extend(garbage);
        }
        let most = if habits.dribbles { host.draw(1..=3) as usize } else { self.waiting.len() };
        let sent = self.end.write(&self.waiting[..most.min(self.waiting.len())]);
        self.waiting.drain(..sent);
        if !habits.is_attentive {
            // It does not wait until all bytes are sent.
            self.waiting.truncate(2000);
        }
    }

    fn read(&mut self, replies: &mut u64) {
        let most = if self.habits.is_attentive { usize::MAX } else { self.setting.host.draw(1..=200) as usize };
        self.partial.extend(self.end.read(most));
        let (mut frames, mut broken) = (Vec::new(), 0);
        let used = self.deframer.consume(&self.partial, &mut |event| match event {
            DeframerEvent::Frame { kind, payload, .. } => frames.push((kind, payload.to_vec())),
            DeframerEvent::Skipped { length, .. } => broken += length,
            DeframerEvent::Rejected { .. } => {}
        });
        self.partial.drain(..used);
        if self.endpoint.is_shared {
            return;
        }
        // A pty may begin with the rest of a frame of the client before.
        if broken > 0 && !(self.endpoint.is_pty && self.frames == 0 && broken < 28) {
            self.setting.host.fail(format_args!("{}: {broken} bytes are no whole frame", self.endpoint.link));
        }
        for (kind, payload) in frames {
            self.frames += 1;
            self.setting.host.note(payload.iter().fold(0_u64, |sum, &byte| sum.wrapping_mul(31) + u64::from(byte)));
            match kind {
                FrameType::Data => self.check_sample(read_data(&payload).sequence),
                FrameType::Reply => {
                    *replies += 1;
                    self.check_reply(payload[0], *replies);
                }
                FrameType::Command => {
                    self.setting.host.fail(format_args!("{}: the unit sent a command", self.endpoint.link))
                }
            }
        }
        self.check_delays();
    }

    /// Samples and replies come in time to a client that reads.
    fn check_delays(&mut self) {
        if !self.habits.is_attentive || !self.setting.is_exact() {
            return;
        }
        let now_ns = self.setting.host.now_ns();
        let sent = self.setting.unit.completed().map(|completed| completed.sample.sequence);
        let received = self.sequence.filter(|received| sent.is_some_and(|sent| sent != *received));
        self.lacking_ns = received.and(self.lacking_ns.or(Some(now_ns)));
        if let (Some(received), Some(since_ns)) = (received, self.lacking_ns)
            && now_ns - since_ns > SAMPLE_NS
        {
            let next = received.wrapping_add(1);
            self.setting.host.fail(format_args!("{}: sample {next} does not come", self.endpoint.link));
        }
        if let Some((opcode, asked_ns)) = self.asked
            && now_ns - asked_ns > REPLY_NS
        {
            let late_ms = (now_ns - asked_ns) / 1_000_000;
            self.setting
                .host
                .fail(format_args!("{}: no reply to command {opcode} for {late_ms} ms", self.endpoint.link));
        }
    }

    fn check_sample(&mut self, sequence: u16) {
        self.setting.totals.samples.fetch_add(1, Relaxed);
        self.lacking_ns = None;
        let expected = self.sequence.replace(sequence).map(|before| before.wrapping_add(1));
        let is_next = expected.is_none_or(|expected| expected == sequence);
        if self.habits.is_attentive && !is_next && self.setting.is_exact() {
            self.setting.host.fail(format_args!(
                "{}: sequence {sequence} after {expected:?} was expected, of a client that reads",
                self.endpoint.link
            ));
        }
    }

    /// The reply of number `count` on a link: its command is on the disk.
    fn check_reply(&mut self, opcode: u8, count: u64) {
        self.setting.totals.replies.fetch_add(1, Relaxed);
        let host = &self.setting.host;
        if self.habits.is_attentive {
            match self.asked.take() {
                Some((asked, _)) if asked == opcode => {}
                asked => host.fail(format_args!("{}: reply to {opcode}, asked was {asked:?}", self.endpoint.link)),
            }
        }
        let Some(disk) = &self.setting.disk else { return };
        let recorded = disk.contents().commands.get(&self.endpoint.link).copied().unwrap_or_default();
        if recorded < count && !disk.is_excused(host.now_ns()) {
            host.fail(format_args!(
                "{}: {count} commands are acknowledged, {recorded} are on the disk, which works",
                self.endpoint.link
            ));
        }
    }
}
