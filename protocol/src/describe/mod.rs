//! The link as other tools read it: a CAN database, a C header, a Wireshark dissector, a document.
//!
//! Each output is a pure function of the tables in [`crate::field`], [`crate::message`] and [`crate::command`]. The
//! results stand beside this crate's sources (`geu.dbc`, `geu.h`, `geu.lua`, `ICD.md`), and a test holds each to its
//! generator.
//!
//! ```
//! use geu_protocol::{CanIdMap, describe};
//! assert!(describe::dbc(CanIdMap::default()).contains("BO_ 416 INCREMENTS: 8 GEU"));
//! ```

mod dbc;
mod dissector;
mod header;
mod icd;

pub use dbc::dbc;
pub use dissector::dissector;
pub use header::header;
pub use icd::icd;

use crate::command::{COMMAND_CAN, COMMAND_SERIAL, REPLY_CAN, REPLY_SERIAL};
use crate::message::{MESSAGES, MessageId};

/// Milliseconds between cyclic messages of one kind.
const CYCLE_MS: u32 = 500;

/// Every message that travels on CAN: identifier relative to the base, and name.
fn can_messages() -> Vec<(u16, &'static str)> {
    let places = MESSAGES.iter().map(|message| (message.place, message.name));
    places
        .chain([(COMMAND_CAN, "COMMAND"), (REPLY_CAN, "REPLY")])
        .filter_map(|(place, name)| match place {
            MessageId::Can(offset) => Some((offset, name)),
            MessageId::Serial(_) => None,
        })
        .collect()
}

/// Every message that travels in a serial frame: type and name.
fn serial_messages() -> Vec<(u8, &'static str)> {
    let places = MESSAGES.iter().map(|message| (message.place, message.name));
    places
        .chain([(COMMAND_SERIAL, "COMMAND"), (REPLY_SERIAL, "REPLY")])
        .filter_map(|(place, name)| match place {
            MessageId::Serial(code) => Some((code, name)),
            MessageId::Can(_) => None,
        })
        .collect()
}

/// `template` with each line that is `marker` and a name replaced by what `fill` gives for the name.
///
/// # Panics
/// For a name that `fill` does not know: the template is part of this crate.
fn filled(template: &str, marker: &str, fill: impl Fn(&str) -> Option<String>) -> String {
    let mut text = String::with_capacity(2 * template.len());
    for line in template.lines() {
        match line.trim().strip_prefix(marker) {
            Some(name) => {
                let name = name.trim();
                text.push_str(&fill(name).unwrap_or_else(|| panic!("no generated part is called {name}")));
            }
            None => {
                text.push_str(line);
                text.push('\n');
            }
        }
    }
    text
}
