use std::sync::mpsc::sync_channel;

use geu_daemon::replay::{ReplayItem, ReplayItemKind, TrafficOrigin};
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
    let ((sender, items), (begins, _began)) = (sync_channel(100), sync_channel(1));
    let mut source = ReplaySource::new(selection, sender, begins);
    let mut reader = Format::from_name("candump").expect("a format").reader().expect("a reader");
    reader.read(LOG.as_bytes(), true, &mut |_, record| source.record(&record));
    source.end_pass();
    let report = source.finish(false).to_string();
    (items.into_iter().flatten().collect(), report)
}

fn selection() -> ReplaySelection {
    let plan = CanIdMap::default();
    ReplaySelection {
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
