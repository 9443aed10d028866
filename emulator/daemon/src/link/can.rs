//! A CAN interface. One that goes down or vanishes is used again when it is back.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use socketcan::{CanFilter, CanSocket, EmbeddedFrame, Frame, Id, Socket, SocketOptions, StandardId};
use tokio::sync::Notify;
use tokio::task::yield_now;

use super::address::CanAddress;
use super::error::LinkError;
use super::interface::{LATE_ANSWERS, Link, LinkInfo, Watched, until_due};
use super::statistics::Sending;
use crate::cadence::now_ns;
use crate::console;
use crate::link_model::{LinkModel, TransmitQueue, WireData};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;

/// Between two attempts at an interface that is gone.
const AGAIN: Duration = Duration::from_millis(250);
/// A full queue is waited for so long in all; then the rest of the sample is dropped.
const QUEUE_PATIENCE: Duration = Duration::from_millis(5);
/// Between two looks for room in a full queue.
const LOOK_AGAIN: Duration = Duration::from_micros(200);
/// After so many frames read the other links have their turn.
const TURN: usize = 16;
/// All 29 bits of an identifier: extended frames with the number of COMMAND are seen too, to be counted.
const ID_MASK: u32 = 0x1FFF_FFFF;

/// What both threads share: the socket, while there is one that works.
struct Bus {
    address: CanAddress,
    socket: Mutex<Option<Arc<CanSocket>>>,
    /// A write found the socket to be of no use: why, and that it did.
    failure: Mutex<Option<Errno>>,
    lost: Notify,
    /// Held for the frames of one sample, so that no other comes between.
    turn: tokio::sync::Mutex<()>,
    /// Answers to commands, by the wall clock.
    answers: Mutex<TransmitQueue>,
    /// Answers wait for their time.
    later: Notify,
    info: LinkInfo,
}

/// What became of a frame.
enum Written {
    Sent,
    Full,
    Failed,
}

struct Can {
    bus: Arc<Bus>,
    /// Whether the interface was up when it was opened.
    is_up: bool,
    /// Whether the queue was full at the last sample; told once, and once when it is over.
    is_full: bool,
}

/// Opens the interface and serves it.
pub(super) fn open(
    address: &CanAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
) -> Result<impl Link + use<>, LinkError> {
    let socket = connect(address)?;
    let bus = Arc::new(Bus {
        address: address.clone(),
        socket: Mutex::new(None),
        failure: Mutex::new(None),
        lost: Notify::new(),
        turn: tokio::sync::Mutex::new(()),
        answers: Mutex::default(),
        later: Notify::new(),
        info: LinkInfo::new(model, format!("can {} {:X}", address.interface, address.plan.base())),
    });
    let is_up = is_up(&address.interface);
    tokio::spawn(attend(socket, is_up, bus.clone(), unit.clone()));
    Ok(Can { bus, is_up, is_full: false })
}

/// A socket that does not block and hears nothing but COMMAND.
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
    // Interface 0 is all of them: what fails here has nothing to do with the name.
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
    socketcan::CanFrame::new(StandardId::new(frame.id())?, frame.data())
}

impl Bus {
    fn socket(&self) -> Option<Arc<CanSocket>> {
        self.socket.lock().expect("nothing panics with the socket").clone()
    }

    /// Whether a write has found the socket to be of no use, and nobody has dealt with that yet.
    fn has_failed(&self) -> bool {
        self.failure.lock().expect("nothing panics with the reason").is_some()
    }

    /// Returns why when a write has found the socket to be of no use.
    async fn failed(&self) -> Errno {
        loop {
            self.lost.notified().await;
            if let Some(errno) = self.failure.lock().expect("nothing panics with the reason").take() {
                return errno;
            }
        }
    }

    /// Writes a frame if there is room.
    fn try_write(&self, socket: &CanSocket, frame: &socketcan::CanFrame) -> Written {
        let Err(error) = socket.write_frame(frame) else { return Written::Sent };
        match error.raw_os_error().map(Errno::from_raw) {
            Some(Errno::ENOBUFS | Errno::EAGAIN | Errno::EINTR) => Written::Full,
            errno => {
                *self.failure.lock().expect("nothing panics with the reason") = errno.or(Some(Errno::EIO));
                self.lost.notify_one();
                Written::Failed
            }
        }
    }

    /// Writes a frame, giving a full queue its time since `asked`, or more where there is `patience`.
    fn write(
        &self,
        socket: &CanSocket,
        frame: &socketcan::CanFrame,
        asked: Instant,
        patience: Option<&Patience>,
    ) -> bool {
        let is_over = || asked.elapsed() >= QUEUE_PATIENCE && patience.is_none_or(|patience| patience.is_over(asked));
        loop {
            match self.try_write(socket, frame) {
                Written::Full if !is_over() => std::thread::sleep(LOOK_AGAIN),
                written => return matches!(written, Written::Sent),
            }
        }
    }

    /// The same for the runtime, which has others to serve meanwhile.
    async fn write_later(&self, socket: &CanSocket, frame: &socketcan::CanFrame, give_up: Instant) -> bool {
        loop {
            match self.try_write(socket, frame) {
                Written::Full if Instant::now() < give_up => tokio::time::sleep(LOOK_AGAIN).await,
                written => return matches!(written, Written::Sent),
            }
        }
    }
}

