//! `faults.jsonl`: the injected faults, their times, and the bytes of each link that they changed.
//!
//! | `what` | |
//! |---|---|
//! | `injected` | an operator injected a fault, with its keys |
//! | `start`, `end` | a fault began to act, with its trigger; a fault ended, with the number of samples it touched |
//! | `bytes` | a sample that differs on a link from the fault-free one: before, after, identifiers of the faults |
//! | `reply` | a reply that faults delayed or suppressed |
//! | `missed` | a sample that was not sent live, whatever `bytes` claims: the process was stalled |
//! | `started-by-hand` | the operator started a fault, with the time from which it acts |
//! | `cleared` | a fault was removed |
//! | `expectation` | an expectation was decided |

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_model::fault::engine::{ActiveFault, FaultEvent};
use geu_model::{CompletedSample, InjectionRecord};
use geu_protocol::Reply;
use geu_protocol::command::hex;
use serde_json::{Value, json};

use crate::event::{PolledSample, UnitEvent};
use crate::fault_json;
use crate::link_model::{ActiveLinkFault, LinkModel, Transmission, WireData};
use crate::output::{Output, RecordError};

pub(crate) struct FaultLog {
    pub file: Output,
    device: Arc<Device>,
    /// The links to compare.
    models: Vec<LinkModel>,
    /// Number of samples that each fault touched since its start.
    touched: BTreeMap<String, u64>,
}

/// A sample on one link.
struct SentSample<'a> {
    model: &'a LinkModel,
    frame: u64,
    sequence: u16,
    is_polled: bool,
    /// The sample without faults; `None` if none would be sent.
    clean: Option<&'a CompletedSample>,
    after: Vec<Transmission>,
    /// Identifiers of the faults that act on it.
    ids: Vec<&'a str>,
}

/// Converts ns to s.
fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
}

impl FaultLog {
    /// Creates the file for the links that are open, and the recorded one.
    pub fn create(
        directory: &Path,
        device: &Arc<Device>,
        recorded: &LinkModel,
        links: &[LinkModel],
    ) -> Result<FaultLog, RecordError> {
        let mut models = links.to_vec();
        if !models.iter().any(|model| model.kind == recorded.kind) {
            models.push(recorded.clone());
        }
        let file = Output::create(directory, "faults.jsonl")?;
        Ok(FaultLog { file, device: device.clone(), models, touched: BTreeMap::new() })
    }

    /// Writes the lines of an event in sample interval `frame`.
    pub fn event(&mut self, frame: u64, event: &UnitEvent) -> Result<(), RecordError> {
        let line = match event {
            UnitEvent::Sample(ended, _, Some(injected)) => return self.sample(frame, ended, injected),
            UnitEvent::Sample(_, _, None) => None,
            UnitEvent::Polled(polled) => return self.polled(frame.saturating_sub(1), polled),
            UnitEvent::Command { link, payload, reply, acting, .. } => self.reply(frame, link, payload, *reply, acting),
            UnitEvent::Missed { frame } => {
                Some(json!({ "what": "missed", "t_s": self.device.on_board_s(frame + 1), "half_second": frame }))
            }
            UnitEvent::Happened(event) => {
                let mut line = fault_json::event(&self.device, frame, event);
                if let FaultEvent::Ended(fault, _) = event {
                    line["touched"] = json!(self.touched.remove(&fault.id).unwrap_or(0));
                }
                Some(line)
            }
            UnitEvent::Injected(fault) => Some(json!({
                "what": "injected", "t_s": self.device.on_board_s(frame), "half_second": frame, "id": fault.id,
                "keys": fault_json::keys(&self.device, fault),
            })),
            UnitEvent::StartedByHand { id, at_s } => {
                Some(json!({ "what": "started-by-hand", "t_s": at_s, "half_second": frame, "id": id }))
            }
            UnitEvent::Cleared { id, until_s } => Some(json!({ "what": "cleared", "t_s": until_s, "id": id })),
        };
        line.map_or(Ok(()), |line| self.line(&line))
    }

    fn line(&mut self, line: &Value) -> Result<(), RecordError> {
        self.file.write(|file| writeln!(file, "{line}"))
    }

    /// A sample that ended while faults acted.
    fn sample(&mut self, frame: u64, ended: &CompletedSample, injected: &InjectionRecord) -> Result<(), RecordError> {
        let sample = Some(ended).filter(|_| ended.cyclic);
        let mut touched = BTreeSet::new();
        for model in self.models.clone() {
            let ids = model.touching(&injected.acting);
            let is_different = self.compare(SentSample {
                model: &model,
                frame,
                sequence: ended.sample.sequence,
                is_polled: false,
                clean: Some(&injected.clean).filter(|clean| clean.cyclic),
                after: model.carry(sample, frame, &injected.acting),
                ids: ids.clone(),
            })?;
            touched.extend(ids.into_iter().filter(|_| is_different));
        }
        self.touch(touched);
        Ok(())
    }

