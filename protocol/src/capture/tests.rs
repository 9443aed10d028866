//! All formats: captures of real tools, any bytes, chunks of any size.

mod fuzzed;
mod python_can;

use proptest::prelude::*;

use super::*;

const CANDUMP: &Format = &candump::FORMATS[0];
const CONSOLE: &Format = &console::FORMATS[0];
const CONSOLE_DELTA: &Format = &console::FORMATS[1];
const ASC: &Format = &asc::FORMATS[0];
const PCAP: &Format = &pcap::FORMATS[0];
const PCAPNG: &Format = &pcapng::FORMATS[0];

#[derive(Debug, Clone, PartialEq, Eq)]
enum Seen {
    Frame(Option<i64>, String, u32, bool, Vec<u8>),
    Remote,
    Fd,
    Error,
    Remark,
    Dropped(u64),
    Broken(bool),
}

fn see(event: CaptureRecord) -> Seen {
    match event {
        CaptureRecord::Frame(frame) => Seen::Frame(
            frame.time.map(|time| time.t_ns),
            String::from_utf8_lossy(frame.interface).into_owned(),
            frame.id,
            frame.extended,
            frame.data.to_vec(),
        ),
        CaptureRecord::Remote => Seen::Remote,
        CaptureRecord::Fd => Seen::Fd,
        CaptureRecord::Error => Seen::Error,
        CaptureRecord::Remark | CaptureRecord::Line(_) => Seen::Remark,
        CaptureRecord::Dropped(count) => Seen::Dropped(count),
        CaptureRecord::Broken { cut, .. } => Seen::Broken(cut),
    }
}

/// All events of a capture in chunks of this length: one per record.
fn read(format: &Format, bytes: &[u8], length: usize) -> Vec<(RecordPosition, Seen)> {
    let (mut reader, mut seen, mut buffer) = (format.reader().expect("a reader"), Vec::new(), Vec::new());
    let mut sink = |place, event: CaptureRecord<'_>| seen.push((place, see(event)));
    for chunk in bytes.chunks(length) {
        buffer.extend_from_slice(chunk);
        let used = reader.read(&buffer, false, &mut sink);
        buffer.drain(..used);
        assert!(buffer.len() <= MAX_RECORD);
    }
    reader.read(&buffer, true, &mut sink);
    assert_eq!(reader.records(), seen.len() as u64);
    seen
}

/// Name of the detected format, or of the other results.
fn detected(head: &[u8], is_complete: bool) -> &'static str {
    match detect(head, is_complete) {
        Detected::Format(format) => format.name,
        Detected::Undecided => "undecided",
        Detected::Foreign(foreign) => foreign.name,
        Detected::UnknownText => "text",
    }
}

fn events(format: &Format, text: &str) -> Vec<Seen> {
    read(format, text.as_bytes(), usize::MAX).into_iter().map(|(_, seen)| seen).collect()
}

fn frame(t_ns: i64, interface: &str, id: u32, data: &[u8]) -> Seen {
    Seen::Frame(Some(t_ns), interface.into(), id, false, data.to_vec())
}

const T_NS: i64 = 1_795_020_000_500_932_000;
const DATA: [u8; 8] = [0xFF, 0xFE, 0, 1, 0, 5, 0, 5];

