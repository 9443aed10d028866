//! Targets of coverage-guided fuzzing: every parser, with checks beyond the absence of a panic.
//!
//! A target is a function of bytes and one name in the table below, which `Cargo.toml` repeats as a program. A program contains only the
//! code that its target uses: the fuzzer passes over all counters of a program at each input. `tests/fuzz/run` builds and runs them.

mod capture;
mod decoded;
mod device;
mod model;
mod serial;
mod socket;
mod table;
mod traffic;

pub type Target = fn(&[u8]);

pub const TARGETS: &[(&str, Target)] = &[
    ("aem", table::reference),
    ("asc", |data| capture::unit("asc", data)),
    ("blf", |data| capture::unit("blf", data)),
    ("candump", |data| capture::unit("candump", data)),
    ("command", model::command),
    ("commands", model::commands),
    ("configuration", model::configuration),
    ("console", |data| capture::unit("console", data)),
    ("console_delta", |data| capture::unit("console-delta", data)),
    ("csv", table::csv),
    ("dbc", device::database),
    ("detect", capture::detected),
    ("device", device::description),
    ("device_can", |data| capture::described("candump", &["mm5.10", "openimu300ri"], data)),
    ("device_serial", serial::described),
    ("device_table", |data| capture::described("table", &["suchai3"], data)),
    ("expression", model::expression),
    ("faults", model::plan),
    ("formula", model::formula),
    ("forty_two", |data| socket::truth(true, data)),
    ("input", table::input),
    ("pcap", |data| capture::unit("pcap", data)),
    ("pcapng", |data| capture::unit("pcapng", data)),
    ("python_csv", |data| capture::unit("python-can-csv", data)),
    ("received", table::knots),
    ("reference", table::reference),
    ("reference_file", table::reference_file),
    ("request", socket::request),
    ("serial", serial::unit),
    ("traffic_can", traffic::frames),
    ("traffic_device", traffic::described),
    ("traffic_serial", traffic::bytes),
    ("trc", |data| capture::unit("trc", data)),
    ("truth", |data| socket::truth(false, data)),
];

/// The target of that name.
///
/// # Panics
/// There is none: the program does not compile.
pub const fn target(name: &str) -> Target {
    let mut index = 0;
    while index < TARGETS.len() {
        if is_same(TARGETS[index].0.as_bytes(), name.as_bytes()) {
            return TARGETS[index].1;
        }
        index += 1;
    }
    panic!("no target of this name");
}

const fn is_same(one: &[u8], other: &[u8]) -> bool {
    let mut index = 0;
    while index < one.len() && index < other.len() && one[index] == other[index] {
        index += 1;
    }
    index == one.len() && index == other.len()
}

/// The content, and the same in three parts, cut where the last two bytes of the input say.
pub fn parts(data: &[u8]) -> (&[u8], [&[u8]; 3]) {
    let Some((content, [one, other])) = data.split_last_chunk::<2>() else { return (data, [data, &[], &[]]) };
    let place = |byte: &u8| usize::from(*byte) * content.len() / usize::from(u8::MAX);
    let (first, last) = (place(one.min(other)), place(one.max(other)));
    (content, [&content[..first], &content[first..last], &content[last..]])
}
