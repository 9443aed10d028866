//! Addresses of external truth.

use std::fmt;
use std::io;
use std::str::FromStr;

/// Address of an external truth source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TruthAddress {
    pub(super) scheme: Scheme,
    pub(super) host_port: String,
}

/// Transport and format of a truth source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    /// JSON lines in datagrams to this address.
    Udp,
    /// JSON lines from a server.
    Tcp,
    /// The socket text of 42 from a server.
    FortyTwo,
}

const SCHEMES: [(&str, Scheme); 3] = [("udp", Scheme::Udp), ("tcp", Scheme::Tcp), ("42", Scheme::FortyTwo)];

impl TruthAddress {
    /// True if a truth of this name is a socket address, valid or not.
    pub fn is_meant(name: &str) -> bool {
        name.contains("://")
    }
}

impl FromStr for TruthAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<TruthAddress, String> {
        let parse = || {
            let (scheme, address) = text.split_once("://")?;
            let (_, scheme) = SCHEMES.into_iter().find(|(name, _)| *name == scheme)?;
            let (host, port) = address.rsplit_once(':')?;
            let is_valid = !host.is_empty() && port.parse::<u16>().is_ok();
            is_valid.then(|| TruthAddress { scheme, host_port: address.to_owned() })
        };
        parse()
            .ok_or_else(|| format!("--truth: expected udp://HOST:PORT, tcp://HOST:PORT or 42://HOST:PORT, got {text}"))
    }
}

impl fmt::Display for TruthAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = SCHEMES.iter().find(|(_, scheme)| *scheme == self.scheme).map_or("", |(name, _)| name);
        write!(f, "{name}://{}", self.host_port)
    }
}

/// The listener for a truth source cannot be opened.
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
