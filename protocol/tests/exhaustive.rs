//! Properties of the default unit's codec for all inputs: each test counts through everything that it claims.

use geu_protocol::can::{AssembledSample, AssemblerEvent, CanDefect, Role};
use geu_protocol::command::{self, COMMANDS, CommandResult};
use geu_protocol::crc::crc16;
use geu_protocol::field::CLOCK_MODULUS;
use geu_protocol::serial::{
    Deframer, DeframerEvent, FrameType, HEADER, MAX_FRAME, SYNC, data_frame, frame, read_data, update_crc,
};
use geu_protocol::{Assembler, CanFrame, CanIdMap, Reply, Sample};

const SAMPLE: Sample = Sample {
    sequence: 0x1234,
    increments: [-2, 0x5A5A, 5, i16::MIN],
    gyro_flags: 0x0F,
    unit_flags: 0x07,
    electronics_centi_c: 2064,
    clock_count: 0xEB90_0116_1234,
    sensor_centi_c: 7000,
};

/// Frames in the order of their bytes, and the number of other bytes.
fn deframe(parts: &[&[u8]]) -> (Vec<(FrameType, Vec<u8>)>, u64) {
    let (mut deframer, mut carry, mut frames, mut skipped) = (Deframer::default(), Vec::new(), Vec::new(), 0);
    let mut sink = |event: DeframerEvent| match event {
        DeframerEvent::Frame { kind, payload, .. } => frames.push((kind, payload.to_vec())),
        DeframerEvent::Skipped { length, .. } => skipped += length,
        DeframerEvent::Rejected { .. } => {}
    };
    for part in parts {
        carry.extend_from_slice(part);
        let used = deframer.consume(&carry, &mut sink);
        carry.drain(..used);
    }
    deframer.finish(&carry, &mut sink);
    (frames, skipped)
}

fn comes_back(sample: Sample) {
    let bytes = data_frame(&sample);
    assert_eq!(read_data(&bytes[HEADER..]), sample);
    let mut found = None;
    let used = Deframer::default().consume(&bytes, &mut |event| match event {
        DeframerEvent::Frame { at: 0, kind: FrameType::Data, payload } => found = Some(read_data(payload)),
        event => panic!("{event:?}"),
    });
    assert_eq!((used, found), (MAX_FRAME, Some(sample)));
    let (ids, mut assembler, mut row) = (CanIdMap::default(), Assembler::default(), None);
    for frame in ids.frames(&sample) {
        assembler.push(ids.role(frame.id()), (), frame.data(), &mut |event| row = Some(event));
    }
    assert_eq!(row, Some(AssemblerEvent::Row(AssembledSample { stamp: (), sample, has_clock: true })));
}

#[test]
fn every_value_of_every_field_comes_back_from_both_links() {
    let set: [fn(&mut Sample, u16); 11] = [
        |sample, value| sample.sequence = value,
        |sample, value| sample.increments[0] = value as i16,
        |sample, value| sample.increments[1] = value as i16,
        |sample, value| sample.increments[2] = value as i16,
        |sample, value| sample.increments[3] = value as i16,
        |sample, value| sample.electronics_centi_c = value as i16,
        |sample, value| sample.sensor_centi_c = value as i16,
        |sample, value| [sample.gyro_flags, sample.unit_flags] = value.to_be_bytes(),
        |sample, value| sample.clock_count = u64::from(value),
        |sample, value| sample.clock_count = u64::from(value) << 16,
        |sample, value| sample.clock_count = u64::from(value) << 32,
    ];
    assert_eq!(CLOCK_MODULUS, 1 << 48);
    for set in set {
        for value in 0..=u16::MAX {
            let mut sample = SAMPLE;
            set(&mut sample, value);
            comes_back(sample);
        }
    }
}

