//! `faults.jsonl`: what was injected, when, and into which bytes of which link.
//!
//! | `what` | |
//! |---|---|
//! | `injected` | a fault came live, with its keys |
//! | `start`, `end` | a fault began to act, and why; it is over, with the samples it touched |
//! | `bytes` | a sample that a link carried otherwise than without the faults that acted: before, after, identifiers |
//! | `reply` | a reply that faults of a link made late or kept back |
//! | `missed` | a sample that was not sent live, whatever `bytes` claims: the process was held up |
//! | `started-by-hand` | a fault that waited for a hand was started, and from when on it acts |
//! | `cleared` | a fault was taken away |
//! | `expectation` | one was decided |

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

use geu_model::fault::Fault;
use geu_model::fault::acting::{ActiveFault, FaultEvent};
use geu_model::fault::catalogue::Transport;
use geu_model::units::on_board_s;
use geu_model::{CompletedSample, InjectionRecord};
use geu_protocol::command::hex;
use geu_protocol::{Reply, Sample};
use serde_json::{Value, json};

use super::event::PolledSample;
use super::output::{Output, RecordError};
use crate::fault_json;
use crate::link_model::{ActiveLinkFault, LinkModel, Transmission, WireData};

/// Writes it.
pub(crate) struct FaultLog {
    file: Output,
    /// The links whose bytes are told.
    models: Vec<LinkModel>,
    /// Samples that each fault touched since it started.
    touched: BTreeMap<String, u64>,
}

/// A sample on one link, as a line tells it.
struct Sent<'a> {
    model: &'a LinkModel,
    /// Its index, and its sequence as told.
    frame: u64,
    sequence: u16,
    is_polled: bool,
}

/// A time in ns as s.
fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
}

fn texts(contents: &[WireData]) -> Vec<String> {
    contents.iter().map(WireData::to_string).collect()
}

impl FaultLog {
    /// Opens it: the recorded link is told, and those that are open beside it.
    pub fn create(directory: &Path, recorded: &LinkModel, links: &[LinkModel]) -> Result<FaultLog, RecordError> {
        let mut models = links.to_vec();
        if !models.iter().any(|model| model.kind == recorded.kind) {
            models.push(recorded.clone());
        }
        Ok(FaultLog { file: Output::create(directory, "faults.jsonl")?, models, touched: BTreeMap::new() })
    }

    fn line(&mut self, line: &Value) -> Result<(), RecordError> {
        self.file.write(|file| writeln!(file, "{line}"))
    }

    /// A sample that ended while faults acted.
    pub fn sample(
        &mut self,
        frame: u64,
        ended: &CompletedSample,
        injected: &InjectionRecord,
    ) -> Result<(), RecordError> {
        let told = Some(&ended.sample).filter(|_| ended.cyclic);
        let clean = Some(&injected.clean).filter(|_| injected.is_clean_cyclic);
        let mut touched = BTreeSet::new();
        for model in self.models.clone() {
            let after = model.carry(told, frame, &injected.acting);
            let ids = model.touching(&injected.acting);
            let sent = Sent { model: &model, frame, sequence: ended.sample.sequence, is_polled: false };
            if self.compare(&sent, clean, &after, &ids)? {
                touched.extend(ids);
            }
        }
        self.touch(touched);
        Ok(())
    }

    /// Sample `frame`, which was polled over a link: faults acted on it, and others act on its way.
    pub fn polled(&mut self, frame: u64, polled: &PolledSample) -> Result<(), RecordError> {
        let PolledSample { link, sample, reply, injected, acting, .. } = polled;
        let injected = injected.as_deref();
        let Some(model) = self.model(link) else { return Ok(()) };
        let clean = injected.map_or(sample, |injected| &injected.clean);
        let mut after = model.polled(sample, reply, acting);
        after.iter_mut().for_each(|transmission| transmission.frame = frame);
        // Those of links act on its way alone.
        let on_data = injected.map_or(&[][..], |injected| &injected.acting).iter();
        let on_data = on_data.filter(|acting| acting.on_link().is_none()).map(|acting| acting.fault.id.as_str());
        let on_way = model.faults(acting).into_iter().map(|it| it.acting.fault.id.as_str());
        let ids: Vec<&str> = on_data.chain(on_way).collect();
        let sent = Sent { model: &model, frame, sequence: sample.sequence, is_polled: true };
        if self.compare(&sent, Some(clean), &after, &ids)? {
            self.touch(ids.into_iter().collect());
        }
        Ok(())
    }

