//! `faults.jsonl`: what was injected, when, and into which bytes of which link.
//!
//! | `what` | |
//! |---|---|
//! | `injected` | a fault came live, with its keys |
//! | `start`, `end` | a fault began to act, and why; it is over, with the half seconds it touched |
//! | `bytes` | a half second that a link carried otherwise than without the faults that acted: before, after, identifiers |
//! | `missed` | a half second that was not sent live, whatever `bytes` claims: the process was held up |
//! | `cleared` | a fault was taken away |
//! | `expectation` | one was decided |

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use geu_model::configuration::fault::fault_text;
use geu_model::fault::Fault;
use geu_model::fault::acting::{Acting, Happening};
use geu_model::fault::expectation::Verdict;
use geu_model::{Ended, Injected};
use geu_protocol::{HalfSecond, Reply};
use serde_json::{Value, json};

use crate::carriage::{Carrier, Content, Piece};
use crate::record::{Output, RecordError};

/// Writes it.
pub(crate) struct FaultLog {
    file: Output,
    /// The links whose bytes are told.
    carriers: Vec<Carrier>,
    /// Half seconds that each fault touched since it started.
    touched: BTreeMap<String, u64>,
}

fn on_board_s(frame: u64) -> f64 {
    frame as f64 * 0.5
}

fn texts(contents: &[Content]) -> Vec<String> {
    contents.iter().map(Content::to_string).collect()
}

/// The keys of a fault as JSON, as the control interface takes them.
pub fn keys(fault: &Fault) -> Value {
    let text = fault_text(fault);
    let document: toml_edit::DocumentMut = text.parse().expect("written as TOML");
    let keys = document.iter().map(|(key, item)| (key.to_owned(), json_of(item.as_value().expect("keys of a fault"))));
    Value::Object(keys.collect())
}

fn json_of(value: &toml_edit::Value) -> Value {
    match value {
        toml_edit::Value::String(text) => json!(text.value()),
        toml_edit::Value::Integer(number) => json!(number.value()),
        toml_edit::Value::Float(number) => json!(number.value()),
        toml_edit::Value::Boolean(flag) => json!(flag.value()),
        toml_edit::Value::InlineTable(table) => {
            Value::Object(table.iter().map(|(key, value)| (key.to_owned(), json_of(value))).collect())
        }
        other => json!(other.to_string()),
    }
}

/// What happened, as the log and the timeline of a bench tell it; `frame` is the half second that begins.
pub(crate) fn told(frame: u64, happening: &Happening) -> Value {
    let t_s = on_board_s(frame);
    match happening {
        Happening::Started(fault) => json!({
            "what": "start", "t_s": t_s, "half_second": frame, "id": fault.id, "trigger": fault.trigger(),
            "fault": fault.action.name(), "gyro": fault.gyro.map(|gyro| gyro.name()), "link": fault.link.map(|link| link.name()),
        }),
        Happening::Ended(fault, half_seconds) => json!({
            "what": "end", "t_s": t_s, "half_second": frame, "id": fault.id, "half_seconds": half_seconds,
        }),
        Happening::Decided(watch) => json!({
            "what": "expectation", "t_s": t_s, "half_second": frame, "id": watch.expectation.id,
            "condition": watch.expectation.condition.to_string(),
            "verdict": if matches!(watch.verdict, Verdict::Met(_)) { "met" } else { "not met" },
        }),
    }
}

impl FaultLog {
    /// Opens it: the recorded link is told, and those that are open beside it.
    pub fn create(directory: &Path, recorded: &Carrier, links: &[Carrier]) -> Result<FaultLog, RecordError> {
        let mut carriers = links.to_vec();
        if !carriers.iter().any(|carrier| carrier.kind == recorded.kind) {
            carriers.push(recorded.clone());
        }
        Ok(FaultLog { file: Output::create(directory, "faults.jsonl")?, carriers, touched: BTreeMap::new() })
    }

    fn line(&mut self, line: &Value) -> Result<(), RecordError> {
        self.file.write(|file| writeln!(file, "{line}"))
    }

