//! A link on which a command is sent to the unit and its reply awaited.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::time::{Duration, Instant};

use geu_protocol::can::{AssemblerEvent, Role};
use geu_protocol::command::CommandResult;
use geu_protocol::serial::{Deframer, DeframerEvent, FrameType, frame, read_data};
use geu_protocol::{Assembler, CanIdMap, Reply, Sample};
use nix::libc;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use socketcan::{CanFilter, CanSocket, EmbeddedFrame, Id, Socket, SocketOptions, StandardId};

use crate::live::set_raw;

/// Opcode of POLL: data follow its reply.
pub const POLL: u8 = 0x03;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// A link on which a command is sent to the unit and its reply awaited.
pub enum CommandLink {
    Serial(File),
    Tcp(TcpStream),
    Can(CanSocket, CanIdMap),
}

impl CommandLink {
    /// Opens a pty or serial device, in raw mode.
    ///
    /// # Errors
    /// A path that cannot be opened, or is no device.
    pub fn serial(device: &Path, baud: u32) -> io::Result<CommandLink> {
        let mut options = OpenOptions::new();
        let file = options.read(true).write(true).custom_flags(libc::O_NOCTTY | libc::O_NONBLOCK).open(device)?;
        if !file.metadata()?.file_type().is_char_device() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "is not a device"));
        }
        set_raw(&file, baud)?;
        Ok(CommandLink::Serial(file))
    }

    /// Connects over TCP.
    ///
    /// # Errors
    /// No listener at the address.
    pub fn tcp(address: &SocketAddr) -> io::Result<CommandLink> {
        let stream = TcpStream::connect_timeout(address, CONNECT_TIMEOUT)?;
        stream.set_nodelay(true)?;
        Ok(CommandLink::Tcp(stream))
    }

    /// Opens a CAN interface for the identifiers of this plan.
    ///
    /// # Errors
    /// No such interface.
    pub fn can(interface: &str, plan: CanIdMap) -> io::Result<CommandLink> {
        let socket = CanSocket::open(interface)?;
        let filters: Vec<_> = (plan.base()..=plan.reply_id())
            .map(|id| CanFilter::new(id.into(), libc::CAN_SFF_MASK | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG))
            .collect();
        socket.set_filters(&filters)?;
        Ok(CommandLink::Can(socket, plan))
    }

    /// Sends a payload and waits for its reply, and for the data where they follow.
    ///
    /// # Errors
    /// A link that breaks.
    pub fn ask(&mut self, payload: &[u8], give_up: Instant) -> io::Result<(Option<Reply>, Option<Sample>)> {
        let (reply, polled) = match self {
            CommandLink::Serial(file) => ask_bytes(file, payload, give_up),
            CommandLink::Tcp(stream) => ask_bytes(stream, payload, give_up),
            CommandLink::Can(socket, plan) => ask_can(socket, *plan, payload, give_up),
        }?;
        Ok((reply, polled.filter(|_| reply.is_some_and(|reply| reply.opcode() == POLL))))
    }
}

type Answer = (Option<Reply>, Option<Sample>);

fn ask_bytes(link: &mut (impl Read + Write + AsFd), payload: &[u8], give_up: Instant) -> io::Result<Answer> {
    let (mut reply, mut polled) = (None, None);
    link.write_all(&frame(FrameType::Command, payload))?;
    let (mut deframer, mut buffer, mut chunk) = (Deframer::default(), Vec::new(), [0; 256]);
    while !is_complete(reply.as_ref(), polled.as_ref()) && wait(link, give_up)? {
        let length = match link.read(&mut chunk) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(length) => length,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(error),
        };
        buffer.extend_from_slice(&chunk[..length]);
        let used = deframer.consume(&buffer, &mut |found| match found {
            DeframerEvent::Frame { kind: FrameType::Reply, payload: bytes, .. } if reply.is_none() => {
                reply = Reply::read(bytes).filter(|reply| reply.opcode() == payload[0]);
            }
            DeframerEvent::Frame { kind: FrameType::Data, payload, .. } if reply.is_some() && polled.is_none() => {
                polled = Some(read_data(payload));
            }
            _ => {}
        });
        buffer.drain(..used);
    }
    Ok((reply, polled))
}

fn ask_can(socket: &CanSocket, plan: CanIdMap, payload: &[u8], give_up: Instant) -> io::Result<Answer> {
    let (mut reply, mut polled) = (None, None);
    let id = StandardId::new(plan.command_id()).expect("a plan has 11-bit identifiers only");
    let frame = socketcan::CanFrame::new(id, payload).expect("a payload has at most eight bytes");
    socket.write_frame(&frame)?;
    let mut assembler = Assembler::default();
    while !is_complete(reply.as_ref(), polled.as_ref()) && wait(socket, give_up)? {
        let frame = socket.read_frame()?;
        let Id::Standard(id) = frame.id() else { continue };
        match plan.role(id.as_raw().into()) {
            Role::Reply if reply.is_none() => {
                reply = Reply::read(frame.data()).filter(|reply| reply.opcode() == payload[0]);
            }
            role if reply.is_some() => assembler.push(role, (), frame.data(), &mut |event| {
                if let AssemblerEvent::Row(row) = event {
                    polled.get_or_insert(row.sample);
                }
            }),
            _ => {}
        }
    }
    Ok((reply, polled))
}

fn is_complete(reply: Option<&Reply>, polled: Option<&Sample>) -> bool {
    reply.is_some_and(|reply| reply.opcode() != POLL || reply.outcome() != CommandResult::Done || polled.is_some())
}

/// Waits until bytes are available; false at the deadline.
fn wait(source: &impl AsFd, give_up: Instant) -> io::Result<bool> {
    let left = give_up.saturating_duration_since(Instant::now());
    let milliseconds = PollTimeout::try_from(left + Duration::from_micros(999)).unwrap_or(PollTimeout::MAX);
    Ok(!left.is_zero() && poll(&mut [PollFd::new(source.as_fd(), PollFlags::POLLIN)], milliseconds)? > 0)
}
