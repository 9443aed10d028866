//! A pty under a stable symlink.
//!
//! Nobody but clients ever keeps the slave open, so the kernel itself tells whether one is attached: without one the
//! master stands hung up. (Holding a slave open and counting inotify's OPEN and CLOSE goes wrong, because equal events
//! that follow each other are merged.) While it is hung up nothing is written and nothing is polled for; inotify tells
//! of the next open. So a client that comes late gets the present, and one that reopens is served again.
//!
//! A client may leave the slave locked (TIOCEXCL), which outlives it: then a new pty takes its place under the symlink.

mod symlink;

use std::convert::Infallible;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use geu_protocol::serial::{BITS_PER_BYTE, DEFAULT_BAUD, MAX_FRAME};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl, open as open_file};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::stat::Mode;
use nix::sys::termios::{FlushArg, SetArg, cfmakeraw, tcflush, tcgetattr, tcsetattr};
use nix::unistd::ttyname;
use tokio::io::unix::AsyncFd;
use tokio::task::yield_now;

use super::error::LinkError;
use super::interface::{Link, LinkInfo, Watched};
use super::receive::{CommandServer, Receiver};
use super::send_buffer::Port;
use super::stream_sender::StreamSender;
use crate::console;
use crate::link_model::{LinkModel, WireData};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;
use symlink::Symlink;

/// Unread bytes beyond which no more are written: what the line discipline of a real port keeps, less a frame.
const BACKLOG: usize = 4095 - MAX_FRAME;
/// Between two looks for room.
const LOOK_AGAIN: Duration = Duration::from_micros(100);
/// Between two attempts at what failed, for lack of descriptors for example.
const AGAIN: Duration = Duration::from_millis(250);

nix::ioctl_read_bad!(
    /// Bytes that can be read.
    fionread,
    nix::libc::FIONREAD,
    nix::libc::c_int
);

/// The pty, as the thread that keeps time sees it.
struct Pty {
    line: Arc<StreamSender>,
    symlink: Arc<Symlink>,
    info: LinkInfo,
    is_stalled: bool,
    /// Bytes that its client had not read when that was asked last, and bytes that were written by then.
    unread: usize,
    written: u64,
}

/// Our end, and where clients open theirs.
struct Terminal {
    master: Port,
    slave: Slave,
}

impl Terminal {
    fn new() -> nix::Result<Terminal> {
        let pair = openpty(None, None)?;
        make_raw(&pair.slave)?;
        fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        fcntl(&pair.master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
        Ok(Terminal { slave: Slave(ttyname(&pair.slave)?), master: Arc::new(pair.master) })
    }
}

/// Where clients open it.
#[derive(Clone)]
struct Slave(PathBuf);

impl Slave {
    /// Opens it for a moment; the kernel takes it for a client while it is open.
    fn open(&self) -> nix::Result<OwnedFd> {
        open_file(&self.0, OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC, Mode::empty())
    }

    /// Forgets what nobody read, and how the last client had set it.
    fn reset(&self) -> nix::Result<()> {
        let slave = self.open()?;
        make_raw(&slave)?;
        tcflush(&slave, FlushArg::TCIFLUSH)
    }

    /// Bytes that its client has not read.
    fn backlog(&self) -> usize {
        let mut length = 0;
        let Ok(slave) = self.open() else { return 0 };
        // SAFETY: the descriptor is open, and FIONREAD writes one int.
        match unsafe { fionread(std::os::fd::AsRawFd::as_raw_fd(&slave), &raw mut length) } {
            Ok(_) => length.max(0) as usize,
            Err(_) => 0,
        }
    }
}

fn make_raw(slave: &OwnedFd) -> nix::Result<()> {
    let mut termios = tcgetattr(slave)?;
    cfmakeraw(&mut termios);
    tcsetattr(slave, SetArg::TCSANOW, &termios)
}

/// What the kernel says of the master: hung up while no client has the slave open, with input where one has written.
fn state(master: impl AsFd) -> PollFlags {
    let mut polled = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
    match poll(&mut polled, PollTimeout::ZERO) {
        Ok(_) => polled[0].revents().unwrap_or(PollFlags::empty()),
        Err(_) => PollFlags::empty(),
    }
}

/// Opens a pty, puts a symlink to it at `path`, and serves it.
pub(super) fn open(
    path: &Path,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
    speedup: f64,
) -> Result<impl Link + use<>, LinkError> {
    let fail = |error: nix::Error| LinkError::Pty(path.display().to_string(), error.into());
    let terminal = Terminal::new().map_err(fail)?;
    let symlink = Arc::new(Symlink::create(path, &terminal.slave.0)?);

    let info = LinkInfo::new(model, format!("pty {}", path.display()));
    let byte_ns = f64::from(BITS_PER_BYTE) * 1e9 / f64::from(DEFAULT_BAUD) / speedup;
    let line = Arc::new(StreamSender::new(None, byte_ns, info.statistics.clone()));
    let inotify = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).map_err(fail)?;
    let inotify = Watched::new(inotify).map_err(|error| LinkError::Pty(path.display().to_string(), error))?;
    let commands = CommandServer { unit: unit.clone(), info: info.clone() };
    let server = Server { inotify, line: line.clone(), symlink: symlink.clone(), commands };
    tokio::spawn(async move { server.attend(terminal).await });
    Ok(Pty { line, symlink, info, is_stalled: false, unread: 0, written: 0 })
}

