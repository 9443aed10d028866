//! `geu send`: sends one command to the unit by name, and prints its reply.

use std::io;
use std::net::ToSocketAddrs;
use std::path::Path;
use std::time::{Duration, Instant};

use clap::Args;
use geu_daemon::link::{CanAddress, SerialAddress};
use geu_protocol::command::{self, COMMANDS, CommandResult};
use geu_protocol::serial::DEFAULT_BAUD;
use geu_protocol::suggestion::did_you_mean;
use geu_protocol::{Reply, Sample};
use geu_recording::{CommandLink, POLL};

use crate::command_error::{CommandError, print};
use crate::device::verify_default;
use crate::running;

/// Sends a command to the unit by name and prints the decoded reply: geu send /tmp/geu0 SET_MODE polled
#[derive(Args, Debug)]
#[command(after_help = table())]
pub struct Arguments {
    /// Pty or serial device (`DEVICE` or `DEVICE:BAUD`), `HOST:PORT` or `tcp:HOST:PORT`, or CAN interface (`INTERFACE` or `INTERFACE:BASE`, hexadecimal) [default: a link of the only running emulator]
    link: Option<String>,
    /// Name of the command; upper or lower case, - or _
    command: Option<String>,
    /// Arguments: numbers, decimal or 0x…, or the names listed below: on, polled, GYRX,GYRY
    #[arg(allow_hyphen_values = true)]
    arguments: Vec<String>,
    /// Send these bytes as the payload, to test the answer to a wrong command: 0909FF
    #[arg(long, value_name = "HEX", conflicts_with = "command")]
    raw: Option<String>,
    /// Unit of the link; the default one alone has commands
    #[arg(long, value_name = "NAME|FILE")]
    device: Option<String>,
    /// Timeout of the reply
    #[arg(long, value_name = "DURATION", default_value = "1", allow_negative_numbers = true, value_parser = crate::settings::duration(0.0, 3600.0))]
    timeout: f64,
    /// Print the table of commands
    #[arg(long)]
    list: bool,
}

/// Runs `geu send`.
///
/// # Errors
/// Bad usage, the link cannot be opened, there is no reply in time, the command was not done.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let reason = "a description would have to list commands with request and reply, and there is no key for them";
    verify_default(arguments.device.as_deref(), reason)?;
    if arguments.list {
        return print(format_args!("{}", table()));
    }
    let (link, payload) = arguments.split()?;
    let link = &match link {
        Some(link) => link.to_owned(),
        None => running::link()?,
    };
    running::note_link(link);
    let give_up = Instant::now() + Duration::from_secs_f64(arguments.timeout);
    let (reply, polled) = open(link)?
        .ask(&payload, give_up)
        .map_err(|error| CommandError::failed(format!("{link}: {error}; is the unit still connected?")))?;
    let Some(reply) = reply else {
        let waited = arguments.timeout;
        return Err(CommandError::failed(format!("{link}: no reply within {waited} s; expected one within 20 ms")));
    };
    let printed = print(format_args!("{}", describe(&reply, polled.as_ref())));
    if reply.outcome() != CommandResult::Done {
        return Err(CommandError::failed(format!(
            "the unit answered {}: {}",
            reply.outcome() as u8,
            reply.outcome().text()
        )));
    }
    if reply.opcode() == POLL && polled.is_none() {
        return Err(CommandError::failed(format!(
            "{link}: the polled data did not follow within {} s",
            arguments.timeout
        )));
    }
    printed
}

impl Arguments {
    /// The link, if one is given, and the payload.
    fn split(&self) -> Result<(Option<&str>, Vec<u8>), CommandError> {
        if let Some(hex) = &self.raw {
            return Ok((self.link.as_deref(), raw_payload(hex)?));
        }
        let is_command = |word: &Option<String>| word.as_deref().is_some_and(command::is_name);
        let (link, name, values) = match (&self.link, &self.command) {
            // The first argument is a command: no link is given.
            (Some(name), first) if is_command(&self.link) && !is_command(first) => {
                (None, name, first.iter().chain(&self.arguments).cloned().collect())
            }
            (Some(link), Some(name)) => (Some(link.as_str()), name, self.arguments.clone()),
            (word, _) => {
                let got = word.as_deref().unwrap_or("nothing");
                let names = COMMANDS.iter().map(|spec| spec.name);
                let hint = word.as_ref().map(|word| did_you_mean(word, names)).unwrap_or_default();
                return Err(CommandError::input(format!(
                    "{hint}expected [LINK] COMMAND [ARGUMENTS], such as geu send /tmp/geu0 PING, got {got}; geu send --list shows the commands"
                )));
            }
        };
        Ok((link, command::written(name, &values).map_err(CommandError::input)?))
    }
}

