//! Serial bytes to every client of a TCP address.

use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use ipnet::IpNet;
use nix::poll::PollFlags;
use nix::sys::socket::{setsockopt, sockopt};
use tokio::net::{TcpListener, TcpStream};

use super::error::LinkError;
use super::interface::LinkInfo;
use super::port::{Port, WatchedPort};
use super::receive::{CommandServer, Receiver, UNHEARD_TIMEOUT};
use super::statistics::{LinkStatistics, Sending};
use super::stream_sender::{Senders, StreamLink, StreamSender};
use crate::console;
use crate::descriptors;
use crate::host::{self, Instant};
use crate::shared_unit::SharedUnit;
use geu_recorder::link_model::LinkModel;

/// Maximum number of clients; more are refused.
const MAX_CLIENTS: usize = 64;
/// Size of the kernel's send buffer, bytes: seconds of data, not an hour. Not set for a run faster than real time, which would
/// wait for acknowledgements all the time.
const SEND_BUFFER: usize = 4096;
/// A client that has shut down its side and is sent no data for this time is gone.
const ENDED_TIMEOUT: Duration = Duration::from_secs(10);
/// Interval of checks of a client that has shut down its side.
const POLL_INTERVAL: Duration = Duration::from_millis(250);
/// Time to the first TCP keep-alive probe, and interval of further probes, s.
const KEEP_ALIVE: u32 = 10;
/// A peer that acknowledges nothing for this time is gone, ms.
pub(crate) const ACKNOWLEDGE_TIMEOUT_MS: u32 = 60_000;
/// Pause after a failed accept, for example for lack of descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Address of the listener, and the allowed clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TcpAddress {
    /// `HOST:PORT`; port 0 takes a free one.
    pub address: String,
    /// Networks that may connect; this machine always may.
    pub allowed: Vec<IpNet>,
}

impl TcpAddress {
    /// # Errors
    /// An address that other machines reach, without an allowed network.
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

/// Listens, and serves the clients.
pub(super) fn open(
    address: &TcpAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
    is_faster: bool,
) -> Result<StreamLink, LinkError> {
    address.check()?;
    let fail = |error| LinkError::Tcp(address.address.clone(), error);
    let listener = std::net::TcpListener::bind(&address.address).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    let listener = TcpListener::from_std(listener).map_err(fail)?;
    let info = LinkInfo::new(model, format!("tcp {}", listener.local_addr().map_err(fail)?));
    let (link, clients) = start(info, unit);
    let server = Server { address: address.clone(), is_faster, clients };
    host::spawn(server.accept(listener));
    Ok(link)
}

/// A link without clients, and its clients to come.
pub(crate) fn start(info: LinkInfo, unit: &Arc<SharedUnit>) -> (StreamLink, Arc<Clients>) {
    let senders = Senders::default();
    let commands = CommandServer { unit: unit.clone(), info: info.clone() };
    let clients = Arc::new(Clients { senders: senders.clone(), commands });
    (StreamLink { info, senders, without_client: Sending::Unread }, clients)
}

/// Accepts clients.
struct Server {
    address: TcpAddress,
    is_faster: bool,
    clients: Arc<Clients>,
}

impl Server {
    async fn accept(self, listener: TcpListener) {
        let (mut is_failing, mut has_logged) = (false, false);
        loop {
            let accepted = listener.accept().await;
            let was_failing = std::mem::replace(&mut is_failing, accepted.is_err());
            let LinkStatistics { name, refused, .. } = &*self.clients.commands.info.statistics;
            let (stream, peer) = match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    if !was_failing {
                        console::say(format_args!("{name}: cannot accept clients: {error}; trying again"));
                    }
                    host::sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            };
            if let Err(reason) = self.admit(stream, peer) {
                refused.fetch_add(1, Relaxed);
                if !std::mem::replace(&mut has_logged, true) {
                    console::say(format_args!("{name}: {peer} refused, further refusals are only counted: {reason}"));
                }
            }
        }
    }

    /// # Errors
    /// The reason of a refusal.
    fn admit(&self, stream: TcpStream, peer: SocketAddr) -> Result<(), String> {
        if !self.address.allows(peer.ip()) {
            return Err("its address is not among those of --tcp-allow".to_owned());
        }
        if descriptors::is_scarce_beside(stream.as_raw_fd()) {
            return Err("the remaining descriptors are reserved; ulimit -n raises the limit".to_owned());
        }
        self.clients.connect(peer, || prepare(stream, self.is_faster))
    }
}

