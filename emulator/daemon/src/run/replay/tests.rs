use std::sync::Mutex;
use std::sync::mpsc::sync_channel;

use geu_model::Configuration;
use geu_model::fault::catalogue::Transport;
use geu_protocol::serial::data_frame;
use geu_protocol::{CanFrame, CanIdMap, Sample};

use super::*;
use crate::cadence::now_ns;
use crate::link::{Link, LinkInfo};
use crate::patience::Patience;
use geu_recorder::link_model::{LinkModel, WireData};

/// Time, ns, and data.
type Timed = Vec<(i64, WireData)>;
type Sent = Arc<Mutex<Timed>>;

/// A link that stores its data.
struct StoredLink {
    info: LinkInfo,
    sent: Sent,
}

impl Link for StoredLink {
    fn info(&self) -> &LinkInfo {
        &self.info
    }

    fn send(&mut self, data: &[WireData], _more_fragments: bool, _patience: &Patience) {
        let now_ns = now_ns();
        self.sent.lock().unwrap().extend(data.iter().map(|data| (now_ns, data.clone())));
    }

    fn send_answers(&mut self) {}

    fn is_drained(&self) -> bool {
        true
    }
}

/// A sample on CAN of base 300 with a foreign frame in it, at 20 ms.
fn items(sample: &Sample) -> Vec<ReplayItem> {
    let frames = CanIdMap::with_base(0x300).unwrap().frames(sample);
    let other = WireData::Frame(CanFrame::new(0x123, &[7]).unwrap());
    let at = |played_ns, what| ReplayItem { recorded_ns: played_ns, played_ns, what };
    let own = |index: usize| ReplayItemKind::Content(WireData::Frame(frames[index]), TrafficOrigin::Sample);
    vec![
        at(20_000_000, ReplayItemKind::Sample { sample: *sample, is_can: true }),
        at(20_000_000, own(0)),
        at(40_000_000, ReplayItemKind::Content(other, TrafficOrigin::Other)),
        at(60_000_000, own(1)),
        at(80_000_000, own(2)),
    ]
}

/// Data of a bus and a stream for one sample, and the earliest start of the replay.
fn played(speed: Speed, plan: Configuration) -> (Timed, Timed, ReplayCounts, i64) {
    played_items(speed, plan, items(&Sample { sequence: 9, ..Sample::default() }))
}

/// Data for any items.
fn played_items(speed: Speed, plan: Configuration, items: Vec<ReplayItem>) -> (Timed, Timed, ReplayCounts, i64) {
    let (bus, stream) = (Sent::default(), Sent::default());
    let link = |model, sent: &Sent| {
        LinkOutput::new(
            Box::new(StoredLink { info: LinkInfo::new(model, "kept"), sent: sent.clone() }) as Box<dyn Link>,
            500_000_000,
        )
    };
    let links = vec![link(LinkModel::can(CanIdMap::default()), &bus), link(LinkModel::serial(Transport::Tcp), &stream)];
    let recorded_plan = CanIdMap::with_base(0x300).unwrap();
    let settings = ReplayOptions { links: Vec::new(), speed, wait_for_client: false, recorded_plan, plan };
    let (sender, received) = sync_channel(1);
    sender.send(items).unwrap();
    drop(sender);
    let mut player =
        Player::new(&settings, links, received, None, Session::new(&[], speed, false).unwrap(), Arc::default());
    let start_ns = now_ns();
    player.play();
    let taken = |sent: Sent| std::mem::take(&mut *sent.lock().unwrap());
    (taken(bus), taken(stream), player.counts, start_ns)
}

#[test]
fn frames_are_sent_unchanged_at_their_time_with_the_identifiers_of_the_link() {
    let sample = Sample { sequence: 9, ..Sample::default() };
    let [increments, status, clock] = CanIdMap::default().frames(&sample);
    let (bus, stream, counts, start_ns) = played(Speed::Times(2.0), Configuration::reference());
    let expected = [increments, CanFrame::new(0x123, &[7]).unwrap(), status, clock].map(WireData::Frame);
    assert_eq!(bus.iter().map(|(_, content)| content.clone()).collect::<Vec<_>>(), expected);
    for ((sent_ns, _), after_ns) in bus.iter().zip([10_000_000, 20_000_000, 30_000_000, 40_000_000]) {
        assert!(*sent_ns >= start_ns + after_ns, "never early");
    }
    assert_eq!(stream.len(), 1);
    assert_eq!(stream[0].1, WireData::Bytes(data_frame(&sample).to_vec()));
    assert_eq!(counts, ReplayCounts { samples: 1, other: 1, ..ReplayCounts::default() });
}

#[test]
fn a_fault_acts_on_the_sample_and_not_on_other_traffic() {
    let mut plan = Configuration::reference();
    plan.add_plan("plan", "[[fault]]\nfault = \"silence\"\n").unwrap();
    let (bus, stream, counts, _) = played(Speed::Max, plan);
    assert_eq!(
        bus.into_iter().map(|(_, content)| content).collect::<Vec<_>>(),
        [WireData::Frame(CanFrame::new(0x123, &[7]).unwrap())]
    );
    assert!(stream.is_empty() && counts.faulted == 1);
}

/// A sample recorded as bytes, at this time.
fn recorded(t_ns: i64, sequence: u16) -> [ReplayItem; 2] {
    let sample = Sample { sequence, ..Sample::default() };
    let at = |what| ReplayItem { recorded_ns: t_ns, played_ns: t_ns, what };
    let content = WireData::Bytes(data_frame(&sample).to_vec());
    [at(ReplayItemKind::Sample { sample, is_can: false }), at(ReplayItemKind::Content(content, TrafficOrigin::Sample))]
}

fn bytes(timed: &Timed) -> Vec<u8> {
    let data_bytes = |content: &WireData| match content {
        WireData::Bytes(bytes) => bytes.clone(),
        WireData::Frame(_) => Vec::new(),
    };
    timed.iter().flat_map(|(_, content)| data_bytes(content)).collect()
}

#[test]
fn delayed_samples_are_sent_at_the_end() {
    let mut plan = Configuration::reference();
    plan.add_plan("plan", "[[fault]]\nfault = \"delay\"\ndelay_s = 60.0\n").unwrap();
    let items = [recorded(0, 1), recorded(500_000_000, 2)].concat();
    let start_ns = now_ns();
    let (_, stream, ..) = played_items(Speed::Times(10.0), plan, items);
    assert_eq!(bytes(&stream).len(), 2 * 28);
    assert!(now_ns() - start_ns < 3_000_000_000, "not a minute later");
}

#[test]
fn recorded_data_does_not_interrupt_a_fragmented_frame() {
    let mut plan = Configuration::reference();
    plan.add_plan("plan", "[[fault]]\nfault = \"split\"\ngap_s = 0.8\nfor_s = 0.5\n").unwrap();
    let items = [recorded(0, 1), recorded(500_000_000, 2), recorded(1_000_000_000, 3)].concat();
    let (_, stream, ..) = played_items(Speed::Times(10.0), plan, items);
    let frames = [1, 2, 3].map(|sequence| data_frame(&Sample { sequence, ..Sample::default() }));
    assert_eq!(bytes(&stream), frames.concat());
}

#[test]
fn the_largest_time_of_a_recording_does_not_overflow() {
    let mut items = [recorded(0, 1), recorded(0, 2)].concat();
    items[2].recorded_ns = i64::MAX;
    let (_, stream, ..) = played_items(Speed::Max, Configuration::reference(), items);
    assert_eq!(bytes(&stream).len(), 2 * 28);
}
