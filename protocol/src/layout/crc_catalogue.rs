//! The CRC catalogue: algorithms by their names.

use ::crc::{self, Algorithm};

/// An algorithm of any width in a register of 32 bits.
///
/// Only [`crate::crc`] uses a register of 16 bits, so that the compiler makes code for its algorithm alone.
macro_rules! in_32_bits {
    ($algorithm:expr) => {
        Algorithm {
            width: $algorithm.width,
            poly: $algorithm.poly as u32,
            init: $algorithm.init as u32,
            refin: $algorithm.refin,
            refout: $algorithm.refout,
            xorout: $algorithm.xorout as u32,
            check: $algorithm.check as u32,
            residue: $algorithm.residue as u32,
        }
    };
}

/// Makes a list of the names and parameters of CRC algorithms: `CRC_16_XMODEM` is `CRC-16/XMODEM`.
macro_rules! catalogue {
    ($($algorithm:ident)*) => {
        static CATALOGUE: &[(&str, Algorithm<u32>)] =
            &[$((stringify!($algorithm), in_32_bits!(crc::$algorithm)),)*];
    };
}

catalogue! {
    CRC_8_AUTOSAR CRC_8_BLUETOOTH CRC_8_CDMA2000 CRC_8_DARC CRC_8_DVB_S2 CRC_8_GSM_A CRC_8_GSM_B CRC_8_HITAG CRC_8_I_432_1
    CRC_8_I_CODE CRC_8_LTE CRC_8_MAXIM_DOW CRC_8_MIFARE_MAD CRC_8_NRSC_5 CRC_8_OPENSAFETY CRC_8_ROHC CRC_8_SAE_J1850 CRC_8_SMBUS
    CRC_8_TECH_3250 CRC_8_WCDMA CRC_16_ARC CRC_16_CDMA2000 CRC_16_CMS CRC_16_DDS_110 CRC_16_DECT_R CRC_16_DECT_X CRC_16_DNP
    CRC_16_EN_13757 CRC_16_GENIBUS CRC_16_GSM CRC_16_IBM_3740 CRC_16_IBM_SDLC CRC_16_ISO_IEC_14443_3_A CRC_16_KERMIT
    CRC_16_LJ1200 CRC_16_M17 CRC_16_MAXIM_DOW CRC_16_MCRF4XX CRC_16_MODBUS CRC_16_NRSC_5 CRC_16_OPENSAFETY_A CRC_16_OPENSAFETY_B
    CRC_16_PROFIBUS CRC_16_RIELLO CRC_16_SPI_FUJITSU CRC_16_T10_DIF CRC_16_TELEDISK CRC_16_TMS37157 CRC_16_UMTS CRC_16_USB
    CRC_16_XMODEM CRC_24_BLE CRC_24_FLEXRAY_A CRC_24_FLEXRAY_B CRC_24_INTERLAKEN CRC_24_LTE_A CRC_24_LTE_B CRC_24_OPENPGP
    CRC_24_OS_9 CRC_32_AIXM CRC_32_AUTOSAR CRC_32_BASE91_D CRC_32_BZIP2 CRC_32_CD_ROM_EDC CRC_32_CKSUM CRC_32_ISCSI
    CRC_32_ISO_HDLC CRC_32_JAMCRC CRC_32_MEF CRC_32_MPEG_2 CRC_32_XFER
}

/// Other names of algorithms in the CRC catalogue, of those in data sheets.
const ALIASES: [(&str, &str); 17] = [
    ("CRC-8", "CRC-8/SMBUS"),
    ("CRC-8/MAXIM", "CRC-8/MAXIM-DOW"),
    ("CRC-16", "CRC-16/ARC"),
    ("CRC-16/AUTOSAR", "CRC-16/IBM-3740"),
    ("CRC-16/BUYPASS", "CRC-16/UMTS"),
    ("CRC-16/CCITT-FALSE", "CRC-16/IBM-3740"),
    ("CRC-16/CCITT-TRUE", "CRC-16/KERMIT"),
    ("CRC-16/DARC", "CRC-16/GENIBUS"),
    ("CRC-16/ISO-HDLC", "CRC-16/IBM-SDLC"),
    ("CRC-16/LHA", "CRC-16/ARC"),
    ("CRC-16/LTE", "CRC-16/XMODEM"),
    ("CRC-16/X-25", "CRC-16/IBM-SDLC"),
    ("CRC-32", "CRC-32/ISO-HDLC"),
    ("CRC-32/AAL5", "CRC-32/BZIP2"),
    ("CRC-32/CASTAGNOLI", "CRC-32/ISCSI"),
    ("CRC-32/POSIX", "CRC-32/CKSUM"),
    ("CRC-32C", "CRC-32/ISCSI"),
];

/// A name of the catalogue: width after a hyphen, the rest after a slash.
fn catalogue_name(algorithm: &str) -> String {
    let mut parts = algorithm.splitn(3, '_');
    let [kind, width, rest] = [(); 3].map(|()| parts.next().unwrap_or_default());
    format!("{kind}-{width}/{}", rest.replace('_', "-"))
}

/// All algorithms with their names.
pub fn crc_algorithms() -> impl Iterator<Item = (String, &'static Algorithm<u32>)> {
    CATALOGUE.iter().map(|(name, algorithm)| (catalogue_name(name), algorithm))
}

/// Name and algorithm by a name or an alias.
pub fn crc_algorithm(name: &str) -> Option<(String, &'static Algorithm<u32>)> {
    let name = ALIASES.iter().find(|(alias, _)| *alias == name).map_or(name, |(_, name)| name);
    crc_algorithms().find(|(own, _)| own == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aliases_are_other_names_of_algorithms() {
        for (alias, name) in ALIASES {
            assert_eq!(crc_algorithm(alias).map(|(name, _)| name).as_deref(), Some(name));
            assert!(crc_algorithms().all(|(own, _)| own != alias), "{alias}");
        }
    }
}
