//! The record of a run in a configuration: the data that repeat it.

use geu_protocol::command::hex;
use geu_protocol::hex::read_hex;
use geu_protocol::{CanIdMap, named};
use serde_json::{Map, Value as Json, json};

use super::document::{Node, Read};
use super::schema::{self, properties};
use super::tree::{Part, line, one, quoted};
use crate::fault::catalogue::Transport;
use crate::parameter_spec::{ValueFormat, numbers};

numbers! {
    /// The numbers of the record.
    struct RunNumbers {
        /// how long it ran
        duration_s: 0.0, 0.0..=1e10, "s";
        /// rate of the serial port that was open; the default one where not named
        serial_baud: absent, 1.0..=1e8, "baud", Whole;
        /// base identifier of CAN; the default one where not named
        can_base: absent, 0.0..=CanIdMap::MAX_BASE as f64, "", Whole;
    }
}

const KEYS: [&str; 10] =
    ["duration_s", UNFINISHED, ENDED_EARLY, "wire", "links", "serial_baud", "can_base", "truth", "injected", "command"];
const UNFINISHED: &str = "unfinished";
const ENDED_EARLY: &str = "ended_early";

/// A command of a recorded run.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCommand {
    /// Index, from 0, of the sample in which it acted.
    pub sample: u64,
    pub link: String,
    pub payload: Vec<u8>,
}

named! {
    /// Format of the link log of a recording.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum LinkLogFormat {
        /// `link.log`, as `candump -l` writes.
        #[default]
        Can = "can",
        Serial = "serial",
    }
}

/// The end of a recording that ended before its run.
#[derive(Debug, Clone, PartialEq)]
pub struct EndedEarly {
    pub sample: u64,
    pub reason: String,
}

/// The data of a recorded run beside its configuration that are needed to repeat it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunRecord {
    /// Duration; 0 if unknown.
    pub duration_s: f64,
    pub wire: Option<LinkLogFormat>,
    /// Transports of the links that were open, which a fault without a link acted on.
    pub links: Vec<Transport>,
    /// Rate of the open serial port, if not the default: a baud mismatch is relative to it.
    pub serial_baud: Option<u32>,
    /// Base identifier of CAN, if not the default.
    pub can_base: Option<u16>,
    /// The recording has no end yet: its other files hold duration and commands.
    pub is_unfinished: bool,
    /// The recording ended before the run.
    pub ended_early: Option<EndedEarly>,
    /// The truth as given, a file or a simulator's address; `None` for the scenario.
    pub truth: Option<String>,
    /// Faults injected during the run: one column of the truth holds the effects that only they have.
    pub injected: Vec<String>,
    pub commands: Vec<RecordedCommand>,
}

impl RunRecord {
    /// Transports of a fault without a link: the open ones and the recorded one; all if unknown.
    pub(super) fn fault_links(&self) -> Vec<Transport> {
        let recorded = match self.wire {
            Some(LinkLogFormat::Serial) => Transport::Pty,
            Some(LinkLogFormat::Can) | None => Transport::Can,
        };
        match &self.links[..] {
            [] => Transport::ALL.to_vec(),
            links => [links, &[recorded]].concat(),
        }
    }
}

fn read_sample(node: &Node) -> Read<u64> {
    node.whole_number("half_second")?
        .ok_or_else(|| node.error("half_second", "expected `half_second`, got none".to_owned()))
}