/// What clients are served with.
struct Server {
    inotify: AsyncFd<Watched<Inotify>>,
    line: Arc<StreamSender>,
    symlink: Arc<Symlink>,
    commands: CommandServer,
}

impl Server {
    /// Serves one client after the other.
    async fn attend(&self, mut terminal: Terminal) -> Infallible {
        let statistics = &self.commands.info.statistics;
        let mut is_failing = false;
        loop {
            let end = self.attend_one(&mut terminal).await;
            self.line.close();
            statistics.clients.store(0, Relaxed);
            let was_failing = std::mem::replace(&mut is_failing, end.is_err());
            if let Err(error) = end {
                if !was_failing {
                    console::say(format_args!("{}: {error}; the unit keeps time and tries again", statistics.name));
                }
                tokio::time::sleep(AGAIN).await;
            }
        }
    }

    /// Waits for a client and serves it until it is gone.
    async fn attend_one(&self, terminal: &mut Terminal) -> io::Result<()> {
        match terminal.slave.reset() {
            Err(Errno::EBUSY) => {
                // In this order: where the symlink cannot be changed, that is tried again.
                let fresh = Terminal::new()?;
                self.symlink.lead_to(&fresh.slave.0)?;
                *terminal = fresh;
            }
            result => result?,
        }
        let Terminal { master, slave } = terminal;
        let watch = self.inotify.get_ref().add_watch(&slave.0, AddWatchFlags::IN_OPEN)?;
        // A client that came and went has left its commands.
        while state(&*master) == PollFlags::POLLHUP {
            let mut guard = self.inotify.readable().await?;
            // What is reported does not matter, only that something is: the master knows the truth.
            let _ = guard.try_io(|inotify| Ok(inotify.get_ref().read_events()?));
        }
        self.inotify.get_ref().rm_watch(watch)?;
        self.line.open(master.clone());
        self.commands.info.statistics.clients.store(1, Relaxed);
        let mut receiver = Receiver::default();
        loop {
            let port = Watched::new(master.clone())?;
            tokio::select! {
                // The end of one client, perhaps with bytes that it left; another may be there already.
                _ = self.commands.serve(&port, &self.line, &mut receiver, &self.commands.info.statistics.name) => {}
                _ = self.line.pump(&port) => {}
            }
            if state(&*master) == PollFlags::POLLHUP {
                self.commands.end(&mut receiver);
                return Ok(());
            }
            yield_now().await;
        }
    }
}

impl Pty {
    fn slave(&self) -> Slave {
        Slave(self.symlink.target())
    }

    /// Whether its client has read enough. The kernel is asked only where all that was written since may be unread: to open
    /// the slave takes a lock that every terminal of the machine shares, which another process may hold for milliseconds.
    fn has_room(&mut self) -> bool {
        let written = self.line.written();
        if self.unread as u64 + (written - self.written) > BACKLOG as u64 {
            (self.unread, self.written) = (self.slave().backlog(), written);
        }
        self.unread <= BACKLOG
    }
}

impl Link for Pty {
    fn info(&self) -> &LinkInfo {
        &self.info
    }

    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience) {
        let asked = Instant::now();
        self.is_stalled &= self.line.is_open();
        // The rest of a frame follows its beginning.
        let is_within_frame = self.line.is_within_frame();
        while self.line.is_open() && !is_within_frame && !self.has_room() {
            if self.is_stalled || patience.is_over(asked) {
                self.is_stalled = !patience.is_none();
                return self.info.statistics.count(self.line.drop_data(more_fragments));
            }
            thread::sleep(LOOK_AGAIN);
        }
        self.info.statistics.count(self.line.send(data, more_fragments, patience));
    }

    fn send_answers(&mut self) {
        self.line.send_answers(i64::MAX);
    }

    fn is_drained(&self) -> bool {
        !self.line.is_open() || (self.line.is_drained() && self.slave().backlog() == 0)
    }
}
