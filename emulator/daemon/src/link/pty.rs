//! A pty under a stable symlink.
//!
//! Only clients keep the slave open, so the kernel reports whether one is attached: without one the master is hung up. (To hold
//! a slave open and count the OPEN and CLOSE events of inotify fails, because equal consecutive events are merged.) While it
//! is hung up nothing is written or polled; inotify reports the next open. So a late client gets the current samples, and one
//! that reopens is served again.
//!
//! A client may leave the slave locked (TIOCEXCL), which outlives it: then a new pty replaces it under the symlink.

mod symlink;

use std::convert::Infallible;
use std::future::Future;
use std::io;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use geu_protocol::serial::{BITS_PER_BYTE, DEFAULT_BAUD};
use nix::errno::Errno;
use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl, open as open_file};
use nix::poll::PollFlags;
use nix::pty::openpty;
use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify};
use nix::sys::stat::{Mode, fchmod};
use nix::sys::termios::{FlushArg, SetArg, cfmakeraw, tcflush, tcgetattr, tcsetattr};
use nix::unistd::{Gid, fchown, ttyname};
use tokio::io::unix::AsyncFd;
use tokio::task::yield_now;

use super::address::PtyAddress;
use super::error::LinkError;
use super::interface::{LinkInfo, RETRY_INTERVAL};
use super::port::{Port, Watched, WatchedPort};
use super::receive::{CommandServer, Receiver};
use super::statistics::Sending;
use super::stream_sender::{CountUnread, Senders, StreamLink, StreamSender};
use crate::console;
use crate::host;
use crate::shared_unit::SharedUnit;
use geu_recorder::link_model::LinkModel;
use symlink::Symlink;

nix::ioctl_read_bad!(
    /// Number of readable bytes.
    fionread,
    nix::libc::FIONREAD,
    nix::libc::c_int
);

/// A pty in the kernel.
pub(crate) trait Terminal: Send + Sync + 'static {
    /// The side of the unit.
    fn master(&self) -> &Port;
    /// Discards unread data and the settings of the last client; replaces a pty that it left locked.
    fn reset(&mut self) -> io::Result<()>;
    /// Waits until a client has opened it.
    fn opened(&self) -> impl Future<Output = io::Result<()>> + Send;
}

/// The master, and the slave that clients open, under its symlink.
struct DeviceTerminal {
    master: Port,
    slave: Slave,
    symlink: Arc<Symlink>,
    group: Option<Gid>,
    inotify: AsyncFd<Watched<Inotify>>,
}

/// Opens a pty: its master and its slave.
fn open_pair(group: Option<Gid>) -> nix::Result<(Port, Slave)> {
    let pair = openpty(None, None)?;
    make_raw(&pair.slave)?;
    group.map(|group| fchown(&pair.slave, None, Some(group))).transpose()?;
    // The mode of the system, often 620, lets the group tty write.
    let group_mode = group.map_or(Mode::empty(), |_| Mode::S_IRGRP | Mode::S_IWGRP);
    fchmod(&pair.slave, Mode::S_IRUSR | Mode::S_IWUSR | group_mode)?;
    fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
    fcntl(&pair.master, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC))?;
    let slave = Slave(ttyname(&pair.slave)?);
    Ok((Port::new(pair.master), slave))
}

impl Terminal for DeviceTerminal {
    fn master(&self) -> &Port {
        &self.master
    }

    fn reset(&mut self) -> io::Result<()> {
        match self.slave.reset() {
            Err(Errno::EBUSY) => {
                // In this order: a failed change of the symlink is tried again.
                let (master, slave) = open_pair(self.group)?;
                self.symlink.lead_to(&slave.0)?;
                (self.master, self.slave) = (master, slave);
            }
            result => result?,
        }
        Ok(())
    }

    async fn opened(&self) -> io::Result<()> {
        let watch = self.inotify.get_ref().add_watch(&self.slave.0, AddWatchFlags::IN_OPEN)?;
        while is_hung_up(&self.master) {
            let mut guard = self.inotify.readable().await?;
            // Any event is a reason to check the state of the master.
            let _ = guard.try_io(|inotify| Ok(inotify.get_ref().read_events()?));
        }
        Ok(self.inotify.get_ref().rm_watch(watch)?)
    }
}

/// True while no client has the slave open; a client that has closed it again may have sent commands.
fn is_hung_up(master: &Port) -> bool {
    master.state() == PollFlags::POLLHUP
}

/// Path of the slave.
struct Slave(PathBuf);

impl Slave {
    /// Opens it for a moment; the kernel regards that as a client.
    fn open(&self) -> nix::Result<OwnedFd> {
        open_file(&self.0, OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC, Mode::empty())
    }

