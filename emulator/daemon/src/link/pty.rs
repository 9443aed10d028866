//! A pty under a stable symlink.
//!
//! Nobody but clients ever keeps the slave open, so the kernel itself tells whether one is attached: without one the
//! master stands hung up. (Holding a slave open and counting inotify's OPEN and CLOSE goes wrong, because equal events
//! that follow each other are merged.) While it is hung up nothing is written and nothing is polled for; inotify tells
//! of the next open. So a client that comes late gets the present, and one that reopens is served again.
//!
//! A client may leave the slave locked (TIOCEXCL), which outlives it: then a new pty takes its place under the symlink.

use std::fs;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
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

use super::line::{Line, Port};
use super::receive::serve;
use super::{Link, LinkError, Tally, Watched, stream};
use crate::carriage::{Carrier, Content};
use crate::console;
use crate::desk::Desk;

/// Unread bytes beyond which no more are written: what the line discipline of a real port keeps, less a frame.
const BACKLOG: usize = 4095 - MAX_FRAME;
/// Between two looks for room.
const LOOK_AGAIN: Duration = Duration::from_micros(100);

nix::ioctl_read_bad!(
    /// Bytes that can be read.
    fionread,
    nix::libc::FIONREAD,
    nix::libc::c_int
);

/// The pty, as the thread that keeps time sees it.
struct Pty {
    line: Arc<Line>,
    symlink: Arc<Symlink>,
    carrier: Carrier,
    bytes: Vec<u8>,
    /// Whether they end within a frame.
    goes_on: bool,
    is_stalled: bool,
    tally: Arc<Tally>,
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

/// Whether no client has the slave open.
fn is_hung_up(master: impl AsFd) -> bool {
    let mut polled = [PollFd::new(master.as_fd(), PollFlags::empty())];
    poll(&mut polled, PollTimeout::ZERO).is_ok()
        && polled[0].revents().is_some_and(|events| events.contains(PollFlags::POLLHUP))
}

/// Opens a pty, puts a symlink to it at `path`, and serves it.
pub(super) fn open(
    path: &Path,
    carrier: Carrier,
    desk: &Arc<Desk>,
    speedup: f64,
) -> Result<impl Link + use<>, LinkError> {
    let fail = |error: nix::Error| LinkError::Pty(path.display().to_string(), error.into());
    let terminal = Terminal::new().map_err(fail)?;
    let symlink = Arc::new(Symlink::create(path, &terminal.slave.0)?);

    let tally = Tally::new(format!("pty {}", path.display()));
    let byte_ns = f64::from(BITS_PER_BYTE) * 1e9 / f64::from(DEFAULT_BAUD) / speedup;
    let line = Arc::new(Line::new(None, byte_ns, tally.clone()));
    let inotify = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).map_err(fail)?;
    let inotify = Watched::new(inotify).map_err(|error| LinkError::Pty(path.display().to_string(), error))?;
    tokio::spawn({
        let (line, symlink, desk, tally) = (line.clone(), symlink.clone(), desk.clone(), tally.clone());
        let carrier = carrier.clone();
        async move {
            if let Err(error) = attend(terminal, &inotify, &line, &symlink, &desk, &carrier, &tally).await {
                console::say(format_args!("{}: {error}; the unit goes on without it", tally.name));
            }
        }
    });
    Ok(Pty { line, symlink, carrier, bytes: Vec::new(), goes_on: false, is_stalled: false, tally })
}