#[test]
fn candump_logs_of_the_wild_are_read_line_by_line() {
    for (line, expected) in [
        ("(1795020000.500932) can0 1A0#FFFE000100050005", frame(T_NS, "can0", 0x1A0, &DATA)),
        ("(1795020000.500932) can0 1a0#fffe000100050005", frame(T_NS, "can0", 0x1A0, &DATA)),
        ("(1795020000.500932000)  can0  1A0#FFFE000100050005 R", frame(T_NS, "can0", 0x1A0, &DATA)),
        ("(1795020000.500932)    vcan10 1A0#FFFE000100050005 T\r", frame(T_NS, "vcan10", 0x1A0, &DATA)),
        ("(1795020000.500932) a-very-long-name 1A0#", frame(T_NS, "a-very-long-name", 0x1A0, &[])),
        ("(0000000000.500932) can0 1A0#FF.FE", frame(500_932_000, "can0", 0x1A0, &[0xFF, 0xFE])),
        ("(0.5) can0 1A0#FFFE000100050005_B", frame(500_000_000, "can0", 0x1A0, &DATA)),
        ("(0.5) can0 000001A0#FF", Seen::Frame(Some(500_000_000), "can0".into(), 0x1A0, true, vec![0xFF])),
        ("(0.5) can0 1A0#R", Seen::Remote),
        ("(0.5) can0 1A0#R8", Seen::Remote),
        ("(0.5) can0 1A0##1112233", Seen::Fd),
        ("(0.5) can0 123#81:00:12345678#112233", Seen::Fd),
        ("(0.5) can0 45123#81:00:12345678#112233", Seen::Fd),
        ("(0.5) can0 4512#81:00:12345678#112233", Seen::Broken(false)),
        ("(0.5) can0 123#81:00:12345678#", Seen::Broken(false)),
        ("(0.5) can0 1A0#FF:E000100050005", Seen::Broken(false)),
        ("(0.5) can0 123#81:00:1234567G#112233", Seen::Broken(false)),
        ("(0.5) can0 123#81:00:12345678#11223", Seen::Broken(false)),
        ("(0.5) can0 123#81:00:12345678", Seen::Broken(false)),
        ("(0.5) can0 20000004#0001000000000000", Seen::Error),
        ("DROPCOUNT: dropped 17 CAN frames on 'can0' socket (total drops 17)", Seen::Dropped(17)),
        ("", Seen::Remark),
        ("# recorded on the bench", Seen::Remark),
        ("(1795020000.500932) can0 8A0#FFFE000100050005", Seen::Broken(false)),
        ("(1795020000.500932) can0 1A0#FFFE00010005000", Seen::Broken(false)),
        ("(1795020000.500932) can0 1A0#FFFE00010005000G", Seen::Broken(false)),
        ("(1795020000.500932) can0 1A0#FFFE00010005000500", Seen::Broken(false)),
        ("(1795020000.50O932) can0 1A0#FFFE000100050005", Seen::Broken(false)),
        ("1795020000.500932) can0 1A0#FFFE000100050005", Seen::Broken(false)),
        ("(1795020000.500932) can0 1A0 FFFE000100050005", Seen::Broken(false)),
        ("(1795020000.500932) can0", Seen::Broken(false)),
        ("(9999999999.500932) can0 1A0#FFFE000100050005", Seen::Broken(false)),
        ("()", Seen::Broken(false)),
        (")(", Seen::Broken(false)),
    ] {
        // Twice, and behind a usual line, so that both ways of reading are gone.
        let usual = "(1795020000.500932) can0 1A0#FFFE000100050005\n";
        let found = events(CANDUMP, &format!("{line}\n{usual}{line}\n"));
        assert_eq!(found, [expected.clone(), frame(T_NS, "can0", 0x1A0, &DATA), expected], "{line}");
    }
}

#[test]
fn a_byte_order_mark_costs_no_line_of_any_text_format() {
    for (format, line) in [
        (CANDUMP, "(1.500000) can0 1A0#01\n"),
        (CONSOLE, "  can0  1A0   [1]  01\n"),
        (ASC, "date Mon Jan 5 10:00:00 am 2026\nbase hex timestamps absolute\n1.500000 1 1A0 Rx d 1 01\n"),
    ] {
        let marked = format!("\u{feff}{line}");
        assert_eq!(detected(marked.as_bytes(), true), format.name);
        for length in [1, 1000] {
            assert_eq!(read(format, marked.as_bytes(), length), read(format, line.as_bytes(), length));
        }
        assert!(events(format, &marked).iter().any(|event| matches!(event, Seen::Frame(..))));
    }
}