    /// A half second that ended while faults acted.
    pub fn half_second(&mut self, frame: u64, ended: &Ended, injected: &Injected) -> Result<(), RecordError> {
        let told = Some(&ended.half_second).filter(|_| ended.cyclic);
        let clean = Some(&injected.clean).filter(|_| injected.is_clean_cyclic);
        let mut touched = Vec::new();
        for carrier in self.carriers.clone() {
            let after = carrier.carry(told, frame, &injected.acting);
            let ids = self.compare(&carrier, frame, clean, after, &injected.acting, ended.half_second.sequence)?;
            touched.extend(ids);
        }
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|id| *self.touched.entry(id).or_default() += 1);
        Ok(())
    }

    /// A half second that was polled while faults act.
    pub fn polled(
        &mut self,
        frame: u64,
        half_second: &HalfSecond,
        reply: &Reply,
        injected: Option<&Injected>,
        acting: &[Acting],
    ) -> Result<(), RecordError> {
        if acting.is_empty() && injected.is_none() {
            return Ok(());
        }
        let clean = injected.map_or(half_second, |injected| &injected.clean);
        for carrier in self.carriers.clone() {
            let mut after = carrier.polled(half_second, reply, acting);
            after.iter_mut().for_each(|piece| piece.frame = frame);
            self.compare(&carrier, frame, Some(clean), after, acting, half_second.sequence)?;
        }
        Ok(())
    }

    /// Writes a line where what goes out is not what would; the identifiers of the faults that act on this link then.
    fn compare(
        &mut self,
        carrier: &Carrier,
        frame: u64,
        clean: Option<&HalfSecond>,
        after: Vec<Piece>,
        acting: &[Acting],
        sequence: u16,
    ) -> Result<Vec<String>, RecordError> {
        let before: Vec<Content> = clean.into_iter().flat_map(|clean| carrier.plain(clean)).collect();
        let is_on_time = after.iter().all(|piece| (piece.frame, piece.after_ns) == (frame, 0));
        if is_on_time && after.iter().map(|piece| &piece.content).eq(&before) {
            return Ok(Vec::new());
        }
        let ids: Vec<String> = carrier.touching(acting).into_iter().map(str::to_owned).collect();
        let after: Vec<Value> = after
            .iter()
            .map(|piece| {
                let late_s = on_board_s(piece.frame - frame) + piece.after_ns as f64 * 1e-9;
                let mut told = json!({ "late_s": late_s, "bytes": piece.content.to_string() });
                if piece.goes_on {
                    told["goes_on"] = json!(true);
                }
                told
            })
            .collect();
        self.line(&json!({
            "what": "bytes", "t_s": on_board_s(frame + 1), "half_second": frame, "sequence": sequence,
            "link": carrier.kind.name(), "ids": ids, "before": texts(&before), "after": after,
        }))?;
        Ok(ids)
    }

    /// Something became of a fault; `frame` is the half second that begins.
    pub fn happened(&mut self, frame: u64, happening: &Happening) -> Result<(), RecordError> {
        let mut line = told(frame, happening);
        if let Happening::Ended(fault, _) = happening {
            line["touched"] = json!(self.touched.remove(&fault.id).unwrap_or(0));
        }
        self.line(&line)
    }

    /// A half second was not sent live.
    pub fn missed(&mut self, frame: u64) -> Result<(), RecordError> {
        self.line(&json!({ "what": "missed", "t_s": on_board_s(frame + 1), "half_second": frame }))
    }

    /// A fault came live.
    pub fn injected(&mut self, frame: u64, fault: &Fault) -> Result<(), RecordError> {
        self.line(&json!({ "what": "injected", "t_s": on_board_s(frame), "half_second": frame, "id": fault.id, "keys": keys(fault) }))
    }

    /// A fault was taken away.
    pub fn cleared(&mut self, id: &str, until_s: f64) -> Result<(), RecordError> {
        self.line(&json!({ "what": "cleared", "t_s": until_s, "id": id }))
    }

    /// Hands what is buffered to the system.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.file.write(|file| file.flush())
    }
}