/// Serves one client after the other.
async fn attend(
    mut terminal: Terminal,
    inotify: &AsyncFd<Watched<Inotify>>,
    line: &Line,
    symlink: &Symlink,
    desk: &Desk,
    carrier: &Carrier,
    tally: &Tally,
) -> io::Result<()> {
    loop {
        match terminal.slave.reset() {
            Err(Errno::EBUSY) => {
                terminal = Terminal::new()?;
                symlink.lead_to(&terminal.slave.0)?;
            }
            result => result?,
        }
        let Terminal { master, slave } = &terminal;
        let watch = inotify.get_ref().add_watch(&slave.0, AddWatchFlags::IN_OPEN)?;
        while is_hung_up(master) {
            let mut guard = inotify.readable().await?;
            // What is told does not matter, only that something is: the master knows the truth.
            let _ = guard.try_io(|inotify| Ok(inotify.get_ref().read_events()?));
        }
        inotify.get_ref().rm_watch(watch)?;
        line.open(master.clone());
        tally.clients.store(1, Relaxed);
        while !is_hung_up(master) {
            let port = Watched::new(master.clone())?;
            tokio::select! {
                // The end of one client; another may be there already.
                _ = serve(&port, line, desk, carrier, &tally.name) => {}
                _ = line.pump(&port) => {}
            }
        }
        line.close();
        tally.clients.store(0, Relaxed);
    }
}

impl Link for Pty {
    fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    fn prepare(&mut self, contents: &[Content], goes_on: bool) {
        (self.bytes, self.goes_on) = (stream(contents), goes_on);
    }

    fn send(&mut self, patience: Duration) {
        let asked = Instant::now();
        self.is_stalled &= self.line.is_open();
        // The rest of a frame follows its beginning.
        let is_within_frame = self.line.is_within_frame();
        while self.line.is_open() && !is_within_frame && self.symlink.slave().backlog() > BACKLOG {
            if self.is_stalled || asked.elapsed() >= patience {
                self.is_stalled = !patience.is_zero();
                return self.tally.count(self.line.drop_data(self.goes_on));
            }
            thread::sleep(LOOK_AGAIN);
        }
        self.tally.count(self.line.send(&self.bytes, self.goes_on, patience));
    }

    fn send_answers(&mut self) {
        self.line.send_answers(i64::MAX);
    }

    fn is_drained(&self) -> bool {
        !self.line.is_open() || (self.line.is_drained() && self.symlink.slave().backlog() == 0)
    }

    fn tally(&self) -> Arc<Tally> {
        self.tally.clone()
    }
}

/// The symlink; removed when it goes, if it is still this one.
struct Symlink {
    path: PathBuf,
    target: Mutex<PathBuf>,
}

impl Symlink {
    /// Makes it in one step, in place of an old one that leads nowhere, or to a pty that is ours now.
    fn create(path: &Path, target: &Path) -> Result<Symlink, LinkError> {
        let name = || path.display().to_string();
        if let Ok(metadata) = path.symlink_metadata() {
            let kind = metadata.file_type();
            if kind.is_dir() {
                return Err(LinkError::PathTaken(name(), "a directory"));
            }
            if !kind.is_symlink() {
                return Err(LinkError::PathTaken(name(), if kind.is_file() { "a file" } else { "a device or socket" }));
            }
            match fs::read_link(path) {
                Ok(old) if old != target && path.exists() => {
                    return Err(LinkError::PathBusy(name(), old.display().to_string()));
                }
                _ => {}
            }
        }
        let symlink = Symlink { path: path.to_owned(), target: Mutex::new(target.to_owned()) };
        symlink.make(target).map_err(|error| LinkError::Pty(name(), error))?;
        Ok(symlink)
    }

    fn make(&self, target: &Path) -> io::Result<()> {
        let mut temporary = self.path.as_os_str().to_owned();
        temporary.push(format!(".{}", process::id()));
        symlink(target, &temporary)
            .and_then(|()| fs::rename(&temporary, &self.path))
            .inspect_err(|_| drop(fs::remove_file(&temporary)))
    }

    fn is_ours(&self) -> bool {
        fs::read_link(&self.path).is_ok_and(|target| target == self.slave().0)
    }

    /// Puts another pty in place of the one before; not if somebody else's link stands there by now.
    fn lead_to(&self, target: &Path) -> io::Result<()> {
        if self.is_ours() {
            self.make(target)?;
        }
        *self.target.lock().expect("nothing panics with the path") = target.to_owned();
        Ok(())
    }

    fn slave(&self) -> Slave {
        Slave(self.target.lock().expect("nothing panics with the path").clone())
    }
}

impl Drop for Symlink {
    fn drop(&mut self) {
        if self.is_ours() {
            let _ = fs::remove_file(&self.path);
        }
    }
}