#[test]
fn a_cut_last_line_is_reported_as_cut() {
    assert_eq!(events(CANDUMP, "(0.5) can0 1A0#FF\n(0.6) can0 1A")[1], Seen::Broken(true));
    assert_eq!(events(CONSOLE, " can0  1A0  [8]  FF FE")[0], Seen::Broken(true));
}

#[test]
fn candump_console_output_is_read_with_and_without_its_options() {
    let usual = |time| Seen::Frame(time, "can0".into(), 0x1A0, false, DATA.to_vec());
    for (line, expected) in [
        ("  can0  1A0   [8]  FF FE 00 01 00 05 00 05", usual(None)),
        (" (1795020000.500932)  can0  1A0   [8]  FF FE 00 01 00 05 00 05", usual(Some(T_NS))),
        (" (2026-11-18 16:40:00.500932)  can0  1A0   [8]  FF FE 00 01 00 05 00 05", usual(Some(T_NS))),
        (" (000.500932)  can0       1A0   [8]  FF FE 00 01 00 05 00 05", usual(Some(500_932_000))),
        (" (000.500932)  can0  RX - -  1A0   [8]  FF FE 00 01 00 05 00 05", usual(Some(500_932_000))),
        (" (000.500932)  can0  TX B E  1A0   [8]  FF FE 00 01 00 05 00 05   '........'", usual(Some(500_932_000))),
        (
            "  can0  1A0   [2]  41 42                     'A B'",
            Seen::Frame(None, "can0".into(), 0x1A0, false, vec![0x41, 0x42]),
        ),
        ("  can0  000001A0   [1]  FF", Seen::Frame(None, "can0".into(), 0x1A0, true, vec![0xFF])),
        ("  can0  1A0   [0]  remote request", Seen::Remote),
        ("  can0  1A0  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B", Seen::Fd),
        ("  can0  20000004   [8]  00 01 00 00 00 00 00 00   ERRORFRAME", Seen::Error),
        ("\tcontroller-problem{rx-overflow}", Seen::Remark),
        ("  can0  1A0   [8]  FF FE 00 01 00 05 00", Seen::Broken(false)),
        ("  can0  1A0   [x]  FF", Seen::Broken(false)),
    ] {
        assert_eq!(events(CONSOLE, &format!("{line}\n")), [expected], "{line}");
    }
    let delta = " (000.000000)  can0  123   [0]\n (000.250000)  can0  123   [0]\n (000.100000)  can0  123   [0]\n";
    let times: Vec<_> = events(CONSOLE_DELTA, delta);
    assert_eq!(times[2], frame(350_000_000, "can0", 0x123, &[]));
    assert_eq!(detected(delta.as_bytes(), true), CONSOLE_DELTA.name);
}

#[test]
fn vector_asc_is_read_in_both_bases_and_both_kinds_of_time() {
    let text = "date Sat Nov 21 03:26:25.693 2026\nbase hex  timestamps absolute\ninternal events logged\n// version 9.0.0\n\
        Begin Triggerblock Wed Nov 18 16:40:00.500 2026\n 0.000000 Start of measurement\n\
        \x20  0.500932 1  1A0             Rx   d 8 FF FE 00 01 00 05 00 05\n\
        \x20  0.600000 2  1A0x            Tx   d 1 FF\n   0.700000 1  1A0             Rx   r 4\n\
        \x20  0.800000 1  ErrorFrame\n\
        \x20  0.900000 CANFD   1 Rx        1A0                                   1 0 8  8 11 22 33 44 55 66 77 88   130000  130     3000 0 0 0 0 0\n\
        \x20  1.000000 CANFD   1 Rx        1A0                                   0 0 8  8 FF FE 00 01 00 05 00 05   130000  130        0 0 0 0 0 0\n\
        \x20  1.100000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n\
        \x20  1.200000 1  1A0             Rx   d 8 FF FE\nEnd TriggerBlock\n";
    let seen = events(ASC, text);
    let expected = [
        frame(500_932_000, "1", 0x1A0, &DATA),
        Seen::Frame(Some(600_000_000), "2".into(), 0x1A0, true, vec![0xFF]),
        Seen::Remote,
        Seen::Error,
        Seen::Fd,
        frame(1_000_000_000, "1", 0x1A0, &DATA),
        Seen::Remark,
        Seen::Broken(false),
        Seen::Remark,
    ];
    assert_eq!(seen[..6], [const { Seen::Remark }; 6]);
    assert_eq!(seen[6..], expected);
    let decimal = "base dec  timestamps relative\n 0.5 1 416 Rx d 2 255 1\n 0.25 1 416 Rx d 0\n";
    let seen = events(ASC, decimal);
    assert_eq!(seen[1..], [frame(500_000_000, "1", 416, &[255, 1]), frame(750_000_000, "1", 416, &[])]);
}

