//! Events of `geu watch`: the check of a posted event, and the limit of their rate.

use std::sync::Mutex;
use std::time::Instant;

use geu_protocol::Gyros;
use geu_protocol::excerpt::excerpt;
use geu_protocol::suggestion::listed;
use serde_json::{Map, Value};

/// Maximum length of a body, byte.
pub(super) const MAX_BODY: usize = 1024;
/// Mean number of events per second, and the number accepted at once.
pub(super) const RATE_HZ: f64 = 20.0;
const BURST: f64 = 100.0;

/// A key of an event: its name, the expected value, and the check of a value.
type Key = (&'static str, &'static str, fn(&Value) -> bool);

/// Keys of an event, all required. Numbers of JSON are finite; times may be Unix times.
const KEYS: [Key; 6] = [
    ("t_s", "a time from 0 to 1e12 s", |value| value.as_f64().is_some_and(|t_s| (0.0..=1e12).contains(&t_s))),
    ("event", "alarm, named, interruption or reference-end", |value| {
        ["alarm", "named", "interruption", "reference-end"].iter().any(|event| value == event)
    }),
    ("code", "1 to 64 characters a-z, 0-9 and -", |value| value.as_str().is_some_and(is_code)),
    ("gyros", "a list", Value::is_array),
    ("statistic", "a number", Value::is_number),
    ("threshold", "a number", Value::is_number),
];

fn is_code(code: &str) -> bool {
    (1..=64).contains(&code.len()) && code.bytes().all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'))
}

fn are_gyros(value: &Value, unit: Gyros) -> bool {
    // A name that is no gyro's, or a repeated one, makes the list longer than the gyros in it.
    let has = |gyros: &[Value]| unit.names().into_iter().filter(|name| gyros.iter().any(|own| own == name)).count();
    value.as_array().is_some_and(|gyros| gyros.len() == has(gyros))
}

/// Checks an event, a line of the output of `geu watch`, on a unit of these gyros.
pub(super) fn check(event: &Map<String, Value>, unit: Gyros) -> Result<(), String> {
    if let Some(other) = event.keys().find(|key| KEYS.iter().all(|(known, ..)| known != key)) {
        return Err(format!("expected the keys {}, got {:?}", listed(KEYS.map(|(key, ..)| key)), excerpt(other)));
    }
    let is_wrong = |(key, _, is_valid): &&Key| {
        !event.get(*key).is_some_and(|value| is_valid(value) && (*key != "gyros" || are_gyros(value, unit)))
    };
    KEYS.iter().find(is_wrong).map_or(Ok(()), |(key, expected, _)| {
        let got = event.get(*key).map_or("none".to_owned(), Value::to_string);
        let names = unit.names();
        let names = match names.split_last() {
            Some((last, others)) if *key == "gyros" && !others.is_empty() => {
                format!(" of {} and {last}, each at most once", others.join(", "))
            }
            Some((last, _)) if *key == "gyros" => format!(" of {last}"),
            _ => String::new(),
        };
        Err(format!("{key}: expected {expected}{names}, got {}", excerpt(&got)))
    })
}

/// Limits the rate of events: the number accepted now, and the time of the last one.
pub(super) struct RateLimit(Mutex<(f64, Instant)>);

impl RateLimit {
    pub fn new() -> RateLimit {
        RateLimit(Mutex::new((BURST, Instant::now())))
    }

    /// True if an event is accepted now.
    pub fn accepts(&self, now: Instant) -> bool {
        let (available, last) = &mut *self.0.lock().expect("no holder panics");
        *available = (*available + now.duration_since(*last).as_secs_f64() * RATE_HZ).min(BURST);
        *last = now;
        let is_accepted = *available >= 1.0;
        *available -= f64::from(u8::from(is_accepted));
        is_accepted
    }
}
