//! The test vectors of the interface control document, byte for byte, both ways.

use geu_protocol::can::{AssembledSample, AssemblerEvent};
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, data_frame, read_data};
use geu_protocol::{Assembler, CanIdMap, Sample};

const SAMPLE_INTERVAL: Sample = Sample {
    sequence: 0,
    increments: [-2, -2, 5, 5],
    gyro_flags: 0x0F,
    unit_flags: 0x07,
    electronics_centi_c: 2064,
    clock_count: 500_000,
    sensor_centi_c: 7000,
};
const CAN: [(u16, u64); 3] =
    [(0x1A0, 0xFFFE_FFFE_0005_0005), (0x1A1, 0x0000_0F07_0810_DD5E), (0x1A2, 0x0000_0007_A120_1B58)];
const SERIAL: [u8; 28] = [
    0xEB, 0x90, 0x01, 0x16, 0x00, 0x00, 0xFF, 0xFE, 0xFF, 0xFE, 0x00, 0x05, 0x00, 0x05, 0x0F, 0x07, 0x08, 0x10, 0x00,
    0x00, 0x00, 0x07, 0xA1, 0x20, 0x1B, 0x58, 0xF4, 0xC5,
];

#[test]
fn can_frames_are_those_of_the_document() {
    let plan = CanIdMap::default();
    for (frame, (id, data)) in plan.frames(&SAMPLE_INTERVAL).iter().zip(CAN) {
        assert_eq!((frame.id(), frame.data()), (id.into(), &data.to_be_bytes()[..]));
    }
    let (mut assembler, mut found) = (Assembler::default(), Vec::new());
    for (stamp, (id, data)) in CAN.into_iter().enumerate() {
        assembler.push(plan.role(id.into()), stamp, &data.to_be_bytes(), &mut |event| found.push(event));
    }
    assert_eq!(found, [AssemblerEvent::Row(AssembledSample { stamp: 0, sample: SAMPLE_INTERVAL, has_clock: true })]);
}

#[test]
fn the_serial_frame_is_that_of_the_document() {
    assert_eq!(data_frame(&SAMPLE_INTERVAL), SERIAL);
    let mut found = Vec::new();
    Deframer::default().consume(&SERIAL, &mut |event| {
        if let DeframerEvent::Frame { at: 0, kind: FrameType::Data, payload } = event {
            found.push(read_data(payload));
        }
    });
    assert_eq!(found, [SAMPLE_INTERVAL]);
}