/// A SocketCAN frame with its identifier in this order.
fn socketcan(id: [u8; 4], data: &[u8]) -> Vec<u8> {
    [&id[..], &[data.len() as u8, 0, 0, 0], data].concat()
}

fn pcap(big: bool, nanoseconds: bool, link: u32, packets: &[Vec<u8>]) -> Vec<u8> {
    let word = |value: u32| if big { value.to_be_bytes() } else { value.to_le_bytes() };
    let mut bytes = [word(if nanoseconds { 0xA1B2_3C4D } else { 0xA1B2_C3D4 }), word(0x0002_0004)].concat();
    bytes.extend([word(0), word(0), word(65_535), word(link)].concat());
    for packet in packets {
        let fraction = if nanoseconds { 500_932_000 } else { 500_932 };
        let length = word(packet.len() as u32);
        bytes.extend([word(1_795_020_000), word(fraction), length, length].concat());
        bytes.extend(packet);
    }
    bytes
}

#[test]
fn pcap_is_read_in_both_orders_and_units_and_all_three_links() {
    let socketcan_frame = socketcan([0, 0, 1, 0xA0], &DATA);
    for (big, nanoseconds) in [(false, false), (false, true), (true, false), (true, true)] {
        let id: [u8; 4] = if big { 0x1A0u32.to_be_bytes() } else { 0x1A0u32.to_le_bytes() };
        let sll = [&[0; 14][..], &[0, 0x0C], &socketcan(id, &DATA)].concat();
        let sll2 = [&[0, 0x0C][..], &[0; 18], &socketcan(id, &DATA)].concat();
        for (link, packet) in [(227, &socketcan_frame), (113, &sll), (276, &sll2)] {
            let bytes = pcap(big, nanoseconds, link, &[packet.clone(), packet.clone()]);
            assert_eq!(detected(&bytes, false), PCAP.name);
            let seen = read(PCAP, &bytes, 7);
            let expected = frame(T_NS, "", 0x1A0, &DATA);
            assert_eq!(
                seen,
                [
                    (RecordPosition::Offset(24), expected.clone()),
                    (RecordPosition::Offset(40 + packet.len() as u64), expected)
                ]
            );
            assert_eq!(read(PCAP, &bytes[..bytes.len() - 1], 7)[1].1, Seen::Broken(true));
        }
    }
    let others = [
        socketcan([0x80, 0, 1, 0xA0], &[1]),
        socketcan([0x40, 0, 1, 0xA0], &[]),
        socketcan([0x20, 0, 0, 4], &[0; 8]),
        socketcan([0, 0, 1, 0xA0], &[0; 12]),
        vec![0, 0, 1, 0xA0, 8, 0, 0, 0, 1],
    ];
    let seen: Vec<_> = read(PCAP, &pcap(false, false, 227, &others), 1000).into_iter().map(|(_, seen)| seen).collect();
    let extended = Seen::Frame(Some(T_NS), String::new(), 0x1A0, true, vec![1]);
    assert_eq!(seen, [extended, Seen::Remote, Seen::Error, Seen::Fd, Seen::Broken(false)]);
}

