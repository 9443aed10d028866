//! A CAN interface. After it was down or removed it is opened again.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use nix::errno::Errno;
use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use socketcan::{CanFilter, CanSocket, EmbeddedFrame, ExtendedId, Frame, Id, Socket, SocketOptions, StandardId};
use tokio::sync::Notify;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::yield_now;

use super::address::CanAddress;
use super::error::LinkError;
use super::interface::{Link, LinkInfo, MAX_WAITING_REPLIES, reopen, retry, until_due};
use super::port::Watched;
use super::statistics::Sending;
use crate::console;
use crate::host::{self, Instant, now_ns};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;
use geu_recorder::link_model::{LinkModel, TransmitQueue, WireData};

/// Time for which a full queue is awaited in all; then the rest of the sample is dropped.
const QUEUE_TIMEOUT: Duration = Duration::from_millis(5);
/// Interval of attempts to write to a full queue.
const POLL_INTERVAL: Duration = Duration::from_micros(200);
/// Number of frames read before other links have their turn.
const TURN: usize = 16;
/// All 29 bits of an identifier: extended frames with the number of COMMAND are received too, to be counted.
const ID_MASK: u32 = 0x1FFF_FFFF;

/// The state shared by both threads.
struct Bus {
    address: CanAddress,
    /// The socket, unless a write has failed.
    socket: Mutex<Option<Arc<CanSocket>>>,
    /// Receives the error of a failed write.
    failures: UnboundedSender<Errno>,
    /// Held for the frames of one sample, so that no other frame of this link comes between.
    turn: tokio::sync::Mutex<()>,
    /// Replies by time, wall clock.
    answers: Mutex<TransmitQueue>,
    /// Replies wait for their time.
    later: Notify,
    info: LinkInfo,
}

/// Outcome of a write.
enum Written {
    Sent,
    Full,
    Failed,
}

struct Can {
    bus: Arc<Bus>,
    /// True if the interface was up when it was opened.
    is_up: bool,
    /// True if the queue was full at the last sample; each change is logged once.
    is_full: bool,
}

/// Opens the interface and serves it.
pub(super) fn open(
    address: &CanAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
) -> Result<impl Link + use<>, LinkError> {
    let socket = connect(address)?;
    let (failures, failed) = unbounded_channel();
    let name = match unit.device.is_iras() {
        true => format!("can {} {:X}", address.interface, address.plan.base()),
        false => format!("can {}", address.interface),
    };
    let bus = Arc::new(Bus {
        address: address.clone(),
        socket: Mutex::new(None),
        failures,
        turn: tokio::sync::Mutex::new(()),
        answers: Mutex::default(),
        later: Notify::new(),
        info: LinkInfo::new(model, name),
    });
    let is_up = is_up(&address.interface);
    host::spawn(serve(is_up.then_some(socket), failed, bus.clone(), unit.clone()));
    Ok(Can { bus, is_up, is_full: false })
}

/// Opens a non-blocking socket that receives only COMMAND.
fn connect(address: &CanAddress) -> Result<CanSocket, LinkError> {
    let explain = |error: io::Error| {
        let name = address.interface.clone();
        match error.raw_os_error().map(Errno::from_raw) {
            Some(Errno::EAFNOSUPPORT | Errno::EPROTONOSUPPORT) => LinkError::CanUnsupported(name, error),
            Some(Errno::EPERM | Errno::EACCES) => LinkError::CanPermission(name, error),
            Some(Errno::ENODEV | Errno::ENXIO)
                if getifaddrs().is_ok_and(|mut all| all.any(|one| one.interface_name == name)) =>
            {
                LinkError::NotCan(name)
            }
            Some(Errno::ENODEV | Errno::ENXIO) => LinkError::CanAbsent(name),
            _ => LinkError::Can(name, error),
        }
    };
    // Interface 0 means all: a failure here does not depend on the name.
    CanSocket::open_iface(0).map_err(explain)?;
    let socket = CanSocket::open(&address.interface).map_err(explain)?;
    socket.set_nonblocking(true).map_err(explain)?;
    socket.set_filters(&[CanFilter::new(address.plan.command_id().into(), ID_MASK)]).map_err(explain)?;
    Ok(socket)
}

