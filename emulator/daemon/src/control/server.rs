//! Connections: a thread of its own, and bounds on what clients can take from it.

use std::collections::HashMap;
use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener, ToSocketAddrs};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use axum::Router;
use axum::http::StatusCode;
use axum::response::IntoResponse;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use nix::libc;
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio_io_timeout::TimeoutStream;

use super::answer::ApiError;
use super::backend::ControlBackend;
use super::guard::Guard;
use super::routes;

/// Ports that are tried from the default one on.
const PORTS: u16 = 100;
/// Connections served at once.
pub(super) const CONNECTIONS: usize = 32;
/// Of these, what clients at one address of another machine may have: enough for a page and a monitor, and others find room.
pub(super) const CONNECTIONS_EACH: usize = 12;
/// Connections beyond these that are told so; the others are closed.
const TURNED_AWAY: usize = 16;
/// A client has so long to send a request's headers, and an idle connection to send the next request.
pub(super) const HEADERS_WITHIN: Duration = Duration::from_secs(5);
/// A client that takes nothing for so long is dropped.
pub(super) const READS_WITHIN: Duration = Duration::from_secs(5);
/// Request line and headers together, byte.
const HEADERS: usize = 16 * 1024;
/// What the kernel keeps for a client that does not read, byte.
const UNREAD: usize = 128 * 1024;
/// After a failed accept (out of descriptors), so long until the next.
const PAUSE: Duration = Duration::from_millis(100);
/// Added to the thread's nice value: whoever keeps time comes first.
const NICE: libc::c_int = 5;

/// A control interface that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The address cannot be listened at.
    #[error("--control {0}: {1}; expected HOST:PORT of this machine, free, for example 127.0.0.1:8470, or off")]
    Address(String, io::Error),
    /// Other machines could drive the unit.
    #[error(
        "--control {0}: other machines can reach this address; expected a token (--control-token-file, or GEU_CONTROL_TOKEN in the environment) that keeps them out, or a loopback address"
    )]
    NoToken(String),
    /// No thread, no runtime.
    #[error("--control: cannot start: {0}")]
    System(#[from] io::Error),
}

/// The control interface, bound and not yet served: clients that come wait.
#[derive(Debug)]
pub struct ControlListener {
    listener: TcpListener,
    guard: Guard,
}

impl ControlListener {
    /// Listens at `address`; where that is the default and taken, at the next free port.
    ///
    /// # Errors
    /// An address that is not free or not this machine's, or that others reach without a token.
    pub fn open(address: &str, is_default: bool, token: Option<String>) -> Result<ControlListener, ControlError> {
        let fail = |error| ControlError::Address(address.to_owned(), error);
        let token = token.filter(|token| !token.is_empty());
        let mut wanted = address.to_socket_addrs().map_err(fail)?;
        let wanted = wanted.next().ok_or_else(|| fail(io::ErrorKind::AddrNotAvailable.into()))?;
        if !wanted.ip().is_loopback() && token.is_none() {
            return Err(ControlError::NoToken(address.to_owned()));
        }
        let last = if is_default { wanted.port().saturating_add(PORTS - 1) } else { wanted.port() };
        let mut port = wanted.port();
        let listener = loop {
            match TcpListener::bind(SocketAddr::new(wanted.ip(), port)) {
                Err(error) if error.kind() == io::ErrorKind::AddrInUse && port < last => port += 1,
                bound => break bound.map_err(fail)?,
            }
        };
        let address = listener.local_addr().map_err(fail)?;
        Ok(ControlListener { listener, guard: Guard { address, token } })
    }

    /// Where it listens, which need not be where it was asked to.
    pub fn address(&self) -> SocketAddr {
        self.guard.address
    }

