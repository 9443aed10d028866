use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use geu_daemon::replay::{ReplayItem, ReplayItemKind, TrafficOrigin};
use geu_model::device::Device;
use geu_protocol::CanIdMap;
use geu_protocol::capture::Format;
use geu_recorder::link_model::WireData;
use geu_recording::Sink;

use crate::{ReplaySelection, ReplaySource};

const LOG: &str = "\
    (5.000000) can0 123#01\n\
    (5.100000) can0 1A0#FFFEFFFE00050005\n\
    (5.100200) can0 123#02\n\
    (5.100400) can0 1A1#00000F070810DD5E\n\
    (5.100600) can0 1A2#00000007A1201B58\n\
    (5.200000) can0 1A8#01\n\
    (5.200100) can0 1A9#01000100\n\
    (5.600000) can0 1A0#0000000000000000\n\
    (5.600200) can1 1A1#0000000000000000\n\
    (7205.6000) can0 1A8#02\n";

/// The items of the log, and the report on it.
fn items(selection: ReplaySelection) -> (Vec<ReplayItem>, String) {
    items_of(LOG, selection)
}

fn items_of(log: &str, selection: ReplaySelection) -> (Vec<ReplayItem>, String) {
    let ((sender, items), (begins, _began)) = (sync_channel(100), sync_channel(1));
    let mut source = ReplaySource::new(selection, sender, begins);
    let mut reader = Format::from_name("candump").expect("a format").reader().expect("a reader");
    reader.read(log.as_bytes(), true, &mut |_, record| Sink::<()>::record(&mut source, &record));
    source.end_pass();
    let report = source.finish(false).to_string();
    (items.into_iter().flatten().collect(), report)
}

fn selection() -> ReplaySelection {
    let plan = CanIdMap::default();
    ReplaySelection {
        device: Device::iras(),
        plan,
        interface: None,
        is_only: false,
        from_ns: 0,
        to_ns: i64::MAX,
        longest_gap_ns: 10_000_000_000,
        carries: (true, true),
    }
}

fn shown(items: &[ReplayItem]) -> Vec<String> {
    let what = |what: &ReplayItemKind| match what {
        ReplayItemKind::Sample { sample, .. } => format!("sample {}", sample.sequence),
        ReplayItemKind::Content(WireData::Frame(frame), origin) => format!("{:03X} {origin:?}", frame.id()),
        ReplayItemKind::Content(WireData::Bytes(bytes), origin) => format!("{} bytes {origin:?}", bytes.len()),
        ReplayItemKind::Note(note) => note.clone(),
    };
    items.iter().map(|item| format!("{} {}", item.played_ns / 1000, what(&item.what))).collect()
}

#[test]
fn frames_keep_order_and_time_and_a_sample_is_known_at_its_start() {
    let (items, report) = items(selection());
    assert_eq!(
        shown(&items),
        [
            "0 123 Other",
            "100000 sample 0",
            "100000 1A0 Sample",
            "100200 123 Other",
            "100400 1A1 Sample",
            "100600 1A2 Sample",
            "200000 1A8 Command",
            "200100 1A9 Unit",
            "600000 1A0 Unit",
            "10600000 a gap of 7200.000 s, 0.600 s into the recording, is shortened to 10 s",
            "10600000 1A8 Command",
        ]
    );
    assert_eq!(items[10].recorded_ns, 7_200_600_000_000);
    assert!(report.contains("1 gaps shortened") && report.contains("1 frames of other interfaces"), "{report}");
    assert!(matches!(items[1].what, ReplayItemKind::Sample { sample, is_can: true } if sample.clock_count == 500_000));
    assert!(!matches!(items[1].what, ReplayItemKind::Content(_, TrafficOrigin::Unit)));
}

#[test]
fn time_range_and_the_unit_alone_can_be_selected() {
    let only = ReplaySelection { is_only: true, to_ns: 300_000_000, ..selection() };
    let (all, _) = items(only);
    let expected = ["0 sample 0", "0 1A0 Sample", "400 1A1 Sample", "600 1A2 Sample", "100100 1A9 Unit"];
    assert_eq!(shown(&all), expected);
    let (late, _) = items(ReplaySelection { from_ns: 190_000_000, to_ns: 500_000_000, ..selection() });
    assert_eq!(shown(&late), ["0 1A8 Command", "100 1A9 Unit"]);
}

#[test]
fn a_sample_of_a_described_unit_begins_with_its_first_frame() {
    let device = Arc::new(Device::from_name("mm5.10").expect("a known unit"));
    let frames = device.frames(true).expect("its messages");
    let line = |t_ms: u32, kind: usize, sequence: f64| {
        let mut data = Vec::new();
        let frame = &frames.frames[kind];
        let slot = frames.slot(&geu_protocol::layout::Quantity::Sequence);
        let values: Vec<f64> =
            (0..frames.values.len()).map(|at| if Some(at) == slot { sequence } else { 0.0 }).collect();
        frame.write(&values, &mut data);
        let bytes: String = data.iter().map(|byte| format!("{byte:02X}")).collect();
        format!("(1.{t_ms:03}000) can0 {:03X}#{bytes}\n", frame.id.expect("an identifier").0)
    };
    // The second frame of the second sample is missing; the third has another unit's traffic inside.
    let log = line(0, 0, 1.0)
        + &line(1, 1, 1.0)
        + &line(10, 0, 2.0)
        + &line(20, 0, 3.0)
        + "(1.020500) can0 0CF02A80#0102030405060708\n"
        + &line(21, 1, 3.0);
    let (all, report) = items_of(&log, ReplaySelection { device: device.clone(), ..selection() });
    let ids: Vec<u32> = frames.frames.iter().map(|frame| frame.id.expect("an identifier").0).collect();
    let [first, second] = [ids[0], ids[1]].map(|id| format!("{id:03X} Sample"));
    assert_eq!(
        shown(&all),
        [
            "0 sample 1".to_owned(),
            format!("0 {first}"),
            format!("1000 {second}"),
            "10000 sample 2".to_owned(),
            format!("10000 {first}"),
            "20000 sample 3".to_owned(),
            format!("20000 {first}"),
            "20500 CF02A80 Other".to_owned(),
            format!("21000 {second}"),
        ],
        "{report}"
    );
}
