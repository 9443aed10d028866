//! The emulator beside the on-board computer: started as a child, or one that runs already; its link, and the way back.

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

/// An emulator that reports no sample for so long is dead, and a link that does not bring what was reported.
const SILENCE: Duration = Duration::from_secs(10);
/// Whether it is to stop is looked at so often meanwhile.
const LOOK_AGAIN: Duration = Duration::from_millis(100);
/// Has the emulator report each sample; with everything that is told, for a datagram may be lost.
const SUBSCRIBE: &str = "{\"subscribe\": \"samples\"}\n";
/// Longest report, byte.
const REPORT: usize = 65_536;
/// A child that was asked to end has so long.
const END: Duration = Duration::from_secs(5);
/// Reads of the link that may wait to be taken.
const QUEUE: usize = 64;

/// A running emulator.
pub struct Emulator {
    /// None for one that somebody else runs.
    child: Option<Running>,
    /// As it was asked for, and the other end of a TCP link.
    link: (String, Option<SocketAddr>),
    read: Receiver<Read>,
    /// Bytes of the link that were taken, and that were reported; nothing reported before the first report.
    taken: u64,
    reported: Option<u64>,
    truth: UdpSocket,
}

/// What one read of the link brought.
struct Read {
    bytes: u64,
    samples: Vec<Sample>,
}

/// A sample that ended in the unit.
pub struct Ended {
    /// Its index since the emulator's start.
    pub index: u64,
    /// What the link brought of it: nothing where a fault kept it silent.
    pub samples: Vec<Sample>,
}

/// The program `geu` that was named, else the one beside this program.
///
/// # Errors
/// No such program.
pub fn program(named: Option<&Path>) -> Result<PathBuf, String> {
    let beside = || std::env::current_exe().ok().map(|own| own.with_file_name("geu"));
    let path = named.map(Path::to_owned).or_else(beside).unwrap_or_default();
    match path.is_file() {
        true => Ok(path),
        false => Err(format!("--geu: expected the program geu, got {}, which is not there", path.display())),
    }
}

impl Emulator {
    /// Starts `geu run` on free ports, held back until this computer is there; it ends with this program, however that ends.
    ///
    /// # Errors
    /// A program that does not start, or ends before its link is ready.
    pub fn start(program: &Path, arguments: &[String]) -> Result<Emulator, String> {
        let mut command = Command::new(program);
        command.args(["run", "--wait", "--tcp", "127.0.0.1:0", "--truth", "udp://127.0.0.1:0"]).args(arguments);
        // SAFETY: between fork and exec this makes one system call and touches no memory.
        unsafe { command.pre_exec(|| set_pdeathsig(Signal::SIGTERM).map_err(io::Error::from)) };
        let failed = |error: io::Error| format!("{}: cannot be started: {error}", program.display());
        let mut process = EmulatorProcess::start(command).map_err(failed)?;
        let said = process.child.stderr.take();
        // What it says goes on, without its status line, which it keeps to a terminal.
        let speaker = thread::spawn(move || {
            for line in said.into_iter().flat_map(|said| BufReader::new(said).lines()).map_while(Result::ok) {
                let _ = writeln!(io::stderr(), "{line}");
            }
        });
        let mut running = Running { process, speaker: Some(speaker) };
        let (mut link, mut truth) = (None, None);
        while let (None, _) | (_, None) = (&link, &truth) {
            let ready = running.process.next_ready();
            let ready =
                ready.map_err(|_| "geu ended before its link was ready; what it said stands above".to_owned())?;
            link = link.or(ready.strip_prefix("tcp ").map(str::to_owned));
            truth = truth.or(ready.strip_prefix("truth udp://").map(str::to_owned));
        }
        let mut emulator = Emulator::attach(&link.unwrap_or_default(), &truth.unwrap_or_default())?;
        emulator.child = Some(running);
        // It waits for this computer: nothing left before.
        emulator.reported = Some(0);
        Ok(emulator)
    }