fn is_up(interface: &str) -> bool {
    getifaddrs().is_ok_and(|mut all| {
        all.any(|one| one.interface_name == interface && one.flags.contains(InterfaceFlags::IFF_UP))
    })
}

fn to_socket(content: &WireData) -> Option<socketcan::CanFrame> {
    let WireData::Frame(frame) = content else { return None };
    match frame.is_extended() {
        true => socketcan::CanFrame::new(ExtendedId::new(frame.id())?, frame.data()),
        false => socketcan::CanFrame::new(StandardId::new(frame.id() as u16)?, frame.data()),
    }
}

impl Bus {
    fn socket(&self) -> MutexGuard<'_, Option<Arc<CanSocket>>> {
        host::lock(&self.socket)
    }

    fn answers(&self) -> MutexGuard<'_, TransmitQueue> {
        host::lock(&self.answers)
    }

    /// Opens a socket if the interface is up.
    fn reconnect(&self) -> Option<CanSocket> {
        Some(&self.address).filter(|address| is_up(&address.interface)).and_then(|address| connect(address).ok())
    }

    /// Writes a frame unless the queue is full.
    fn try_write(&self, socket: &CanSocket, frame: &socketcan::CanFrame) -> Written {
        let Err(error) = socket.write_frame(frame) else { return Written::Sent };
        match error.raw_os_error().map(Errno::from_raw) {
            Some(Errno::ENOBUFS | Errno::EAGAIN | Errno::EINTR) => Written::Full,
            errno => {
                *self.socket() = None;
                let _ = self.failures.send(errno.unwrap_or(Errno::EIO));
                Written::Failed
            }
        }
    }

    /// Writes frames, waits for a full queue up to its timeout in all, or up to `patience`, and returns true if all are sent.
    fn write_all(&self, socket: &CanSocket, data: &[WireData], patience: Option<&Patience>) -> bool {
        let _turn = self.turn.blocking_lock();
        let start = Instant::now();
        let is_over = || start.elapsed() >= QUEUE_TIMEOUT && patience.is_none_or(|patience| patience.is_over(start));
        data.iter().filter_map(to_socket).all(|frame| {
            loop {
                match self.try_write(socket, &frame) {
                    Written::Full if !is_over() => host::sleep_thread(POLL_INTERVAL),
                    written => return matches!(written, Written::Sent),
                }
            }
        })
    }

    /// Writes a frame on the runtime, which serves other links meanwhile.
    async fn write_later(&self, socket: &CanSocket, frame: &socketcan::CanFrame, give_up: Instant) -> bool {
        loop {
            match self.try_write(socket, frame) {
                Written::Full if Instant::now() < give_up => host::sleep(POLL_INTERVAL).await,
                written => return matches!(written, Written::Sent),
            }
        }
    }

    /// Sends the replies that are due, and returns the time of the next one.
    async fn send_answers(&self, socket: &CanSocket) -> Option<i64> {
        loop {
            let Some((_, data)) = self.answers().next_due(now_ns()) else { return self.answers().next_ns() };
            let turn = self.turn.lock().await;
            let give_up = Instant::now() + QUEUE_TIMEOUT;
            for frame in data.iter().filter_map(to_socket) {
                if !self.write_later(socket, &frame, give_up).await {
                    break;
                }
            }
            drop(turn);
        }
    }

    /// Sends replies at their time.
    async fn answer_later(&self, socket: &CanSocket) -> Infallible {
        loop {
            until_due(&self.later, self.send_answers(socket).await).await;
        }
    }
}

