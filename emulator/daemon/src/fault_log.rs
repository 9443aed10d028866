//! `faults.jsonl`: what was injected, when, and into which bytes of which link.
//!
//! | `what` | |
//! |---|---|
//! | `injected` | a fault came live, with its keys |
//! | `start`, `end` | a fault began to act, and why; it is over, with the half seconds it touched |
//! | `bytes` | a half second that a link carried otherwise than without the faults that acted: before, after, identifiers |
//! | `reply` | a reply that faults of a link made late or kept back |
//! | `missed` | a half second that was not sent live, whatever `bytes` claims: the process was held up |
//! | `started-by-hand` | a fault that waited for a hand was started, and from when on it acts |
//! | `cleared` | a fault was taken away |
//! | `expectation` | one was decided |

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

use geu_model::configuration::fault::fault_text;
use geu_model::fault::Fault;
use geu_model::fault::acting::{Acting, Happening};
use geu_model::fault::catalogue::{LinkKind, LinkLaw};
use geu_model::fault::expectation::Verdict;
use geu_model::units::on_board_s;
use geu_model::{Ended, Injected};
use geu_protocol::command::hex;
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

/// A half second on one link, as a line tells it.
struct Sent<'a> {
    carrier: &'a Carrier,
    /// Its index, and its sequence as told.
    frame: u64,
    sequence: u16,
    is_polled: bool,
}

/// A time in ns as s.
fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
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
        let mut touched = BTreeSet::new();
        for carrier in self.carriers.clone() {
            let after = carrier.carry(told, frame, &injected.acting);
            let ids = carrier.touching(&injected.acting);
            let sent = Sent { carrier: &carrier, frame, sequence: ended.half_second.sequence, is_polled: false };
            if self.compare(&sent, clean, &after, &ids)? {
                touched.extend(ids);
            }
        }
        self.touch(touched);
        Ok(())
    }

    /// Half second `frame`, which was polled over a link: faults acted on it, and others act on its way.
    pub fn polled(
        &mut self,
        frame: u64,
        link: &str,
        half_second: &HalfSecond,
        reply: &Reply,
        injected: Option<&Injected>,
        acting: &[Acting],
    ) -> Result<(), RecordError> {
        let Some(carrier) = self.carrier(link) else { return Ok(()) };
        let clean = injected.map_or(half_second, |injected| &injected.clean);
        let mut after = carrier.polled(half_second, reply, acting);
        after.iter_mut().for_each(|piece| piece.frame = frame);
        // Those of links act on its way alone.
        let on_data = injected.map_or(&[][..], |injected| &injected.acting).iter();
        let on_data = on_data.filter(|acting| acting.on_link().is_none()).map(|acting| acting.fault.id.as_str());
        let on_way = carrier.own(acting).into_iter().map(|(acting, _)| acting.fault.id.as_str());
        let ids: Vec<&str> = on_data.chain(on_way).collect();
        let sent = Sent { carrier: &carrier, frame, sequence: half_second.sequence, is_polled: true };
        if self.compare(&sent, Some(clean), &after, &ids)? {
            self.touch(ids.into_iter().collect());
        }
        Ok(())
    }

    /// The link of a command, by the kind with which its name begins; nothing for the control interface.
    fn carrier(&self, link: &str) -> Option<Carrier> {
        let kind = LinkKind::named(link.split(' ').next()?)?;
        self.carriers.iter().find(|carrier| carrier.kind == kind).cloned()
    }

    /// Counts a half second for each of these faults.
    fn touch(&mut self, ids: BTreeSet<&str>) {
        ids.into_iter().for_each(|id| *self.touched.entry(id.to_owned()).or_default() += 1);
    }

    /// Writes a line where what goes out is not what would; whether it is not.
    fn compare(
        &mut self,
        sent: &Sent,
        clean: Option<&HalfSecond>,
        after: &[Piece],
        ids: &[&str],
    ) -> Result<bool, RecordError> {
        let Sent { carrier, frame, sequence, is_polled } = *sent;
        let before: Vec<Content> = clean.into_iter().flat_map(|clean| carrier.plain(clean)).collect();
        let is_on_time = after.iter().all(|piece| (piece.frame, piece.after_ns) == (frame, 0));
        if is_on_time && after.iter().map(|piece| &piece.content).eq(&before) {
            return Ok(false);
        }
        let piece = |piece: &Piece| {
            let late_s = on_board_s(piece.frame - frame) + seconds(piece.after_ns);
            let mut told = json!({ "late_s": late_s, "bytes": piece.content.to_string() });
            if piece.goes_on {
                told["goes_on"] = json!(true);
            }
            told
        };
        let mut line = json!({
            "what": "bytes", "t_s": on_board_s(frame + 1), "half_second": frame, "sequence": sequence,
            "link": carrier.kind.name(), "ids": ids, "before": texts(&before),
            "after": after.iter().map(piece).collect::<Vec<Value>>(),
        });
        if is_polled {
            line["polled"] = json!(true);
        }
        self.line(&line)?;
        Ok(true)
    }

    /// The reply to a command within half second `frame`: a line where faults make it late or keep it back, or keep the unit
    /// from hearing the command.
    pub fn reply(
        &mut self,
        frame: u64,
        link: &str,
        command: &[u8],
        reply: Result<Reply, Reply>,
        acting: &[Acting],
    ) -> Result<(), RecordError> {
        let Some(carrier) = self.carrier(link) else { return Ok(()) };
        let after = reply.ok().and_then(|reply| carrier.reply(&reply, acting));
        let before = carrier.plain_reply(&reply.unwrap_or_else(|unheard| unheard));
        if after.as_ref().is_some_and(|piece| piece.after_ns == 0) {
            return Ok(());
        }
        let of_replies =
            |law: &LinkLaw| matches!(law, LinkLaw::Silence | LinkLaw::ReplyMissing | LinkLaw::ReplyLate { .. });
        let own = carrier.own(acting).into_iter().filter(|(_, law)| of_replies(law));
        let silent = acting.iter().filter(|acting| acting.silences_unit());
        let ids: Vec<&str> = silent.chain(own.map(|(acting, _)| acting)).map(|it| it.fault.id.as_str()).collect();
        self.line(&json!({
            "what": "reply", "t_s": on_board_s(frame), "half_second": frame, "link": carrier.kind.name(), "ids": ids,
            "command": hex(command), "before": before.to_string(),
            "after": after.as_ref().map(|piece| piece.content.to_string()),
            "late_s": after.as_ref().map(|piece| seconds(piece.after_ns)),
        }))
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

    /// A fault that waited for a hand was started.
    pub fn started_by_hand(&mut self, frame: u64, id: &str, at_s: f64) -> Result<(), RecordError> {
        self.line(&json!({ "what": "started-by-hand", "t_s": at_s, "half_second": frame, "id": id }))
    }

    /// A fault was taken away.
    pub fn cleared(&mut self, id: &str, until_s: f64) -> Result<(), RecordError> {
        self.line(&json!({ "what": "cleared", "t_s": until_s, "id": id }))
    }

    /// Hands what is buffered to the system.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.file.flush()
    }

    /// Bytes that the system does not have yet.
    pub fn buffered(&self) -> usize {
        self.file.buffered()
    }
}
