//! Connections: listener, thread, and limits per client.

use std::collections::HashMap;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr, TcpListener, ToSocketAddrs};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use axum::Router;
use axum::http::StatusCode;
use hyper::server::conn::http1;
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

/// Number of ports tried, from the default one on.
const PORTS: u16 = 100;
/// Maximum number of connections.
pub(super) const CONNECTIONS: usize = 32;
/// Maximum number of connections from one address of another machine: enough for a page and a monitor.
pub(super) const CONNECTIONS_EACH: usize = 12;
/// Maximum number of further connections that get an error response; others are closed.
const REJECTED: usize = 16;
/// Time that a client has to send the headers of a request, and an idle connection to send the next request.
pub(super) const HEADERS_TIMEOUT: Duration = Duration::from_secs(5);
/// A client that reads nothing for this long is disconnected.
pub(super) const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum length of request line and headers, byte.
const MAX_HEADERS: usize = 16 * 1024;
/// Send buffer of the kernel for a client that does not read, byte.
const SEND_BUFFER: usize = 128 * 1024;
/// Pause after a failed accept (no descriptors left).
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Added to the nice value of the thread: the cadence has priority.
const NICE: libc::c_int = 5;

/// A control interface that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum ControlError {
    /// The listener cannot be opened.
    #[error("--control {0}: {1}; expected HOST:PORT of this machine, free, for example 127.0.0.1:8470, or off")]
    Address(String, io::Error),
    /// Without a token any machine could command the unit.
    #[error(
        "--control {0}: other machines can reach this address; expected a token (--control-token-file, or GEU_CONTROL_TOKEN in the environment), or a loopback address"
    )]
    NoToken(String),
    /// No thread, no runtime.
    #[error("--control: cannot start: {0}")]
    System(#[from] io::Error),
}

/// The control interface, bound but not yet served: clients wait.
#[derive(Debug)]
pub struct ControlListener {
    listener: TcpListener,
    guard: Guard,
}

impl ControlListener {
    /// Listens at `address`; if that is the default and in use, at the next free port.
    ///
    /// # Errors
    /// An address that is in use or not of this machine, or that other machines can reach without a token.
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

    /// The bound address.
    pub fn address(&self) -> SocketAddr {
        self.guard.address
    }

    /// Serves `backend` until the returned server is dropped.
    ///
    /// # Errors
    /// No thread or no runtime.
    pub fn serve(self, backend: Arc<dyn ControlBackend>) -> Result<Server, ControlError> {
        self.listener.set_nonblocking(true)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let router = routes::router(backend, self.guard);
        let (stop, stopped) = oneshot::channel::<()>();
        let thread = thread::Builder::new().name("geu-control".to_owned()).spawn(move || {
            // SAFETY: uses no memory; on Linux process 0 is the calling thread. Without permission it changes nothing.
            unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) };
            runtime.block_on(async {
                let Ok(listener) = tokio::net::TcpListener::from_std(self.listener) else { return };
                tokio::select! { _ = stopped => {} () = accept(listener, router) => {} }
            });
            // Does not wait for the workers: the clients are disconnected.
            runtime.shutdown_background();
        })?;
        Ok(Server { stop: Some(stop), thread: Some(thread) })
    }
}

/// The served control interface; dropping it ends it and its connections.
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

/// Permits for connections. Clients on another machine, with or without the token, cannot take all of them.
pub(super) struct ConnectionLimiter {
    all: Arc<Semaphore>,
    each: HashMap<IpAddr, Arc<Semaphore>>,
}

/// A permit, held until dropped.
pub(super) type ConnectionPermit = (OwnedSemaphorePermit, Option<OwnedSemaphorePermit>);

impl ConnectionLimiter {
    pub fn new() -> ConnectionLimiter {
        ConnectionLimiter { all: Arc::new(Semaphore::new(CONNECTIONS)), each: HashMap::new() }
    }

    /// Returns a permit for `peer`, or `None` at the limit.
    pub fn acquire(&mut self, peer: IpAddr) -> Option<ConnectionPermit> {
        let permit = self.all.clone().try_acquire_owned().ok()?;
        let peer = network(peer);
        if peer.is_loopback() {
            return Some((permit, None));
        }
        self.each.retain(|_, own| own.available_permits() < CONNECTIONS_EACH);
        let own = self.each.entry(peer).or_insert_with(|| Arc::new(Semaphore::new(CONNECTIONS_EACH)));
        Some((permit, Some(own.clone().try_acquire_owned().ok()?)))
    }
}

/// The address that connections are counted by; of IPv6 the /64 network, in which a machine can choose any address.
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
    let (mut limiter, rejected) = (ConnectionLimiter::new(), Arc::new(Semaphore::new(REJECTED)));
    let full = Router::new().fallback(async || {
        let message = format!(
            "expected at most {CONNECTIONS} connections at once, {CONNECTIONS_EACH} of one machine, got more; try again later"
        );
        ApiError(StatusCode::SERVICE_UNAVAILABLE, message)
    });
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_PAUSE).await;
            continue;
        };
        if let Some(permit) = limiter.acquire(peer.ip()) {
            tokio::spawn(serve(stream, router.clone(), true, permit));
        } else if let Ok(permit) = rejected.clone().try_acquire_owned() {
            tokio::spawn(serve(stream, full.clone(), false, (permit, None)));
        }
    }
}

/// Answers the requests of one connection until either end closes it; holds `_permit` until then.
async fn serve(stream: TcpStream, router: Router, keep_alive: bool, _permit: ConnectionPermit) {
    let _ = stream.set_nodelay(true);
    let _ = nix::sys::socket::setsockopt(&stream, nix::sys::socket::sockopt::SndBuf, &SEND_BUFFER);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(HEADERS_TIMEOUT).max_buf_size(MAX_HEADERS);
    let io = TokioIo::new(Box::pin(stream));
    // Errors of a connection are visible to its client.
    let _ = builder.keep_alive(keep_alive).serve_connection(io, TowerToHyperService::new(router)).await;
}