    /// Discards unread data and the settings of the last client.
    fn reset(&self) -> nix::Result<()> {
        let slave = self.open()?;
        make_raw(&slave)?;
        tcflush(&slave, FlushArg::TCIFLUSH)
    }

    /// Number of bytes that the client has not read.
    fn count_unread(&self) -> u64 {
        let mut length = 0;
        let Ok(slave) = self.open() else { return 0 };
        // SAFETY: the descriptor is open, and FIONREAD writes one int.
        match unsafe { fionread(std::os::fd::AsRawFd::as_raw_fd(&slave), &raw mut length) } {
            Ok(_) => length.max(0) as u64,
            Err(_) => 0,
        }
    }
}

fn make_raw(slave: &OwnedFd) -> nix::Result<()> {
    let mut termios = tcgetattr(slave)?;
    cfmakeraw(&mut termios);
    tcsetattr(slave, SetArg::TCSANOW, &termios)
}

/// Opens a pty, puts a symlink to it at the path of the address, and serves it.
pub(super) fn open(
    address: &PtyAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
    speedup: f64,
) -> Result<StreamLink, LinkError> {
    let PtyAddress { path, group } = address;
    let fail = |error: nix::Error| match (error, group) {
        (Errno::EPERM, Some(_)) => LinkError::PtyGroup(error.into()),
        _ => LinkError::Pty(path.display().to_string(), error.into()),
    };
    let (master, slave) = open_pair(*group).map_err(fail)?;
    let symlink = Arc::new(Symlink::create(path, &slave.0)?);
    let own_symlink = symlink.clone();
    let count_unread = move || Slave(own_symlink.target()).count_unread();
    let inotify = Inotify::init(InitFlags::IN_NONBLOCK | InitFlags::IN_CLOEXEC).map_err(fail)?;
    let inotify = Watched::new(inotify).map_err(|error| LinkError::Pty(path.display().to_string(), error))?;
    let terminal = DeviceTerminal { master, slave, symlink, group: *group, inotify };
    Ok(start(terminal, format!("pty {}", path.display()), model, unit, speedup, Box::new(count_unread)))
}

/// Serves a pty.
pub(crate) fn start(
    terminal: impl Terminal,
    name: String,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
    speedup: f64,
    count_unread: CountUnread,
) -> StreamLink {
    let info = LinkInfo::new(model, name);
    let byte_ns =
        f64::from(BITS_PER_BYTE) * 1e9 / f64::from(info.model.encoding.baud().unwrap_or(DEFAULT_BAUD)) / speedup;
    let sender = StreamSender::new(None, byte_ns, &info, Some(count_unread));
    let senders = Senders::one(&sender);
    let server = Server { sender, commands: CommandServer { unit: unit.clone(), info: info.clone() } };
    host::spawn(async move { match server.serve(terminal).await {} });
    StreamLink { info, senders, without_client: Sending::Unread }
}

struct Server {
    sender: Arc<StreamSender>,
    commands: CommandServer,
}

impl Server {
    /// Serves one client after the other.
    async fn serve(&self, mut terminal: impl Terminal) -> Infallible {
        let statistics = &self.commands.info.statistics;
        let mut is_failing = false;
        loop {
            let end = self.serve_one(&mut terminal).await;
            self.sender.close();
            statistics.clients.store(0, Relaxed);
            let was_failing = std::mem::replace(&mut is_failing, end.is_err());
            if let Err(error) = end {
                if !was_failing {
                    console::say(format_args!("{}: {error}; the unit keeps time and tries again", statistics.name));
                }
                host::sleep(RETRY_INTERVAL).await;
            }
        }
    }

    /// Waits for a client and serves it until it is gone.
    async fn serve_one(&self, terminal: &mut impl Terminal) -> io::Result<()> {
        terminal.reset()?;
        terminal.opened().await?;
        let master = terminal.master();
        self.sender.open(master.clone());
        self.commands.info.statistics.clients.store(1, Relaxed);
        let mut receiver = Receiver::default();
        loop {
            let port = WatchedPort::new(master.clone())?;
            tokio::select! {
                biased;
                // The end of one client, perhaps with unread bytes; another may be attached already.
                _ = self.commands.serve(&port, &self.sender, &mut receiver, &self.commands.info.statistics.name) => {}
                _ = self.sender.pump(&port) => {}
            }
            if is_hung_up(master) {
                self.commands.end(&mut receiver);
                return Ok(());
            }
            yield_now().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    use nix::unistd::getegid;

    use super::*;

    #[test]
    fn a_pty_is_open_to_its_user_alone_unless_a_group_is_named() {
        for (group, mode) in [(None, 0o600), (Some(getegid()), 0o660)] {
            let (_master, slave) = open_pair(group).expect("a pty");
            let found = fs::metadata(&slave.0).expect("its slave").permissions().mode();
            assert_eq!(found & 0o777, mode, "{group:?}");
        }
    }
}
