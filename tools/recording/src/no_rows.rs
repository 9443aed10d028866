use geu_protocol::CanIdMap;
use geu_protocol::capture::Format;

use crate::{DecodeSummary, DefectKind};

/// Identifiers listed at most.
const MAX_IDS: usize = 8;

/// Reason why inputs gave no sample, and advice; `None` if they gave samples.
pub fn no_rows_reason(summary: &DecodeSummary, plan: CanIdMap, format: Option<&Format>) -> Option<String> {
    let account = &summary.account;
    if summary.rows == 0 && account.records + account.bytes == 0 {
        return Some("no sample: nothing was received".to_owned());
    }
    if let Some(device) = summary.device.as_ref().filter(|_| summary.rows == 0) {
        let (other, bytes, defects) = (account.other, account.resynchronised_bytes, account.defect_count());
        return Some(format!(
            "no sample: expected frames or rows of {device}, see `geu device show`; got {other} other frames, {bytes} other bytes and {defects} defects"
        ));
    }
    if summary.rows > 0 || account.elsewhere > 0 {
        return None;
    }
    let defects =
        match account.defects.iter().map(|(kind, count)| format!("{} {count}", kind.name())).collect::<Vec<_>>() {
            kinds if kinds.is_empty() => "no defect".to_owned(),
            kinds => format!("defects {}", kinds.join(", ")),
        };
    if account.records == 0 {
        let bytes = account.bytes;
        return Some(format!(
            "no sample: expected serial frames EB 90 01 16 …, got {bytes} bytes with {} of commands, {} of replies, {defects}; --device selects another unit",
            account.command_bytes, account.reply_bytes
        ));
    }
    let broken = [DefectKind::BrokenRecord, DefectKind::CutRecord].iter().filter_map(|kind| account.defects.get(kind));
    let unread = account.remarks + broken.sum::<u64>();
    if account.records == unread {
        let records = account.records;
        return Some(match format {
            Some(format) => {
                let name = format.name;
                format!("--input-format {name} found no record, {defects}; without it the content selects the format")
            }
            None => format!("no sample: expected CAN frames, got {records} records without any, {defects}"),
        });
    }
    let (base, ids) = (plan.base(), summary.others.ids());
    let expected = format!("expected identifiers {base:03X}, {:03X}, {:03X} (base {base:X})", base + 1, base + 2);
    let likely = summary.others.likely().map(CanIdMap::base).filter(|likely| *likely != base);
    if likely.is_none() && ids.contains(&base) {
        return Some(format!(
            "no sample: {expected}, which are there, but no INCREMENTS with a STATUS that matches it: {defects}"
        ));
    }
    let mut got = ids.iter().take(MAX_IDS).map(|id| format!("{id:03X}")).collect::<Vec<_>>().join(", ");
    match ids.len() {
        0 => got = "none of eleven bits".to_owned(),
        count if count > MAX_IDS => got += &format!(" and {} more", count - MAX_IDS),
        _ => {}
    }
    let todo = match likely {
        Some(likely) => format!("{likely:03X} to {:03X} are as the unit sends them: --base {likely:X}", likely + 2),
        None => "--base is another, if the unit has another".to_owned(),
    };
    Some(format!("no sample: {expected}, got {got}; {todo}"))
}
