//! What the fuzzer found in captures.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::python_can::{BLF, blf, container, message, object};
use super::*;

/// Excerpts of the broken records of a capture in chunks of this length.
fn excerpts(format: &Format, bytes: &[u8], length: usize) -> Vec<Vec<u8>> {
    let (mut reader, mut excerpts, mut buffer) = (format.reader().expect("a reader"), Vec::new(), Vec::new());
    let mut sink = |_, record: CaptureRecord<'_>| {
        if let CaptureRecord::Broken { bytes, .. } = record {
            excerpts.push(bytes.to_vec());
        }
    };
    for chunk in bytes.chunks(length) {
        buffer.extend_from_slice(chunk);
        let used = reader.read(&buffer, false, &mut sink);
        buffer.drain(..used);
    }
    reader.read(&buffer, true, &mut sink);
    excerpts
}

#[test]
fn a_broken_record_of_a_binary_capture_is_reported_with_the_same_bytes_in_any_chunks() {
    let packets = pcap(false, false, 227, &[vec![0xA5; 300]]);
    let mut endless = packets.clone();
    endless[32..36].copy_from_slice(&[0xFF; 4]);
    let section = [0x0A, 0x0D, 0x0D, 0x0A, 28, 0, 0, 0, 0x4D, 0x3C, 0x2B, 0x1A];
    let unclosed = [&section[..], &[0; 400]].concat();
    let object = object(1, 1, 2, 0, &message(0, 0x1A0, &DATA));
    let between = blf(&[[&[7; 300][..], &object].concat()]);
    for (format, file) in [(PCAP, endless), (PCAPNG, unclosed), (BLF, between)] {
        let whole = excerpts(format, &file, usize::MAX);
        assert!(!whole.is_empty() && !whole[0].is_empty(), "{}", format.name);
        for length in [1, 7, 100] {
            assert_eq!(excerpts(format, &file, length), whole, "{} by {length}", format.name);
        }
    }
}

#[test]
fn a_standard_frame_with_an_identifier_of_more_than_eleven_bits_is_broken() {
    let standard = socketcan([0, 0, 0x07, 0xFF], &DATA);
    let longer = socketcan([0, 0, 0x08, 0], &DATA);
    let extended = socketcan([0x80, 0, 0x08, 0], &DATA);
    let seen = read(PCAP, &pcap(false, false, 227, &[standard, longer, extended]), 100);
    let is_read =
        |(_, seen): &(_, Seen)| matches!(seen, Seen::Frame(_, _, 0x7FF, false, _) | Seen::Frame(_, _, 0x800, true, _));
    assert_eq!(seen.iter().map(is_read).collect::<Vec<_>>(), [true, false, true]);
    assert_eq!(seen[1].1, Seen::Broken(false));
    let file = blf(&[object(1, 1, 2, 0, &message(0, 0x800, &DATA))]);
    assert_eq!(read(BLF, &file, 100)[0].1, Seen::Broken(false));
}

#[test]
fn a_container_that_ends_in_an_object_is_reported_from_its_signature_in_any_chunks() {
    let whole = object(1, 1, 2, 0, &message(0, 0x1A0, &DATA));
    // Behind bytes that are no object, two bytes before the object: they may arrive with it or before it.
    for (rest, excerpt) in [(&whole[..20], &whole[..20]), (&[], &[])] {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::none());
        encoder.write_all(&[&[7; 20][..], &[0; 2], rest].concat()).expect("bytes in memory");
        let compressed = encoder.finish().expect("bytes in memory");
        let file = blf(&[container(2, &compressed[..compressed.len() - 4])]);
        for length in 1..60 {
            assert_eq!(excerpts(BLF, &file, length), [&[7; 8][..], excerpt], "by {length}");
        }
    }
}

#[test]
fn a_damaged_container_that_the_file_cuts_is_reported_once() {
    let mut file = blf(&[container(2, &[0xFF; 40])]);
    file.truncate(file.len() - 10);
    for length in 1..200 {
        assert_eq!(read(BLF, &file, length).len(), 1, "by {length}");
    }
}
