//! Reads inputs to their end, or until it is stopped.

mod archives;
mod decode;
mod parallel;
mod records;
mod seen;

use std::io::ErrorKind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use geu_protocol::capture::{Detected, Format, Reader, RecordPosition};
use geu_protocol::excerpt::excerpt;
use geu_protocol::hex::spaced_hex;

pub use self::decode::Decode;
use self::seen::Seen;
use crate::decoder::{Decoder, DecoderOptions};
use crate::input::{InputError, Source, Unpacked, open};
use crate::live::{CanSocket, Received, SerialPort, wait_readable};
use crate::parquet_text::SEPARATOR;
use crate::row::Sink;
use crate::summary::DecodeSummary;

const CHUNK: usize = 1 << 20;
/// Bytes from which a format is detected, at most.
const HEAD: usize = 1 << 16;
/// Interval at which a live read checks for a stop.
const WAIT: Duration = Duration::from_millis(100);
/// Serial bytes without a frame after which an input is refused: noise for an hour and a half at the default rate. It also
/// bounds endless inputs, such as devices or a kilobyte of gzip with gigabytes of content.
const MAX_WITHOUT_FRAME: u64 = 64 << 20;
/// Bytes of an unknown input in its error.
const MAX_EXCERPT: usize = 16;

/// When to stop before the end.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stop<'a> {
    /// Set from outside, by a signal.
    pub flag: Option<&'a AtomicBool>,
    pub deadline: Option<Instant>,
}

impl Stop<'_> {
    pub(crate) fn is_asked(&self) -> bool {
        self.flag.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    pub(crate) fn is_due(&self) -> bool {
        self.is_asked() || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    pub(crate) fn wait(&self) -> Duration {
        self.deadline.map_or(WAIT, |deadline| deadline.saturating_duration_since(Instant::now()).min(WAIT))
    }
}

/// Opens inputs and decodes them as one stream.
pub struct InputReader<'a, D = Decoder> {
    options: DecoderOptions,
    decoder: D,
    stop: Stop<'a>,
    /// A serial recording in which a frame must be found: name, length and first bytes.
    serial: Option<(String, u64, Vec<u8>)>,
    /// True once an input was open.
    is_open: bool,
}

impl<'a> InputReader<'a> {
    /// A reader before its first input.
    pub fn new(options: DecoderOptions, stop: Stop<'a>) -> InputReader<'a> {
        InputReader::with(Decoder::new(&options), options, stop)
    }
}

impl<'a, D: Decode> InputReader<'a, D> {
    /// A reader with this decoder.
    pub fn with(decoder: D, options: DecoderOptions, stop: Stop<'a>) -> InputReader<'a, D> {
        InputReader { decoder, options, stop, serial: None, is_open: false }
    }

    /// Reads an input to its end. Rows before an error have been given out.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn read(&mut self, name: &str, sink: &mut impl Sink<D::Row>) -> Result<(), InputError> {
        if !self.options.reads_no_archives && self.archive(name, sink)? {
            return Ok(());
        }
        let source = open(name, self.options.baud, self.decoder.reads_tables(), self.stop)?;
        if self.options.range.is_some() {
            return Err(InputError::NoArchive { name: name.to_owned() });
        }
        self.begin(name, sink);
        match source {
            Source::Bytes { bytes, is_live } => self.bytes(name, bytes, is_live, sink),
            Source::Serial(port) => self.port(name, port, sink),
            Source::Can(socket) => self.socket(name, socket, sink),
        }
    }

    fn begin(&mut self, name: &str, sink: &mut impl Sink<D::Row>) {
        if !std::mem::replace(&mut self.is_open, true) {
            sink.opened();
        }
        self.decoder.begin(name, sink);
    }

    /// Ends the stream: gives out what waits, and the summary.
    ///
    /// # Errors
    /// A serial recording that was read to its end and in which no frame was found; an empty range; an end before the deadline.
    pub fn finish(mut self, sink: &mut impl Sink<D::Row>) -> (DecodeSummary, Result<(), InputError>) {
        let left = self.stop.deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        let is_stopped = self.stop.is_asked() || left.is_some_and(|left| left.is_zero());
        if is_stopped {
            self.decoder.stop();
        }
        self.decoder.finish(sink);
        let expected = self.decoder.expected();
        let summary = self.decoder.into_summary();
        let names = || summary.inputs.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(" ");
        let result = match (self.serial, left) {
            _ if is_stopped => Ok(()),
            (Some((name, length, head)), _) if summary.serial_frames == 0 => {
                Err(no_frame(&name, length, &head, expected))
            }
            _ if self.options.range.is_some() && summary.rows == 0 => Err(InputError::EmptyRange { names: names() }),
            (_, Some(left)) => {
                let (left_s, rows) = (left.as_secs_f64(), summary.rows);
                Err(InputError::EndedEarly { names: names(), left_s, rows })
            }
            _ => Ok(()),
        };
        (summary, result)
    }

