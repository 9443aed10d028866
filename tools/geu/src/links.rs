//! The links that `geu run` and `geu replay` open.

use std::net::IpAddr;
use std::path::PathBuf;

use clap::{ArgMatches, Args, Command, Error, FromArgMatches};
use geu_daemon::link::{CanAddress, LinkAddress, PtyAddress, SerialAddress, TcpAddress};
use ipnet::IpNet;
use nix::unistd::{Gid, Group};

use crate::command_error::CommandError;

/// Name of the default pty.
const DEFAULT_PTY: &str = "geu0";

/// Links, as given on the command line.
#[derive(Args, Debug, Default)]
struct Named {
    /// Pty under a stable symlink
    #[arg(long, value_name = "PATH")]
    pty: Vec<PathBuf>,
    /// Group that may open the pty too, for example dialout [default: only the user of the emulator]
    #[arg(long, value_name = "GROUP", value_parser = group)]
    pty_group: Option<Gid>,
    /// Serial port, 8N1 [default rate: 115200]
    #[arg(long, value_name = "DEVICE[:BAUD]")]
    serial: Vec<SerialAddress>,
    /// SocketCAN interface; the base identifier in hexadecimal [default: 1A0]
    #[arg(long, value_name = "INTERFACE[:BASE]")]
    can: Vec<CanAddress>,
    /// Serve the serial bytes to every client of HOST:PORT; port 0 takes a free port
    #[arg(long, value_name = "ADDRESS")]
    tcp: Vec<String>,
    /// Other machines that may connect over TCP, by address or network; clients can send commands to the unit
    #[arg(long, value_name = "ADDRESS[/BITS]", value_parser = network, requires = "tcp")]
    tcp_allow: Vec<IpNet>,
}

fn group(name: &str) -> Result<Gid, String> {
    match Group::from_name(name) {
        Ok(Some(group)) => Ok(group.gid),
        Ok(None) => Err("expected a group of this machine, as `getent group` lists them".to_owned()),
        Err(error) => Err(format!("the groups of this machine cannot be read: {error}")),
    }
}

fn network(text: &str) -> Result<IpNet, String> {
    let address = |text: &str| text.parse::<IpAddr>().map(IpNet::from);
    text.parse::<IpNet>()
        .or_else(|_| address(text))
        .map_err(|_| "expected an address or a network, for example 192.168.7.4 or 192.168.7.0/24".to_owned())
}

/// Links in the order of the command line.
#[derive(Debug, Default)]
pub struct Links {
    named: Vec<LinkAddress>,
    /// Group of the default pty.
    pty_group: Option<Gid>,
}

impl Links {
    /// Addresses; the default pty if no link is given.
    ///
    /// # Errors
    /// A group without a pty.
    pub fn addresses(&self) -> Result<Vec<LinkAddress>, CommandError> {
        let has_pty = self.named.is_empty() || self.named.iter().any(|link| matches!(link, LinkAddress::Pty(_)));
        if self.pty_group.is_some() && !has_pty {
            return Err(CommandError::input("--pty-group: expected --pty PATH beside the other links, got none"));
        }
        if self.named.is_empty() {
            let directory = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_dir());
            let path = directory.unwrap_or_else(|| "/tmp".into()).join(DEFAULT_PTY);
            return Ok(vec![LinkAddress::Pty(PtyAddress { path, group: self.pty_group })]);
        }
        Ok(self.named.clone())
    }
}

impl Args for Links {
    fn augment_args(command: Command) -> Command {
        Named::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Named::augment_args_for_update(command)
    }
}

impl FromArgMatches for Links {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Links, Error> {
        let Named { pty, pty_group, serial, can, tcp, tcp_allow } = Named::from_arg_matches(matches)?;
        let tcp = tcp.into_iter().map(|address| TcpAddress { address, allowed: tcp_allow.clone() });
        let pty = pty.into_iter().map(|path| LinkAddress::Pty(PtyAddress { path, group: pty_group }));
        let positions = |option: &str| matches.indices_of(option).into_iter().flatten();
        let mut links: Vec<(usize, LinkAddress)> = Vec::new();
        links.extend(positions("pty").zip(pty));
        links.extend(positions("serial").zip(serial.into_iter().map(LinkAddress::Serial)));
        links.extend(positions("can").zip(can.into_iter().map(LinkAddress::Can)));
        links.extend(positions("tcp").zip(tcp.map(LinkAddress::Tcp)));
        links.sort_by_key(|(position, _)| *position);
        Ok(Links { named: links.into_iter().map(|(_, link)| link).collect(), pty_group })
    }

    fn from_arg_matches_mut(matches: &mut ArgMatches) -> Result<Links, Error> {
        Links::from_arg_matches(matches)
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Links::from_arg_matches(matches)?;
        Ok(())
    }
}
