//! Client of the control interface of a running emulator.

use std::io::{self, BufRead, BufReader, Read};
use std::sync::LazyLock;
use std::time::Duration;

use clap::Args;
use geu_daemon::control::DEFAULT_ADDRESS;
use geu_protocol::Gyro;
use serde_json::Value;
use ureq::http::{Method, Request, StatusCode};
use ureq::{Agent, AsSendBody};

use crate::command_error::CommandError;
use crate::running;
use crate::token::Token;

/// Time limit of an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest line of an event stream, bytes; a sample with the largest number of active faults takes a tenth of it.
const LONGEST_LINE: u64 = 8 * 1024 * 1024;

/// Letters of a foreign answer that a message shows.
const SHOWN_LETTERS: usize = 80;

/// Keeps its connections between requests.
static AGENT: LazyLock<Agent> = LazyLock::new(|| {
    let config = Agent::config_builder().http_status_as_error(false).timeout_connect(Some(ANSWER_TIMEOUT));
    config.timeout_recv_response(Some(ANSWER_TIMEOUT)).max_redirects(0).build().new_agent()
});

/// Selection of a running emulator.
#[derive(Args, Debug, Clone)]
pub struct EmulatorArgs {
    /// Control interface of the emulator, as it prints at its start [default: of the only running emulator]
    #[arg(long, value_name = "ADDRESS")]
    control: Option<String>,
    /// The emulator with this link: /tmp/geu0, vcan0, 127.0.0.1:4700
    #[arg(long, value_name = "LINK", conflicts_with = "control")]
    at: Option<String>,
    #[command(flatten)]
    token: Token,
}

impl EmulatorArgs {
    /// Returns the selected emulator, and prints its name on standard error.
    ///
    /// # Errors
    /// No emulator or several match, it has no control interface, or the token cannot be read.
    pub fn find(&self) -> Result<ControlClient, CommandError> {
        let control = match &self.control {
            Some(address) => address.clone(),
            None => running::control(self.at.as_deref())?,
        };
        let mut client = ControlClient::new(&control, &self.token)?;
        client.which = running::note_emulator(&client.control);
        Ok(client)
    }
}

/// A running emulator.
#[derive(Debug, Clone)]
pub struct ControlClient {
    control: String,
    token: Option<String>,
    /// Name for people.
    pub which: String,
}

/// An event of the emulator.
pub struct ServerEvent {
    /// Name in the event stream: `timeline`, `watch`, or that of a sample.
    pub name: String,
    pub data: Value,
}

impl ControlClient {
    /// The emulator with the control interface at this address.
    ///
    /// # Errors
    /// The token cannot be read.
    pub fn new(address: &str, token: &Token) -> Result<ControlClient, CommandError> {
        let control = address.trim_start_matches("http://").trim_end_matches('/').to_owned();
        let which = format!("control http://{control}/");
        Ok(ControlClient { control, token: token.read()?, which })
    }

