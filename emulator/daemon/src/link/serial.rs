//! A real serial port. An adapter that is unplugged is opened again when it comes back.

use std::io;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::time::Duration;

use tokio_serial::{DataBits, Parity, SerialStream, StopBits};

use super::address::SerialAddress;
use super::error::LinkError;
use super::interface::{Link, LinkInfo, Watched};
use super::receive::{CommandServer, Receiver};
use super::send_buffer::Port;
use super::statistics::Sending;
use super::stream_sender::StreamSender;
use crate::console;
use crate::link_model::{LinkModel, WireData};
use crate::patience::Patience;
use crate::shared_unit::SharedUnit;

/// Between two attempts at a port that is gone.
const AGAIN: Duration = Duration::from_millis(250);

impl SerialAddress {
    fn open(&self) -> io::Result<(SerialStream, Port)> {
        let builder = tokio_serial::new(&self.device, self.baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One);
        let stream = SerialStream::open(&builder)?;
        // SAFETY: the descriptor belongs to `stream`, which is alive during the call that duplicates it.
        let borrowed = unsafe { std::os::fd::BorrowedFd::borrow_raw(std::os::fd::AsRawFd::as_raw_fd(&stream)) };
        let port = Arc::new(borrowed.as_fd().try_clone_to_owned()?);
        Ok((stream, port))
    }
}

struct Serial {
    line: Arc<StreamSender>,
    info: LinkInfo,
}

/// Opens the port and serves it.
pub(super) fn open(
    address: &SerialAddress,
    model: LinkModel,
    unit: &Arc<SharedUnit>,
) -> Result<impl Link + use<>, LinkError> {
    let opened = address.open().map_err(|error| LinkError::Serial(address.device.clone(), error))?;
    let info = LinkInfo::new(model, format!("serial {} {}", address.device, address.baud));
    let line = Arc::new(StreamSender::new(None, 0.0, info.statistics.clone()));
    let commands = CommandServer { unit: unit.clone(), info: info.clone() };
    tokio::spawn(attend(opened, address.clone(), line.clone(), commands));
    Ok(Serial { line, info })
}

async fn attend(
    mut opened: (SerialStream, Port),
    address: SerialAddress,
    line: Arc<StreamSender>,
    commands: CommandServer,
) {
    let name = &commands.info.statistics.name;
    loop {
        line.open(opened.1.clone());
        let end = session(&opened.1, &line, &commands).await;
        line.close();
        drop(opened);
        let reason = end.err().map_or_else(|| "hung up".to_owned(), |error| error.to_string());
        console::say(format_args!("{name}: gone ({reason}); the unit keeps time and waits for it to come back"));
        opened = loop {
            tokio::time::sleep(AGAIN).await;
            if let Ok(opened) = address.open() {
                break opened;
            }
        };
        console::say(format_args!("{name}: is back"));
    }
}

async fn session(port: &Port, line: &StreamSender, commands: &CommandServer) -> io::Result<()> {
    let port = Watched::new(port.clone())?;
    let mut receiver = Receiver::default();
    let end = tokio::select! {
        end = commands.serve(&port, line, &mut receiver, &commands.info.statistics.name) => end,
        end = line.pump(&port) => end,
    };
    commands.end(&mut receiver);
    end
}

impl Link for Serial {
    fn info(&self) -> &LinkInfo {
        &self.info
    }

    fn send(&mut self, data: &[WireData], more_fragments: bool, patience: &Patience) {
        self.info.statistics.count(match self.line.send(data, more_fragments, patience) {
            Sending::Unread => Sending::Dropped,
            outcome => outcome,
        });
    }

    fn send_answers(&mut self) {
        self.line.send_answers(i64::MAX);
    }

    fn is_drained(&self) -> bool {
        self.line.is_drained()
    }
}
