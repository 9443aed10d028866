//! Each fault of links on each transport that supports it.

use std::collections::BTreeMap;

use geu_model::fault::catalogue::{CATALOGUE, FaultSpec, Scope, Transport};
use geu_model::parameter_spec::{DefaultValue, ValueFormat as NumberForm};
use geu_model::{CompletedSample, Configuration, GyroUnit};
use geu_protocol::CanIdMap;
use geu_protocol::crc::crc16;
use geu_protocol::serial::{self, Deframer, DeframerEvent};

use super::super::{LinkModel, Transmission, WireData};
use super::MAX_TRANSMISSIONS;

fn model(kind: Transport) -> LinkModel {
    match kind {
        Transport::Can => LinkModel::can(CanIdMap::default()),
        kind => LinkModel::serial(kind),
    }
}

/// Fault-free and actual data of a link in each of 20 samples, with a fault in samples 8 to 15.
fn carried(kind: Transport, keys: &str) -> Vec<(Vec<WireData>, Vec<Transmission>)> {
    planned(kind, &format!("[[fault]]\nlink = \"{}\"\nat_s = 4.0\nfor_s = 4.0\n{keys}", kind.name()))
}

/// Fault-free and actual data with any plan.
fn planned(kind: Transport, plan: &str) -> Vec<(Vec<WireData>, Vec<Transmission>)> {
    let mut configuration = Configuration::reference();
    configuration.add_plan("plan", plan).unwrap_or_else(|error| panic!("{error}"));
    let (mut unit, model) = (GyroUnit::new(&configuration), model(kind));
    let samples = (0..20).map(|frame| {
        let ended = unit.end_sample();
        let acting = unit.injected().map(|injected| injected.acting.clone()).unwrap_or_default();
        let sent = Some(&ended).filter(|_| ended.cyclic);
        (model.encoding.sample(&ended), model.carry(sent, frame, &acting))
    });
    samples.collect()
}

fn keys(spec: &FaultSpec) -> String {
    let value = |default: DefaultValue, form: NumberForm, min: f64| match (default, form) {
        (DefaultValue::Value(value), _) => value,
        (_, NumberForm::Whole) => min.max(3.0),
        _ => min.max(0.3),
    };
    let numbers = spec.numbers.iter().map(|n| (n, value(n.default, n.form, n.min)));
    numbers.fold(format!("fault = \"{}\"\n", spec.code), |text, (number, value)| {
        text + &format!("{} = {}\n", number.name, number.written(value))
    })
}

#[test]
fn each_fault_changes_the_data_of_each_supporting_link_only_while_it_acts() {
    for spec in CATALOGUE.iter().filter(|spec| spec.scope == Scope::Link && !spec.code.starts_with("reply")) {
        for kind in spec.links() {
            let (all, again) = (carried(kind, &keys(spec)), carried(kind, &keys(spec)));
            assert_eq!(all, again, "{} on {}", spec.code, kind.name());
            let mut touched = 0;
            for (frame, (before, after)) in all.iter().enumerate() {
                let on_time =
                    after.iter().all(|transmission| (transmission.frame, transmission.after_ns) == (frame as u64, 0));
                let same = on_time && after.iter().map(|transmission| &transmission.content).eq(before);
                assert!(same || (8..16).contains(&frame), "{} on {} at {frame}", spec.code, kind.name());
                touched += usize::from(!same);
            }
            assert!(touched >= 4, "{} on {}: {touched}", spec.code, kind.name());
        }
    }
}

/// Counts of deframer events in the bytes of the samples in which the fault acts.
fn found(keys: &str) -> BTreeMap<&'static str, usize> {
    let bytes: Vec<u8> = carried(Transport::Pty, keys)[8..16]
        .iter()
        .flat_map(|(_, after)| after.iter().flat_map(|transmission| transmission.content.bytes().to_vec()))
        .collect();
    let mut counts = BTreeMap::new();
    let mut deframer = Deframer::default();
    deframer.consume(&bytes, &mut |found| {
        let name = match found {
            DeframerEvent::Frame { kind: serial::FrameType::Data, .. } => "data",
            DeframerEvent::Frame { .. } => "other",
            DeframerEvent::Rejected { .. } => "rejected",
            _ => "else",
        };
        *counts.entry(name).or_default() += 1;
    });
    counts
}

