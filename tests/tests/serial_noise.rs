//! A million good serial frames among random noise, truncated and bit-flipped frames.

use geu_protocol::serial::{MAX_FRAME, SYNC, SerialDefect, data_frame};
use geu_protocol::{CLOCK_PER_SAMPLE, Sample};
use geu_recording::{Decode, Decoder, DecoderOptions, Defect, DefectKind, ReceivedSample, Sink};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const FRAMES: u64 = 1_000_000;
const SEED: u64 = 0x6E75;
/// Sequence and clock begin somewhere, so that nothing looks like a restart.
const FIRST_SEQUENCE: u64 = 40_000;
const FIRST_CLOCK: u64 = 1 << 40;

fn good(index: u64) -> Sample {
    let mix = index.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    Sample {
        sequence: (FIRST_SEQUENCE + index) as u16,
        increments: [mix as i16, (mix >> 16) as i16, (mix >> 32) as i16, (mix >> 48) as i16],
        gyro_flags: 0x0F,
        unit_flags: 0x07,
        electronics_centi_c: 2_000,
        clock_count: FIRST_CLOCK + index * CLOCK_PER_SAMPLE,
        sensor_centi_c: 7_000,
    }
}

/// Compares decoded samples as they arrive.
#[derive(Default)]
struct Check {
    /// Good frames that came, each once and in order.
    came: u64,
    /// Index of the next good frame.
    next: u64,
    /// DATA that is no good frame.
    accidents: u64,
    /// Defects of the clock, and of the sequence.
    doubted: u64,
    jumps: u64,
    /// Samples reported as missing.
    lost: u64,
    /// Syncs with a good header and a CRC that does not match.
    mismatched: u64,
}

impl Sink for Check {
    fn row(&mut self, row: &ReceivedSample) {
        let index = row.sample.clock_count.wrapping_sub(FIRST_CLOCK) / CLOCK_PER_SAMPLE;
        if (self.next..FRAMES).contains(&index) && row.sample == good(index) {
            self.came += 1;
            self.next = index + 1;
        } else {
            self.accidents += 1;
        }
    }

    fn defect(&mut self, defect: &Defect) {
        match defect.kind {
            DefectKind::ClockInconsistent => self.doubted += 1,
            DefectKind::SequenceGap => self.lost += defect.lost,
            DefectKind::SequenceJump => self.jumps += 1,
            DefectKind::Serial(SerialDefect::CrcMismatch) => self.mismatched += 1,
            _ => {}
        }
    }
}

#[test]
fn a_million_good_frames_come_out_of_noise_and_nothing_else_does() {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let (mut decoder, mut check) = (Decoder::new(&DecoderOptions::default()), Check::default());
    decoder.begin("noise.bin", &mut check);
    let (mut bytes, mut fed) = (Vec::new(), 0u64);
    for index in 0..FRAMES {
        match random.random_range(0..4) {
            0 => {
                // Noise, thick with beginnings of frames.
                let length = random.random_range(0..60);
                for _ in 0..length {
                    match random.random_range(0..8) {
                        0 => bytes.extend(SYNC),
                        1 => bytes.extend([0xEB, 0x90, 0x01, 22]),
                        _ => bytes.push(random.next_u32() as u8),
                    }
                }
            }
            1 => {
                // Both bytes of the CRC or more are missing: with one missing, the EB of the next frame is the right one in
                // 1 of 256 cases.
                let cut = random.random_range(1..=MAX_FRAME - 2);
                bytes.extend(&data_frame(&good(random.next_u32().into()))[..cut]);
            }
            2 => {
                let mut frame = data_frame(&good(random.next_u32().into()));
                for _ in 0..random.random_range(1..4) {
                    frame[random.random_range(0..MAX_FRAME)] ^= 1 << random.random_range(0..8);
                }
                // Two flips of one bit are none.
                if frame == data_frame(&geu_protocol::serial::read_data(&frame[4..26])) {
                    frame[10] ^= 1;
                }
                bytes.extend(frame);
            }
            _ => {}
        }
        bytes.extend(data_frame(&good(index)));
        if bytes.len() > 1 << 14 || index + 1 == FRAMES {
            // In blocks of any length.
            let mut rest = &bytes[..];
            while !rest.is_empty() {
                let (block, behind) = rest.split_at(random.random_range(1..=rest.len().min(5_000)));
                decoder.serial(block, None, &mut check);
                rest = behind;
            }
            fed += bytes.len() as u64;
            bytes.clear();
        }
    }
    decoder.finish(&mut check);
    let summary = decoder.summary();
    let account = &summary.account;
    assert!(account.adds_up(), "{account:?}");
    assert_eq!(account.bytes, fed);
    // Each candidate (a sync with a good header) matches by accident with a probability of 1/65 536.
    let accidental = summary.serial_frames - check.came;
    let expected = (check.mismatched + accidental) as f64 / 65_536.0;
    // 99 % of Poisson's numbers, nearly normal from ten on; one more since they are whole.
    let bound = expected + 2.33 * expected.sqrt() + 1.0;
    println!(
        "seed {SEED}: {} of {FRAMES} good frames out of {fed} bytes; {} candidates rejected; {accidental} accidental \
         frames, {} of them DATA (expected {expected:.0}, 99 % bound {bound:.0})",
        check.came, check.mismatched, check.accidents
    );
    assert!((accidental as f64) < bound, "seed {SEED}");
    assert_eq!(
        (check.doubted, check.jumps),
        (check.accidents, 0),
        "each accident shows as a clock defect; seed {SEED}"
    );
    // An accidental frame may lie over the beginning of a good one; nothing else loses one, and it shows as a gap.
    assert!(FRAMES - check.came <= accidental, "seed {SEED}: {} good frames lost", FRAMES - check.came);
    assert!(check.lost <= FRAMES - check.came, "seed {SEED}");
}
