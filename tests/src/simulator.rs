//! A simulator that sends truth over UDP to a running emulator and reads its replies.

use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::geu;

/// Timeout of a test: long, for a loaded machine.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A running `geu run` on a truth over UDP and a link over TCP, and the socket of its simulator.
pub struct Simulated {
    child: Child,
    /// Address of its link.
    pub link: String,
    /// To its truth.
    pub socket: UdpSocket,
}

impl Simulated {
    /// Starts it.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(arguments: &[&str]) -> Simulated {
        let mut command = geu();
        command.args([
            "run",
            "--tcp",
            "127.0.0.1:0",
            "--start",
            "0",
            "--truth",
            "udp://127.0.0.1:0",
            "--control",
            "off",
        ]);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("geu starts");
        let lines = BufReader::new(child.stdout.take().expect("a pipe")).lines().map_while(Result::ok);
        let (mut link, mut truth) = (None, None);
        for line in lines {
            link = link.or(line.strip_prefix("ready tcp ").map(str::to_owned));
            truth = truth.or(line.strip_prefix("ready truth udp://").map(str::to_owned));
            if link.is_some() && truth.is_some() {
                break;
            }
        }
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
        socket.connect(truth.expect("it listens")).expect("an address");
        socket.set_read_timeout(Some(PATIENCE)).expect("a socket");
        Simulated { child, link: link.expect("a link"), socket }
    }

    /// Sends lines.
    ///
    /// # Panics
    /// If they cannot be sent.
    pub fn send(&self, lines: &str) {
        self.socket.send(lines.as_bytes()).expect("sent");
    }

    /// The next report.
    ///
    /// # Panics
    /// If none comes.
    pub fn report(&self) -> String {
        let mut datagram = [0; 4096];
        let length = self.socket.recv(&mut datagram).expect("a report");
        String::from_utf8_lossy(&datagram[..length]).into_owned()
    }

    /// Asks it to end.
    ///
    /// # Panics
    /// If it does not run any more.
    pub fn ask_to_end(&self) {
        kill(Pid::from_raw(self.child.id() as i32), Signal::SIGTERM).expect("it runs");
    }

    /// Waits for its end: the exit code, what it said on standard error, and how long that took.
    ///
    /// # Panics
    /// If it ended before.
    pub fn end(mut self) -> (Option<i32>, String, Duration) {
        let (start, mut said) = (Instant::now(), String::new());
        self.child.stderr.take().expect("a pipe").read_to_string(&mut said).expect("text");
        (self.child.wait().expect("its end").code(), said, start.elapsed())
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A line of a body turned by this angle about X.
pub fn about_x(t_s: f64, arcsec: f64) -> String {
    let half_rad = (arcsec / 3600.0).to_radians() / 2.0;
    format!("{{\"t_s\": {t_s}, \"q\": [{}, {}, 0, 0]}}\n", half_rad.cos(), half_rad.sin())
}
