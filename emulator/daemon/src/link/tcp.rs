//! Serial bytes to every client of a TCP address.

use std::net::SocketAddr;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{setsockopt, sockopt};
use tokio::net::{TcpListener, TcpStream};

use super::line::{Line, Port};
use super::receive::serve;
use super::{Link, LinkError, Tally, Watched, stream};
use crate::carriage::{Carrier, Content};
use crate::console;
use crate::desk::Desk;

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

struct Tcp {
    clients: Clients,
    carrier: Carrier,
    bytes: Vec<u8>,
    /// Whether they end within a frame.
    goes_on: bool,
    tally: Arc<Tally>,
}

type Clients = Arc<Mutex<Vec<Arc<Client>>>>;

/// One client.
struct Client {
    line: Line,
    /// It has ended its side, and perhaps is gone.
    has_ended: AtomicBool,
}

/// Listens, and serves whoever comes.
pub(super) fn open(
    address: &str,
    carrier: Carrier,
    desk: &Arc<Desk>,
    is_faster: bool,
) -> Result<impl Link + use<>, LinkError> {
    let fail = |error| LinkError::Tcp(address.to_owned(), error);
    let listener = std::net::TcpListener::bind(address).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    let listener = TcpListener::from_std(listener).map_err(fail)?;
    let tally = Tally::new(format!("tcp {}", listener.local_addr().map_err(fail)?));
    let clients = Clients::default();
    tokio::spawn(accept(listener, is_faster, clients.clone(), desk.clone(), carrier.clone(), tally.clone()));
    Ok(Tcp { clients, carrier, bytes: Vec::new(), goes_on: false, tally })
}

async fn accept(
    listener: TcpListener,
    is_faster: bool,
    clients: Clients,
    desk: Arc<Desk>,
    carrier: Carrier,
    tally: Arc<Tally>,
) {
    let mut has_told = false;
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_AGAIN).await;
            continue;
        };
        let mut served = clients.lock().expect("nothing panics with the list").clone();
        served.retain(|client| client.line.is_open());
        if served.len() >= CLIENTS
            && let Some(client) = served.iter().find(|client| client.has_ended.load(Relaxed))
        {
            // It most likely is gone; somebody who is there needs its place.
            client.line.close();
        } else if served.len() >= CLIENTS {
            if !std::mem::replace(&mut has_told, true) {
                console::say(format_args!(
                    "{}: {CLIENTS} clients are served, {peer} and more are turned away",
                    tally.name
                ));
            }
            continue;
        }
        let Ok(port) = prepare(stream, is_faster) else { continue };
        let line = Line::new(Some(port.clone()), 0.0, tally.clone());
        let client = Arc::new(Client { line, has_ended: AtomicBool::new(false) });
        clients.lock().expect("nothing panics with the list").push(client.clone());
        tally.clients.fetch_add(1, Relaxed);
        tokio::spawn({
            let (clients, desk, tally) = (clients.clone(), desk.clone(), tally.clone());
            let carrier = carrier.clone();
            async move {
                attend(port, &client, &desk, &carrier, peer).await;
                client.line.close();
                clients.lock().expect("nothing panics with the list").retain(|other| !Arc::ptr_eq(other, &client));
                tally.clients.fetch_sub(1, Relaxed);
            }
        });
    }
}

fn prepare(stream: TcpStream, is_faster: bool) -> std::io::Result<Port> {
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

async fn attend(port: Port, client: &Client, desk: &Desk, carrier: &Carrier, peer: SocketAddr) {
    let Ok(port) = Watched::new(port) else { return };
    let link = format!("tcp {peer}");
    let commands = async {
        if serve(&port, &client.line, desk, carrier, &link).await.is_ok() {
            // It has said all it had to say, but may go on listening: `socat -u`, `nc` at the end of its input.
            client.has_ended.store(true, Relaxed);
            until_gone(port.get_ref(), &client.line).await;
        }
    };
    tokio::select! {
        () = commands => {}
        _ = client.line.pump(&port) => {}
    }
}

/// Returns when a client that has ended its side has ended the other too, or was sent nothing for a while: only what
/// is sent shows whether it still listens.
async fn until_gone(port: &Watched<Port>, line: &Line) {
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
    fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    fn prepare(&mut self, contents: &[Content], goes_on: bool) {
        (self.bytes, self.goes_on) = (stream(contents), goes_on);
    }

    fn send(&mut self, patience: Duration) {
        let clients = self.clients.lock().expect("nothing panics with the list").clone();
        for client in &clients {
            self.tally.count(client.line.send(&self.bytes, self.goes_on, patience));
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

    fn tally(&self) -> Arc<Tally> {
        self.tally.clone()
    }
}
