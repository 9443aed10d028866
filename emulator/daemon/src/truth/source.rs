//! Reading a source: tasks of the runtime that take what comes and hand it to the follower.
//!
//! A source that runs ahead of the unit is read no further than [`AHEAD_S`]; what it sends meanwhile waits in the kernel. 42
//! waits for its answer after every message: it is given when the running half second needs more, so 42 keeps the unit's
//! pace.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UdpSocket};

use super::forty_two::Message;
use super::lines::Lines;
use super::{Live, LiveAddress, json};
use crate::console;

/// Further than this ahead of what the unit needs nothing is read, on-board s.
const AHEAD_S: f64 = 2.0;
/// Longest datagram, byte.
const DATAGRAM: usize = 65_536;
/// Read at a time from a server, byte.
const CHUNK: usize = 16_384;
/// A server that is not there is tried again after so long.
const TRY_AGAIN: Duration = Duration::from_millis(250);
/// A server that does not answer is not waited for any longer.
const ANSWER: Duration = Duration::from_secs(2);
/// What 42 waits for.
const ACKNOWLEDGEMENT: &[u8] = b"Ack\n";

/// Begins to read.
pub(super) fn open(live: &Arc<Live>) -> io::Result<()> {
    let reader = live.clone();
    match &live.address {
        LiveAddress::Udp(address) => {
            let socket = std::net::UdpSocket::bind(address)?;
            socket.set_nonblocking(true)?;
            let socket = UdpSocket::from_std(socket)?;
            console::ready(&format!("truth udp://{}", socket.local_addr()?));
            tokio::spawn(listen(reader, socket));
        }
        LiveAddress::Tcp(address) | LiveAddress::FortyTwo(address) => {
            tokio::spawn(visit(reader, address.clone()));
        }
    }
    Ok(())
}

/// Takes datagrams, each of one or more lines.
async fn listen(live: Arc<Live>, socket: UdpSocket) {
    let (mut lines, mut datagram) = (Lines::default(), vec![0; DATAGRAM]);
    loop {
        live.until_wanted(AHEAD_S).await;
        let Ok((length, peer)) = socket.recv_from(&mut datagram).await else {
            tokio::time::sleep(TRY_AGAIN).await;
            continue;
        };
        let mut take = |number: u64, line: Result<&str, String>| {
            live.take(format_args!("line {number}, from {peer}"), line.and_then(json::sample));
        };
        lines.take(&datagram[..length], &mut take);
        if !datagram[..length].ends_with(b"\n") {
            lines.end(&mut take);
        }
    }
}

/// Connects to a server, reads it, and connects again when it is gone.
async fn visit(live: Arc<Live>, address: String) {
    let mut was_there = true;
    loop {
        let stream = match tokio::time::timeout(ANSWER, TcpStream::connect(&address)).await {
            Ok(stream) => stream,
            Err(_) => Err(io::ErrorKind::TimedOut.into()),
        };
        match stream {
            Ok(stream) => {
                was_there = true;
                console::say(format_args!("truth {}: connected", live.address));
                let ended = read(&live, stream).await;
                let why = ended.err().map_or_else(|| "it closed the connection".to_owned(), |error| error.to_string());
                console::say(format_args!("truth {}: {why}; tried again until it is back", live.address));
            }
            Err(error) if std::mem::take(&mut was_there) => {
                console::say(format_args!("truth {}: {error}; tried again until it is there", live.address));
            }
            Err(_) => {}
        }
        tokio::time::sleep(TRY_AGAIN).await;
    }
}

/// Reads a server to its end.
async fn read(live: &Live, mut stream: TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let is_forty_two = matches!(live.address, LiveAddress::FortyTwo(_));
    let (mut lines, mut message, mut chunk) = (Lines::default(), Message::default(), vec![0; CHUNK]);
    loop {
        if !is_forty_two {
            live.until_wanted(AHEAD_S).await;
        }
        let length = stream.read(&mut chunk).await?;
        if length == 0 {
            return Ok(());
        }
        let mut messages = 0;
        lines.take(&chunk[..length], |number, line| {
            let read = match line {
                Ok(line) if is_forty_two => message.line(line),
                line => Some(line.and_then(json::sample)),
            };
            let Some(read) = read else { return };
            messages += u64::from(is_forty_two);
            live.take(format_args!("line {number}"), read);
        });
        for _ in 0..messages {
            live.until_wanted(0.0).await;
            stream.write_all(ACKNOWLEDGEMENT).await?;
        }
    }
}
