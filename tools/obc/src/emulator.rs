//! The emulator: a child process or a running one; its link, and the truth sent to it.

use std::env;
use std::fs::OpenOptions;
use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::{self, BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use geu_process::EmulatorProcess;
use geu_protocol::Sample;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, read_data};
use nix::sys::prctl::set_pdeathsig;
use nix::sys::signal::Signal;
use serde_json::Value;

/// Longest wait for a report of the emulator, and for its bytes on the link.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Interval at which the stop flag is checked.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Requests a report for each sample; sent with every datagram, because a datagram may be lost.
const SUBSCRIBE: &str = "{\"subscribe\": \"samples\"}\n";
/// Longest report, bytes.
const REPORT: usize = 65_536;
/// Longest wait for the end of the child.
const END_TIMEOUT: Duration = Duration::from_secs(5);
/// Capacity of the queue of reads.
const QUEUE: usize = 64;

/// A running emulator.
pub struct Emulator {
    /// `None` for an emulator that is not our child.
    child: Option<Running>,
    /// Name of the link, and the peer of a TCP link.
    link: (String, Option<SocketAddr>),
    reads: Receiver<Read>,
    /// Bytes received on the link, and reported as sent; `None` before the first report.
    received: u64,
    reported: Option<u64>,
    truth: UdpSocket,
}

/// Result of a read of the link.
struct Read {
    bytes: u64,
    samples: Vec<Sample>,
}

/// A completed sample of the unit.
pub struct CompletedSample {
    /// Index since the emulator's start.
    pub index: u64,
    /// Samples received on the link; none if a fault suppressed it.
    pub samples: Vec<Sample>,
}

/// The given program `geu`, else that in the directory of this program, else that of the PATH.
///
/// # Errors
/// There is no such program.
pub fn program(named: Option<&Path>) -> Result<PathBuf, String> {
    if let Some(path) = named {
        let missing = || format!("--geu: expected the program geu, got {}, which does not exist", path.display());
        return path.is_file().then(|| path.to_owned()).ok_or_else(missing);
    }
    let beside = env::current_exe().ok().map(|own| own.with_file_name("geu"));
    let paths = env::var_os("PATH").unwrap_or_default();
    let mut places = beside.into_iter().chain(env::split_paths(&paths).map(|directory| directory.join("geu")));
    let missing =
        "--geu: expected the program geu in the directory of this program or of PATH, got none; give --geu PROGRAM";
    places.find(|path| path.is_file()).ok_or_else(|| missing.to_owned())
}

impl Emulator {
    /// Starts `geu run` on free ports, waiting for this computer. It ends with this program.
    ///
    /// # Errors
    /// The program does not start, or ends before its link is ready.
    pub fn start(program: &Path, arguments: &[String]) -> Result<Emulator, String> {
        let mut command = Command::new(program);
        command.args(["run", "--wait", "--tcp", "127.0.0.1:0", "--truth", "udp://127.0.0.1:0"]).args(arguments);
        // SAFETY: between fork and exec this makes one system call and touches no memory.
        unsafe { command.pre_exec(|| set_pdeathsig(Signal::SIGTERM).map_err(io::Error::from)) };
        let failed = |error: io::Error| format!("{}: cannot be started: {error}", program.display());
        let mut process = EmulatorProcess::start(command).map_err(failed)?;
        let stderr = process.child.stderr.take();
        // Forwards its messages; the status line is only for a terminal.
        let forwarder = thread::spawn(move || {
            for line in stderr.into_iter().flat_map(|stderr| BufReader::new(stderr).lines()).map_while(Result::ok) {
                let _ = writeln!(io::stderr(), "{line}");
            }
        });
        let mut running = Running { process, forwarder: Some(forwarder) };
        let (mut link, mut truth) = (None, None);
        while let (None, _) | (_, None) = (&link, &truth) {
            let ready = running.process.next_ready();
            let ready = ready.map_err(|_| "geu ended before its link was ready; its messages are above".to_owned())?;
            link = link.or(ready.strip_prefix("tcp ").map(str::to_owned));
            truth = truth.or(ready.strip_prefix("truth udp://").map(str::to_owned));
        }
        let mut emulator = Emulator::attach(&link.unwrap_or_default(), &truth.unwrap_or_default())?;
        emulator.child = Some(running);
        // It waits for this computer: no byte was sent before.
        emulator.reported = Some(0);
        Ok(emulator)
    }

    /// Connects to a running emulator: its link is a TCP address or a path, its truth an address.
    ///
    /// # Errors
    /// A connection fails.
    pub fn attach(link: &str, truth: &str) -> Result<Emulator, String> {
        let failed =
            |error: io::Error| format!("--link {link}: cannot be opened: {error}; expected HOST:PORT or a pty");
        let (stream, peer): (Box<dyn io::Read + Send>, _) = match Path::new(link).exists() {
            true => (Box::new(OpenOptions::new().read(true).open(link).map_err(failed)?), None),
            false => {
                let stream = TcpStream::connect(link).map_err(failed)?;
                let peer = stream.peer_addr().map_err(failed)?;
                (Box::new(stream), Some(peer))
            }
        };
        let refused = |error: io::Error| format!("--truth {truth}: cannot be opened: {error}; expected HOST:PORT");
        let socket = UdpSocket::bind("0.0.0.0:0").map_err(refused)?;
        socket.connect(truth).map_err(refused)?;
        socket.set_read_timeout(Some(POLL_INTERVAL)).map_err(refused)?;
        let link = (link.to_owned(), peer);
        Ok(Emulator { child: None, link, reads: listen(stream), received: 0, reported: None, truth: socket })
    }

