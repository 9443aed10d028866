//! CRC-16/IBM-3740: polynomial 1021, initial value FFFF, not reflected, no final exclusive-or.

use ::crc::{CRC_16_IBM_3740, Crc, Table};

const ENGINE: Crc<u16, Table<BLOCK>> = Crc::<u16, Table<BLOCK>>::new(&CRC_16_IBM_3740);
/// Bytes that the engine takes in one step.
const BLOCK: usize = 16;

/// For each number of zero bytes, the value that becomes the initial value behind them.
const BEFORE_ZEROS: [u16; BLOCK] = {
    let mut before = [CRC_16_IBM_3740.init; BLOCK];
    let mut count = 1;
    while count < BLOCK {
        let (mut value, mut bit) = (before[count - 1], 0);
        while bit < 8 {
            // The polynomial is odd: it was applied if the lowest bit is set.
            value = if value & 1 == 1 { (value ^ CRC_16_IBM_3740.poly) >> 1 | 0x8000 } else { value >> 1 };
            bit += 1;
        }
        before[count] = value;
        count += 1;
    }
    before
};

/// Zeros before fewer bytes than a block make it whole: one step in place of a step for each byte.
#[inline]
pub fn crc16(bytes: &[u8]) -> u16 {
    let missing = if bytes.is_empty() { 0 } else { BLOCK.saturating_sub(bytes.len()) };
    let mut digest = ENGINE.digest_with_initial(BEFORE_ZEROS[missing]);
    if missing == 0 {
        digest.update(bytes);
    } else {
        let mut block = [0; BLOCK];
        block[missing..].copy_from_slice(bytes);
        digest.update(&block);
    }
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_published_check_value() {
        // The catalogue of parametrised CRC algorithms gives 29B1 for "123456789".
        assert_eq!(crc16(b"123456789"), 0x29B1);
    }

    #[test]
    fn whole_blocks_give_what_single_bytes_give() {
        let bytes: Vec<u8> = (0..70).map(|index| (index * 37 + 11) as u8).collect();
        for length in 0..bytes.len() {
            assert_eq!(crc16(&bytes[..length]), ENGINE.checksum(&bytes[..length]), "{length}");
        }
    }
}
