//! What the faults of links do to a half second, in four steps: to what it says, to its bytes, to how often and when they
//! are sent, to what else is on the link. Within a step, in the order of the plan.

use geu_model::fault::acting::Acting;
use geu_model::fault::catalogue::LinkLaw;
use geu_model::noise::Stream;
use geu_model::units::HALF_SECOND_NS;
use geu_protocol::can::{STATUS_COVERED, close_status};
use geu_protocol::serial::{self, CRC, HEADER, LENGTH_AT, OVERHEAD, TYPE_AT};
use geu_protocol::{CanFrame, HalfSecond};

use super::{Encoding, LinkModel, Transmission, WireData, baud, ns};

/// Nonsense between half seconds comes in so many portions.
const PORTIONS: u64 = 16;
/// Pieces of a half second: about as many as the fastest bus has room for, frames without data at 1 Mbit/s. What many
/// faults together would send beyond is not sent.
const MOST_PIECES: usize = 10_000;

fn draw(acting: &Acting) -> Stream {
    acting.draw().at("link", acting.frame)
}

/// The half second itself, with what belongs to it; nothing where none is sent.
pub(super) fn half_second(
    model: &LinkModel,
    half_second: Option<&HalfSecond>,
    frame: u64,
    own: &[(&Acting, LinkLaw)],
) -> Vec<Transmission> {
    let said = half_second.and_then(|it| own.iter().try_fold(*it, |said, (acting, law)| say(said, acting, *law)));
    let Some(said) = said else { return Vec::new() };
    let mut contents = model.plain(&said);
    // Each would name the messages anew: the last one counts.
    let names = |law: &LinkLaw| matches!(law, LinkLaw::WrongIdentifier { .. });
    let name = own.iter().rposition(|(_, law)| names(law));
    let changing = own.iter().enumerate().filter(|(index, (_, law))| !names(law) || Some(*index) == name);
    changing.for_each(|(_, (acting, law))| change(model, &mut contents, acting, *law));
    let mut transmissions: Vec<Transmission> =
        contents.into_iter().map(|content| Transmission::on_time(frame, content)).collect();
    let mut times = 1;
    own.iter().for_each(|(acting, law)| send(model, &mut transmissions, &mut times, acting, *law));
    own.iter().for_each(|(acting, law)| lead(&mut transmissions, acting, *law));
    transmissions
}

/// What the half second says; nothing where it repeats one that there never was.
fn say(mut said: HalfSecond, acting: &Acting, law: LinkLaw) -> Option<HalfSecond> {
    match law {
        LinkLaw::SequenceStuck => said.sequence = acting.before.map_or(0, |before| before.sequence),
        LinkLaw::SequenceJump { by } => said.sequence = said.sequence.wrapping_add(by as u16),
        LinkLaw::StaleRepeat => return acting.before,
        _ => {}
    }
    Some(said)
}

/// Its bytes.
fn change(model: &LinkModel, contents: &mut Vec<WireData>, acting: &Acting, law: LinkLaw) {
    match (law, model.encoding) {
        (LinkLaw::BitFlip { bits, is_after_crc }, _) => flip(contents, bits, is_after_crc, &mut draw(acting)),
        (LinkLaw::Truncate { bytes }, _) => contents.retain_mut(|content| {
            let kept = bytes_of(content).len().saturating_sub(bytes as usize);
            cut(content, kept);
            kept > 0
        }),
        (LinkLaw::WrongLength { length }, Encoding::Serial { .. }) => {
            each_frame(contents, |bytes| bytes[LENGTH_AT] = length as u8);
        }
        (LinkLaw::WrongLength { length }, Encoding::Can(_)) => {
            contents.iter_mut().for_each(|content| cut(content, (length as usize).min(8)));
        }
        (LinkLaw::WrongIdentifier { identifier }, Encoding::Serial { .. }) => {
            each_frame(contents, |bytes| bytes[TYPE_AT] = identifier as u8);
        }
        (LinkLaw::WrongIdentifier { identifier }, Encoding::Can(plan)) => {
            for content in contents {
                if let WireData::Frame(frame) = content {
                    let id = (identifier as u16).saturating_add(frame.id().saturating_sub(plan.base()));
                    *frame = CanFrame::new(id, frame.data()).unwrap_or(*frame);
                }
            }
        }
        (LinkLaw::BaudMismatch { baud }, Encoding::Serial { baud: own }) => {
            for content in contents {
                if let WireData::Bytes(bytes) = content {
                    *bytes = baud::read_at(bytes, baud, f64::from(own));
                }
            }
        }
        _ => {}
    }
}