impl Part for &mut RunRecord {
    fn read(&mut self, root: &Node, key: &str) -> Read<()> {
        let Some(node) = root.table(key)? else { return Ok(()) };
        node.only(&KEYS)?;
        let RunNumbers { duration_s, serial_baud, can_base } = node.numbers()?;
        self.duration_s = duration_s;
        self.serial_baud = (!serial_baud.is_nan()).then_some(serial_baud as u32);
        self.can_base = (!can_base.is_nan()).then_some(can_base as u16);
        if node.keys().contains(&"wire") {
            self.wire = LinkLogFormat::from_name(node.choice("wire", &LinkLogFormat::NAMES)?);
        }
        let links = node.choices("links", &Transport::NAMES)?;
        self.links = links.into_iter().filter_map(Transport::from_name).collect();
        self.is_unfinished = node.value(UNFINISHED, ValueFormat::Flag, 0.0, 1.0)? == Some(1.0);
        if let Some(node) = node.table(ENDED_EARLY)? {
            node.only(&["half_second", "reason"])?;
            self.ended_early =
                Some(EndedEarly { sample: read_sample(&node)?, reason: node.text("reason")?.to_owned() });
        }
        if node.keys().contains(&"truth") {
            self.truth = Some(node.text("truth")?.to_owned());
        }
        self.injected = node.texts("injected")?.into_iter().map(str::to_owned).collect();
        for node in node.tables("command")? {
            node.only(&["half_second", "link", "bytes"])?;
            let sample = read_sample(&node)?;
            let payload = read_hex(node.text("bytes")?)
                .ok_or_else(|| node.error("bytes", "expected pairs of hexadecimal digits for `bytes`".to_owned()))?;
            self.commands.push(RecordedCommand { sample, link: node.text("link")?.to_owned(), payload });
        }
        Ok(())
    }

    fn show(&self, key: &str, _complete: bool, text: &mut String) {
        if **self == RunRecord::default() {
            return;
        }
        line!(text, "\n[{key}]\nduration_s = {:?}", self.duration_s);
        if self.is_unfinished {
            line!(text, "{UNFINISHED} = true");
        }
        if let Some(EndedEarly { sample, reason }) = &self.ended_early {
            line!(text, "{ENDED_EARLY} = {{ half_second = {sample}, reason = {} }}", quoted(reason));
        }
        if let Some(wire) = self.wire {
            line!(text, "wire = {:?}", wire.name());
        }
        if !self.links.is_empty() {
            line!(text, "links = {:?}", self.links.iter().map(|link| link.name()).collect::<Vec<_>>());
        }
        if let Some(baud) = self.serial_baud {
            line!(text, "serial_baud = {baud}");
        }
        if let Some(base) = self.can_base {
            line!(text, "can_base = {base:#X}");
        }
        if let Some(truth) = &self.truth {
            line!(text, "truth = {}", quoted(truth));
        }
        if !self.injected.is_empty() {
            line!(text, "injected = {:?}", self.injected);
        }
        for RecordedCommand { sample, link, payload } in &self.commands {
            let bytes = hex(payload);
            line!(text, "\n[[{key}.command]]\nhalf_second = {sample}\nlink = {link:?}\nbytes = {bytes:?}");
        }
    }

    fn schema(&self, key: &str) -> Map<String, Json> {
        let text = || json!({ "type": "string" });
        let sample = || ("half_second", json!({ "type": "integer", "minimum": 0 }));
        let early = properties([sample(), ("reason", text())], &["half_second", "reason"]);
        let command = properties([sample(), ("link", text()), ("bytes", text())], &["half_second", "link", "bytes"]);
        let unfinished = "the recording has no end yet: duration and commands stand in the files beside it";
        let truth =
            "truth: a file (reference.csv, CCSDS AEM, received.csv) or, for geu run, udp://, tcp:// or 42://HOST:PORT";
        let [duration, baud, base] = RunNumbers::NUMBERS else { unreachable!("three numbers") };
        let fields = [
            (duration.name, schema::number(duration)),
            (UNFINISHED, json!({ "type": "boolean", "description": unfinished })),
            (ENDED_EARLY, early),
            ("wire", json!({ "enum": LinkLogFormat::NAMES })),
            ("links", json!({ "type": "array", "items": { "enum": Transport::NAMES } })),
            (baud.name, schema::number(baud)),
            (base.name, schema::number(base)),
            ("truth", json!({ "type": "string", "description": truth })),
            ("injected", json!({ "type": "array", "items": text(), "description": "faults injected while it ran" })),
            ("command", json!({ "type": "array", "items": command })),
        ];
        one(key, properties(fields, &[]))
    }
}
