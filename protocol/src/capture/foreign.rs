//! Known formats without a reader: signature, name and the conversion to a format with one.

use std::fmt;

/// A known format without a reader.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreign {
    pub signature: &'static [u8],
    pub name: &'static str,
    /// Conversion to a format with a reader.
    conversion: &'static str,
}

const UNPACK: &str = "unpack it; compressed by gzip or zstd it is read as it is";
const TABLE: &str = "export it as CSV: `geu decode --device DESCRIPTION` reads tables of samples (docs/devices.md)";

const fn foreign(signature: &'static [u8], name: &'static str, conversion: &'static str) -> Foreign {
    Foreign { signature, name, conversion }
}

pub const FOREIGN: &[Foreign] = &[
    foreign(
        b"MDF     ",
        "an ASAM MDF measurement",
        "convert it with python-can and asammdf: `can_logconvert INPUT.mf4 OUTPUT.log`",
    ),
    foreign(
        b"UnFinMF ",
        "an unfinished ASAM MDF measurement",
        "finalise it with asammdf, then `can_logconvert INPUT.mf4 OUTPUT.log`",
    ),
    foreign(
        b"SQLite format 3\0",
        "an SQLite database",
        "convert a log of python-can with `can_logconvert INPUT.db OUTPUT.log`",
    ),
    Foreign::PARQUET,
    foreign(
        b"ARROW1",
        "an Arrow file",
        "convert it to Parquet: `geu decode --format parquet` of its recording, or pyarrow",
    ),
    foreign(b"PARE", "an encrypted Parquet table", TABLE),
    foreign(b"\x89HDF\r\n\x1a\n", "an HDF5 file", TABLE),
    foreign(b"t_s,sequence,clock_count,", "the rows of `geu decode`, no capture", "give the capture they came from"),
    foreign(b"PK\x03\x04", "a ZIP archive", UNPACK),
    foreign(b"BZh", "a file compressed by bzip2", UNPACK),
    foreign(b"\xFD7zXZ\0", "a file compressed by xz", UNPACK),
    foreign(b"\x04\x22\x4D\x18", "a file compressed by lz4", UNPACK),
    foreign(b"7z\xBC\xAF\x27\x1C", "a 7z archive", UNPACK),
];

impl Foreign {
    /// Read as a table of samples or a reference, where the reader can seek.
    pub const PARQUET: Foreign = foreign(
        b"PAR1",
        "a Parquet table",
        "give it as a file that is not compressed, where a reference or `--device DESCRIPTION` with a table is read; an archive of `geu decode` is read if the file is whole",
    );

    pub(super) fn from_head(head: &[u8]) -> Option<&'static Foreign> {
        let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head);
        FOREIGN.iter().find(|foreign| head.starts_with(foreign.signature))
    }
}

impl fmt::Display for Foreign {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "is {}, which is not read here; {}", self.name, self.conversion)
    }
}
