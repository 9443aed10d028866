//! Addresses of links on the command line.

use std::path::PathBuf;
use std::sync::Arc;

use geu_model::device::Device;
use geu_model::fault::catalogue::Transport;
use geu_protocol::CanIdMap;
use nix::unistd::Gid;

use super::tcp::TcpAddress;
use geu_recorder::link_model::LinkModel;

/// A link to be opened.
#[derive(Debug, Clone)]
pub enum LinkAddress {
    /// A pty with a symlink at this path.
    Pty(PtyAddress),
    /// A serial port.
    Serial(SerialAddress),
    /// A CAN interface.
    Can(CanAddress),
    /// Serial bytes to every client of an address.
    Tcp(TcpAddress),
    /// A link of a simulated host.
    #[cfg(test)]
    Simulated(crate::simulation::chaos::SimulatedLink),
}

impl LinkAddress {
    /// Kind of the link.
    pub fn kind(&self) -> Transport {
        match self {
            LinkAddress::Pty(_) => Transport::Pty,
            LinkAddress::Serial(_) => Transport::Serial,
            LinkAddress::Can(_) => Transport::Can,
            LinkAddress::Tcp(_) => Transport::Tcp,
            #[cfg(test)]
            LinkAddress::Simulated(link) => link.kind(),
        }
    }

    /// Model of the link of a unit.
    pub fn model(&self, device: &Arc<Device>) -> LinkModel {
        let (baud, plan) = match self {
            LinkAddress::Serial(address) => (address.baud, None),
            LinkAddress::Can(address) => (None, Some(address.plan)),
            LinkAddress::Pty(_) | LinkAddress::Tcp(_) => (None, None),
            #[cfg(test)]
            LinkAddress::Simulated(_) => (None, None),
        };
        LinkModel::of_unit(device, self.kind(), baud, plan)
    }
}

/// A pty: the path of its symlink, and who may open it.
#[derive(Debug, Clone)]
pub struct PtyAddress {
    /// Path of the symlink.
    pub path: PathBuf,
    /// Group that may open it too; `None` for the user of the emulator alone.
    pub group: Option<Gid>,
}

/// `INTERFACE[:BASE]`, the base in hexadecimal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CanAddress {
    /// Name of the interface.
    pub interface: String,
    /// Identifiers.
    pub plan: CanIdMap,
}

impl std::str::FromStr for CanAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<CanAddress, String> {
        let (interface, plan) = match text.split_once(':') {
            None => (text, CanIdMap::default()),
            Some((interface, base)) => {
                let plan = u16::from_str_radix(base, 16).ok().and_then(CanIdMap::with_base);
                (
                    interface,
                    plan.ok_or_else(|| {
                        format!(
                            "expected a base from 0 to {:X} in hexadecimal after the colon, got {base}",
                            CanIdMap::MAX_BASE
                        )
                    })?,
                )
            }
        };
        if interface.is_empty() || interface.len() > 15 {
            return Err(format!("expected INTERFACE or INTERFACE:BASE with a name of 1 to 15 bytes, got {text:?}"));
        }
        Ok(CanAddress { interface: interface.to_owned(), plan })
    }
}

/// `DEVICE[:BAUD]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SerialAddress {
    /// Path of the device.
    pub device: String,
    /// Rate, 8N1; `None` for that of the unit.
    pub baud: Option<u32>,
}

impl std::str::FromStr for SerialAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<SerialAddress, String> {
        let (device, baud) = match text.rsplit_once(':') {
            // Names under /dev/serial/by-path have colons of their own.
            Some((device, baud)) if !baud.is_empty() && baud.bytes().all(|byte| byte.is_ascii_digit()) => {
                let baud = baud.parse().ok().filter(|&baud| baud > 0);
                (device, Some(baud.ok_or_else(|| format!("expected DEVICE:BAUD with a rate above 0, got {text}"))?))
            }
            _ => (text, None),
        };
        if device.is_empty() {
            return Err(format!("expected DEVICE or DEVICE:BAUD, got {text:?}"));
        }
        Ok(SerialAddress { device: device.to_owned(), baud })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_an_interface_and_perhaps_a_base_in_hexadecimal() {
        let base = |text: &str| text.parse::<CanAddress>().map(|address| address.plan.base()).ok();
        assert_eq!(base("vcan0"), Some(0x1A0));
        assert_eq!(base("vcan0:300"), Some(0x300));
        assert_eq!(base("vcan0:7F6"), Some(0x7F6));
        for text in ["vcan0:7F7", "vcan0:xyz", "vcan0:", "", ":1A0", "a-name-too-long-for-linux"] {
            assert_eq!(base(text), None, "{text}");
        }
    }

    #[test]
    fn an_address_is_a_device_and_perhaps_a_rate() {
        let parse = |text: &str| text.parse::<SerialAddress>().map(|address| (address.device, address.baud));
        assert_eq!(parse("/dev/ttyUSB0"), Ok(("/dev/ttyUSB0".to_owned(), None)));
        assert_eq!(parse("/dev/ttyUSB0:9600"), Ok(("/dev/ttyUSB0".to_owned(), Some(9600))));
        let by_path = "/dev/serial/by-path/pci-0:14.0-usb-0:2:1.0-port0";
        assert_eq!(parse(by_path), Ok((by_path.to_owned(), None)));
        assert!(parse("/dev/ttyUSB0:0").is_err() && parse(":9600").is_err() && parse("").is_err());
    }
}