#[test]
fn every_identifier_and_length_is_a_message_of_the_unit_or_other_traffic() {
    for base in (0..=CanIdMap::MAX_BASE).chain([CanIdMap::MAX_BASE + 1, u16::MAX]) {
        let Some(ids) = CanIdMap::with_base(base) else {
            assert!(base > CanIdMap::MAX_BASE);
            continue;
        };
        let own: Vec<u32> = (0..=0x7FF).filter(|id| ids.role(*id) != Role::Other).collect();
        assert_eq!(own, [0, 1, 2, 8, 9].map(|offset| u32::from(base) + offset));
    }
    let ids = CanIdMap::default();
    let good = ids.frames(&SAMPLE);
    for id in 0..=0xFFF {
        for length in 0..=9 {
            let bytes = [0xA5; 9];
            let Some(frame) = CanFrame::new(id, &bytes[..length]) else {
                assert!(id > 0x7FF || length > 8);
                continue;
            };
            assert_eq!((frame.id(), frame.data()), (id.into(), &bytes[..length]));
            // Between the frames of a sample.
            for place in 0..=good.len() {
                let (mut assembler, mut rows, mut defects) = (Assembler::default(), 0, 0);
                let mut traffic = good.to_vec();
                traffic.insert(place, frame);
                let mut sink = |event| match event {
                    AssemblerEvent::Row(AssembledSample { sample, has_clock, .. }) => {
                        rows += 2 + usize::from(has_clock);
                        let is_read =
                            |read: &Sample| (read.increments, read.sequence) == (SAMPLE.increments, SAMPLE.sequence);
                        assert!(is_read(&sample), "{id:03X}#{length} at {place}: {sample:?}");
                    }
                    AssemblerEvent::Defect((), defect, _) => defects += CanDefect::frames(defect) as usize,
                };
                for frame in &traffic {
                    assembler.push(ids.role(frame.id()), (), frame.data(), &mut sink);
                }
                assembler.finish(&mut sink);
                let is_cyclic = matches!(ids.role(id.into()), Role::Increments | Role::Status | Role::Clock);
                // Each frame of the unit is in a row or in a defect, once.
                assert_eq!(rows + defects, good.len() + usize::from(is_cyclic), "{id:03X}#{length} at {place}");
                assert!(is_cyclic || defects == 0);
            }
        }
    }
}

/// The change of the CRC by each pattern of one byte at each place of `length` bytes before the CRC.
fn syndromes(length: usize) -> Vec<[u16; 256]> {
    let none = crc16(&vec![0; length]);
    let of = |at: usize, pattern: u8| {
        let mut bytes = vec![0; length];
        bytes[at] = pattern;
        crc16(&bytes) ^ none
    };
    let mut all: Vec<[u16; 256]> = (0..length).map(|at| std::array::from_fn(|pattern| of(at, pattern as u8))).collect();
    // The CRC itself, high byte first.
    all.extend([8, 0].map(|shift| std::array::from_fn(|pattern| (pattern as u16) << shift)));
    all
}

/// A CRC is linear: a change is not detected if its bytes' changes of the CRC cancel.
#[test]
fn the_crc_detects_every_change_of_one_byte_of_two_adjacent_ones_and_of_up_to_three_bits() {
    // DATA behind its sync, and INCREMENTS with STATUS.
    for covered in [MAX_FRAME - SYNC.len() - 2, 14] {
        let syndromes = syndromes(covered);
        let mut undetected_of_two_bytes = 0u64;
        for (at, one) in syndromes.iter().enumerate() {
            assert!(one[1..].iter().all(|change| *change != 0), "byte {at}");
            for other in &syndromes[at + 1..] {
                let mut is_reached = vec![false; 1 << 16];
                one[1..].iter().for_each(|change| is_reached[usize::from(*change)] = true);
                undetected_of_two_bytes +=
                    other[1..].iter().filter(|change| is_reached[usize::from(**change)]).count() as u64;
            }
            if let Some(next) = syndromes.get(at + 1) {
                assert!(next[1..].iter().all(|change| !one.contains(change)), "bytes {at} and {}", at + 1);
            }
        }
        // Two bytes that are not adjacent: so few of 255² changes for each of their places cancel.
        assert_eq!(undetected_of_two_bytes, if covered == 14 { 82 } else { 301 });
        let bits: Vec<u16> = syndromes.iter().flat_map(|byte| (0..8).map(|bit| byte[1 << bit])).collect();
        for (index, first) in bits.iter().enumerate() {
            for (second_index, second) in bits.iter().enumerate().skip(index + 1) {
                assert_ne!(first, second);
                assert!(bits[second_index + 1..].iter().all(|third| first ^ second != *third));
            }
        }
    }
}

#[test]
fn no_changed_byte_of_a_frame_gives_another_sample() {
    let good = data_frame(&SAMPLE);
    for at in 0..good.len() {
        for change in 1..=u8::MAX {
            let mut bytes = good;
            bytes[at] ^= change;
            let (frames, skipped) = deframe(&[&bytes]);
            assert!(frames.is_empty() && skipped == MAX_FRAME as u64, "byte {at}, {change:02X}: {frames:?}");
        }
    }
    let ids = CanIdMap::default();
    let [increments, status, _] = ids.frames(&SAMPLE);
    for at in 0..16 {
        for change in 1..=u8::MAX {
            let mut bytes = [increments.data(), status.data()].concat();
            bytes[at] ^= change;
            let mut found = Vec::new();
            let mut assembler = Assembler::default();
            assembler.push(Role::Increments, (), &bytes[..8], &mut |event| found.push(event));
            assembler.push(Role::Status, (), &bytes[8..], &mut |event| found.push(event));
            assembler.finish(&mut |event| found.push(event));
            assert!(
                matches!(found[..], [AssemblerEvent::Defect((), CanDefect::CrcMismatch, _)]),
                "byte {at}, {change:02X}"
            );
        }
    }
}

