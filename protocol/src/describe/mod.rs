//! Descriptions of the link for other tools: a CAN database, a C header, a Wireshark dissector, a document, and the packets for ground
//! systems (XTCE, COSMOS).
//!
//! Each output is a template filled with the tables in [`crate::field`], [`crate::message`] and [`crate::command`]. The
//! results are in the root of this crate (`geu.dbc`, `geu.h`, `geu.lua`, `ICD.md`); a test compares each with its generator.
//!
//! ```
//! use geu_protocol::{CanIdMap, describe};
//! assert!(describe::dbc(CanIdMap::default()).contains("BO_ 416 INCREMENTS: 8 GEU"));
//! ```

mod cosmos;
mod dbc;
mod device;
mod packet;
mod tables;
mod xtce;

pub use device::Wire;
pub use packet::{Ground, ground};

use crate::can::CanIdMap;
use crate::template::{engine, filled};

/// The CAN database for identifiers at `plan`.
pub fn dbc(plan: CanIdMap) -> String {
    filled(&engine(), include_str!("template.dbc"), &dbc::tables(plan))
}

/// The header for on-board software, in C.
pub fn header() -> String {
    filled(&engine(), include_str!("template.h"), &tables::tables())
}

/// The dissector for Wireshark.
pub fn dissector() -> String {
    filled(&engine(), include_str!("template.lua"), &tables::tables())
}

const BEGIN: &str = "<!-- generated: ";
const END: &str = "<!-- end -->";

/// The document with its generated sections from the tables of this crate.
///
/// # Panics
/// For a section that the template does not have, or that is not closed: both are part of this crate.
pub fn icd() -> String {
    refreshed(include_str!("../../ICD.md"), &filled(&engine(), include_str!("template.md"), &tables::tables()))
}

/// `document` with each marked section as in `sections`.
fn refreshed(document: &str, sections: &str) -> String {
    let mut parts = document.split(BEGIN);
    let mut text = parts.next().unwrap_or_default().to_string();
    for part in parts {
        let (name, rest) = part.split_once('\n').expect("a marker is a line");
        let (_, prose) = rest.split_once(END).unwrap_or_else(|| panic!("section {name} lacks its {END}"));
        let section = sections.split(BEGIN).find(|section| section.starts_with(name));
        let section = section.unwrap_or_else(|| panic!("the template has no section {name}"));
        text += &format!("{BEGIN}{}{prose}", section.trim_end());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_is_replaced_and_prose_is_not() {
        let sections = "<!-- generated: b -->\nB\n<!-- end -->\n<!-- generated: a -->\nfresh\n<!-- end -->\n";
        let text = refreshed("# A\n<!-- generated: a -->\nstale\n<!-- end -->\nprose\n", sections);
        assert_eq!(text, "# A\n<!-- generated: a -->\nfresh\n<!-- end -->\nprose\n");
    }
}