async fn serve(socket: Option<CanSocket>, mut failed: UnboundedReceiver<Errno>, bus: Arc<Bus>, unit: Arc<SharedUnit>) {
    let name = &bus.info.statistics.name;
    let mut socket = match socket {
        Some(socket) => socket,
        None => {
            console::say(format_args!(
                "{name}: is down; the unit keeps time, and sends when it is up: ip link set {} up",
                bus.address.interface
            ));
            let socket = retry(|| bus.reconnect()).await;
            console::ready(name);
            socket
        }
    };
    loop {
        let shared = Arc::new(socket);
        // Failures of the previous socket.
        while failed.try_recv().is_ok() {}
        *bus.socket() = Some(shared.clone());
        let reason = tokio::select! {
            biased;
            error = receive(shared.clone(), &bus, &unit) => error.to_string(),
            errno = failed.recv() => errno.unwrap_or(Errno::EIO).desc().to_owned(),
            never = bus.answer_later(&shared) => match never {},
        };
        // Replies that wait are obsolete.
        *bus.answers() = TransmitQueue::default();
        *bus.socket() = None;
        drop(shared);
        socket = reopen(name, reason, || bus.reconnect()).await;
    }
}

/// Answers commands until the socket fails.
async fn receive(socket: Arc<CanSocket>, bus: &Bus, unit: &SharedUnit) -> io::Error {
    let socket = match Watched::new(socket) {
        Ok(socket) => socket,
        Err(error) => return error,
    };
    for count in 1_usize.. {
        if count.is_multiple_of(TURN) {
            yield_now().await;
        }
        let received = match socket.readable().await {
            Ok(mut guard) => guard.try_io(|socket| socket.get_ref().read_frame()),
            Err(error) => return error,
        };
        match received {
            Err(_) => {}
            Ok(Err(error)) => return error,
            Ok(Ok(frame)) => answer(&frame, socket.get_ref(), bus, unit).await,
        }
    }
    unreachable!("the count has no end")
}

async fn answer(frame: &socketcan::CanFrame, socket: &CanSocket, bus: &Bus, unit: &SharedUnit) {
    let is_command = matches!(frame.id(), Id::Standard(_)) && !frame.is_remote_frame() && !frame.is_error_frame();
    if !is_command || frame.data().is_empty() {
        unit.rejected.fetch_add(1, Relaxed);
        return;
    }
    let answered = unit.command(&bus.info.statistics.name, frame.data()).await;
    let transmissions = unit.transmissions(&answered, &bus.info.model);
    if transmissions.is_empty() {
        return;
    }
    if bus.answers().message_count() >= MAX_WAITING_REPLIES {
        bus.info.statistics.unread_replies.fetch_add(1, Relaxed);
        return;
    }
    bus.answers().put(transmissions, 0, now_ns());
    bus.info.statistics.replies.fetch_add(1, Relaxed);
    bus.send_answers(socket).await;
    bus.later.notify_one();
}

impl Can {
    fn log_queue(&mut self, is_full: bool) {
        let was_full = std::mem::replace(&mut self.is_full, is_full);
        let name = &self.bus.info.statistics.name;
        match (was_full, is_full) {
            (false, true) => console::say(format_args!(
                "{name}: the transmit queue is full; the unit keeps time and drops frames: is the bus connected, does another node acknowledge?"
            )),
            (true, false) => console::say(format_args!("{name}: the transmit queue accepts frames again")),
            _ => {}
        }
    }
}

impl Link for Can {
    fn info(&self) -> &LinkInfo {
        &self.bus.info
    }

    fn send(&mut self, data: &[WireData], _more_fragments: bool, patience: &Patience) {
        let socket = self.bus.socket().clone();
        let is_sent = socket.is_some_and(|socket| {
            // A queue that was full is not awaited again until it accepts a sample.
            let is_sent = self.bus.write_all(&socket, data, Some(patience).filter(|_| !self.is_full));
            self.log_queue(!is_sent && self.bus.socket().is_some());
            is_sent
        });
        self.bus.info.statistics.count(if is_sent { Sending::Sent } else { Sending::Dropped });
    }

    fn send_answers(&mut self) {
        let Some(socket) = self.bus.socket().clone() else { return };
        let due = std::iter::from_fn(|| self.bus.answers().next_due(i64::MAX));
        let data: Vec<WireData> = due.flat_map(|(_, data)| data).collect();
        self.bus.write_all(&socket, &data, None);
    }

    fn is_ready(&self) -> bool {
        self.is_up
    }

    fn is_drained(&self) -> bool {
        true
    }
}