/// All sequences of up to seven bytes that begin frames.
#[test]
fn every_short_sequence_of_syncs_types_and_lengths_is_accounted_for_however_it_is_cut() {
    const BYTES: [u8; 6] = [0xEB, 0x90, 0x10, 0x11, 1, 2];
    for length in 0..=7u32 {
        for number in 0..6usize.pow(length) {
            let bytes: Vec<u8> = (0..length).map(|place| BYTES[number / 6usize.pow(place) % 6]).collect();
            let whole = deframe(&[&bytes]);
            let framed: usize = whole.0.iter().map(|(_, payload)| payload.len() + HEADER + 2).sum();
            assert_eq!(framed as u64 + whole.1, bytes.len() as u64);
            let (first, last) = bytes.split_at(bytes.len() / 2);
            assert_eq!(whole, deframe(&[first, last]), "{bytes:02X?}");
        }
    }
}

#[test]
fn every_command_of_up_to_two_bytes_and_of_three_with_an_opcode_below_16_is_understood_or_refused_as_its_table_states()
{
    let mut payloads: Vec<Vec<u8>> = vec![Vec::new()];
    payloads.extend((0..=u8::MAX).map(|byte| vec![byte]));
    payloads.extend((0..=u16::MAX).map(|bytes| bytes.to_be_bytes().to_vec()));
    payloads.extend((0..1u32 << 20).map(|bytes| bytes.to_be_bytes()[1..].to_vec()));
    // SELF_TEST, each argument with all of its values.
    payloads.extend((0..=u8::MAX).map(|gyros| vec![4, gyros, 0, 1, 1]));
    payloads.extend((0..=u16::MAX).map(|counts| [&[4, 1][..], &counts.to_be_bytes(), &[1]].concat()));
    payloads.extend((0..=u8::MAX).map(|samples| vec![4, 1, 0, 1, samples]));
    for payload in payloads {
        let spec = COMMANDS.iter().find(|spec| Some(&spec.opcode) == payload.first());
        let expected = match (spec, payload.len()) {
            (_, 0) => Err(CommandResult::BadArgument),
            (None, _) => Err(CommandResult::UnknownOpcode),
            (Some(spec), length) => {
                let own: usize = spec.arguments.iter().map(|argument| argument.wire.length()).sum();
                let mut rest = &payload[1..];
                let is_in_range = own + 1 == length
                    && spec.arguments.iter().all(|argument| {
                        let (bytes, after) = rest.split_at(argument.wire.length());
                        rest = after;
                        let unsigned = bytes.iter().fold(0i64, |value, byte| value << 8 | i64::from(*byte));
                        let value = if argument.wire.limits().0 < 0 { i64::from(unsigned as i16) } else { unsigned };
                        (argument.range.0..=argument.range.1).contains(&value)
                    });
                if is_in_range { Ok(()) } else { Err(CommandResult::BadArgument) }
            }
        };
        assert_eq!(command::parse(&payload).map(|_| ()), expected, "{payload:02X?}");
    }
}

#[test]
fn every_reply_of_two_and_three_bytes_comes_back() {
    let comes_back = |payload: &[u8]| match Reply::read(payload) {
        Some(reply) => assert_eq!(reply.bytes(), payload),
        None => assert!(payload[1] > 3),
    };
    (0..=u16::MAX).for_each(|bytes| comes_back(&bytes.to_be_bytes()));
    (0..1u32 << 24).for_each(|bytes| comes_back(&bytes.to_be_bytes()[1..]));
}

#[test]
fn every_payload_of_one_and_two_bytes_is_found_in_its_frame() {
    for kind in [FrameType::Command, FrameType::Reply] {
        for bytes in 0..=u16::MAX {
            let payload = bytes.to_be_bytes();
            for payload in [&payload[..], &payload[..1]] {
                let accepted = kind == FrameType::Command || payload.len() == 2;
                let bytes = frame(kind, payload);
                let (frames, skipped) = deframe(&[&bytes]);
                assert_eq!(frames, if accepted { vec![(kind, payload.to_vec())] } else { Vec::new() });
                assert_eq!(skipped, if accepted { 0 } else { bytes.len() as u64 });
                let mut again = bytes.clone();
                update_crc(&mut again);
                assert_eq!(again, bytes);
            }
        }
    }
}
