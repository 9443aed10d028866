//! Serial bytes to every client of a TCP address.

use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use ipnet::IpNet;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{setsockopt, sockopt};
use tokio::net::{TcpListener, TcpStream};

use super::error::LinkError;
use super::interface::{Link, LinkInfo, Watched};
use super::receive::{CommandServer, Receiver};
use super::send_buffer::Port;
use super::statistics::Sending;
use super::stream_sender::StreamSender;
use crate::console;
use crate::descriptors;
use crate::link_model::{LinkModel, WireData};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;

/// Clients at once; more are turned away.
const CLIENTS: usize = 64;
/// Asked of the kernel for what a client has not taken, byte: some seconds of it, not an hour. Not asked of a faster
/// run, which would wait for acknowledgements all the time.
const SEND_BUFFER: usize = 4096;
/// A client that has ended its side and gets nothing for so long is taken for gone.
const DEAF: Duration = Duration::from_secs(10);
/// Between two looks at a client that has ended its side.
const LOOK_AGAIN: Duration = Duration::from_millis(250);
/// A client is asked for a sign of life after so long, and again after so long, s.
const KEEP_ALIVE: u32 = 10;
/// A client that acknowledges nothing for so long is gone, ms.
const SILENCE_MS: u32 = 60_000;
/// After an accept that failed: for lack of descriptors, for example.
const ACCEPT_AGAIN: Duration = Duration::from_millis(200);

/// Where clients connect, and from where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TcpAddress {
    /// `HOST:PORT`; port 0 takes a free one.
    pub address: String,
    /// Networks whose machines may connect; this machine always may.
    pub allowed: Vec<IpNet>,
}

impl TcpAddress {
    /// Who may connect to it.
    ///
    /// # Errors
    /// An address that other machines reach, where none of them is named.
    fn check(&self) -> Result<(), LinkError> {
        let fail = |error| LinkError::Tcp(self.address.clone(), error);
        let mut reached = self.address.to_socket_addrs().map_err(fail)?;
        match self.allowed.is_empty() && reached.any(|address| !address.ip().to_canonical().is_loopback()) {
            true => Err(LinkError::TcpOpenToAll(self.address.clone())),
            false => Ok(()),
        }
    }

    fn allows(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        peer.is_loopback() || self.allowed.iter().any(|network| network.contains(&peer))
    }
}

struct Tcp {
    clients: Clients,
    info: LinkInfo,
}

type Clients = Arc<Mutex<Vec<Arc<Client>>>>;

/// One client.
struct Client {
    line: StreamSender,
    /// It has ended its side, and perhaps is gone.
    has_ended: AtomicBool,
}

/// Listens, and serves whoever comes.
pub(super) fn open(
    address: &TcpAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
    is_faster: bool,
) -> Result<impl Link + use<>, LinkError> {
    address.check()?;
    let fail = |error| LinkError::Tcp(address.address.clone(), error);
    let listener = std::net::TcpListener::bind(&address.address).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    let listener = TcpListener::from_std(listener).map_err(fail)?;
    let info = LinkInfo::new(model, format!("tcp {}", listener.local_addr().map_err(fail)?));
    let clients = Clients::default();
    let server = Server {
        address: address.clone(),
        is_faster,
        clients: clients.clone(),
        commands: CommandServer { unit: unit.clone(), info: info.clone() },
    };
    tokio::spawn(server.accept(listener));
    Ok(Tcp { clients, info })
}

/// What the clients of an address are served with.
struct Server {
    address: TcpAddress,
    is_faster: bool,
    clients: Clients,
    commands: CommandServer,
}