impl Bus {
    fn answers(&self) -> MutexGuard<'_, TransmitQueue> {
        self.answers.lock().expect("nothing panics with the answers")
    }

    /// Sends the answers whose time has come; when the next is due.
    async fn send_answers(&self, socket: &CanSocket) -> Option<i64> {
        loop {
            let Some((_, contents)) = self.answers().take(now_ns()) else { return self.answers().next_ns() };
            let turn = self.turn.lock().await;
            let give_up = Instant::now() + QUEUE_PATIENCE;
            for frame in contents.iter().filter_map(to_socket) {
                if !self.write_later(socket, &frame, give_up).await {
                    break;
                }
            }
            drop(turn);
        }
    }

    /// Sends answers at their time.
    async fn answer_later(&self, socket: &CanSocket) -> Infallible {
        loop {
            let next_ns = self.send_answers(socket).await;
            until_due(&self.later, next_ns).await;
        }
    }
}

async fn attend(socket: CanSocket, mut was_up: bool, bus: Arc<Bus>, unit: Arc<SharedUnit>) {
    let name = &bus.info.statistics.name;
    let mut next = Some(socket);
    if !was_up {
        console::say(format_args!(
            "{name}: is down; the unit keeps time, and sends when it is up: ip link set {} up",
            bus.address.interface
        ));
        next = None;
    }
    loop {
        let socket = loop {
            match next.take() {
                Some(socket) => break Arc::new(socket),
                None => {
                    tokio::time::sleep(AGAIN).await;
                    next =
                        Some(&bus.address).filter(|address| is_up(&address.interface)).and_then(|it| connect(it).ok());
                }
            }
        };
        if !was_up {
            console::ready(name);
            was_up = true;
        }
        // What failed on the socket before says nothing of this one.
        bus.failure.lock().expect("nothing panics with the reason").take();
        *bus.socket.lock().expect("nothing panics with the socket") = Some(socket.clone());
        let reason = tokio::select! {
            error = serve(socket.clone(), &bus, &unit) => error.to_string(),
            errno = bus.failed() => errno.desc().to_owned(),
            never = bus.answer_later(&socket) => match never {},
        };
        // What was not answered by now is history.
        *bus.answers() = TransmitQueue::default();
        *bus.socket.lock().expect("nothing panics with the socket") = None;
        console::say(format_args!("{name}: gone ({reason}); the unit keeps time and waits for it to come back"));
        loop {
            tokio::time::sleep(AGAIN).await;
            if is_up(&bus.address.interface)
                && let Ok(socket) = connect(&bus.address)
            {
                next = Some(socket);
                break;
            }
        }
        console::say(format_args!("{name}: is back"));
    }
}

/// Answers commands until the socket is of no use.
async fn serve(socket: Arc<CanSocket>, bus: &Bus, unit: &SharedUnit) -> io::Error {
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
    unreachable!("nobody counts so far")
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
    if bus.answers().len() >= LATE_ANSWERS {
        bus.info.statistics.unread_replies.fetch_add(1, Relaxed);
        return;
    }
    bus.answers().put(transmissions, 0, now_ns());
    bus.info.statistics.replies.fetch_add(1, Relaxed);
    bus.send_answers(socket).await;
    bus.later.notify_one();
}

impl Can {
    fn tell_queue(&mut self, is_full: bool) {
        let was_full = std::mem::replace(&mut self.is_full, is_full);
        let name = &self.bus.info.statistics.name;
        match (was_full, is_full) {
            (false, true) => console::say(format_args!(
                "{name}: the transmit queue is full; the unit keeps time and drops what does not fit: is the bus connected, does anybody acknowledge?"
            )),
            (true, false) => console::say(format_args!("{name}: the transmit queue has room again")),
            _ => {}
        }
    }
}

impl Link for Can {
    fn info(&self) -> &LinkInfo {
        &self.bus.info
    }

    fn send(&mut self, data: &[WireData], _more_fragments: bool, patience: &Patience) {
        let outcome = match self.bus.socket() {
            Some(socket) => {
                let turn = self.bus.turn.blocking_lock();
                // A queue that stayed full once is not waited for like that again until it has room.
                let patience = Some(patience).filter(|_| !self.is_full);
                let asked = Instant::now();
                let all_sent =
                    data.iter().filter_map(to_socket).all(|frame| self.bus.write(&socket, &frame, asked, patience));
                drop(turn);
                self.tell_queue(!all_sent && !self.bus.has_failed());
                if all_sent { Sending::Sent } else { Sending::Dropped }
            }
            None => Sending::Dropped,
        };
        self.bus.info.statistics.count(outcome);
    }

    fn send_answers(&mut self) {
        let Some(socket) = self.bus.socket() else { return };
        let due = std::iter::from_fn(|| self.bus.answers().take(i64::MAX));
        let frames: Vec<_> = due.flat_map(|(_, contents)| contents).filter_map(|content| to_socket(&content)).collect();
        let turn = self.bus.turn.blocking_lock();
        let asked = Instant::now();
        for frame in frames {
            if !self.bus.write(&socket, &frame, asked, None) {
                break;
            }
        }
        drop(turn);
    }

    fn is_ready(&self) -> bool {
        self.is_up
    }

    fn is_drained(&self) -> bool {
        true
    }
}
