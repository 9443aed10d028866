//! What a person at the terminal sees: ready lines on standard output, messages and the status line on standard error.

use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use geu_protocol::Sample;
use geu_protocol::field::unit_flag;

use crate::lateness::{DurationNs, Histogram};

/// What may wait for a terminal that stands still; more is lost.
const QUEUE: usize = 256;
/// At the end such a terminal is waited for so long.
const LAST_WORDS: Duration = Duration::from_millis(200);
/// Back to the first column, and erase.
const ERASE: &str = "\r\x1b[K";

enum Message {
    Ready(String),
    Said(String),
    Status(String),
    Finish(SyncSender<()>),
}

/// Tells on standard output that a link is ready. A reader that left is no reason to stop.
pub(crate) fn ready(link: &str) {
    tell(Message::Ready(format!("ready {link}\n")));
}

/// Says something on standard error.
pub(crate) fn say(message: impl Display) {
    tell(Message::Said(format!("geu: {message}\n")));
}

/// Takes the status line away.
pub(crate) fn clear_status() {
    tell(Message::Said(String::new()));
}

/// Waits until all is shown, but not for ever.
pub(crate) fn finish() {
    let (done, is_done) = sync_channel(1);
    tell(Message::Finish(done));
    let _ = is_done.recv_timeout(LAST_WORDS);
}

/// Whether standard error is a terminal, where a status line makes sense.
pub(crate) fn wants_status() -> bool {
    stderr().is_terminal()
}

/// Shows the state of the unit in place of the last status line.
pub(crate) fn show_status(sample: Option<&Sample>, clients: usize, lateness: &Histogram) {
    let Some(sample) = sample else { return };
    let [x, y, za, zb] = sample.increments;
    let mode = if sample.unit_flags & unit_flag("polled") == 0 { "cyclic" } else { "polled" };
    let late = if lateness.count() > 0 {
        format!("late {} (max {})", DurationNs(lateness.percentile_ns(0.5)), DurationNs(lateness.max_ns()))
    } else {
        String::new()
    };
    tell(Message::Status(format!(
        "seq {:5}  X {x:+6}  Y {y:+6}  ZA {za:+6}  ZB {zb:+6}  {:.2} / {:.2} °C  {mode}  {clients} client{}  {late}",
        sample.sequence,
        f64::from(sample.electronics_centi_c) / 100.0,
        f64::from(sample.sensor_centi_c) / 100.0,
        if clients == 1 { "" } else { "s" },
    )));
}

/// Hands over to the thread that writes: neither a terminal that stands still nor a closed one holds anybody up.
fn tell(message: Message) {
    static MESSAGES: OnceLock<SyncSender<Message>> = OnceLock::new();
    let messages = MESSAGES.get_or_init(|| {
        let (sender, messages) = sync_channel(QUEUE);
        // Without a thread the receiver is gone, and nothing is shown.
        let _ = thread::Builder::new().name("geu-console".to_owned()).spawn(move || show(&messages));
        sender
    });
    let _ = messages.try_send(message);
}

fn show(messages: &Receiver<Message>) {
    // Whether a status line stands on the terminal now, to be written over.
    let mut stands = false;
    for message in messages {
        let erase = if std::mem::take(&mut stands) { ERASE } else { "" };
        let _ = match message {
            Message::Ready(line) => {
                let _ = write!(stderr(), "{erase}");
                let mut out = stdout().lock();
                out.write_all(line.as_bytes()).and_then(|()| out.flush())
            }
            Message::Said(text) => write!(stderr(), "{erase}{text}"),
            Message::Status(text) => {
                stands = true;
                write!(stderr(), "{erase}{text}")
            }
            Message::Finish(done) => {
                let _ = done.try_send(());
                write!(stderr(), "{erase}")
            }
        };
    }
}
