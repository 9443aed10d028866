//! PEAK TRC, python-can's CSV and Vector BLF.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::*;

const TRC: &Format = &trc::FORMATS[0];
const CSV: &Format = &python_csv::FORMATS[0];
pub(super) const BLF: &Format = &blf::FORMATS[0];

fn contents(seen: Vec<(RecordPosition, Seen)>) -> Vec<Seen> {
    seen.into_iter().map(|(_, seen)| seen).collect()
}

#[test]
fn peak_trc_is_read_in_every_version() {
    let event = |kind: &Seen, bus: &str| match kind {
        Seen::Frame(time, _, id, extended, data) => Seen::Frame(*time, bus.into(), *id, *extended, data.clone()),
        other => other.clone(),
    };
    // Header, bus, and lines: a frame, an extended frame, a remote frame, an error frame, a change of the hardware's state.
    let short = Seen::Frame(Some(60_000_000), String::new(), 0x1FF_01A0, true, vec![0xFF]);
    let expected = [frame(59_900_000, "", 0x1A0, &DATA), short, Seen::Remote, Seen::Error, Seen::Remark];
    for (header, bus, lines) in [
        (
            "",
            "",
            [
                "1) 59.9 01A0 8 FF FE 00 01 00 05 00 05",
                "2) 60 01FF01A0 1 FF",
                "3) 61 0100 3 RTR",
                "4) 62 0008 4 ERROR 00 19 08 08",
                "5) 63 FFFFFFFF 4 00 00 00 04 BUSLIGHT",
            ],
        ),
        (
            "1.1",
            "",
            [
                "     1)        59.9  Rx         01A0  8  FF FE 00 01 00 05 00 05 ",
                "2) 60.0 Tx 01FF01A0 1 FF",
                "3) 61.0 Rx 0100 3 RTR",
                "4) 62.0 Error 0008 4 00 19 08 08",
                "5) 63.0 Warng FFFFFFFF 4 00 00 00 04 BUSLIGHT",
            ],
        ),
        (
            "1.2",
            "2",
            [
                "1) 59.900 2 Rx 01A0 8 FF FE 00 01 00 05 00 05",
                "2) 60.000 2 Tx 01FF01A0 1 FF",
                "3) 61.000 2 Rx 0100 3 RTR",
                "4) 62.000 2 Error 0008 4 00 19 08 08",
                "5) 63.000 2 Warng FFFFFFFF 4 00 00 00 04 BUSLIGHT",
            ],
        ),
        (
            "1.3",
            "2",
            [
                "1) 59.900 2 Rx 01A0 - 8 FF FE 00 01 00 05 00 05",
                "2) 60.000 2 Tx 01FF01A0 - 1 FF",
                "3) 61.000 2 Rx 0100 - 3 RTR",
                "4) 62.000 2 Error 0008 - 4 00 19 08 08",
                "5) 63.000 2 Rx 18EF0000 - 9 01 02 03 04 05 06 07 08 09",
            ],
        ),
        (
            "2.0\n;$COLUMNS=N,O,T,I,d,l,D",
            "",
            [
                "1 59.900 DT 01A0 Rx 8 FF FE 00 01 00 05 00 05",
                "2 60.000 DT 01FF01A0 Tx 1 FF",
                "3 61.000 RR 0100 Rx 3",
                "4 62.000 ER Rx 04 00 02 00 00",
                "5 63.000 EC Rx 02 02",
            ],
        ),
        (
            "2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D",
            "2",
            [
                "      1        59.900 DT  2     01A0 Rx -  8    FF FE 00 01 00 05 00 05",
                "2 60.000 DT 2 01FF01A0 Tx - 1 FF",
                "3 61.000 RR 2 0100 Rx - 3",
                "4 62.000 ER 2 - Rx - 5 04 00 02 00 00",
                "5 63.000 EV 2 a note of the user",
            ],
        ),
    ] {
        let header = if header.is_empty() { ";   C:\\trace.trc\n".into() } else { format!(";$FILEVERSION={header}\n") };
        let text = format!("{header}{}\n", lines.join("\n"));
        assert_eq!(detected(text.as_bytes(), true), TRC.name, "{text}");
        let seen = events(TRC, &text);
        let expected: Vec<_> = expected.iter().map(|kind| event(kind, bus)).collect();
        assert_eq!(seen[header.lines().count()..], expected, "{text}");
    }
}