    /// True after a request to stop or at the deadline.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_due()
    }

    fn is_done(&self, sink: &impl Sink<D::Row>) -> bool {
        self.stop.is_due() || sink.is_closed()
    }

    fn bytes(
        &mut self,
        name: &str,
        Unpacked { mut reader, container }: Unpacked,
        is_live: bool,
        sink: &mut impl Sink<D::Row>,
    ) -> Result<(), InputError> {
        let (mut buffer, mut filled, mut offset) = (vec![0; CHUNK], 0, 0u64);
        let mut target = self.options.format.map(|format| self.target(format));
        let mut failure = None;
        loop {
            if self.is_done(sink) {
                break;
            }
            let length = match reader.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(length) => length,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(source) => {
                    failure = Some(read_error(name, container, offset, source));
                    break;
                }
            };
            (filled, offset) = (filled + length, offset + length as u64);
            if target.is_none() {
                let head = &buffer[..filled.min(HEAD)];
                match self.decoder.detect(head, filled >= HEAD) {
                    Detected::Format(format) => target = Some(self.target(format)),
                    Detected::Undecided => continue,
                    Detected::Foreign(foreign) => return Err(InputError::Foreign { name: name.to_owned(), foreign }),
                    Detected::UnknownText => return Err(unknown_text(name, head, self.decoder.columns())),
                }
            }
            if let Some(target) = &mut target {
                let used = target.consume(&buffer[..filled], &mut self.decoder, sink);
                buffer.copy_within(used..filled, 0);
                filled -= used;
                match target {
                    Target::Serial { head, length }
                        if *length >= MAX_WITHOUT_FRAME && self.decoder.summary().serial_frames == 0 =>
                    {
                        return Err(no_frame(name, *length, head, self.decoder.expected()));
                    }
                    // A short input is not worth the threads.
                    Target::Capture(capture) if !is_live && offset >= CHUNK as u64 => {
                        let (decoder, stop) = (&mut self.decoder, self.stop);
                        let ending =
                            parallel::read(&mut reader, (&mut buffer, &mut filled), capture, decoder, sink, stop);
                        offset += ending.length;
                        if let Some(source) = ending.error {
                            failure = Some(read_error(name, container, offset, source));
                            break;
                        }
                    }
                    _ => {}
                }
            }
            // Only after the first row: an input that is refused leaves no header.
            if is_live && self.decoder.summary().rows > 0 {
                sink.flush();
            }
        }
        // An incomplete record is then neither a record nor a defect.
        let is_stopped = self.is_done(sink);
        let rest = &buffer[..filled];
        if target.is_none() && filled > 0 {
            match self.decoder.detect(rest, true) {
                Detected::Format(format) => target = Some(self.target(format)),
                Detected::Foreign(foreign) => return Err(InputError::Foreign { name: name.to_owned(), foreign }),
                _ if failure.is_none() && !is_stopped => return Err(unknown_text(name, rest, self.decoder.columns())),
                _ => {}
            }
        }
        let is_empty = match &mut target {
            Some(target) => {
                let is_empty = target.finish(rest, is_stopped, &mut self.decoder, sink);
                match target {
                    Target::Serial { head, length } => {
                        self.serial.get_or_insert_with(|| (name.to_owned(), *length, std::mem::take(head)));
                    }
                    Target::Capture(capture) => {
                        let (name, container) = (name.to_owned(), capture.format);
                        let cut = capture.seen.cut.take().filter(|_| !is_stopped);
                        failure = failure.or(cut.map(|(offset, got)| InputError::Cut { name, container, offset, got }));
                    }
                }
                is_empty
            }
            None => Some("0 bytes".to_owned()),
        };
        match (failure, is_empty) {
            (Some(failure), _) => Err(failure),
            // A link that ends before its first byte ends early.
            (None, None) => Ok(()),
            (None, Some(_)) if is_stopped || is_live && self.stop.deadline.is_some() => Ok(()),
            (None, Some(got)) => Err(InputError::Empty { name: name.to_owned(), got }),
        }
    }

    fn target(&mut self, format: &'static Format) -> Target {
        self.decoder.describe(format.name);
        match format.reader() {
            Some(reader) => Target::Capture(Capture { reader, format: format.name, seen: Seen::default() }),
            None => Target::Serial { head: Vec::new(), length: 0 },
        }
    }

    fn port(&mut self, name: &str, mut port: SerialPort, sink: &mut impl Sink<D::Row>) -> Result<(), InputError> {
        self.decoder.describe("live serial");
        let (mut buffer, mut offset) = ([0; 4096], 0);
        while !self.is_done(sink) {
            if !wait_readable(port.descriptor(), self.stop.wait()) {
                continue;
            }
            let Some((length, time)) =
                port.read(&mut buffer).map_err(|source| InputError::Read { name: name.to_owned(), offset, source })?
            else {
                break;
            };
            offset += length as u64;
            self.decoder.serial(&buffer[..length], Some(time), sink);
            sink.flush();
        }
        Ok(())
    }

    fn socket(&mut self, name: &str, mut socket: CanSocket, sink: &mut impl Sink<D::Row>) -> Result<(), InputError> {
        self.decoder.describe("live CAN");
        let mut frames = 0;
        while !self.is_done(sink) {
            if !wait_readable(socket.descriptor(), self.stop.wait()) {
                continue;
            }
            loop {
                let (decoder, place) = (&mut self.decoder, RecordPosition::Line(frames + 1));
                let received = socket
                    .receive(&mut |event| decoder.event(place, &event, sink))
                    .map_err(|source| InputError::Read { name: name.to_owned(), offset: frames, source })?;
                match received {
                    Received::Frame { dropped } => {
                        frames += 1;
                        self.decoder.count_records(1);
                        if dropped > 0 {
                            self.decoder.dropped(place, dropped, sink);
                        }
                    }
                    Received::Empty => break,
                }
                if self.is_done(sink) {
                    break;
                }
            }
            sink.flush();
        }
        Ok(())
    }
}