    /// Names of the gyros; as of the default unit if the emulator does not answer, which is said later.
    pub fn gyros(&self) -> Vec<String> {
        let catalogue = self.ask(Method::GET, "/api/catalogue", None).unwrap_or_default();
        let names = catalogue["gyros"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let names: Vec<String> = names.map(str::to_owned).collect();
        if names.is_empty() { Gyro::NAMES.map(str::to_owned).to_vec() } else { names }
    }

    /// Sends a request and returns the answer.
    ///
    /// # Errors
    /// No emulator answers, or it refuses: its own message.
    pub fn ask(&self, method: Method, path: &str, body: Option<&Value>) -> Result<Value, CommandError> {
        let text = body.map(Value::to_string);
        let request = self.request(method, path, text.is_some());
        let mut response = match text {
            Some(text) => self.send(request.body(text), Some(ANSWER_TIMEOUT)),
            None => self.send(request.body(()), Some(ANSWER_TIMEOUT)),
        }?;
        let answer: Value = response.body_mut().read_json().map_err(|error| {
            CommandError::failed(format!("--control {}: {error}; expected the answer of an emulator", self.control))
        })?;
        if response.status().is_success() {
            return Ok(answer);
        }
        Err(refusal(response.status(), &answer))
    }

    /// The failure of an answer that no emulator gives.
    pub fn foreign(&self, answer: &Value) -> CommandError {
        let answer: String = answer.to_string().chars().take(SHOWN_LETTERS).collect();
        let what = format!("expected the answer of an emulator, got {answer}; geu run prints its address at the start");
        CommandError::failed(format!("--control {}: {what}", self.control))
    }

    /// Follows the events until the emulator ends, or disconnects a slow client.
    ///
    /// # Errors
    /// No emulator answers, or it refuses.
    pub fn follow(&self) -> Result<impl Iterator<Item = Result<ServerEvent, CommandError>> + use<>, CommandError> {
        let mut response = self.send(self.request(Method::GET, "/api/events", false).body(()), None)?;
        if !response.status().is_success() {
            let answer: Value = response.body_mut().read_json().unwrap_or_default();
            return Err(refusal(response.status(), &answer));
        }
        if response.body().mime_type() != Some("text/event-stream") {
            let message = "expected a stream of events, got another answer; is it an emulator?";
            return Err(CommandError::failed(format!("--control {}: {message}", self.control)));
        }
        let mut stream = BufReader::new(response.into_body().into_reader());
        let (mut name, control) = (String::new(), self.control.clone());
        Ok(std::iter::from_fn(move || {
            loop {
                let line = match read_line(&mut stream) {
                    Ok(line) => line?,
                    Err(_) => {
                        let message = format!(
                            "--control {control}: expected events in lines of at most {LONGEST_LINE} bytes, got a longer one; is it an emulator?"
                        );
                        return Some(Err(CommandError::failed(message)));
                    }
                };
                if let Some(event) = line.strip_prefix("event:") {
                    event.trim().clone_into(&mut name);
                } else if let Some(data) = line.strip_prefix("data:")
                    && let Ok(data) = serde_json::from_str(data)
                {
                    return Some(Ok(ServerEvent { name: name.clone(), data }));
                }
            }
        }))
    }

    fn request(&self, method: Method, path: &str, has_body: bool) -> ureq::http::request::Builder {
        let mut request = Request::builder().method(method).uri(format!("http://{}{path}", self.control));
        if has_body {
            request = request.header("content-type", "application/json");
        }
        match &self.token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }

    fn send<B: AsSendBody>(
        &self,
        request: ureq::http::Result<Request<B>>,
        within: Option<Duration>,
    ) -> Result<ureq::http::Response<ureq::Body>, CommandError> {
        let request = request.map_err(|error| {
            CommandError::input(format!(
                "--control {}: {error}; expected HOST:PORT, such as {DEFAULT_ADDRESS}",
                self.control
            ))
        })?;
        AGENT.run(AGENT.configure_request(request).timeout_global(within).build()).map_err(|error| {
            let what = match error {
                // A stopped process answers once it continues.
                ureq::Error::Timeout(_) => {
                    format!("expected an answer within {ANSWER_TIMEOUT:?}, got none; is it an emulator, and not stopped? A change may still be made")
                }
                error => format!("{error}; expected a running emulator; geu run prints its address at the start"),
            };
            CommandError::failed(format!("--control {}: {what}", self.control))
        })
    }
}

/// The error message of a refused request.
fn refusal(status: StatusCode, answer: &Value) -> CommandError {
    let message = answer["error"].as_str().map_or_else(|| status.to_string(), str::to_owned);
    match status {
        StatusCode::UNAUTHORIZED => {
            CommandError::input(format!("{message}; give it with --control-token-file FILE or GEU_CONTROL_TOKEN"))
        }
        _ => CommandError::input(message),
    }
}

/// A line longer than [`LONGEST_LINE`].
struct TooLong;

/// The next line of a stream; `None` at its end or if it breaks.
fn read_line(stream: &mut impl BufRead) -> Result<Option<String>, TooLong> {
    let mut line = Vec::new();
    let read: io::Result<usize> = stream.take(LONGEST_LINE + 1).read_until(b'\n', &mut line);
    match read {
        Ok(_) if line.len() as u64 > LONGEST_LINE => Err(TooLong),
        Ok(1..) => Ok(Some(String::from_utf8_lossy(line.trim_ascii_end()).into_owned())),
        Ok(0) | Err(_) => Ok(None),
    }
}
