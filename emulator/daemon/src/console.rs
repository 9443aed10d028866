//! Terminal output: ready lines on standard output, messages and the status line on standard error.

use std::fmt::Display;
use std::io::{IsTerminal, Write, stderr, stdout};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use geu_model::CompletedSample;
use geu_model::device::Device;
use geu_protocol::field::unit_flag;

use crate::lateness::{DurationNs, Histogram};

/// Messages that wait for a blocked terminal; more are lost.
const QUEUE: usize = 256;
/// Maximum wait for a blocked terminal at the end.
const FINISH_TIMEOUT: Duration = Duration::from_millis(200);
/// Back to the first column, and erase.
const ERASE: &str = "\r\x1b[K";

enum Message {
    Ready(String),
    Text(String),
    Status(String),
    Finish(SyncSender<()>),
}

/// Prints on standard output that a link is ready. A closed output is ignored.
pub(crate) fn ready(link: &str) {
    send(Message::Ready(format!("ready {link}\n")));
}

/// Prints a message on standard error.
pub(crate) fn say(message: impl Display) {
    send(Message::Text(format!("geu: {message}\n")));
}

/// Erases the status line.
pub(crate) fn clear_status() {
    send(Message::Text(String::new()));
}

/// Waits until all messages are printed, for a limited time.
pub(crate) fn finish() {
    let (done, is_done) = sync_channel(1);
    send(Message::Finish(done));
    let _ = is_done.recv_timeout(FINISH_TIMEOUT);
}

/// True if standard error is a terminal, which has a status line.
pub(crate) fn wants_status() -> bool {
    stderr().is_terminal()
}

/// Replaces the status line.
pub(crate) fn show_status(device: &Device, sample: Option<CompletedSample>, clients: usize, lateness: &Histogram) {
    let Some(CompletedSample { sample, outputs, .. }) = sample else { return };
    let counts = device.gyros().zip(outputs.counts);
    let counts: Vec<String> =
        counts.map(|(gyro, counts)| format!("{} {counts:+6.0}", gyro.name().trim_start_matches("GYR"))).collect();
    let mode = if sample.unit_flags & unit_flag("polled") == 0 { "cyclic" } else { "polled" };
    let late = if lateness.count() > 0 {
        format!("late {} (max {})", DurationNs(lateness.percentile_ns(0.5)), DurationNs(lateness.max_ns()))
    } else {
        String::new()
    };
    send(Message::Status(format!(
        "seq {:5}  {}  {:.2} / {:.2} °C  {mode}  {clients} client{}  {late}",
        sample.sequence,
        counts.join("  "),
        f64::from(sample.electronics_centi_c) / 100.0,
        f64::from(sample.sensor_centi_c) / 100.0,
        if clients == 1 { "" } else { "s" },
    )));
}

/// Queues a message for the printing thread, so that a blocked or closed terminal delays no caller.
fn send(message: Message) {
    #[cfg(test)]
    if crate::simulation::host().is_some() {
        return;
    }
    static MESSAGES: OnceLock<SyncSender<Message>> = OnceLock::new();
    let messages = MESSAGES.get_or_init(|| {
        let (sender, messages) = sync_channel(QUEUE);
        // Without a thread the receiver is gone, and messages are lost.
        let _ = thread::Builder::new().name("geu-console".to_owned()).spawn(move || show(&messages));
        sender
    });
    let _ = messages.try_send(message);
}

fn show(messages: &Receiver<Message>) {
    // True if the terminal shows a status line, which the next message erases.
    let mut has_status = false;
    for message in messages {
        let erase = if std::mem::take(&mut has_status) { ERASE } else { "" };
        let _ = match message {
            Message::Ready(line) => {
                let _ = write!(stderr(), "{erase}");
                let mut out = stdout().lock();
                out.write_all(line.as_bytes()).and_then(|()| out.flush())
            }
            Message::Text(text) => write!(stderr(), "{erase}{text}"),
            Message::Status(text) => {
                has_status = true;
                write!(stderr(), "{erase}{text}")
            }
            Message::Finish(done) => {
                let _ = done.try_send(());
                write!(stderr(), "{erase}")
            }
        };
    }
}
