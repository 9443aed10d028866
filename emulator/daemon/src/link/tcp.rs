//! Serial bytes to every client of a TCP address.

use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use geu_protocol::HalfSecond;
use geu_protocol::serial::{MAX_FRAME, data_frame};
use nix::sys::socket::{setsockopt, sockopt};
use tokio::net::{TcpListener, TcpStream};

use super::line::{Line, Port};
use super::receive::serve;
use super::{Link, LinkError, Tally, Watched};
use crate::console;
use crate::desk::Desk;

/// Clients at once; more are turned away.
const CLIENTS: usize = 64;
/// Asked of the kernel for what a client has not taken, byte: some seconds of it, not an hour. Not asked of a faster
/// run, which would wait for acknowledgements all the time.
const SEND_BUFFER: usize = 4096;
/// After an accept that failed: for lack of descriptors, for example.
const ACCEPT_AGAIN: Duration = Duration::from_millis(200);

struct Tcp {
    clients: Clients,
    frame: [u8; MAX_FRAME],
    tally: Arc<Tally>,
}

type Clients = Arc<Mutex<Vec<Arc<Line>>>>;

/// Listens, and serves whoever comes.
pub(super) fn open(address: &str, desk: &Arc<Desk>, is_faster: bool) -> Result<impl Link + use<>, LinkError> {
    let fail = |error| LinkError::Tcp(address.to_owned(), error);
    let listener = std::net::TcpListener::bind(address).map_err(fail)?;
    listener.set_nonblocking(true).map_err(fail)?;
    let listener = TcpListener::from_std(listener).map_err(fail)?;
    let tally = Tally::new(format!("tcp {}", listener.local_addr().map_err(fail)?));
    let clients = Clients::default();
    console::ready(&tally.name);
    tokio::spawn(accept(listener, is_faster, clients.clone(), desk.clone(), tally.clone()));
    Ok(Tcp { clients, frame: [0; MAX_FRAME], tally })
}

async fn accept(listener: TcpListener, is_faster: bool, clients: Clients, desk: Arc<Desk>, tally: Arc<Tally>) {
    let mut has_told = false;
    loop {
        let Ok((stream, peer)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_AGAIN).await;
            continue;
        };
        if tally.clients.load(Relaxed) >= CLIENTS {
            if !std::mem::replace(&mut has_told, true) {
                console::say(format_args!(
                    "{}: {CLIENTS} clients are served, {peer} and more are turned away",
                    tally.name
                ));
            }
            continue;
        }
        let Ok(port) = prepare(stream, is_faster) else { continue };
        let line = Arc::new(Line::new(Some(port.clone()), 0.0, tally.clone()));
        clients.lock().expect("nothing panics with the list").push(line.clone());
        tally.clients.fetch_add(1, Relaxed);
        tokio::spawn({
            let (clients, desk, tally) = (clients.clone(), desk.clone(), tally.clone());
            async move {
                attend(port, &line, &desk, peer).await;
                line.close();
                clients.lock().expect("nothing panics with the list").retain(|other| !Arc::ptr_eq(other, &line));
                tally.clients.fetch_sub(1, Relaxed);
            }
        });
    }
}

fn prepare(stream: TcpStream, is_faster: bool) -> std::io::Result<Port> {
    stream.set_nodelay(true)?;
    let stream = OwnedFd::from(stream.into_std()?);
    if !is_faster {
        setsockopt(&stream, sockopt::SndBuf, &SEND_BUFFER)?;
    }
    Ok(Arc::new(stream))
}

async fn attend(port: Port, line: &Line, desk: &Desk, peer: SocketAddr) {
    let Ok(port) = Watched::new(port) else { return };
    let link = format!("tcp {peer}");
    let commands = async {
        if serve(&port, line, desk, &link).await.is_ok() {
            // It has said all it had to say, but may go on listening: `socat -u`, `nc` at the end of its input.
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        () = commands => {}
        _ = line.pump(&port) => {}
    }
}

impl Link for Tcp {
    fn prepare(&mut self, half_second: &HalfSecond) {
        self.frame = data_frame(half_second);
    }

    fn send(&mut self, patience: Duration) {
        let clients = self.clients.lock().expect("nothing panics with the list").clone();
        for client in &clients {
            self.tally.count(client.send(&self.frame, patience));
        }
    }

    fn is_drained(&self) -> bool {
        self.clients.lock().expect("nothing panics with the list").iter().all(|client| client.is_drained())
    }

    fn tally(&self) -> Arc<Tally> {
        self.tally.clone()
    }
}
