//! Opening an input: what it is, and what can be wrong with it.

use std::fs::{self, File};
use std::io::{self, Cursor, Read};
use std::os::fd::{AsFd, AsRawFd, RawFd};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use geu_protocol::capture::Foreign;
use thiserror::Error;

use crate::live::{CanSocket, SerialPort};

/// Why an input cannot be read, or not to its end.
#[derive(Debug, Error)]
pub enum InputError {
    /// Neither a path nor an interface has this name.
    #[error(
        "{name}: no such file, and no CAN interface of that name; expected a recording, -, a serial device or a CAN interface"
    )]
    Missing {
        /// As it was given.
        name: String,
    },
    /// A directory.
    #[error("{name}: is a directory; expected a recording, -, a serial device or a CAN interface")]
    Directory {
        /// Its path.
        name: String,
    },
    /// The operating system refuses to open it.
    #[error("{name}: cannot be opened: {source}")]
    Open {
        /// Path or interface.
        name: String,
        /// The reason it gives.
        source: io::Error,
    },
    /// Reading failed.
    #[error("{name}: reading failed after {offset} bytes: {source}")]
    Read {
        /// Path or interface.
        name: String,
        /// Bytes read until then.
        offset: u64,
        /// The reason.
        source: io::Error,
    },
    /// A compressed file that is damaged or cut.
    #[error("{name}: {container} is damaged or cut: expected more after {offset} bytes of content, got: {source}")]
    Container {
        /// Its path.
        name: String,
        /// `gzip` or `zstd`.
        container: &'static str,
        /// Bytes of content until then.
        offset: u64,
        /// What the decompressor says.
        source: io::Error,
    },
    /// A binary capture that ends inside its header, a packet or a block.
    #[error("{name}: offset {offset}: {container} is cut: expected a whole header, packet or block, got {got} bytes")]
    Cut {
        /// Its path.
        name: String,
        /// `pcap` or `pcapng`.
        container: &'static str,
        /// Where what is cut begins.
        offset: u64,
        /// Bytes of it that are there.
        got: u64,
    },
    /// Nothing in it.
    #[error("{name}: is empty: expected a capture, got {got}")]
    Empty {
        /// Its name.
        name: String,
        /// What there is instead.
        got: String,
    },
    /// A format that is known, and not read.
    #[error("{name}: {foreign}")]
    Foreign {
        /// Its name.
        name: String,
        /// What it is, and what makes a capture of it.
        foreign: &'static Foreign,
    },
    /// Text in no known format.
    #[error(
        "{name}: line 1: expected a candump log, candump output or Vector ASC, got {got}; --input-format names a format"
    )]
    UnknownText {
        /// Its name.
        name: String,
        /// Its first line.
        got: String,
    },
    /// Binary without a frame.
    #[error(
        "{name}: offset 0 to {length}: expected pcap, pcapng or serial frames EB 90 … with a matching CRC, got none; it begins {got}"
    )]
    NoFrame {
        /// Its name.
        name: String,
        /// Its length, byte.
        length: u64,
        /// Its first bytes.
        got: String,
    },
}

/// An opened input.
pub(crate) enum Source {
    /// Bytes of a recording. With a descriptor to wait on where they may come late.
    Bytes { reader: Box<dyn Read>, container: Option<&'static str>, wait_on: Option<RawFd> },
    /// A live serial link.
    Serial(SerialPort),
    /// A live CAN link.
    Can(CanSocket),
}

const GZIP: [u8; 2] = [0x1F, 0x8B];
const ZSTD: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
/// Window that a zstd file may ask for, as a power of two: the largest that `zstd` writes without being told so.
const ZSTD_WINDOW_LOG: u32 = 27;

/// Opens what `name` names; an existing path beats an interface of the same name.
pub(crate) fn open(name: &str, baud: Option<u32>) -> Result<Source, InputError> {
    let failed = |source| InputError::Open { name: name.to_owned(), source };
    if name == "-" {
        // Not the buffered standard input: what waits in a buffer cannot be waited for.
        let stdin = File::from(io::stdin().as_fd().try_clone_to_owned().map_err(failed)?);
        let wait_on = (!stdin.metadata().is_ok_and(|metadata| metadata.is_file())).then(|| stdin.as_raw_fd());
        return container(Box::new(stdin), wait_on).map_err(failed);
    }
    let path = Path::new(name);
    let metadata = match fs::metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return interface(name),
        Err(error) => return Err(failed(error)),
    };
    if metadata.is_dir() {
        return Err(InputError::Directory { name: name.to_owned() });
    }
    if metadata.file_type().is_char_device()
        && let Some(port) = SerialPort::open(path, baud).map_err(failed)?
    {
        return Ok(Source::Serial(port));
    }
    let file = File::open(path).map_err(failed)?;
    let wait_on = (!metadata.is_file()).then(|| file.as_raw_fd());
    container(Box::new(file), wait_on).map_err(failed)
}

fn interface(name: &str) -> Result<Source, InputError> {
    if nix::net::if_::if_nametoindex(name).is_err() {
        return Err(InputError::Missing { name: name.to_owned() });
    }
    let socket = CanSocket::open(name).map_err(|source| InputError::Open { name: name.to_owned(), source })?;
    Ok(Source::Can(socket))
}

/// Looks through gzip and zstd, told by their first bytes.
pub(crate) fn container(mut reader: Box<dyn Read>, wait_on: Option<RawFd>) -> io::Result<Source> {
    let mut head = Vec::new();
    // The first bytes tell; a live stream may begin with fewer, and may end with them.
    while head.len() < ZSTD.len() && (ZSTD.starts_with(&head) || GZIP.starts_with(&head)) {
        let mut byte = [0];
        match reader.read(&mut byte) {
            Ok(0) => break,
            Ok(_) => head.push(byte[0]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => break,
            Err(error) => return Err(error),
        }
    }
    let (gzip, zstd) = (head.starts_with(&GZIP), head == ZSTD);
    let reader = Cursor::new(head).chain(reader);
    Ok(if gzip {
        let reader = Box::new(flate2::read::MultiGzDecoder::new(reader));
        Source::Bytes { reader, container: Some("gzip"), wait_on: None }
    } else if zstd {
        let mut reader = Box::new(zstd::Decoder::new(reader)?);
        reader.window_log_max(ZSTD_WINDOW_LOG)?;
        Source::Bytes { reader, container: Some("zstd"), wait_on: None }
    } else {
        Source::Bytes { reader: Box::new(reader), container: None, wait_on }
    })
}
