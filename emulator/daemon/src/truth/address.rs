//! Where a truth from outside comes from.

use std::fmt;
use std::io;
use std::str::FromStr;

/// Where the truth comes from, and how it is spoken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TruthAddress {
    /// JSON lines in datagrams to this address.
    Udp(String),
    /// JSON lines from a server.
    Tcp(String),
    /// The socket text of 42 from a server.
    FortyTwo(String),
}

impl TruthAddress {
    /// Whether a truth of that name comes from a socket, well spelt or not.
    pub fn is_meant(name: &str) -> bool {
        name.contains("://")
    }
}

impl FromStr for TruthAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<TruthAddress, String> {
        let wrong = || format!("--truth: expected udp://HOST:PORT, tcp://HOST:PORT or 42://HOST:PORT, got {text}");
        let (scheme, address) = text.split_once("://").ok_or_else(wrong)?;
        let (host, port) = address.rsplit_once(':').ok_or_else(wrong)?;
        if host.is_empty() || port.parse::<u16>().is_err() {
            return Err(wrong());
        }
        match scheme {
            "udp" => Ok(TruthAddress::Udp(address.to_owned())),
            "tcp" => Ok(TruthAddress::Tcp(address.to_owned())),
            "42" => Ok(TruthAddress::FortyTwo(address.to_owned())),
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for TruthAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TruthAddress::Udp(address) => write!(f, "udp://{address}"),
            TruthAddress::Tcp(address) => write!(f, "tcp://{address}"),
            TruthAddress::FortyTwo(address) => write!(f, "42://{address}"),
        }
    }
}

/// An address that cannot be listened at.
#[derive(Debug, thiserror::Error)]
#[error("--truth {address}: cannot be listened at: {source}; expected a free port of this machine")]
pub struct TruthError {
    pub(super) address: TruthAddress,
    pub(super) source: io::Error,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_names_its_scheme_host_and_port() {
        for text in ["udp://127.0.0.1:4701", "tcp://simulator:10001", "42://[::1]:10001"] {
            assert_eq!(text.parse::<TruthAddress>().expect(text).to_string(), text);
        }
        for text in
            ["udp://", "udp://:1", "udp://host", "udp://host:99999", "http://host:80", "://host:1", "tcp:host:1"]
        {
            let message = text.parse::<TruthAddress>().expect_err(text);
            assert!(message.contains("expected udp://HOST:PORT") && message.contains(text), "{message}");
        }
    }
}