fn bytes_of(content: &WireData) -> &[u8] {
    match content {
        WireData::Bytes(bytes) => bytes,
        WireData::Frame(frame) => frame.data(),
    }
}

/// Makes it so long, with zeros behind where it was shorter.
fn cut(content: &mut WireData, length: usize) {
    match content {
        WireData::Bytes(bytes) => bytes.truncate(length),
        WireData::Frame(frame) => {
            let mut data = frame.data().to_vec();
            data.resize(length, 0);
            *frame = frame.with_data(&data).unwrap_or(*frame);
        }
    }
}

/// Changes the header of whole frames; their CRC is right again.
fn each_frame(contents: &mut [WireData], change: impl Fn(&mut [u8])) {
    for content in contents {
        if let WireData::Bytes(bytes) = content
            && bytes.len() >= OVERHEAD
        {
            change(bytes);
            serial::close(bytes);
        }
    }
}

/// Flips bits anywhere in the data; before the CRC it is right again, after it the CRC may be hit too.
fn flip(contents: &mut [WireData], bits: u64, is_after_crc: bool, draw: &mut Stream) {
    let is_serial = matches!(contents.first(), Some(WireData::Bytes(_)));
    // Places that may be hit: message and byte.
    let mut places = Vec::new();
    for (index, content) in contents.iter().enumerate() {
        let length = bytes_of(content).len();
        let covered = match (is_serial, index) {
            (true, _) => HEADER..length.saturating_sub(if is_after_crc { 0 } else { CRC }),
            (false, 1) if !is_after_crc => 0..STATUS_COVERED.min(length),
            (false, _) => 0..length,
        };
        places.extend(covered.flat_map(|byte| (0..8).map(move |bit| (index, byte, bit))));
    }
    for _ in 0..bits.min(places.len() as u64) {
        let (index, byte, bit) = places.swap_remove((draw.uniform() * places.len() as f64) as usize);
        let mut data = bytes_of(&contents[index]).to_vec();
        data[byte] ^= 1 << bit;
        match &mut contents[index] {
            WireData::Bytes(bytes) => *bytes = data,
            WireData::Frame(frame) => *frame = frame.with_data(&data).unwrap_or(*frame),
        }
    }
    if is_after_crc {
        return;
    }
    match contents {
        [WireData::Bytes(bytes)] => serial::close(bytes),
        [WireData::Frame(increments), WireData::Frame(status), ..] => {
            if let Ok(mut data) = <[u8; 8]>::try_from(status.data()) {
                close_status(increments.data(), &mut data);
                *status = status.with_data(&data).unwrap_or(*status);
            }
        }
        _ => {}
    }
}

/// How often and when. `times` is how often the half second is in `transmissions`.
fn send(model: &LinkModel, transmissions: &mut Vec<Transmission>, times: &mut usize, acting: &Acting, law: LinkLaw) {
    let late = |transmissions: &mut Vec<Transmission>, by_ns: i64| {
        transmissions.iter_mut().for_each(|transmission| transmission.after_ns += by_ns)
    };
    match law {
        LinkLaw::Drop => transmissions.clear(),
        LinkLaw::Duplicate { copies } => {
            let once = transmissions[..transmissions.len() / *times].to_vec();
            let room = (MOST_PIECES / once.len().max(1)).saturating_sub(*times);
            let copies = room.min(copies as usize);
            (0..copies).for_each(|_| transmissions.extend(once.iter().cloned()));
            *times += copies;
        }
        LinkLaw::Delay { delay_s } => late(transmissions, ns(delay_s)),
        LinkLaw::Jitter { jitter_s } => late(transmissions, ns(jitter_s * draw(acting).uniform())),
        // Just behind the next.
        LinkLaw::Reorder if acting.elapsed.is_multiple_of(2) => {
            transmissions.iter_mut().for_each(|transmission| {
                (transmission.frame, transmission.after_ns) = (transmission.frame + 1, transmission.after_ns + 1)
            });
        }
        LinkLaw::Merge { frames } => {
            let held = frames - 1 - acting.elapsed % frames;
            transmissions.iter_mut().for_each(|transmission| transmission.frame += held);
        }
        LinkLaw::Split { byte, gap_s } => split(model, transmissions, byte as usize, ns(gap_s)),
        _ => {}
    }
}