#[test]
fn peak_trc_times_count_from_the_start_in_utc() {
    // python-can's header of a trace from 2026-11-18 16:40:00.5, and that of version 1.2 with its semicolon.
    for start in ["46344.69445023148", "46344.69445023148;"] {
        let text = format!(
            ";$FILEVERSION=2.1\n;$STARTTIME={start}\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n1 0.932 DT 1 01A0 Rx - 1 FF\n"
        );
        assert_eq!(events(TRC, &text)[3], frame(T_NS, "1", 0x1A0, &[0xFF]));
    }
    for broken in [
        ";$STARTTIME=1e300",
        ";$STARTTIME=nan",
        "1) 59.9 Rx 01A0 8 FF FE 00 01 00 05 00",
        "1) 59.9 Rx 01A0 8 FF FE 00 01 00 05 00 5",
        "1) 59.9 Rx 01A0 1 FF FE",
        "1) 59.9 Rx 08A0 1 FF",
        "1) 59.9 Rx 2FFFFFFF 1 FF",
        "1) 59.9 Xx 01A0 1 FF",
        "x) 59.9 Rx 01A0 1 FF",
        "1) 59.9",
    ] {
        assert_eq!(events(TRC, &format!(";$FILEVERSION=1.1\n{broken}\n"))[1], Seen::Broken(false), "{broken}");
    }
    let fd =
        ";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n5 1334.416 FD 0500 Tx 12 01 02 03 04 05 06 07 08 09 0A 0B 0C\n";
    assert_eq!(events(TRC, fd)[2], Seen::Fd);
}