#[test]
fn pcapng_interfaces_have_their_own_names_and_time_units() {
    for big in [false, true] {
        let word = |value: u32| if big { value.to_be_bytes() } else { value.to_le_bytes() };
        let half = |value: u16| if big { value.to_be_bytes() } else { value.to_le_bytes() };
        let block = |kind: u32, body: &[u8]| {
            let padded = body.len().next_multiple_of(4);
            let length = word(padded as u32 + 12);
            let padding = vec![0; padded - body.len()];
            [&word(kind)[..], &length, body, &padding, &length].concat()
        };
        let interface = |name: &[u8; 4], resolution: u8| {
            let options =
                [&half(2)[..], &half(4), name, &half(9), &half(1), &[resolution, 0, 0, 0], &half(0), &half(0)];
            block(1, &[&half(227)[..], &half(0), &word(65_535), &options.concat()].concat())
        };
        let packet = |interface: u32, ticks: u64| {
            let frame = socketcan([0, 0, 1, 0xA0], &DATA);
            let length = word(frame.len() as u32);
            block(
                6,
                &[&word(interface), &word((ticks >> 32) as u32), &word(ticks as u32), &length, &length, &frame[..]]
                    .concat(),
            )
        };
        let bytes = [
            block(0x0A0D_0D0A, &[&word(0x1A2B_3C4D)[..], &half(1), &half(0), &[0xFF; 8]].concat()),
            interface(b"can0", 6),
            interface(b"can1", 9),
            interface(b"can2", 0x80 | 1),
            packet(0, T_NS as u64 / 1_000),
            packet(1, T_NS as u64),
            packet(2, 3),
            packet(7, 3),
        ]
        .concat();
        assert_eq!(detected(&bytes, false), PCAPNG.name);
        let seen: Vec<_> = read(PCAPNG, &bytes, 11).into_iter().map(|(_, seen)| seen).collect();
        let (first, second) = (frame(T_NS, "can0", 0x1A0, &DATA), frame(T_NS, "can1", 0x1A0, &DATA));
        assert_eq!(seen[4..], [first, second, frame(1_500_000_000, "can2", 0x1A0, &DATA), Seen::Broken(false)]);
    }
}

#[test]
fn the_format_is_detected_from_the_content() {
    let of_text = |text: &str| detected(text.as_bytes(), true);
    assert_eq!(of_text("# a comment\n(1.5) can0 123#\n"), CANDUMP.name);
    assert_eq!(of_text(" can0  123   [1]  11\n"), CONSOLE.name);
    assert_eq!(of_text("date today\n 0.5 1 123 Rx d 0\n"), ASC.name);
    assert_eq!(of_text("To be, or not to be\n"), "text");
    assert_eq!(detected(b"To be, or", false), "undecided");
    assert_eq!(detected(&[0, 1, 2, 3], true), "serial");
    assert_eq!(detected(&[0, 1, 2, 3], false), "undecided");
    let serial = crate::serial::data_frame(&crate::Sample::default());
    assert_eq!(detected(&serial, false), "serial");
}