    /// Sample `frame`, polled over a link: some faults acted on it, others act on its transmission.
    fn polled(&mut self, frame: u64, polled: &PolledSample) -> Result<(), RecordError> {
        let PolledSample { link, sample, reply, injected, acting, .. } = polled;
        let injected = injected.as_deref();
        let Some(model) = self.model(link) else { return Ok(()) };
        let mut after = model.polled(sample, reply, acting);
        after.iter_mut().for_each(|transmission| transmission.frame = frame);
        let on_sample = injected.map_or(&[][..], |injected| &injected.acting).iter();
        let on_sample = on_sample.filter(|acting| acting.on_link().is_none()).map(|acting| acting.fault.id.as_str());
        let on_link = model.faults(acting).into_iter().map(|it| it.acting.fault.id.as_str());
        let ids: Vec<&str> = on_sample.chain(on_link).collect();
        let is_different = self.compare(SentSample {
            model: &model,
            frame,
            sequence: sample.sample.sequence,
            is_polled: true,
            clean: Some(injected.map_or(sample, |injected| &injected.clean)),
            after,
            ids: ids.clone(),
        })?;
        if is_different {
            self.touch(ids.into_iter().collect());
        }
        Ok(())
    }

    /// The link of a command, by the transport at the start of its name; `None` for the control interface.
    fn model(&self, link: &str) -> Option<LinkModel> {
        let kind = Transport::from_name(link.split(' ').next()?)?;
        self.models.iter().find(|model| model.kind == kind).cloned()
    }

    /// Counts a sample for each of these faults.
    fn touch(&mut self, ids: BTreeSet<&str>) {
        ids.into_iter().for_each(|id| *self.touched.entry(id.to_owned()).or_default() += 1);
    }

    /// Writes a line and returns true if the sample differs from the fault-free one.
    fn compare(&mut self, sent: SentSample) -> Result<bool, RecordError> {
        let SentSample { model, frame, sequence, is_polled, clean, after, ids } = sent;
        let before: Vec<WireData> = clean.into_iter().flat_map(|clean| model.encoding.sample(clean)).collect();
        let is_on_time = after.iter().all(|transmission| (transmission.frame, transmission.after_ns) == (frame, 0));
        if is_on_time && after.iter().map(|transmission| &transmission.content).eq(&before) {
            return Ok(false);
        }
        let transmission = |transmission: &Transmission| {
            let late_s = self.device.on_board_s(transmission.frame - frame) + seconds(transmission.after_ns);
            let mut line = json!({ "late_s": late_s, "bytes": transmission.content.to_string() });
            if transmission.more_fragments {
                line["goes_on"] = json!(true);
            }
            line
        };
        let mut line = json!({
            "what": "bytes", "t_s": self.device.on_board_s(frame + 1), "half_second": frame, "sequence": sequence,
            "link": model.kind.name(), "ids": ids,
            "before": before.iter().map(WireData::to_string).collect::<Vec<_>>(),
            "after": after.iter().map(transmission).collect::<Vec<Value>>(),
        });
        if is_polled {
            line["polled"] = json!(true);
        }
        self.line(&line)?;
        Ok(true)
    }

    /// The line of a reply that faults delay or suppress, also by suppressing its command.
    fn reply(
        &self,
        frame: u64,
        link: &str,
        command: &[u8],
        reply: Result<Reply, Reply>,
        acting: &[ActiveFault],
    ) -> Option<Value> {
        let model = self.model(link)?;
        let after = reply.ok().and_then(|reply| model.reply(&reply, acting));
        if after.as_ref().is_some_and(|transmission| transmission.after_ns == 0) {
            return None;
        }
        let before = model.encoding.reply(&reply.unwrap_or_else(|silenced| silenced));
        let on_link = model.faults(acting).into_iter().filter(ActiveLinkFault::changes_replies);
        let on_unit = acting.iter().filter(|acting| acting.silences_unit());
        let ids: Vec<&str> = on_unit.chain(on_link.map(|it| it.acting)).map(|it| it.fault.id.as_str()).collect();
        Some(json!({
            "what": "reply", "t_s": self.device.on_board_s(frame), "half_second": frame, "link": model.kind.name(), "ids": ids,
            "command": hex(command), "before": before.to_string(),
            "after": after.as_ref().map(|transmission| transmission.content.to_string()),
            "late_s": after.as_ref().map(|transmission| seconds(transmission.after_ns)),
        }))
    }
}
