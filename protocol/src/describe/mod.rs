//! Descriptions of the link for other tools: a CAN database, a C header, a Wireshark dissector, a document.
//!
//! Each output is a pure function of the tables in [`crate::field`], [`crate::message`] and [`crate::command`]. The
//! results are in the root of this crate (`geu.dbc`, `geu.h`, `geu.lua`, `ICD.md`); a test compares each with its generator.
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
fn can_messages() -> impl Iterator<Item = (u16, &'static str)> {
    ids().filter_map(|(id, name)| if let MessageId::Can(offset) = id { Some((offset, name)) } else { None })
}

/// Every message that travels in a serial frame: type and name.
fn serial_messages() -> impl Iterator<Item = (u8, &'static str)> {
    ids().filter_map(|(id, name)| if let MessageId::Serial(code) = id { Some((code, name)) } else { None })
}

fn ids() -> impl Iterator<Item = (MessageId, &'static str)> {
    let commands =
        [(COMMAND_CAN, "COMMAND"), (REPLY_CAN, "REPLY"), (COMMAND_SERIAL, "COMMAND"), (REPLY_SERIAL, "REPLY")];
    MESSAGES.iter().map(|message| (message.id, message.name)).chain(commands)
}

/// Replaces each line of `template` that is `marker` and a name by `fill(name)`.
///
/// # Panics
/// For a name unknown to `fill`: the template is part of this crate.
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