    /// Sends the truth, a line for an instant. The unit counts a datagram that cannot be sent as late.
    pub fn send_truth(&self, lines: &str) {
        let _ = self.truth.send(format!("{SUBSCRIBE}{lines}").as_bytes());
    }

    /// The next completed sample of the unit, with its samples on the link.
    ///
    /// # Errors
    /// The emulator reports no sample, the reported bytes are not received, or the link is closed.
    pub fn next(&mut self, stop: &AtomicBool) -> Result<CompletedSample, String> {
        let mut datagram = vec![0; REPORT];
        let timeout_s = TIMEOUT.as_secs();
        let silent = format!("no sample was reported for {timeout_s} s; expected a running emulator");
        let length = wait_for(stop, &silent, || match self.truth.recv(&mut datagram) {
            Ok(length) => Ok(Some(length)),
            Err(error) if matches!(error.kind(), WouldBlock | TimedOut | Interrupted) => Ok(None),
            Err(error) => Err(format!("the emulator cannot be reached: {error}")),
        })?;
        let unreadable = |what: &str| format!("a report of the emulator cannot be read: expected {what}");
        let report: Value = serde_json::from_slice(&datagram[..length]).map_err(|_| unreadable("JSON"))?;
        let whole = |key: &str| report[key].as_u64().ok_or_else(|| unreadable(key));
        let (index, sequence, bytes) = (whole("half_second")?, whole("sequence")?, self.bytes_of(&report["sent"])?);
        let mut samples: Vec<Sample> = Vec::new();
        let is_received =
            |samples: &[Sample]| bytes == 0 || samples.iter().any(|sample| u64::from(sample.sequence) == sequence);
        // Bytes before the first report belong to earlier samples: the sequence identifies the reported one.
        while match self.reported {
            Some(reported) => self.received < reported + bytes,
            None => !is_received(&samples),
        } {
            let silent = format!("the link is silent for {timeout_s} s: expected {bytes} bytes of a sample");
            let read = wait_for(stop, &silent, || match self.reads.recv_timeout(POLL_INTERVAL) {
                Ok(read) => Ok(Some(read)),
                Err(RecvTimeoutError::Timeout) => Ok(None),
                Err(RecvTimeoutError::Disconnected) => Err("the link was closed: expected another sample".to_owned()),
            })?;
            self.received += read.bytes;
            samples.extend(read.samples);
        }
        self.reported = Some(self.reported.map_or(self.received, |reported| reported + bytes));
        Ok(CompletedSample { index, samples })
    }

    /// Bytes on this computer's link, of a report.
    fn bytes_of(&self, sent: &Value) -> Result<u64, String> {
        let (link, peer) = &self.link;
        let is_ours = |name: &str| match (name.split_once(' '), peer) {
            // An emulator that listens at every address of its machine is identified by its port.
            (Some(("tcp", address)), Some(peer)) => {
                address.parse().is_ok_and(|own: SocketAddr| own.port() == peer.port())
            }
            (Some(("pty" | "serial", path)), None) => path == link,
            _ => false,
        };
        let bytes = sent.as_object().and_then(|sent| sent.iter().find(|(name, _)| is_ours(name)));
        bytes
            .and_then(|(_, handed)| handed["bytes"].as_u64())
            .ok_or_else(|| format!("--link {link}: expected a link of the emulator at --truth: {sent}"))
    }

    /// Ends the child; true if it exits with success, as with met expectations.
    ///
    /// # Errors
    /// The child could not run, or did not end.
    pub fn end(mut self) -> Result<bool, String> {
        let Some(mut running) = self.child.take() else { return Ok(true) };
        let _ = running.process.terminate();
        let child = &mut running.process.child;
        let asked = Instant::now();
        while asked.elapsed() < END_TIMEOUT {
            match child.try_wait() {
                Ok(Some(status)) if matches!(status.code(), Some(0 | 1)) => return Ok(status.success()),
                Ok(Some(status)) => return Err(format!("geu ended with {status}; its messages are above")),
                _ => thread::sleep(Duration::from_millis(10)),
            }
        }
        Err(format!("geu did not end within {} s of SIGTERM; it was killed", END_TIMEOUT.as_secs()))
    }
}

/// The child. When it is dropped, it is killed and its last messages are forwarded.
struct Running {
    process: EmulatorProcess,
    forwarder: Option<JoinHandle<()>>,
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.process.child.kill();
        let _ = self.process.child.wait();
        self.forwarder.take().map(JoinHandle::join);
    }
}

/// Polls until there is a value; an error after [`TIMEOUT`], or when the stop flag is set.
fn wait_for<T>(
    stop: &AtomicBool,
    timeout_message: &str,
    mut poll: impl FnMut() -> Result<Option<T>, String>,
) -> Result<T, String> {
    let start = Instant::now();
    while !stop.load(Relaxed) && start.elapsed() <= TIMEOUT {
        if let Some(value) = poll()? {
            return Ok(value);
        }
    }
    Err(timeout_message.to_owned())
}

/// Reads a link on a thread.
fn listen(mut stream: Box<dyn io::Read + Send>) -> Receiver<Read> {
    let (sender, reads) = sync_channel(QUEUE);
    thread::spawn(move || {
        let (mut deframer, mut rest, mut chunk) = (Deframer::default(), Vec::new(), [0; 4096]);
        while let Ok(length @ 1..) = stream.read(&mut chunk) {
            rest.extend_from_slice(&chunk[..length]);
            let mut read = Read { bytes: length as u64, samples: Vec::new() };
            let consumed = deframer.consume(&rest, &mut |found| {
                if let DeframerEvent::Frame { kind: FrameType::Data, payload, .. } = found {
                    read.samples.push(read_data(payload));
                }
            });
            rest.drain(..consumed);
            if sender.send(read).is_err() {
                return;
            }
        }
    });
    reads
}