/// Random sequences of parts of captures and other bytes, which reach deep into the readers.
fn debris() -> impl Strategy<Value = Vec<u8>> {
    let text = prop_oneof![
        Just("(1795020000.500932) can0 1A0#FFFE000100050005\n"),
        Just("(1795020000.500932) can1 1A1#00000F070810DD5E R\r\n"),
        Just("(0.5) can0 1A0##1"),
        Just(" can0  1A0   [8]  FF FE 00 01 00 05 00 05\n"),
        Just(" (000.1)  can0  TX - -  1A0   [1]  FF 'x'\n"),
        Just("   0.500932 1  1A0             Rx   d 8 FF FE 00 01 00 05 00 05\n"),
        Just(" 1.0 CANFD   1 Rx 1A0 1 0 8  2 11 22 1 1 3000\n"),
        Just("base dec timestamps relative\n"),
        Just(";$FILEVERSION=1.1\n;$STARTTIME=46344.69445023148\n"),
        Just("     1)      1059.9  Rx         01A0  8  FF FE 00 01 00 05 00 05\r\n"),
        Just(";$COLUMNS=N,O,T,B,I,d,R,L,D\n"),
        Just("1 0.932 DT 1 01A0 Rx - 1 FF\n"),
        Just("1795020000.500932,0x1a0,0,0,0,8,//4AAQAFAAU=\n"),
        Just("(99999999999999999999.0"),
        Just("(-9223372036.854775808) a 1#"),
        Just("\n"),
    ]
    .prop_map(|text| text.as_bytes().to_vec());
    let binary = prop_oneof![
        Just(pcap(false, true, 113, &[])),
        Just(pcap(true, false, 227, &[socketcan([0, 0, 1, 0xA0], &DATA)])),
        Just(0x0A0D_0D0Au32.to_be_bytes().to_vec()),
        Just(vec![28, 0, 0, 0, 0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0]),
        Just(vec![0xFF; 8]),
        proptest::collection::vec(any::<u8>(), 0..30),
    ];
    proptest::collection::vec(prop_oneof![text, binary], 0..12).prop_map(|parts| parts.concat())
}

proptest! {
    #[test]
    fn any_bytes_in_any_chunks_give_the_same_events(bytes in debris(), length in 1usize..60) {
        for format in Format::all() {
            if format.reader().is_some() {
                prop_assert_eq!(read(format, &bytes, length), read(format, &bytes, usize::MAX));
            }
        }
        detect(&bytes, false);
        detect(&bytes, true);
    }

    #[test]
    fn the_fast_way_reads_as_the_slow_way(seconds in 0u64..9_223_372_036, digits in 0u32..10, micros in 0u32..1_000_000,
                                          id in 0u32..0x800, data in any::<u64>(), at in 0usize..50, other in any::<u8>()) {
        let seconds = seconds / 10u64.pow(digits);
        let fast = format!("({seconds}.{micros:06}) can0 {id:03X}#{data:016X}\n");
        let slow = format!("({seconds}.{micros:06}) can0  {id:03X}#{data:016X} R\n");
        // Lines behind, as the fast way reads only before others.
        let behind = "# ".repeat(50);
        let seen = events(CANDUMP, &format!("(0.5) can0 123#\n{fast}{slow}{fast}{behind}"));
        prop_assert_eq!(&seen[1], &seen[2]);
        prop_assert_eq!(&seen[1], &seen[3]);
        prop_assert_eq!(&seen[1], &frame((seconds * 1_000_000 + u64::from(micros)) as i64 * 1_000, "can0", id, &data.to_be_bytes()));
        // With one byte changed, which only the slow way reads first.
        let mut changed = fast.clone().into_bytes();
        let length = changed.len() - 1;
        changed[at % length] = if other == b'\n' { b' ' } else { other };
        let lone = read(CANDUMP, &changed, usize::MAX);
        let among = read(CANDUMP, &[fast.as_bytes(), &changed, behind.as_bytes()].concat(), usize::MAX);
        prop_assert_eq!(&lone[0].1, &among[1].1);
    }
}

#[test]
fn a_line_without_end_does_not_grow_for_ever() {
    let mut bytes = vec![b'x'; 3 * MAX_RECORD];
    bytes.extend(b"\n(0.5) can0 1A0#FF\n");
    let expected = [
        (RecordPosition::Line(1), Seen::Broken(false)),
        (RecordPosition::Line(2), frame(500_000_000, "can0", 0x1A0, &[0xFF])),
    ];
    for length in [1_000, 100_000, usize::MAX] {
        assert_eq!(read(CANDUMP, &bytes, length), expected, "{length}");
    }
}