impl Server {
    async fn accept(self, listener: TcpListener) {
        let server = Arc::new(self);
        let (mut is_failing, mut has_told) = (false, false);
        loop {
            let accepted = listener.accept().await;
            let was_failing = std::mem::replace(&mut is_failing, accepted.is_err());
            let name = &server.commands.info.statistics.name;
            let (stream, peer) = match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    if !was_failing {
                        console::say(format_args!("{name}: no client can be taken in: {error}; tries again"));
                    }
                    tokio::time::sleep(ACCEPT_AGAIN).await;
                    continue;
                }
            };
            if let Err(reason) = server.take_in(stream, peer) {
                server.commands.info.statistics.refused.fetch_add(1, Relaxed);
                if !std::mem::replace(&mut has_told, true) {
                    console::say(format_args!("{name}: {peer} is turned away, and more may be: {reason}"));
                }
            }
        }
    }

    /// Serves a client in a task of its own, or says why not.
    fn take_in(self: &Arc<Server>, stream: TcpStream, peer: SocketAddr) -> Result<(), String> {
        if !self.address.allows(peer.ip()) {
            return Err("its address is not among those of --tcp-allow".to_owned());
        }
        if descriptors::is_scarce_beside(stream.as_raw_fd()) {
            return Err("the descriptors that are left are for others; ulimit -n raises the limit".to_owned());
        }
        let mut served = self.clients().clone();
        served.retain(|client| client.line.is_open());
        if served.len() >= CLIENTS {
            // One that has ended its side most likely is gone; somebody who is there needs its place.
            let gone = served.iter().find(|client| client.has_ended.load(Relaxed));
            gone.ok_or_else(|| format!("{CLIENTS} clients are served"))?.line.close();
        }
        let port = prepare(stream, self.is_faster).map_err(|error| error.to_string())?;
        let line = StreamSender::new(Some(port.clone()), 0.0, self.commands.info.statistics.clone());
        let client = Arc::new(Client { line, has_ended: AtomicBool::new(false) });
        self.clients().push(client.clone());
        self.commands.info.statistics.clients.fetch_add(1, Relaxed);
        let server = self.clone();
        tokio::spawn(async move {
            server.attend(port, &client, peer).await;
            client.line.close();
            server.clients().retain(|other| !Arc::ptr_eq(other, &client));
            server.commands.info.statistics.clients.fetch_sub(1, Relaxed);
        });
        Ok(())
    }

    fn clients(&self) -> MutexGuard<'_, Vec<Arc<Client>>> {
        self.clients.lock().expect("nothing panics with the list")
    }

    async fn attend(&self, port: Port, client: &Client, peer: SocketAddr) {
        let Ok(port) = Watched::new(port) else { return };
        let link = format!("tcp {peer}");
        let commands = async {
            let mut receiver = Receiver::of_network();
            let end = self.commands.serve(&port, &client.line, &mut receiver, &link).await;
            self.commands.end(&mut receiver);
            match end {
                // It has said all it had to say, but may go on listening: `socat -u`, `nc` at the end of its input.
                Ok(()) => {
                    client.has_ended.store(true, Relaxed);
                    until_gone(port.get_ref(), &client.line).await;
                }
                Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                    self.commands.info.statistics.refused.fetch_add(1, Relaxed);
                    console::say(format_args!("{}: {peer} {error}; closed", self.commands.info.statistics.name));
                }
                Err(_) => {}
            }
        };
        tokio::select! {
            () = commands => {}
            _ = client.line.pump(&port) => {}
        }
    }
}

fn prepare(stream: TcpStream, is_faster: bool) -> io::Result<Port> {
    stream.set_nodelay(true)?;
    let stream = OwnedFd::from(stream.into_std()?);
    setsockopt(&stream, sockopt::KeepAlive, &true)?;
    setsockopt(&stream, sockopt::TcpKeepIdle, &KEEP_ALIVE)?;
    setsockopt(&stream, sockopt::TcpKeepInterval, &KEEP_ALIVE)?;
    setsockopt(&stream, sockopt::TcpUserTimeout, &SILENCE_MS)?;
    if !is_faster {
        setsockopt(&stream, sockopt::SndBuf, &SEND_BUFFER)?;
    }
    Ok(Arc::new(stream))
}

/// Returns when a client that has ended its side has ended the other too, or was sent nothing for a while: only what
/// is sent shows whether it still listens.
async fn until_gone(port: &Watched<Port>, line: &StreamSender) {
    let (mut written, mut since) = (line.written(), Instant::now());
    while since.elapsed() < DEAF {
        tokio::time::sleep(LOOK_AGAIN).await;
        let mut polled = [PollFd::new(port.as_fd(), PollFlags::empty())];
        let gone = PollFlags::POLLHUP | PollFlags::POLLERR;
        if poll(&mut polled, PollTimeout::ZERO).is_err()
            || polled[0].revents().is_some_and(|events| events.intersects(gone))
        {
            return;
        }
        let before = std::mem::replace(&mut written, line.written());
        if written != before {
            since = Instant::now();
        }
    }
}

impl Link for Tcp {
    fn info(&self) -> &LinkInfo {
        &self.info
    }

    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience) {
        let clients = self.clients.lock().expect("nothing panics with the list").clone();
        if clients.is_empty() {
            self.info.statistics.count(Sending::Unread);
        }
        for client in &clients {
            self.info.statistics.count(client.line.send(data, more_fragments, patience));
        }
    }

    fn send_answers(&mut self) {
        for client in self.clients.lock().expect("nothing panics with the list").iter() {
            client.line.send_answers(i64::MAX);
        }
    }

    fn is_drained(&self) -> bool {
        self.clients.lock().expect("nothing panics with the list").iter().all(|client| client.line.is_drained())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(address: &str, allowed: &[&str]) -> TcpAddress {
        let allowed = allowed.iter().map(|network| network.parse().expect("a network")).collect();
        TcpAddress { address: address.to_owned(), allowed }
    }

    #[test]
    fn other_machines_are_let_in_only_where_they_are_named() {
        assert!(address("127.0.0.1:0", &[]).check().is_ok() && address("[::1]:0", &[]).check().is_ok());
        for open in ["0.0.0.0:0", "[::]:0", "192.0.2.1:0"] {
            assert!(matches!(address(open, &[]).check(), Err(LinkError::TcpOpenToAll(_))), "{open}");
            assert!(address(open, &["192.0.2.0/24"]).check().is_ok(), "{open}");
        }
        let some = address("0.0.0.0:0", &["192.0.2.0/24", "2001:db8::/32"]);
        for (peer, is_allowed) in [
            ("192.0.2.7", true),
            ("::ffff:192.0.2.7", true),
            ("192.0.3.7", false),
            ("127.0.0.1", true),
            ("2001:db8::1", true),
            ("2001:db9::1", false),
        ] {
            assert_eq!(some.allows(peer.parse().expect("an address")), is_allowed, "{peer}");
        }
    }
}