    /// Serves `bench` until what is returned is dropped.
    ///
    /// # Errors
    /// No thread or no runtime.
    pub fn serve(self, bench: Arc<impl ControlBackend>) -> Result<Server, ControlError> {
        self.listener.set_nonblocking(true)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let router = routes::router(bench, self.guard);
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = thread::Builder::new().name("geu-control".to_owned()).spawn(move || {
            // SAFETY: has no memory to get wrong; on Linux process 0 is the calling thread. Refused, it changes nothing.
            unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) };
            runtime.block_on(async {
                let Ok(listener) = tokio::net::TcpListener::from_std(self.listener) else { return };
                tokio::select! { _ = stopped => {} () = accept(listener, router) => {} }
            });
            // Whatever a worker still does is for nobody: the end does not wait for it.
            runtime.shutdown_background();
        })?;
        Ok(Server { stop: Some(stop), thread: Some(thread) })
    }
}

/// The control interface, served; ends when dropped, with all its connections.
#[derive(Debug)]
pub struct Server {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The places for connections. Who reaches the port from elsewhere, with or without the token, may not have them all.
pub(super) struct ConnectionLimiter {
    all: Arc<Semaphore>,
    each: HashMap<IpAddr, Arc<Semaphore>>,
}

/// A place, held until it is dropped.
pub(super) type ConnectionPermit = (OwnedSemaphorePermit, Option<OwnedSemaphorePermit>);

impl ConnectionLimiter {
    /// All of them, free.
    pub fn new() -> ConnectionLimiter {
        ConnectionLimiter { all: Arc::new(Semaphore::new(CONNECTIONS)), each: HashMap::new() }
    }

    /// One for a client at this address; nothing where there is none.
    pub fn take(&mut self, peer: IpAddr) -> Option<ConnectionPermit> {
        let place = self.all.clone().try_acquire_owned().ok()?;
        let peer = network(peer);
        if peer.is_loopback() {
            return Some((place, None));
        }
        self.each.retain(|_, own| own.available_permits() < CONNECTIONS_EACH);
        let own = self.each.entry(peer).or_insert_with(|| Arc::new(Semaphore::new(CONNECTIONS_EACH)));
        Some((place, Some(own.clone().try_acquire_owned().ok()?)))
    }
}

/// What counts as one address: of IPv6 the network, in which a machine takes as many as it likes.
fn network(peer: IpAddr) -> IpAddr {
    match peer.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            let [a, b, c, d, ..] = address.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        own => own,
    }
}

async fn accept(listener: tokio::net::TcpListener, router: Router) {
    let (mut places, doorstep) = (ConnectionLimiter::new(), Arc::new(Semaphore::new(TURNED_AWAY)));
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        if let Some(place) = places.take(peer.ip()) {
            let router = router.clone();
            tokio::spawn(async move {
                converse(stream, Some(router)).await;
                drop(place);
            });
        } else if let Ok(place) = doorstep.clone().try_acquire_owned() {
            tokio::spawn(async move {
                converse(stream, None).await;
                drop(place);
            });
        }
    }
}

/// Answers the requests of one connection until either end has enough; without a router, tells that there is no room.
async fn converse(stream: TcpStream, router: Option<Router>) {
    let _ = stream.set_nodelay(true);
    let _ = nix::sys::socket::setsockopt(&stream, nix::sys::socket::sockopt::SndBuf, &UNREAD);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(READS_WITHIN));
    let io = TokioIo::new(Box::pin(stream));
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(HEADERS_WITHIN).max_buf_size(HEADERS);
    // What goes wrong with a connection is the client's to see.
    let _ = match router {
        Some(router) => builder.serve_connection(io, TowerToHyperService::new(router)).await,
        None => {
            let full = service_fn(|_| async {
                let message = format!(
                    "expected at most {CONNECTIONS} connections at once, {CONNECTIONS_EACH} of one machine, got more; try again later"
                );
                Ok::<_, Infallible>(ApiError(StatusCode::SERVICE_UNAVAILABLE, message).into_response())
            });
            builder.keep_alive(false).serve_connection(io, full).await
        }
    };
}
