//! Live links: a CAN socket with the kernel's receive times, a serial port, and streams of bytes.

use std::fs::{File, OpenOptions};
use std::io::{self, IoSliceMut, IsTerminal, Read};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use geu_protocol::capture::{CaptureRecord, Timestamp, socketcan_record};
use geu_protocol::serial::DEFAULT_BAUD;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt};
use nix::sys::termios::{BaudRate, FlushArg, SetArg, Termios, cfmakeraw, cfsetspeed, tcflush, tcgetattr, tcsetattr};
use socketcan::{Socket, SocketOptions};

use crate::input_reader::Stop;

/// Waits until bytes can be read, for `timeout` at most; a signal ends it too.
pub(crate) fn wait_readable(descriptor: RawFd, timeout: Duration) -> bool {
    // SAFETY: the descriptor belongs to a source that outlives the call.
    let descriptor = unsafe { BorrowedFd::borrow_raw(descriptor) };
    let timeout = PollTimeout::try_from(timeout).unwrap_or(PollTimeout::MAX);
    let mut descriptors = [PollFd::new(descriptor, PollFlags::POLLIN)];
    poll(&mut descriptors, timeout).is_ok_and(|ready| ready > 0)
}

/// A pipe, a FIFO or a device. Its bytes are waited for, and the first writer of a FIFO, no longer than until it is to stop; what reads
/// through a decompressor then gets the error [`io::ErrorKind::WouldBlock`] in place of an end.
pub(crate) struct Stream<'a> {
    file: File,
    stop: Stop<'a>,
}

impl<'a> Stream<'a> {
    pub fn new(file: File, stop: Stop<'a>) -> Stream<'a> {
        Stream { file, stop }
    }

    /// Opens a path without waiting for a writer. Until the first has come a FIFO is not readable; it is not at its end either.
    pub fn open(path: &Path, stop: Stop<'a>) -> io::Result<Stream<'a>> {
        let file = OpenOptions::new().read(true).custom_flags(nix::libc::O_NONBLOCK).open(path)?;
        Ok(Stream::new(file, stop))
    }

    pub fn file(&self) -> &File {
        &self.file
    }
}

impl Read for Stream<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while !self.stop.is_due() {
            if !wait_readable(self.file.as_raw_fd(), self.stop.wait()) {
                continue;
            }
            match self.file.read(buffer) {
                // Another reader of it was faster, or a signal came.
                Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {}
                read => return read,
            }
        }
        Err(io::ErrorKind::WouldBlock.into())
    }
}

/// A time cut to microseconds, as in candump logs.
fn microseconds(t_ns: i64) -> Timestamp {
    Timestamp { t_ns: t_ns - t_ns.rem_euclid(1_000), digits: 6 }
}

fn now() -> Timestamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    microseconds(since.as_nanos() as i64)
}

/// A raw CAN socket that also receives CAN FD and error frames, to count them.
pub(crate) struct CanSocket {
    socket: socketcan::CanFdSocket,
    name: String,
    /// Frames dropped by the socket, from the kernel's counter.
    dropped: u32,
}

/// Result of a CAN socket.
pub(crate) enum Received {
    /// One frame, and the number dropped before it.
    Frame { dropped: u64 },
    /// No frame available.
    Empty,
}

impl CanSocket {
    pub fn open(name: &str) -> io::Result<CanSocket> {
        let socket = socketcan::CanFdSocket::open(name)?;
        socket.set_error_filter_accept_all()?;
        socket.set_nonblocking(true)?;
        setsockopt(&socket, sockopt::ReceiveTimestampns, &true)?;
        setsockopt(&socket, sockopt::RxqOvfl, &1)?;
        // As much as the kernel allows: rows wait here while a slow reader holds up the output.
        let _ = setsockopt(&socket, sockopt::RcvBuf, &(1 << 22));
        Ok(CanSocket { socket, name: name.to_owned(), dropped: 0 })
    }

    pub fn descriptor(&self) -> RawFd {
        self.socket.as_raw_fd()
    }