fn split(model: &LinkModel, transmissions: &mut Vec<Transmission>, place: usize, gap_ns: i64) {
    if matches!(model.encoding, Encoding::Can(_)) {
        transmissions.iter_mut().skip(place).for_each(|transmission| transmission.after_ns += gap_ns);
        return;
    }
    // What is behind the gap, in a frame that has one already, comes that much later too.
    let mut behind_ns = 0;
    let parts = transmissions.drain(..).flat_map(|transmission| {
        let transmission = Transmission { after_ns: transmission.after_ns + behind_ns, ..transmission };
        let more_fragments = transmission.more_fragments;
        let parts = match &transmission.content {
            WireData::Bytes(bytes) if bytes.len() > place => {
                let (head, tail) = bytes.split_at(place);
                behind_ns += gap_ns;
                let part = |bytes: &[u8], after_ns, more_fragments| Transmission {
                    after_ns,
                    content: WireData::Bytes(bytes.to_vec()),
                    more_fragments,
                    ..transmission
                };
                vec![
                    part(head, transmission.after_ns, true),
                    part(tail, transmission.after_ns + gap_ns, more_fragments),
                ]
            }
            _ => vec![transmission],
        };
        if !more_fragments {
            behind_ns = 0;
        }
        parts
    });
    *transmissions = parts.collect();
}

/// What stands before the half second, in the same go; before none where none is sent.
fn lead(transmissions: &mut [Transmission], acting: &Acting, law: LinkLaw) {
    if let (LinkLaw::ExtraBytes { bytes }, Some(Transmission { content: WireData::Bytes(own), .. })) =
        (law, transmissions.first_mut())
    {
        let mut draw = draw(acting);
        let extra: Vec<u8> = (0..bytes).map(|_| draw.bits() as u8).collect();
        *own = [extra, std::mem::take(own)].concat();
    }
}

/// What else is on the link, whether a half second is sent or not.
pub(super) fn add_noise(
    model: &LinkModel,
    transmissions: &mut Vec<Transmission>,
    frame: u64,
    own: &[(&Acting, LinkLaw)],
) {
    for (acting, law) in own {
        if let LinkLaw::Babble { amount } = *law {
            babble(model, transmissions, frame, &mut draw(acting), amount);
        }
    }
}

