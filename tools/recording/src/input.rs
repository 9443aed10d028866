//! Opening of inputs, and their errors.

use std::fs::{self, File, Metadata};
use std::io::{self, Cursor, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileTypeExt;
use std::path::Path;
use std::sync::mpsc;
use std::thread;

use geu_protocol::capture::{Foreign, Format};
use thiserror::Error;

use crate::input_reader::Stop;
use crate::live::{CanSocket, SerialPort, Stream};
use crate::parquet_text::open_table;

/// Why an input cannot be read, or not to its end.
#[derive(Debug, Error)]
pub enum InputError {
    /// Neither a path nor an interface has this name.
    #[error(
        "{name}: no such file, and no CAN interface of that name; expected a recording, -, a serial device, a CAN interface or HOST:PORT"
    )]
    Missing { name: String },
    /// A directory.
    #[error(
        "{name}: is a directory; expected a recording, an archive of Parquet files, -, a serial device, a CAN interface or HOST:PORT"
    )]
    Directory { name: String },
    /// The operating system refuses to open it.
    #[error("{name}: cannot be opened: {source}")]
    Open { name: String, source: io::Error },
    /// Reading failed.
    #[error("{name}: reading failed after {offset} bytes: {source}")]
    Read {
        name: String,
        /// Bytes read until then.
        offset: u64,
        source: io::Error,
    },
    /// A compressed file that is damaged or cut.
    #[error("{name}: {container} is damaged or cut: expected more after {offset} bytes of content, got: {source}")]
    Container {
        name: String,
        container: &'static str,
        /// Bytes of content until then.
        offset: u64,
        source: io::Error,
    },
    /// A binary capture that ends inside its header, a packet or a block, or holds a damaged container.
    #[error(
        "{name}: offset {offset}: {container} is damaged or cut: expected a whole header, packet, block or container, got {}; \
         everything else was decoded",
        if got.is_empty() { "a part" } else { got }
    )]
    Cut {
        name: String,
        container: &'static str,
        offset: u64,
        /// First bytes.
        got: String,
    },
    /// An empty input.
    #[error("{name}: is empty: expected a capture, got {got}")]
    Empty { name: String, got: String },
    /// A known format without a reader.
    #[error("{name}: {foreign}")]
    Foreign { name: String, foreign: &'static Foreign },
    /// Text in no known format.
    #[error(
        "{name}: line 1: expected {}, got {got}; --input-format selects a format, --device another unit",
        Format::titles(true)
    )]
    UnknownText { name: String, got: String },
    /// A file or directory of an archive that is not read.
    #[error("{name}: {message}")]
    Archive { name: String, message: String },
    /// A range of times of an input that is no archive.
    #[error(
        "{name}: expected an archive of `geu decode --format parquet` with --from or --to, got another input or a damaged file; leave them out, or decode the recording to an archive"
    )]
    NoArchive { name: String },
    /// No row between two times.
    #[error("--from, --to: expected samples of {names} in this range, got none")]
    EmptyRange { names: String },
    /// The input ended by itself before the time for which it was to be read.
    #[error("{names}: ended {left_s:.1} s before the end of --duration, after {rows} rows; was the unit stopped?")]
    EndedEarly { names: String, left_s: f64, rows: u64 },
    /// Text without the columns of the unit's table.
    #[error("{name}: line 1: expected {expected}, got {got}")]
    Columns { name: String, expected: String, got: String },
    /// Binary without a frame.
    #[error("{name}: offset 0 to {length}: expected {expected}, got none; it begins {got}")]
    NoFrame { name: String, length: u64, got: String, expected: String },
}

pub(crate) enum Source<'a> {
    /// Bytes of a recording, which may come late where it is live.
    Bytes {
        bytes: Unpacked<'a>,
        is_live: bool,
    },
    Serial(SerialPort),
    Can(CanSocket),
}

pub(crate) struct Unpacked<'a> {
    pub reader: Box<dyn Read + 'a>,
    pub container: Option<&'static str>,
}

const GZIP: [u8; 2] = [0x1F, 0x8B];
const ZSTD: [u8; 4] = [0x28, 0xB5, 0x2F, 0xFD];
/// Largest window of a zstd file, as a power of two: the largest that `zstd` writes by default.
const ZSTD_WINDOW_LOG: u32 = 27;

/// True for a file, also as standard input, and for the directory of an archive: it can be read again, and ends.
pub fn is_recording(name: &str) -> bool {
    metadata(name).is_ok_and(|metadata| lasts(&metadata))
}

/// True if `name` exists and is no recording: lost data cannot be read again.
pub fn is_live(name: &str) -> bool {
    match metadata(name) {
        Ok(metadata) => !lasts(&metadata),
        Err(_) => nix::net::if_::if_nametoindex(name).is_ok() || is_address(name),
    }
}

/// Verifies that an input exists, before others are read.
///
/// # Errors
/// Neither a path, nor an interface, nor an address has this name.
pub fn verify_exists(name: &str) -> Result<(), InputError> {
    match metadata(name) {
        Err(error) if error.kind() == io::ErrorKind::NotFound && !is_live(name) => {
            Err(InputError::Missing { name: name.to_owned() })
        }
        _ => Ok(()),
    }
}