    /// Receives one frame and reports it, with the kernel's receive time.
    pub fn receive(&mut self, sink: &mut impl FnMut(CaptureRecord)) -> io::Result<Received> {
        let mut frame = [0; size_of::<nix::libc::canfd_frame>()];
        let mut control = nix::cmsg_space!(nix::sys::time::TimeSpec, u32);
        let mut parts = [IoSliceMut::new(&mut frame)];
        let message = match recvmsg::<()>(self.descriptor(), &mut parts, Some(&mut control), MsgFlags::empty()) {
            Ok(message) => message,
            Err(nix::Error::EAGAIN | nix::Error::EINTR) => return Ok(Received::Empty),
            // The interface is down; it may come up again.
            Err(nix::Error::ENETDOWN) => return Ok(Received::Empty),
            Err(error) => return Err(error.into()),
        };
        let (mut time, mut dropped) = (None, self.dropped);
        for entry in message.cmsgs()? {
            match entry {
                ControlMessageOwned::ScmTimestampns(stamp) => {
                    time = Some(microseconds(stamp.tv_sec() * 1_000_000_000 + stamp.tv_nsec()));
                }
                ControlMessageOwned::RxqOvfl(count) => dropped = count,
                _ => {}
            }
        }
        let length = message.bytes;
        let lost = dropped.wrapping_sub(self.dropped);
        self.dropped = dropped;
        let frame = &frame[..length];
        let id = frame.first_chunk().map_or(0, |bytes| u32::from_ne_bytes(*bytes));
        let is_fd = length > size_of::<nix::libc::can_frame>();
        let event =
            if is_fd { Some(CaptureRecord::Fd) } else { socketcan_record(id, time, self.name.as_bytes(), frame) };
        sink(event.unwrap_or(CaptureRecord::Broken { bytes: frame, cut: false }));
        Ok(Received::Frame { dropped: lost.into() })
    }
}

/// A serial device or pty in raw mode; its settings are put back at the end.
pub(crate) struct SerialPort {
    file: File,
    before: Termios,
}

impl SerialPort {
    /// Opens a terminal device; `None` for another device.
    pub fn open(path: &Path, baud: Option<u32>) -> io::Result<Option<SerialPort>> {
        let flags = nix::libc::O_NOCTTY | nix::libc::O_NONBLOCK;
        let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
        if !file.is_terminal() {
            return Ok(None);
        }
        let before = set_raw(&file, baud.unwrap_or(DEFAULT_BAUD))?;
        // Bytes in the buffer are older than their receive time would be.
        tcflush(&file, FlushArg::TCIFLUSH)?;
        Ok(Some(SerialPort { file, before }))
    }

    pub fn descriptor(&self) -> RawFd {
        self.file.as_raw_fd()
    }

    /// Reads available bytes, with the time; `None` at the end (the other side of a pty closed, a device unplugged).
    pub fn read(&mut self, buffer: &mut [u8]) -> io::Result<Option<(usize, Timestamp)>> {
        match self.file.read(buffer) {
            Ok(0) => Ok(None),
            Ok(length) => Ok(Some((length, now()))),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {
                Ok(Some((0, now())))
            }
            Err(error) if matches!(error.raw_os_error(), Some(nix::libc::EIO | nix::libc::ENXIO)) => Ok(None),
            Err(error) => Err(error),
        }
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        let _ = tcsetattr(self.file.as_fd(), SetArg::TCSANOW, &self.before);
    }
}

/// Sets a terminal to raw mode and returns its settings before.
pub(crate) fn set_raw(file: &File, baud: u32) -> io::Result<Termios> {
    let before = tcgetattr(file)?;
    let mut raw = before.clone();
    cfmakeraw(&mut raw);
    cfsetspeed(&mut raw, baud_rate(baud)?)?;
    tcsetattr(file, SetArg::TCSANOW, &raw)?;
    Ok(before)
}

fn baud_rate(baud: u32) -> io::Result<BaudRate> {
    Ok(match baud {
        1_200 => BaudRate::B1200,
        2_400 => BaudRate::B2400,
        4_800 => BaudRate::B4800,
        9_600 => BaudRate::B9600,
        19_200 => BaudRate::B19200,
        38_400 => BaudRate::B38400,
        57_600 => BaudRate::B57600,
        115_200 => BaudRate::B115200,
        230_400 => BaudRate::B230400,
        460_800 => BaudRate::B460800,
        921_600 => BaudRate::B921600,
        1_000_000 => BaudRate::B1000000,
        2_000_000 => BaudRate::B2000000,
        _ => {
            let text = format!("baud: expected a standard rate from 1200 to 2000000, got {baud}");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
    })
}