#[test]
fn a_receiver_accepts_frames_with_a_valid_crc() {
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
fn reordered_and_merged_samples_have_the_intended_order() {
    let released = |keys: &str| {
        let all = carried(Transport::Tcp, keys);
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
fn on_can_the_crc_is_valid_after_a_flip_before_it_and_invalid_after_a_flip_after_it() {
    for (place, is_valid) in [("before", true), ("after", false)] {
        let all = carried(Transport::Can, &format!("fault = \"bit-flip\"\nbits = 40\ncrc = \"{place}\""));
        for (_, after) in &all[8..16] {
            let [WireData::Frame(increments), WireData::Frame(status), _] =
                [0, 1, 2].map(|index| after[index].content.clone())
            else {
                panic!("three frames")
            };
            let crc = crc16(&[increments.data(), &status.data()[..6]].concat()).to_be_bytes();
            assert_eq!(status.data()[6..] == crc, is_valid);
        }
    }
}

#[test]
fn a_fault_on_every_link_spares_unsupported_transports() {
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
    let unit = GyroUnit::new(&configuration);
    let touching = |kind| model(kind).touching(unit.faults().acting()).len();
    assert_eq!(Transport::ALL.map(touching), [1, 1, 0, 0]);
}

#[test]
fn copies_add_up_and_many_faults_together_stay_within_bounds() {
    let sent = |kind, fault: &str, count| planned(kind, &fault.repeat(count))[3].1.len();
    let duplicate = "[[fault]]\nfault = \"duplicate\"\ncopies = 16\n";
    assert_eq!(sent(Transport::Tcp, duplicate, 5), 81);
    assert_eq!(sent(Transport::Can, duplicate, 5), 3 * 81);
    assert_eq!(sent(Transport::Can, duplicate, 1000), 3 * (MAX_TRANSMISSIONS / 3));
    assert_eq!(sent(Transport::Can, "[[fault]]\nfault = \"babble\"\namount = 1000\n", 20), MAX_TRANSMISSIONS);
}

#[test]
fn of_several_identifiers_the_last_counts() {
    let fault = |identifier: u32| {
        format!("[[fault]]\nlink = \"can\"\nfault = \"wrong-identifier\"\nidentifier = {identifier}\n")
    };
    let all = planned(Transport::Can, &(fault(2045) + &fault(2045) + &fault(0x700)));
    let ids = all[3].1.iter().map(|transmission| match &transmission.content {
        WireData::Frame(frame) => frame.id(),
        WireData::Bytes(_) => panic!("a frame"),
    });
    assert_eq!(ids.collect::<Vec<_>>(), [0x700, 0x701, 0x702]);
}

#[test]
fn extra_bytes_are_sent_only_with_a_sample() {
    let extra = "[[fault]]\nfault = \"extra-bytes\"\nbytes = 5\n";
    let drop = "[[fault]]\nfault = \"drop\"\n";
    assert_eq!(planned(Transport::Pty, extra)[3].1[0].content.bytes().len(), 33);
    assert_eq!(planned(Transport::Pty, &(extra.to_owned() + drop))[3].1, []);
    assert_eq!(planned(Transport::Pty, &(extra.to_owned() + "[[fault]]\nfault = \"reset\"\nfor_s = 5"))[3].1, []);
}

#[test]
fn stale_repeat_sends_nothing_before_the_first_sample() {
    let all = planned(Transport::Pty, "[[fault]]\nfault = \"stale-repeat\"\nfor_s = 2.0");
    assert!(all[..4].iter().all(|(_, after)| after.is_empty()));
    assert_eq!(all[4].1.len(), 1);
}

#[test]
fn replies_have_no_noise() {
    let mut configuration = Configuration::reference();
    configuration.add_plan("plan", "[[fault]]\nfault = \"babble\"").expect("a plan");
    let unit = GyroUnit::new(&configuration);
    let (sample, acting) = (CompletedSample::default(), unit.faults().acting());
    for kind in Transport::ALL {
        let model = model(kind);
        let reply = geu_protocol::Reply::new(3, geu_protocol::CommandResult::Done, &[]);
        let polled = model.polled(&sample, &reply, acting);
        let contents: Vec<WireData> = polled.into_iter().map(|transmission| transmission.content).collect();
        assert_eq!(contents, model.encoding.sample(&sample));
        assert!(model.carry(None, 0, acting).len() >= 16, "the noise is on the link");
    }
}

#[test]
fn the_parts_of_a_frame_stay_together_in_order() {
    let split =
        |byte, gap_s| format!("[[fault]]\nlink = \"tcp\"\nfault = \"split\"\nbyte = {byte}\ngap_s = {gap_s:?}\n");
    let all = planned(Transport::Tcp, &(split(10, 0.125) + &split(4, 0.25) + "[[fault]]\nfault = \"duplicate\"\n"));
    let parts: Vec<_> = all[3].1.iter().map(|it| (it.content.bytes().len(), it.after_ns, it.more_fragments)).collect();
    let once = [(4, 0, true), (6, 250_000_000, true), (4, 375_000_000, true), (14, 625_000_000, false)];
    assert_eq!(parts, [once, once].concat());
}
