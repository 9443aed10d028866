//! Why a link cannot be opened.

use std::io;

/// A link that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Something other than a symlink stands where the link to the pty should.
    #[error(
        "--pty {0}: there is {1} at this path, which is never replaced; expected a free path, or an old link: remove it, or name another path"
    )]
    PathTaken(String, &'static str),
    /// The symlink leads to a device that lives.
    #[error(
        "--pty {0}: is a link to {1}, which is in use (another emulator?); expected a free path: end the other, remove the link, or name another path"
    )]
    PathBusy(String, String),
    /// The symlink cannot be made, or no pty to be had.
    #[error("--pty {0}: {1}; expected a path in a directory that exists and may be written")]
    Pty(String, io::Error),
    /// The serial port cannot be opened.
    #[error("--serial {0}: {1}; expected a serial device that exists and may be read and written")]
    Serial(String, io::Error),
    /// The address cannot be listened at.
    #[error("--tcp {0}: {1}; expected HOST:PORT of this machine, free, for example 127.0.0.1:5000")]
    Tcp(String, io::Error),
    /// Other machines could drive the unit.
    #[error(
        "--tcp {0}: other machines can reach this address, and whoever connects drives the unit; expected --tcp-allow with the addresses that may, for example --tcp-allow 192.168.7.0/24, or a loopback address"
    )]
    TcpOpenToAll(String),
    /// No such CAN interface.
    #[error(
        "--can {0}: no such interface; expected one of `ip link`, for example: ip link add dev vcan0 type vcan; ip link set vcan0 up"
    )]
    CanAbsent(String),
    /// Not a CAN interface.
    #[error("--can {0}: is not a CAN interface; expected one that `ip -details link` shows as can or vcan")]
    NotCan(String),
    /// No right to it.
    #[error("--can {0}: no permission to open a CAN socket ({1}); expected a user, or a container, that may")]
    CanPermission(String, io::Error),
    /// No SocketCAN at all.
    #[error(
        "--can {0}: this kernel has no SocketCAN ({1}); expected the module can_raw: modprobe can_raw, or another kernel"
    )]
    CanUnsupported(String, io::Error),
    /// Anything else.
    #[error("--can {0}: {1}")]
    Can(String, io::Error),
}