#[test]
fn python_can_csv_is_read_line_by_line() {
    let header = "timestamp,arbitration_id,extended,remote,error,dlc,data";
    for (line, expected) in [
        ("1795020000.500932,0x1a0,0,0,0,8,//4AAQAFAAU=", frame(T_NS, "", 0x1A0, &DATA)),
        ("0.5,0x1a0,1,0,0,1,/w==", Seen::Frame(Some(500_000_000), String::new(), 0x1A0, true, vec![0xFF])),
        ("5e-05,0x1a0,0,0,0,0,", frame(50_000, "", 0x1A0, &[])),
        ("0.5,0x1a0,0,0,0,6,AQIDBAUG\r", frame(500_000_000, "", 0x1A0, &[1, 2, 3, 4, 5, 6])),
        ("0.5,0x1a0,0,1,0,8,", Seen::Remote),
        ("0.5,0x4,1,0,1,8,AAEAAAAAAAA=", Seen::Error),
        ("0.5,0x1a0,0,0,0,12,AAECAwQFBgcICQoL", Seen::Fd),
        (header, Seen::Remark),
        ("", Seen::Remark),
        ("0.5,0x1a0,0,0,0,8,//4AAQAFAAU", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,8,//4AAQAFAAUA", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,8,//4AAQAFAA==", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,3,//-A", Seen::Broken(false)),
        ("0.5,0x8a0,0,0,0,0,", Seen::Broken(false)),
        ("0.5,0x20000000,1,0,0,0,", Seen::Broken(false)),
        ("0.5,1a0,0,0,0,0,", Seen::Broken(false)),
        ("inf,0x1a0,0,0,0,0,", Seen::Broken(false)),
        ("1e300,0x1a0,0,0,0,0,", Seen::Broken(false)),
        ("0.5,0x1a0,0,2,0,0,", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,65,", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,4294967295,", Seen::Broken(false)),
        ("0.5,0x1a0,0,0,0,0,,", Seen::Broken(false)),
        ("0.5,0x1a0", Seen::Broken(false)),
    ] {
        assert_eq!(events(CSV, &format!("{header}\n{line}\n"))[1], expected, "{line}");
    }
    assert_eq!(detected(format!("{header}\n0.5,0x1a0,0,0,0,0,\n").as_bytes(), true), CSV.name);
    assert_eq!(events(CSV, "0.5,0x1a0,0,0,0,8,//4AAQAFAA")[0], Seen::Broken(true));
}

/// A BLF object of this type with the header of version 1 or 2.
pub(super) fn object(version: u16, kind: u32, flags: u32, ticks: u64, body: &[u8]) -> Vec<u8> {
    let header = if version == 1 { 32u16 } else { 40 };
    let length = u32::from(header) + body.len() as u32;
    let mut bytes =
        [&b"LOBJ"[..], &header.to_le_bytes(), &version.to_le_bytes(), &length.to_le_bytes(), &kind.to_le_bytes()]
            .concat();
    bytes.extend([&flags.to_le_bytes()[..], &[0; 4], &ticks.to_le_bytes()].concat());
    bytes.resize(header.into(), 0);
    bytes.extend(body);
    bytes.resize(bytes.len() + length as usize % 4, 0);
    bytes
}

/// Body of a CAN message.
pub(super) fn message(flags: u8, id: u32, data: &[u8]) -> Vec<u8> {
    let mut body = [&[2, 0, flags, data.len() as u8][..], &id.to_le_bytes(), data].concat();
    body.resize(16, 0);
    body
}

pub(super) fn container(method: u16, content: &[u8]) -> Vec<u8> {
    let length = (32 + content.len() as u32).to_le_bytes();
    let header =
        [b"LOBJ\x10\0\x01\0", &length[..], &10u32.to_le_bytes(), &method.to_le_bytes(), &[0; 6], &[0xFF; 4], &[0; 4]]
            .concat();
    [header, content.to_vec(), vec![0; content.len() % 4]].concat()
}

fn zlib(content: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(content).expect("bytes in memory");
    container(2, &encoder.finish().expect("bytes in memory"))
}

/// A file that starts at 2026-11-18 16:40:00.500.
pub(super) fn blf(objects: &[Vec<u8>]) -> Vec<u8> {
    let mut header = [&b"LOGG"[..], &144u32.to_le_bytes(), &[0; 32]].concat();
    header.extend([2026u16, 11, 3, 18, 16, 40, 0, 500].iter().flat_map(|number| number.to_le_bytes()));
    header.resize(144, 0);
    [header, objects.concat()].concat()
}

/// Eight objects: two frames, then one each of the other kinds.
fn objects() -> Vec<u8> {
    let fd = |flags: u8| [&[2, 0, 0, 8, 0xA0, 1, 0, 0][..], &[0, 0, 0, 0, 0, flags, 8, 0, 0, 0, 0, 0], &DATA].concat();
    let fd_64 =
        |flags: u32| [&[2, 8, 8, 0, 0xA0, 1, 0, 0, 0, 0, 0, 0][..], &flags.to_le_bytes(), &[0; 24], &DATA].concat();
    [
        object(1, 1, 2, 932_000, &message(0, 0x1A0, &DATA)),
        object(2, 86, 1, 94, &message(1, 0x8000_01A0, &[0xFF])),
        object(1, 1, 2, 0, &message(0x80, 0x1A0, &[])),
        object(1, 73, 2, 0, &[0; 32]),
        object(1, 100, 2, 0, &fd(1)),
        object(1, 100, 2, 932_000, &fd(0)),
        object(1, 101, 2, 0, &fd_64(0x1000)),
        object(1, 101, 2, 932_000, &fd_64(0)),
        object(1, 96, 2, 0, b"a marker of the user"),
    ]
    .concat()
}

fn expected() -> Vec<Seen> {
    let usual = frame(T_NS, "2", 0x1A0, &DATA);
    let extended = Seen::Frame(Some(1_795_020_000_500_940_000), "2".into(), 0x1A0, true, vec![0xFF]);
    vec![usual.clone(), extended, Seen::Remote, Seen::Error, Seen::Fd, usual.clone(), Seen::Fd, usual, Seen::Remark]
}

#[test]
fn vector_blf_is_read_compressed_stored_and_across_containers() {
    let all = objects();
    let (a, b) = all.split_at(250);
    for file in [
        blf(&[zlib(&all)]),
        blf(&[container(0, &all)]),
        blf(&[zlib(a), zlib(b)]),
        blf(&[container(0, a), zlib(b)]),
        blf(std::slice::from_ref(&all)),
    ] {
        assert_eq!(detected(&file, false), BLF.name);
        for length in [1, 7, 1_000] {
            assert_eq!(contents(read(BLF, &file, length)), expected());
        }
    }
    let mut unstarted = blf(&[zlib(&all)]);
    unstarted[40..56].fill(0);
    assert_eq!(contents(read(BLF, &unstarted, 100))[0], frame(932_000, "2", 0x1A0, &DATA));
}

#[test]
fn damaged_blf_gives_the_frames_of_all_other_containers() {
    let frames = |count: usize| object(1, 1, 2, 932_000, &message(0, 0x1A0, &DATA)).repeat(count);
    let usual = frame(T_NS, "2", 0x1A0, &DATA);
    let (good, bad) = (zlib(&frames(2)), container(2, b"no data of zlib"));
    let usual = |count: usize| vec![usual.clone(); count];
    let with = |parts: &[&[Seen]]| parts.concat();
    let cut = [Seen::Broken(true)];
    let mut reaches_over = good.clone();
    let length = (2 * good.len()) as u32;
    reaches_over[8..12].copy_from_slice(&length.to_le_bytes());
    for (file, expected) in [
        (blf(&[reaches_over, good.clone(), good.clone()]), with(&[&usual(2), &cut, &usual(4)])),
        (blf(&[good.clone(), bad, good.clone()]), with(&[&usual(2), &cut, &usual(2)])),
        (blf(&[good.clone(), container(7, b"unknown"), good.clone()]), with(&[&usual(2), &cut, &usual(2)])),
        (blf(&[good.clone(), b"no object here".to_vec(), good.clone()]), with(&[&usual(2), &cut, &usual(2)])),
        (
            blf(&[container(0, &[&frames(1)[..], &[0xAA; 30], &frames(1)].concat())]),
            with(&[&usual(1), &cut, &usual(1)]),
        ),
        // The object continues in a damaged or a missing container.
        (blf(&[zlib(&frames(2)[..60]), container(2, b"!"), good.clone()]), with(&[&usual(1), &cut, &usual(2)])),
        (blf(&[zlib(&frames(2)[..60])]), with(&[&usual(1), &cut])),
        (blf(&[good.clone(), container(0, &frames(2))[..100].to_vec()]), with(&[&usual(3), &cut])),
        (blf(&[good.clone(), good[..20].to_vec()]), with(&[&usual(2), &cut])),
        (blf(&[]), vec![]),
        (blf(std::slice::from_ref(&good))[..100].to_vec(), cut.to_vec()),
        // Without a readable header there is no start.
        ([b"LOGG\xFF\xFF\xFF\xFF".to_vec(), good].concat(), with(&[&cut, &vec![frame(932_000, "2", 0x1A0, &DATA); 2]])),
    ] {
        for length in [1, 50, 10_000] {
            assert_eq!(contents(read(BLF, &file, length)), expected, "{file:?}");
        }
    }
}

#[test]
fn a_container_that_claims_four_gigabytes_takes_no_memory() {
    let frames = object(1, 1, 2, 932_000, &message(0, 0x1A0, &DATA));
    let mut large = object(1, 65, 2, 0, &vec![0; 5 << 20]);
    let inside = blf(&[zlib(&[large.clone(), frames.clone()].concat())]);
    assert_eq!(contents(read(BLF, &inside, 1_000)), [Seen::Remark, frame(T_NS, "2", 0x1A0, &DATA)]);
    large[8..12].fill(0xFF);
    let mut claims = blf(&[container(0, &frames), large]);
    claims[144 + 8..144 + 12].fill(0xFF);
    let seen = contents(read(BLF, &claims, 100_000));
    assert_eq!(seen, [frame(T_NS, "2", 0x1A0, &DATA), Seen::Remark, Seen::Broken(true)]);
}

proptest! {
    #[test]
    fn blf_with_other_bytes_gives_the_same_events_in_any_chunks(changes in proptest::collection::vec((any::<usize>(), any::<u8>()), 1..6),
                                                                is_compressed in any::<bool>(), length in 1usize..300) {
        let all = [objects(), objects()].concat();
        let pack = |content: &[u8]| if is_compressed { zlib(content) } else { container(0, content) };
        let mut file = blf(&[pack(&all), pack(&all[..300]), pack(&all[300..])]);
        for (at, byte) in changes {
            let at = at % file.len();
            file[at] = byte;
        }
        prop_assert_eq!(read(BLF, &file, length), read(BLF, &file, usize::MAX));
    }
}