/// The clients of a link.
pub(crate) struct Clients {
    senders: Senders,
    commands: CommandServer,
}

impl Clients {
    /// Serves a client in a task of its own.
    ///
    /// # Errors
    /// The reason of a refusal.
    pub fn connect(
        self: &Arc<Clients>,
        peer: SocketAddr,
        open: impl FnOnce() -> io::Result<Port>,
    ) -> Result<(), String> {
        let mut served = self.senders.lock().clone();
        served.retain(|client| client.is_open());
        if served.len() >= MAX_CLIENTS {
            // A client that has shut down its side most likely is gone; the new client takes its place.
            let gone = served.iter().find(|client| client.has_ended.load(Relaxed));
            gone.ok_or_else(|| format!("{MAX_CLIENTS} clients are served"))?.close();
        }
        let port = open().map_err(|error| error.to_string())?;
        let client = StreamSender::new(Some(port.clone()), 0.0, &self.commands.info, None);
        self.senders.lock().push(client.clone());
        self.commands.info.statistics.clients.fetch_add(1, Relaxed);
        let clients = self.clone();
        host::spawn(async move {
            clients.serve(port, &client, peer).await;
            client.close();
            clients.senders.lock().retain(|other| !Arc::ptr_eq(other, &client));
            clients.commands.info.statistics.clients.fetch_sub(1, Relaxed);
        });
        Ok(())
    }

    async fn serve(&self, port: Port, client: &StreamSender, peer: SocketAddr) {
        let Ok(port) = WatchedPort::new(port) else { return };
        let link = format!("tcp {peer}");
        let commands = async {
            let mut receiver = Receiver::for_network();
            let end = self.commands.serve(&port, client, &mut receiver, &link).await;
            self.commands.end(&mut receiver);
            match end {
                // It sends no more, but may still read: `socat -u`, `nc` at the end of its input.
                Ok(()) => {
                    client.has_ended.store(true, Relaxed);
                    until_gone(&port.port, client).await;
                }
                Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                    self.commands.info.statistics.refused.fetch_add(1, Relaxed);
                    console::say(format_args!("{}: {peer} {error}; closed", self.commands.info.statistics.name));
                }
                Err(_) => {}
            }
        };
        tokio::pin!(commands);
        tokio::select! {
            biased;
            () = &mut commands => {}
            _ = client.pump(&port) => {
                // A client that is gone may have sent commands before.
                client.close();
                let _ = host::timeout(UNHEARD_TIMEOUT, commands).await;
            }
        }
    }
}

fn prepare(stream: TcpStream, is_faster: bool) -> io::Result<Port> {
    stream.set_nodelay(true)?;
    let stream = OwnedFd::from(stream.into_std()?);
    keep_alive(&stream)?;
    if !is_faster {
        setsockopt(&stream, sockopt::SndBuf, &SEND_BUFFER)?;
    }
    Ok(Port::new(stream))
}

/// Enables keep-alive probes, which detect a vanished peer.
pub(crate) fn keep_alive(stream: &impl AsFd) -> io::Result<()> {
    setsockopt(stream, sockopt::KeepAlive, &true)?;
    setsockopt(stream, sockopt::TcpKeepIdle, &KEEP_ALIVE)?;
    setsockopt(stream, sockopt::TcpKeepInterval, &KEEP_ALIVE)?;
    setsockopt(stream, sockopt::TcpUserTimeout, &ACKNOWLEDGE_TIMEOUT_MS)?;
    Ok(())
}

/// Returns when a client that has shut down its side has closed the connection, or was sent no data for some time: only sent
/// data shows whether it still reads.
async fn until_gone(port: &Port, client: &StreamSender) {
    let (mut written, mut since) = (client.written(), Instant::now());
    while since.elapsed() < ENDED_TIMEOUT {
        host::sleep(POLL_INTERVAL).await;
        if port.state().intersects(PollFlags::POLLHUP | PollFlags::POLLERR) {
            return;
        }
        let before = std::mem::replace(&mut written, client.written());
        if written != before {
            since = Instant::now();
        }
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
    fn other_machines_must_be_allowed() {
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
