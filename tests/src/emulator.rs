//! A running emulator and a client of it, for tests.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::ops::{Deref, DerefMut};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

use geu_process::EmulatorProcess;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, read_data};
use geu_protocol::{Reply, Sample};
use nix::libc::{O_NOCTTY, O_NONBLOCK};

use crate::geu;

/// Timeout of a test.
const PATIENCE: Duration = Duration::from_secs(8);

/// A running `geu run`; ended when it goes.
pub struct Emulator {
    process: EmulatorProcess,
    /// Addresses of the `ready` lines, one per link.
    pub ready: Vec<String>,
}

impl Deref for Emulator {
    type Target = EmulatorProcess;
    fn deref(&self) -> &EmulatorProcess {
        &self.process
    }
}

impl DerefMut for Emulator {
    fn deref_mut(&mut self) -> &mut EmulatorProcess {
        &mut self.process
    }
}

impl Emulator {
    /// Starts it and waits for `links` links.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(links: usize, arguments: &[&str]) -> Emulator {
        Emulator::start_as(geu(), links, arguments)
    }

    /// Starts a program in its own environment.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start_as(mut command: Command, links: usize, arguments: &[&str]) -> Emulator {
        command.arg("run").args(arguments);
        Emulator::of(command, links)
    }

    /// Starts a command and waits for `links` links.
    ///
    /// # Panics
    /// If it does not start.
    pub fn of(command: Command, links: usize) -> Emulator {
        let mut process = EmulatorProcess::start(command).expect("geu starts");
        let ready = (0..links).map(|_| process.next_ready().expect("a line for each link")).collect();
        Emulator { process, ready }
    }

    /// HOST:PORT of its control interface, which becomes ready after all links.
    ///
    /// # Panics
    /// Without one.
    pub fn control(&mut self) -> String {
        self.process.control_address().expect("a control interface")
    }

    /// On TCP alone, and a client of it.
    ///
    /// # Panics
    /// If it does not start.
    pub fn on_tcp(arguments: &[&str]) -> (Emulator, Client) {
        let emulator = Emulator::start(1, &[&["--tcp", "127.0.0.1:0"], arguments].concat());
        let client = emulator.tcp();
        (emulator, client)
    }

    /// A client over TCP.
    ///
    /// # Panics
    /// Without such a link.
    pub fn tcp(&self) -> Client {
        let address = self.ready.iter().find_map(|ready| ready.strip_prefix("tcp ")).expect("a TCP link");
        let stream = TcpStream::connect(address).expect("the unit listens");
        stream.set_nonblocking(true).expect("a socket");
        stream.set_nodelay(true).expect("a socket");
        Client::new(stream)
    }

    /// Sends SIGTERM.
    ///
    /// # Panics
    /// If it does not run any more.
    pub fn ask_to_end(&self) {
        self.process.terminate().expect("it runs");
    }

    /// Waits for its end and gives what it said on standard error.
    ///
    /// # Panics
    /// If it ended before.
    pub fn end(self) -> (Option<i32>, String) {
        let (status, text) = self.process.wait().expect("its end");
        (status.code(), text)
    }
}

/// A client of a byte stream.
pub struct Client {
    /// The link.
    pub stream: Box<dyn Stream>,
    deframer: Deframer,
    buffer: Vec<u8>,
    /// Everything received.
    pub bytes: Vec<u8>,
    /// Samples received.
    pub samples: Vec<Sample>,
    /// Replies received.
    pub replies: Vec<Reply>,
    /// Other bytes.
    pub defects: usize,
    /// True at the end of the stream.
    pub is_over: bool,
}

/// Stream of a client.
pub trait Stream: Read + Write {}
impl<T: Read + Write> Stream for T {}

impl Client {
    /// A client of this stream.
    pub fn new(stream: impl Stream + 'static) -> Client {
        Client {
            stream: Box::new(stream),
            deframer: Deframer::default(),
            buffer: Vec::new(),
            bytes: Vec::new(),
            samples: Vec::new(),
            replies: Vec::new(),
            defects: 0,
            is_over: false,
        }
    }

    /// A client of a pty.
    ///
    /// # Panics
    /// Without it.
    pub fn open(path: &Path) -> Client {
        let mut options = OpenOptions::new();
        Client::new(options.read(true).write(true).custom_flags(O_NOCTTY | O_NONBLOCK).open(path).expect("a pty"))
    }

    /// Reads what comes until `enough`, the end of the stream, or the end of patience; says whether it was enough.
    pub fn read_until(&mut self, enough: impl Fn(&Client) -> bool) -> bool {
        self.read_for(PATIENCE, enough)
    }

    /// Reads with its own timeout.
    pub fn read_for(&mut self, patience: Duration, enough: impl Fn(&Client) -> bool) -> bool {
        let (start, mut chunk) = (Instant::now(), [0; 4096]);
        while !enough(self) {
            match self.stream.read(&mut chunk) {
                Ok(0) => self.is_over = true,
                Ok(length) => self.push(&chunk[..length]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => sleep(Duration::from_micros(300)),
                Err(_) => self.is_over = true,
            }
            if self.is_over || start.elapsed() > patience {
                return enough(self);
            }
        }
        true
    }

    fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        self.buffer.extend_from_slice(bytes);
        let used = self.deframer.consume(&self.buffer, &mut |found| match found {
            DeframerEvent::Frame { kind: FrameType::Data, payload, .. } => self.samples.push(read_data(payload)),
            DeframerEvent::Frame { kind: FrameType::Reply, payload, .. } => {
                self.replies.push(Reply::read(payload).expect("a reply"))
            }
            _ => self.defects += 1,
        });
        self.buffer.drain(..used);
    }

    /// Sends bytes and waits for the next reply: it, and how long it took.
    ///
    /// # Panics
    /// Without a reply.
    pub fn ask(&mut self, bytes: &[u8]) -> (Reply, Duration) {
        let (before, start) = (self.replies.len(), Instant::now());
        self.stream.write_all(bytes).expect("a write");
        assert!(self.read_until(|client| client.replies.len() > before), "no reply to {bytes:02X?}");
        (self.replies[before], start.elapsed())
    }

    /// True if all samples came, without a gap or other bytes.
    pub fn is_without_gap(&self) -> bool {
        self.defects == 0
            && self.samples.windows(2).all(|pair| {
                pair[1].sequence == pair[0].sequence.wrapping_add(1)
                    && pair[1].clock_count == pair[0].clock_count + 500_000
            })
    }
}
