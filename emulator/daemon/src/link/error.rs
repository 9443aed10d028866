//! Errors that prevent a link.

use std::io;

/// A link that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The path of the symlink has another kind of file.
    #[error(
        "--pty {0}: there is {1} at this path, which is never replaced; expected a free path, or an old link: remove it, or choose another path"
    )]
    PathTaken(String, &'static str),
    /// The symlink leads to a device in use.
    #[error(
        "--pty {0}: is a link to {1}, which is in use (another emulator?); expected a free path: end the other, remove the link, or choose another path"
    )]
    PathBusy(String, String),
    /// The symlink or the pty cannot be created.
    #[error("--pty {0}: {1}; expected a path in a directory that exists and may be written")]
    Pty(String, io::Error),
    /// The pty cannot be given to the group.
    #[error("--pty-group: {0}; expected a group of the emulator's user, as `id -Gn` lists them")]
    PtyGroup(io::Error),
    /// The serial port cannot be opened.
    #[error("--serial {0}: {1}; expected a serial device that exists and may be read and written")]
    Serial(String, io::Error),
    /// The address cannot be bound.
    #[error("--tcp {0}: {1}; expected HOST:PORT of this machine, free, for example 127.0.0.1:5000")]
    Tcp(String, io::Error),
    /// Any other machine could command the unit.
    #[error(
        "--tcp {0}: other machines can reach this address, and any client commands the unit; expected --tcp-allow with the permitted addresses, for example --tcp-allow 192.168.7.0/24, or a loopback address"
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
    /// No permission.
    #[error("--can {0}: no permission to open a CAN socket ({1}); expected a user, or a container, that may")]
    CanPermission(String, io::Error),
    /// No SocketCAN in the kernel.
    #[error(
        "--can {0}: this kernel has no SocketCAN ({1}); expected the module can_raw: modprobe can_raw, or another kernel"
    )]
    CanUnsupported(String, io::Error),
    /// Anything else.
    #[error("--can {0}: {1}")]
    Can(String, io::Error),
}