/// Destination of the bytes of an input.
enum Target {
    Capture(Capture),
    Serial { head: Vec<u8>, length: u64 },
}

struct Capture {
    reader: Box<dyn Reader>,
    format: &'static str,
    seen: Seen,
}

impl Capture {
    fn read<D: Decode>(&mut self, bytes: &[u8], is_last: bool, decoder: &mut D, sink: &mut impl Sink<D::Row>) -> usize {
        let Capture { reader, seen, .. } = self;
        reader.read(bytes, is_last, &mut |place, event| seen.event(place, &event, decoder, sink))
    }
}

impl Target {
    fn consume<D: Decode>(&mut self, bytes: &[u8], decoder: &mut D, sink: &mut impl Sink<D::Row>) -> usize {
        match self {
            Target::Capture(capture) => capture.read(bytes, false, decoder, sink),
            Target::Serial { head, length } => {
                let missing = MAX_EXCERPT.saturating_sub(head.len()).min(bytes.len());
                head.extend_from_slice(&bytes[..missing]);
                *length += bytes.len() as u64;
                sink.bytes(bytes);
                decoder.serial(bytes, None, sink);
                bytes.len()
            }
        }
    }

    /// Reads the last bytes, which may end inside a record if stopped. Returns the content in words if it has no record.
    fn finish<D: Decode>(
        &mut self,
        bytes: &[u8],
        is_stopped: bool,
        decoder: &mut D,
        sink: &mut impl Sink<D::Row>,
    ) -> Option<String> {
        match self {
            Target::Capture(capture) => {
                capture.read(bytes, !is_stopped, decoder, sink);
                let records = capture.reader.records();
                decoder.count_records(records);
                (capture.seen.remarks == records).then(|| format!("{records} records without a CAN frame"))
            }
            Target::Serial { length, .. } => {
                if !bytes.is_empty() {
                    self.consume(bytes, decoder, sink);
                    return None;
                }
                (*length == 0).then(|| "0 bytes".to_owned())
            }
        }
    }
}

fn read_error(name: &str, container: Option<&'static str>, offset: u64, source: std::io::Error) -> InputError {
    let name = name.to_owned();
    match container {
        Some(container) => InputError::Container { name, container, offset, source },
        None => InputError::Read { name, offset, source },
    }
}

fn unknown_text(name: &str, head: &[u8], columns: Option<String>) -> InputError {
    let line = head.split(|&byte| byte == b'\n').next().unwrap_or_default();
    let got = format!("{:?}", excerpt(&String::from_utf8_lossy(line).replace(SEPARATOR, ",")));
    let name = name.to_owned();
    match columns {
        Some(expected) => InputError::Columns { name, expected, got },
        None => InputError::UnknownText { name, got },
    }
}

fn no_frame(name: &str, length: u64, head: &[u8], expected: String) -> InputError {
    InputError::NoFrame { name: name.to_owned(), length, got: spaced_hex(head), expected }
}