    /// The link of a command, by the kind with which its name begins; nothing for the control interface.
    fn model(&self, link: &str) -> Option<LinkModel> {
        let kind = Transport::named(link.split(' ').next()?)?;
        self.models.iter().find(|model| model.kind == kind).cloned()
    }

    /// Counts a sample for each of these faults.
    fn touch(&mut self, ids: BTreeSet<&str>) {
        ids.into_iter().for_each(|id| *self.touched.entry(id.to_owned()).or_default() += 1);
    }

    /// Writes a line where what goes out is not what would; whether it is not.
    fn compare(
        &mut self,
        sent: &Sent,
        clean: Option<&Sample>,
        after: &[Transmission],
        ids: &[&str],
    ) -> Result<bool, RecordError> {
        let Sent { model, frame, sequence, is_polled } = *sent;
        let before: Vec<WireData> = clean.into_iter().flat_map(|clean| model.plain(clean)).collect();
        let is_on_time = after.iter().all(|transmission| (transmission.frame, transmission.after_ns) == (frame, 0));
        if is_on_time && after.iter().map(|transmission| &transmission.content).eq(&before) {
            return Ok(false);
        }
        let transmission = |transmission: &Transmission| {
            let late_s = on_board_s(transmission.frame - frame) + seconds(transmission.after_ns);
            let mut told = json!({ "late_s": late_s, "bytes": transmission.content.to_string() });
            if transmission.more_fragments {
                told["goes_on"] = json!(true);
            }
            told
        };
        let mut line = json!({
            "what": "bytes", "t_s": on_board_s(frame + 1), "half_second": frame, "sequence": sequence,
            "link": model.kind.name(), "ids": ids, "before": texts(&before),
            "after": after.iter().map(transmission).collect::<Vec<Value>>(),
        });
        if is_polled {
            line["polled"] = json!(true);
        }
        self.line(&line)?;
        Ok(true)
    }

    /// The reply to a command within sample interval `frame`: a line where faults make it late or keep it back, or keep the unit
    /// from hearing the command.
    pub fn reply(
        &mut self,
        frame: u64,
        link: &str,
        command: &[u8],
        reply: Result<Reply, Reply>,
        acting: &[ActiveFault],
    ) -> Result<(), RecordError> {
        let Some(model) = self.model(link) else { return Ok(()) };
        let after = reply.ok().and_then(|reply| model.reply(&reply, acting));
        let before = model.plain_reply(&reply.unwrap_or_else(|unheard| unheard));
        if after.as_ref().is_some_and(|transmission| transmission.after_ns == 0) {
            return Ok(());
        }
        let own = model.faults(acting).into_iter().filter(ActiveLinkFault::changes_replies);
        let silent = acting.iter().filter(|acting| acting.silences_unit());
        let ids: Vec<&str> = silent.chain(own.map(|it| it.acting)).map(|it| it.fault.id.as_str()).collect();
        self.line(&json!({
            "what": "reply", "t_s": on_board_s(frame), "half_second": frame, "link": model.kind.name(), "ids": ids,
            "command": hex(command), "before": before.to_string(),
            "after": after.as_ref().map(|transmission| transmission.content.to_string()),
            "late_s": after.as_ref().map(|transmission| seconds(transmission.after_ns)),
        }))
    }

    /// Something became of a fault; `frame` is the sample that begins.
    pub fn happened(&mut self, frame: u64, happening: &FaultEvent) -> Result<(), RecordError> {
        let mut line = fault_json::happening(frame, happening);
        if let FaultEvent::Ended(fault, _) = happening {
            line["touched"] = json!(self.touched.remove(&fault.id).unwrap_or(0));
        }
        self.line(&line)
    }

    /// A sample was not sent live.
    pub fn missed(&mut self, frame: u64) -> Result<(), RecordError> {
        self.line(&json!({ "what": "missed", "t_s": on_board_s(frame + 1), "half_second": frame }))
    }

    /// A fault came live.
    pub fn injected(&mut self, frame: u64, fault: &Fault) -> Result<(), RecordError> {
        self.line(&json!({ "what": "injected", "t_s": on_board_s(frame), "half_second": frame, "id": fault.id, "keys": fault_json::keys(fault) }))
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