    /// Goes to one that runs: its link is a TCP address or a path, its truth is told to an address.
    ///
    /// # Errors
    /// Addresses at which nobody is.
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
        let refused = |error: io::Error| format!("--truth {truth}: cannot be told: {error}; expected HOST:PORT");
        let socket = UdpSocket::bind("0.0.0.0:0").map_err(refused)?;
        socket.connect(truth).map_err(refused)?;
        socket.set_read_timeout(Some(LOOK_AGAIN)).map_err(refused)?;
        let link = (link.to_owned(), peer);
        Ok(Emulator { child: None, link, read: listen(stream), taken: 0, reported: None, truth: socket })
    }

    /// Tells the truth, a line for an instant. One that cannot be sent is late, which the unit counts.
    pub fn tell(&self, lines: &str) {
        let _ = self.truth.send(format!("{SUBSCRIBE}{lines}").as_bytes());
    }

    /// The next sample that ended in the unit, with all that the link was handed by then.
    ///
    /// # Errors
    /// An emulator that reports none, a link that does not bring what was reported, or is closed.
    pub fn next(&mut self, stop: &AtomicBool) -> Result<Ended, String> {
        let mut datagram = vec![0; REPORT];
        let length = patiently(stop, || match self.truth.recv(&mut datagram) {
            Ok(length) => Some(Ok(length)),
            Err(error) if matches!(error.kind(), WouldBlock | TimedOut | Interrupted) => None,
            Err(error) => Some(Err(format!("the emulator cannot be reached: {error}"))),
        });
        let length = length.unwrap_or_else(|| {
            let silence_s = SILENCE.as_secs();
            Err(format!("no sample was reported for {silence_s} s; expected an emulator that runs"))
        })?;
        let unreadable = |what: &str| format!("a report of the emulator cannot be read: expected {what}");
        let report: Value = serde_json::from_slice(&datagram[..length]).map_err(|_| unreadable("JSON"))?;
        let whole = |key: &str| report[key].as_u64().ok_or_else(|| unreadable(key));
        let (index, sequence, bytes) = (whole("half_second")?, whole("sequence")?, self.bytes_of(&report["sent"])?);
        let mut samples: Vec<Sample> = Vec::new();
        let is_there =
            |samples: &[Sample]| bytes == 0 || samples.iter().any(|sample| u64::from(sample.sequence) == sequence);
        // What a link brought before the first report was of samples before: they are known by their sequence.
        while match self.reported {
            Some(reported) => self.taken < reported + bytes,
            None => !is_there(&samples),
        } {
            let read = patiently(stop, || match self.read.recv_timeout(LOOK_AGAIN) {
                Ok(read) => Some(Ok(read)),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => {
                    Some(Err("the link was closed: expected another sample".to_owned()))
                }
            });
            let read = read.unwrap_or_else(|| {
                let silence_s = SILENCE.as_secs();
                Err(format!("the link is silent for {silence_s} s: expected {bytes} bytes of a sample"))
            })?;
            self.taken += read.bytes;
            samples.extend(read.samples);
        }
        self.reported = Some(self.reported.map_or(self.taken, |reported| reported + bytes));
        Ok(Ended { index, samples })
    }

    /// Bytes that a report says of this computer's link.
    fn bytes_of(&self, sent: &Value) -> Result<u64, String> {
        let (link, peer) = &self.link;
        let is_ours = |name: &str| match (name.split_once(' '), peer) {
            // One that listens at every address of its machine is known by its port.
            (Some(("tcp", address)), Some(peer)) => {
                address.parse().is_ok_and(|own: SocketAddr| own.port() == peer.port())
            }
            (Some(("pty" | "serial", path)), None) => path == link,
            _ => false,
        };
        let bytes = sent.as_object().and_then(|sent| sent.iter().find(|(name, _)| is_ours(name)));
        bytes.and_then(|(_, handed)| handed["bytes"].as_u64()).ok_or_else(|| {
            format!("--link {link}: expected a link of the emulator at --truth, got one that it does not have: {sent}")
        })
    }

    /// Ends a child, and waits for it: whether it was content, as with what a plan expects.
    ///
    /// # Errors
    /// A child that could not run, or did not end.
    pub fn end(mut self) -> Result<bool, String> {
        let Some(mut running) = self.child.take() else { return Ok(true) };
        let _ = running.process.terminate();
        let child = &mut running.process.child;
        let asked = Instant::now();
        while asked.elapsed() < END {
            match child.try_wait() {
                Ok(Some(status)) if matches!(status.code(), Some(0 | 1)) => return Ok(status.success()),
                Ok(Some(status)) => return Err(format!("geu ended with {status}; what it said stands above")),
                _ => thread::sleep(Duration::from_millis(10)),
            }
        }
        Err(format!("geu did not end within {} s of being asked to; it was killed", END.as_secs()))
    }
}

/// A child that does not outlive this program's interest in it, and whose last words are passed on before that ends.
struct Running {
    process: EmulatorProcess,
    speaker: Option<JoinHandle<()>>,
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.process.child.kill();
        let _ = self.process.child.wait();
        self.speaker.take().map(JoinHandle::join);
    }
}

/// Asks until there is an answer; none after [`SILENCE`], or when it is to stop.
fn patiently<T>(stop: &AtomicBool, mut ask: impl FnMut() -> Option<T>) -> Option<T> {
    let asked = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return Some(answer);
        }
        if stop.load(Relaxed) || asked.elapsed() > SILENCE {
            return None;
        }
    }
}

/// Reads a link on a thread of its own.
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
