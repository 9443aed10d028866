//! What a person at the terminal sees: ready lines on standard output, messages and the status line on standard error.

use std::fmt::{Arguments, Display};
use std::io::{IsTerminal, Write, stderr, stdout};
use std::sync::Mutex;

use geu_protocol::HalfSecond;
use geu_protocol::field::unit_flag;

use crate::lateness::{Histogram, Time};

/// Whether a status line stands on the terminal now, to be written over.
static STATUS_STANDS: Mutex<bool> = Mutex::new(false);
/// Back to the first column, and erase.
const ERASE: &str = "\r\x1b[K";

/// Tells on standard output that a link is ready. A reader that left is no reason to stop.
pub(crate) fn ready(link: &str) {
    clear_status();
    let mut out = stdout().lock();
    let _ = writeln!(out, "ready {link}").and_then(|()| out.flush());
}

/// Says something on standard error.
pub(crate) fn say(message: impl Display) {
    write(format_args!("geu: {message}\n"), false);
}

/// Takes the status line away.
pub(crate) fn clear_status() {
    write(format_args!(""), false);
}

/// Whether standard error is a terminal, where a status line makes sense.
pub(crate) fn wants_status() -> bool {
    stderr().is_terminal()
}

/// Shows the state of the unit in place of the last status line.
pub(crate) fn show_status(half_second: Option<&HalfSecond>, clients: usize, lateness: &Histogram) {
    let Some(half_second) = half_second else { return };
    let [x, y, za, zb] = half_second.increments;
    let mode = if half_second.unit_flags & unit_flag("polled") == 0 { "cyclic" } else { "polled" };
    let late = if lateness.count() > 0 {
        format!("late {} (max {})", Time(lateness.percentile_ns(0.5)), Time(lateness.max_ns()))
    } else {
        String::new()
    };
    write(
        format_args!(
            "seq {:5}  X {x:+6}  Y {y:+6}  ZA {za:+6}  ZB {zb:+6}  {:.2} / {:.2} °C  {mode}  {clients} client{}  {late}",
            half_second.sequence,
            f64::from(half_second.electronics_centi_c) / 100.0,
            f64::from(half_second.sensor_centi_c) / 100.0,
            if clients == 1 { "" } else { "s" },
        ),
        true,
    );
}

fn write(text: Arguments, is_status: bool) {
    let mut stands = STATUS_STANDS.lock().expect("nothing panics while it writes");
    let erase = if *stands { ERASE } else { "" };
    let _ = write!(stderr().lock(), "{erase}{text}");
    *stands = is_status;
}
