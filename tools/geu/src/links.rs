//! The links that `geu run` and `geu replay` open.

use std::net::IpAddr;
use std::path::PathBuf;

use clap::Args;
use geu_daemon::link::{CanAddress, LinkAddress, SerialAddress, TcpAddress};
use ipnet::IpNet;

/// Name of the default pty.
const DEFAULT_PTY: &str = "geu0";

/// Links, as they are named on the command line.
#[derive(Args, Debug, Default)]
pub struct Links {
    /// Pty under a stable symlink
    #[arg(long, value_name = "PATH")]
    pty: Vec<PathBuf>,
    /// Serial port, 8N1 [default rate: 115200]
    #[arg(long, value_name = "DEVICE[:BAUD]")]
    serial: Vec<SerialAddress>,
    /// SocketCAN interface; the base identifier in hexadecimal [default: 1A0]
    #[arg(long, value_name = "INTERFACE[:BASE]")]
    can: Vec<CanAddress>,
    /// Serves the serial bytes to every client of HOST:PORT; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS")]
    tcp: Vec<String>,
    /// Machines that may connect over TCP beside this one, by address or network; what connects drives the unit
    #[arg(long, value_name = "ADDRESS[/BITS]", value_parser = network)]
    tcp_allow: Vec<IpNet>,
}

fn network(text: &str) -> Result<IpNet, String> {
    let address = |text: &str| text.parse::<IpAddr>().map(IpNet::from);
    text.parse::<IpNet>()
        .or_else(|_| address(text))
        .map_err(|_| "expected an address or a network, for example 192.168.7.4 or 192.168.7.0/24".to_owned())
}

impl Links {
    /// Their addresses; the default pty where none is named.
    pub fn addresses(&self) -> Vec<LinkAddress> {
        let mut links: Vec<LinkAddress> = Vec::new();
        links.extend(self.can.iter().cloned().map(LinkAddress::Can));
        links.extend(self.serial.iter().cloned().map(LinkAddress::Serial));
        links.extend(self.pty.iter().cloned().map(LinkAddress::Pty));
        links.extend(
            self.tcp
                .iter()
                .cloned()
                .map(|address| LinkAddress::Tcp(TcpAddress { address, allowed: self.tcp_allow.clone() })),
        );
        if links.is_empty() {
            let directory = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_dir());
            links.push(LinkAddress::Pty(directory.unwrap_or_else(|| "/tmp".into()).join(DEFAULT_PTY)));
        }
        links
    }
}