fn table() -> String {
    let mut text = String::from("Commands:\n");
    for spec in COMMANDS {
        let names: Vec<_> = spec.arguments.iter().map(|argument| argument.name.to_uppercase()).collect();
        text +=
            &format!("  {:02X} {:<34} {}\n", spec.opcode, format!("{} {}", spec.name, names.join(" ")), spec.meaning);
        for argument in spec.arguments {
            text += &format!("       {:<32} {}\n", argument.name.to_uppercase(), argument.usage());
        }
    }
    text
}

fn raw_payload(hex: &str) -> Result<Vec<u8>, CommandError> {
    command::from_hex(hex).ok_or_else(|| {
        CommandError::input(format!("--raw: expected 1 to 8 bytes, two hexadecimal digits each, got {hex:?}"))
    })
}

fn describe(reply: &Reply, polled: Option<&Sample>) -> String {
    let spec = COMMANDS.iter().find(|spec| spec.opcode == reply.opcode());
    let name = spec.map_or_else(|| format!("{:02X}", reply.opcode()), |spec| spec.name.to_owned());
    let mut text = format!("{name}: {}", reply.outcome().text());
    let mut rest = reply.values();
    for value in spec.map_or(&[][..], |spec| spec.values) {
        let length = value.wire.length();
        if rest.len() >= length {
            text += &format!("  {} {}", value.name, value.wire.read(rest));
            rest = &rest[length..];
        }
    }
    if !rest.is_empty() {
        text += &format!("  {rest:02X?}");
    }
    text.push('\n');
    if let Some(sample) = polled {
        text += &format!(
            "sequence {}  increments {:?}  gyro flags {:02X}  unit flags {:02X}  electronics {:.2} °C  sensor {:.2} °C  clock {}\n",
            sample.sequence,
            sample.increments,
            sample.gyro_flags,
            sample.unit_flags,
            f64::from(sample.electronics_centi_c) / 100.0,
            f64::from(sample.sensor_centi_c) / 100.0,
            sample.clock_count
        );
    }
    text
}

/// Opens a link for commands.
fn open(link: &str) -> Result<CommandLink, CommandError> {
    let fail = |error: io::Error, expected: &str| CommandError::input(format!("{link}: {error}; expected {expected}"));
    let serial: Option<SerialAddress> = link.parse().ok();
    if let Some(serial) = serial.filter(|serial| Path::new(&serial.device).exists()) {
        let opened = CommandLink::serial(Path::new(&serial.device), serial.baud.unwrap_or(DEFAULT_BAUD));
        return opened.map_err(|error| fail(error, "a pty or serial device"));
    }
    let address = link.strip_prefix("tcp:");
    if let Some(address) = address.or(Some(link).filter(|link| is_host_and_port(link))) {
        let address = address.to_socket_addrs().ok().and_then(|mut all| all.next());
        let address =
            address.ok_or_else(|| CommandError::input(format!("{link}: expected HOST:PORT that can be resolved")))?;
        return CommandLink::tcp(&address)
            .map_err(|error| fail(error, "a unit that listens there: geu run --tcp HOST:PORT"));
    }
    if link.contains('/') {
        return Err(CommandError::input(format!(
            "{link}: no such device; expected the path that `geu run` prints as ready"
        )));
    }
    let address: CanAddress = link.parse().map_err(|error| CommandError::input(format!("{link}: {error}")))?;
    CommandLink::can(&address.interface, address.plan)
        .map_err(|error| fail(error, "a path, HOST:PORT, or a CAN interface that `ip link` shows"))
}

/// True for `localhost:5000`, but not for `vcan0:1A0`: an interface of that name precedes a host.
fn is_host_and_port(link: &str) -> bool {
    link.rsplit_once(':').is_some_and(|(host, port)| {
        port.parse::<u16>().is_ok() && !host.is_empty() && nix::net::if_::if_nametoindex(host).is_err()
    })
}
