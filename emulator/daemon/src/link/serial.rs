//! A serial port. An adapter that was unplugged is opened again when it is back.

use std::io;
use std::os::fd::AsFd;
use std::sync::Arc;

use tokio_serial::{DataBits, Parity, SerialStream, StopBits};

use super::address::SerialAddress;
use super::error::LinkError;
use super::interface::{LinkInfo, reopen};
use super::port::{Port, WatchedPort};
use super::receive::{CommandServer, Receiver, UNHEARD_TIMEOUT};
use super::statistics::Sending;
use super::stream_sender::{Senders, StreamLink, StreamSender};
use crate::host;
use crate::shared_unit::SharedUnit;
use geu_protocol::serial::DEFAULT_BAUD;
use geu_recorder::link_model::LinkModel;

impl SerialAddress {
    fn open(&self) -> io::Result<(SerialStream, Port)> {
        let builder = tokio_serial::new(&self.device, self.baud.unwrap_or(DEFAULT_BAUD))
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(StopBits::One);
        let stream = SerialStream::open(&builder)?;
        // SAFETY: the descriptor belongs to `stream`, which is alive during the call that duplicates it.
        let borrowed = unsafe { std::os::fd::BorrowedFd::borrow_raw(std::os::fd::AsRawFd::as_raw_fd(&stream)) };
        let port = Port::new(borrowed.as_fd().try_clone_to_owned()?);
        Ok((stream, port))
    }
}

/// Opens the port and serves it.
pub(super) fn open(address: &SerialAddress, model: LinkModel, unit: &Arc<SharedUnit>) -> Result<StreamLink, LinkError> {
    let address = &SerialAddress { baud: model.encoding.baud(), ..address.clone() };
    let opened = address.open().map_err(|error| LinkError::Serial(address.device.clone(), error))?;
    let info = LinkInfo::new(model, format!("serial {} {}", address.device, address.baud.unwrap_or(DEFAULT_BAUD)));
    let sender = StreamSender::new(None, 0.0, &info, None);
    let commands = CommandServer { unit: unit.clone(), info: info.clone() };
    let senders = Senders::one(&sender);
    host::spawn(serve(opened, address.clone(), sender, commands));
    Ok(StreamLink { info, senders, without_client: Sending::Dropped })
}

async fn serve(
    mut opened: (SerialStream, Port),
    address: SerialAddress,
    sender: Arc<StreamSender>,
    commands: CommandServer,
) {
    loop {
        sender.open(opened.1.clone());
        let end = session(&opened.1, &sender, &commands).await;
        sender.close();
        drop(opened);
        let reason = end.err().map_or_else(|| "hung up".to_owned(), |error| error.to_string());
        opened = reopen(&commands.info.statistics.name, reason, || address.open().ok()).await;
    }
}

async fn session(port: &Port, sender: &StreamSender, commands: &CommandServer) -> io::Result<()> {
    let port = WatchedPort::new(port.clone())?;
    let mut receiver = Receiver::default();
    let end = {
        let heard = commands.serve(&port, sender, &mut receiver, &commands.info.statistics.name);
        tokio::pin!(heard);
        tokio::select! {
            biased;
            end = &mut heard => end,
            end = sender.pump(&port) => {
                sender.close();
                let _ = host::timeout(UNHEARD_TIMEOUT, heard).await;
                end
            }
        }
    };
    commands.end(&mut receiver);
    end
}