fn babble(model: &LinkModel, transmissions: &mut Vec<Transmission>, frame: u64, draw: &mut Stream, amount: u64) {
    let mut nonsense = |count: u64| -> Vec<u8> { (0..count).map(|_| draw.bits() as u8).collect() };
    for portion in 0..amount.min(PORTIONS) {
        let count = (portion + 1) * amount / PORTIONS.min(amount) - portion * amount / PORTIONS.min(amount);
        let after_ns = (2 * portion as i64 + 1) * HALF_SECOND_NS / (2 * amount.min(PORTIONS) as i64);
        let contents = match model.encoding {
            Encoding::Serial { .. } => vec![WireData::Bytes(nonsense(count))],
            Encoding::Can(_) => (0..count)
                .filter_map(|_| {
                    let bytes = nonsense(11);
                    let id = u16::from_be_bytes([bytes[0], bytes[1]]) & 0x7FF;
                    CanFrame::new(id, &bytes[3..3 + usize::from(bytes[2] % 9)]).map(WireData::Frame)
                })
                .collect(),
        };
        let room = MOST_PIECES.saturating_sub(transmissions.len());
        let noise = contents.into_iter().take(room);
        transmissions.extend(noise.map(|content| Transmission { after_ns, ..Transmission::on_time(frame, content) }));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use geu_model::fault::catalogue::{CATALOGUE, LinkKind, Scope, Spec};
    use geu_model::number::{Default, Form as NumberForm};
    use geu_model::{Configuration, Unit};
    use geu_protocol::CanPlan;
    use geu_protocol::crc::crc16;
    use geu_protocol::serial::{Deframer, Found};

    use super::*;

    fn model(kind: LinkKind) -> LinkModel {
        match kind {
            LinkKind::Can => LinkModel::can(CanPlan::default()),
            kind => LinkModel::serial(kind),
        }
    }

    /// What a link carries in each of 20 half seconds with a fault of it in 8 to 15, and what it would carry.
    fn carried(kind: LinkKind, keys: &str) -> Vec<(Vec<WireData>, Vec<Transmission>)> {
        planned(kind, &format!("[[fault]]\nlink = \"{}\"\nat_s = 4.0\nfor_s = 4.0\n{keys}", kind.name()))
    }

    /// The same with any plan.
    fn planned(kind: LinkKind, plan: &str) -> Vec<(Vec<WireData>, Vec<Transmission>)> {
        let mut configuration = Configuration::reference();
        configuration.add_plan("plan", plan).unwrap_or_else(|error| panic!("{error}"));
        let (mut unit, model) = (Unit::new(&configuration), model(kind));
        let half_seconds = (0..20).map(|frame| {
            let ended = unit.end_half_second();
            let acting = unit.injected().map(|injected| injected.acting.clone()).unwrap_or_default();
            let sent = Some(&ended.half_second).filter(|_| ended.cyclic);
            (model.plain(&ended.half_second), model.carry(sent, frame, &acting))
        });
        half_seconds.collect()
    }

    fn keys(spec: &Spec) -> String {
        let value = |default: Default, form: NumberForm, least: f64| match (default, form) {
            (Default::Value(value), _) => value,
            (_, NumberForm::Whole) => least.max(3.0),
            _ => least.max(0.3),
        };
        let numbers = spec.numbers.iter().map(|n| (n, value(n.default, n.form, n.least)));
        numbers.fold(format!("fault = \"{}\"\n", spec.code), |text, (number, value)| {
            text + &format!("{} = {}\n", number.name, number.written(value))
        })
    }

    #[test]
    fn every_fault_changes_what_every_link_that_has_it_carries_while_it_acts_and_no_longer() {
        for spec in CATALOGUE.iter().filter(|spec| spec.scope == Scope::Link && !spec.code.starts_with("reply")) {
            for kind in spec.links() {
                let (all, again) = (carried(kind, &keys(spec)), carried(kind, &keys(spec)));
                assert_eq!(all, again, "{} on {}", spec.code, kind.name());
                let mut touched = 0;
                for (frame, (before, after)) in all.iter().enumerate() {
                    let on_time = after
                        .iter()
                        .all(|transmission| (transmission.frame, transmission.after_ns) == (frame as u64, 0));
                    let same = on_time && after.iter().map(|transmission| &transmission.content).eq(before);
                    assert!(same || (8..16).contains(&frame), "{} on {} at {frame}", spec.code, kind.name());
                    touched += usize::from(!same);
                }
                assert!(touched >= 4, "{} on {}: {touched}", spec.code, kind.name());
            }
        }
    }

    /// The kinds of what a deframer finds in the bytes of the half seconds in which the fault acts.
    fn found(keys: &str) -> BTreeMap<&'static str, usize> {
        let bytes: Vec<u8> = carried(LinkKind::Pty, keys)[8..16]
            .iter()
            .flat_map(|(_, after)| after.iter().flat_map(|transmission| bytes_of(&transmission.content).to_vec()))
            .collect();
        let mut counts = BTreeMap::new();
        let mut deframer = Deframer::default();
        deframer.consume(&bytes, &mut |found| {
            let name = match found {
                Found::Frame { kind: serial::Kind::Data, .. } => "data",
                Found::Frame { .. } => "other",
                Found::Rejected { .. } => "rejected",
                _ => "else",
            };
            *counts.entry(name).or_default() += 1;
        });
        counts
    }

    #[test]
    fn a_receiver_sees_good_frames_where_the_crc_is_right_and_none_where_it_is_not() {
        for (keys, good, is_rejected) in [
            ("fault = \"bit-flip\"\ncrc = \"before\"\nbits = 5", 8, false),
            ("fault = \"bit-flip\"\ncrc = \"after\"\nbits = 1", 0, true),
            ("fault = \"sequence-jump\"\nby = 100", 8, false),
            ("fault = \"duplicate\"\ncopies = 2", 24, false),
            ("fault = \"split\"", 8, false),
            ("fault = \"drop\"", 0, false),
            ("fault = \"wrong-length\"\nlength = 4", 0, true),
            ("fault = \"wrong-identifier\"\nidentifier = 2", 0, true),
        ] {
            let found = found(keys);
            assert_eq!(found.get("data").copied().unwrap_or(0), good, "{keys}: {found:?}");
            assert_eq!(found.get("rejected").is_some_and(|&count| count > 0), is_rejected, "{keys}: {found:?}");
        }
    }

    #[test]
    fn reordered_and_merged_half_seconds_leave_in_the_order_that_is_meant() {
        let released = |keys: &str| {
            let all = carried(LinkKind::Tcp, keys);
            let mut transmissions: Vec<(u64, i64, usize)> = all[8..16]
                .iter()
                .enumerate()
                .flat_map(|(index, (_, after))| {
                    after.iter().map(move |transmission| (transmission.frame, transmission.after_ns, index))
                })
                .collect();
            transmissions.sort_unstable();
            transmissions.into_iter().map(|(frame, _, index)| (frame, index)).collect::<Vec<_>>()
        };
        let swapped = [(9, 1), (9, 0), (11, 3), (11, 2), (13, 5), (13, 4), (15, 7), (15, 6)];
        assert_eq!(released("fault = \"reorder\""), swapped);
        let merged: Vec<(u64, usize)> = (0..8).map(|index| (if index < 4 { 11 } else { 15 }, index)).collect();
        assert_eq!(released("fault = \"merge\"\nframes = 4"), merged);
    }

    #[test]
    fn on_can_a_flip_before_the_crc_is_believed_and_one_after_it_is_not() {
        for (place, is_believed) in [("before", true), ("after", false)] {
            let all = carried(LinkKind::Can, &format!("fault = \"bit-flip\"\nbits = 40\ncrc = \"{place}\""));
            for (_, after) in &all[8..16] {
                let [WireData::Frame(increments), WireData::Frame(status), _] =
                    [0, 1, 2].map(|index| after[index].content.clone())
                else {
                    panic!("three frames")
                };
                let crc = crc16(&[increments.data(), &status.data()[..6]].concat()).to_be_bytes();
                assert_eq!(status.data()[6..] == crc, is_believed);
            }
        }
    }

    #[test]
    fn a_fault_on_every_link_is_on_none_that_cannot_have_it() {
        let on_links = CATALOGUE.iter().filter(|spec| spec.scope == Scope::Link && !spec.links().is_empty());
        let pairs = on_links.flat_map(|spec| spec.unable.iter().map(move |(kind, _)| (spec, *kind)));
        assert!(pairs.clone().count() >= 3);
        for (spec, kind) in pairs {
            for (before, after) in planned(kind, &format!("[[fault]]\n{}", keys(spec))) {
                let plain: Vec<WireData> = after.into_iter().map(|transmission| transmission.content).collect();
                assert_eq!(plain, before, "{} on {}", spec.code, kind.name());
            }
        }
        let mut configuration = Configuration::reference();
        configuration.add_plan("plan", "[[fault]]\nfault = \"baud-mismatch\"\nbaud = 9600.0").expect("a plan");
        let unit = Unit::new(&configuration);
        let touching = |kind| model(kind).touching(unit.faults().acting()).len();
        assert_eq!(LinkKind::ALL.map(touching), [1, 1, 0, 0]);
    }

    #[test]
    fn copies_add_up_and_many_faults_together_stay_within_bounds() {
        let sent = |kind, fault: &str, count| planned(kind, &fault.repeat(count))[3].1.len();
        let duplicate = "[[fault]]\nfault = \"duplicate\"\ncopies = 16\n";
        assert_eq!(sent(LinkKind::Tcp, duplicate, 5), 81);
        assert_eq!(sent(LinkKind::Can, duplicate, 5), 3 * 81);
        assert_eq!(sent(LinkKind::Can, duplicate, 1000), 3 * (MOST_PIECES / 3));
        assert_eq!(sent(LinkKind::Can, "[[fault]]\nfault = \"babble\"\namount = 1000\n", 20), MOST_PIECES);
    }

    #[test]
    fn of_several_identifiers_the_last_counts() {
        let fault = |identifier: u32| {
            format!("[[fault]]\nlink = \"can\"\nfault = \"wrong-identifier\"\nidentifier = {identifier}\n")
        };
        let all = planned(LinkKind::Can, &(fault(2045) + &fault(2045) + &fault(0x700)));
        let ids = all[3].1.iter().map(|transmission| match &transmission.content {
            WireData::Frame(frame) => frame.id(),
            WireData::Bytes(_) => panic!("a frame"),
        });
        assert_eq!(ids.collect::<Vec<_>>(), [0x700, 0x701, 0x702]);
    }

    #[test]
    fn what_stands_before_a_half_second_is_sent_with_one_alone() {
        let extra = "[[fault]]\nfault = \"extra-bytes\"\nbytes = 5\n";
        let drop = "[[fault]]\nfault = \"drop\"\n";
        assert_eq!(bytes_of(&planned(LinkKind::Pty, extra)[3].1[0].content).len(), 33);
        assert_eq!(planned(LinkKind::Pty, &(extra.to_owned() + drop))[3].1, []);
        assert_eq!(planned(LinkKind::Pty, &(extra.to_owned() + "[[fault]]\nfault = \"reset\"\nfor_s = 5"))[3].1, []);
    }

    #[test]
    fn nothing_is_repeated_before_there_was_a_half_second() {
        let all = planned(LinkKind::Pty, "[[fault]]\nfault = \"stale-repeat\"\nfor_s = 2.0");
        assert!(all[..4].iter().all(|(_, after)| after.is_empty()));
        assert_eq!(all[4].1.len(), 1);
    }

    #[test]
    fn noise_is_no_part_of_an_answer() {
        let mut configuration = Configuration::reference();
        configuration.add_plan("plan", "[[fault]]\nfault = \"babble\"").expect("a plan");
        let unit = Unit::new(&configuration);
        let (half_second, acting) = (HalfSecond::default(), unit.faults().acting());
        for kind in LinkKind::ALL {
            let model = model(kind);
            let reply = geu_protocol::Reply::new(3, geu_protocol::Outcome::Done, &[]);
            let polled = model.polled(&half_second, &reply, acting);
            let contents: Vec<WireData> = polled.into_iter().map(|transmission| transmission.content).collect();
            assert_eq!(contents, model.plain(&half_second));
            assert!(model.carry(None, 0, acting).len() >= 16, "it is on the link all the same");
        }
    }

    #[test]
    fn the_parts_of_a_frame_stay_together_in_order() {
        let split =
            |byte, gap_s| format!("[[fault]]\nlink = \"tcp\"\nfault = \"split\"\nbyte = {byte}\ngap_s = {gap_s:?}\n");
        let all = planned(LinkKind::Tcp, &(split(10, 0.125) + &split(4, 0.25) + "[[fault]]\nfault = \"duplicate\"\n"));
        let parts: Vec<_> =
            all[3].1.iter().map(|it| (bytes_of(&it.content).len(), it.after_ns, it.more_fragments)).collect();
        let once = [(4, 0, true), (6, 250_000_000, true), (4, 375_000_000, true), (14, 625_000_000, false)];
        assert_eq!(parts, [once, once].concat());
    }
}