fn lasts(metadata: &Metadata) -> bool {
    metadata.is_file() || metadata.is_dir()
}

fn metadata(name: &str) -> io::Result<Metadata> {
    match name {
        "-" => io::stdin().as_fd().try_clone_to_owned().and_then(|stdin| File::from(stdin).metadata()),
        path => fs::metadata(path),
    }
}

/// Opens an input by its name; an existing path has precedence over an interface. A file of Parquet is read as text if it may be a table.
pub(crate) fn open<'a>(
    name: &str,
    baud: Option<u32>,
    may_be_table: bool,
    stop: Stop<'a>,
) -> Result<Source<'a>, InputError> {
    let failed = |source| InputError::Open { name: name.to_owned(), source };
    let recording = |file: File| {
        claim(name, &file)?;
        let bytes = if may_be_table { open_table(file)? } else { unpack(file)? };
        Ok(Source::Bytes { bytes, is_live: false })
    };
    let live = |stream: Stream<'a>| {
        claim(name, stream.file())?;
        Ok(Source::Bytes { bytes: unpack(stream)?, is_live: true })
    };
    if name == "-" {
        // Not the buffered standard input: `poll` does not see its buffer.
        let stdin = File::from(io::stdin().as_fd().try_clone_to_owned().map_err(failed)?);
        let is_file = stdin.metadata().is_ok_and(|metadata| metadata.is_file());
        return if is_file { recording(stdin) } else { live(Stream::new(stdin, stop)) }.map_err(failed);
    }
    let path = Path::new(name);
    let metadata = match fs::metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return match interface(name) {
                Err(InputError::Missing { .. }) if is_address(name) => match connect(name, stop) {
                    Ok(Some(socket)) => live(Stream::new(socket, stop)).map_err(failed),
                    // Stopped before it was connected: an empty input.
                    Ok(None) => Ok(Source::Bytes { bytes: unpack(io::empty()).map_err(failed)?, is_live: true }),
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {
                        Err(InputError::Missing { name: name.to_owned() })
                    }
                    Err(error) => Err(failed(error)),
                },
                opened => opened,
            };
        }
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
    if metadata.is_file() { File::open(path).and_then(recording) } else { Stream::open(path, stop).and_then(live) }
        .map_err(failed)
}

/// Registers an input, so that no output overwrites it.
pub(crate) fn claim(name: &str, file: &File) -> io::Result<()> {
    geu_files::claim_input(name, &file.metadata()?).map_err(io::Error::other)
}

fn is_address(name: &str) -> bool {
    name.rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && !host.contains('/') && port.parse::<u16>().is_ok())
}

/// Connects; `None` if stopped before. A thread waits for the resolver and the peer, because neither can be interrupted.
fn connect(address: &str, stop: Stop) -> io::Result<Option<File>> {
    let address = address.strip_prefix("tcp:").unwrap_or(address).to_owned();
    let (sender, connected) = mpsc::channel();
    let connect = move || {
        let resolved = address.to_socket_addrs().map_err(|_| io::Error::from(io::ErrorKind::NotFound));
        sender.send(resolved.and_then(|addresses| TcpStream::connect(&*addresses.collect::<Vec<_>>())))
    };
    thread::Builder::new().name("connecting".to_owned()).spawn(connect)?;
    loop {
        match connected.recv_timeout(stop.wait()) {
            Ok(stream) => return stream.map(|stream| Some(File::from(OwnedFd::from(stream)))),
            Err(_) if stop.is_asked() => return Ok(None),
            Err(_) if !stop.is_due() => {}
            Err(_) => return Err(io::Error::new(io::ErrorKind::TimedOut, "no connection within --duration")),
        }
    }
}

fn interface(name: &str) -> Result<Source<'static>, InputError> {
    if nix::net::if_::if_nametoindex(name).is_err() {
        return Err(InputError::Missing { name: name.to_owned() });
    }
    let socket = CanSocket::open(name).map_err(|source| InputError::Open { name: name.to_owned(), source })?;
    Ok(Source::Can(socket))
}

/// Decompresses gzip and zstd, detected by their first bytes.
pub(crate) fn unpack<'a>(mut reader: impl Read + 'a) -> io::Result<Unpacked<'a>> {
    let mut head = Vec::new();
    // A live stream may deliver fewer bytes at first, or in all.
    while head.len() < ZSTD.len() && (ZSTD.starts_with(&head) || GZIP.starts_with(&head)) {
        let mut byte = [0];
        match reader.read(&mut byte) {
            Ok(0) => break,
            Ok(_) => head.push(byte[0]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            // Stopped; the next read fails again.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
            Err(error) => return Err(error),
        }
    }
    let (gzip, zstd) = (head.starts_with(&GZIP), head == ZSTD);
    let reader = Cursor::new(head).chain(reader);
    let (reader, container): (Box<dyn Read + 'a>, _) = if gzip {
        (Box::new(flate2::read::MultiGzDecoder::new(reader)), Some("gzip"))
    } else if zstd {
        let mut reader = zstd::Decoder::new(reader)?;
        reader.window_log_max(ZSTD_WINDOW_LOG)?;
        (Box::new(reader), Some("zstd"))
    } else {
        (Box::new(reader), None)
    };
    Ok(Unpacked { reader, container })
}
