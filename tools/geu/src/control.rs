//! The control interface of a running emulator, as a client sees it.

use std::io::{BufRead, BufReader};
use std::sync::LazyLock;
use std::time::Duration;

use clap::Args;
use geu_daemon::control::DEFAULT_ADDRESS;
use serde_json::Value;
use ureq::http::{Method, Request};
use ureq::{Agent, AsSendBody};

use crate::failure::Failure;

/// An emulator that does not answer by then is not there.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// Keeps its connections from one question to the next.
static AGENT: LazyLock<Agent> = LazyLock::new(|| {
    Agent::config_builder().http_status_as_error(false).timeout_connect(Some(ANSWER_WITHIN)).build().new_agent()
});

/// Which emulator.
#[derive(Args, Debug, Clone)]
pub struct Emulator {
    /// Control interface of the emulator, as it says when it starts
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_ADDRESS)]
    control: String,
    /// Its token, where it has one
    #[arg(long, value_name = "TOKEN", env = "GEU_CONTROL_TOKEN", hide_env_values = true)]
    control_token: Option<String>,
}

/// Something that the emulator tells of itself.
pub struct Told {
    /// `half-second` or `timeline`.
    pub name: String,
    /// What.
    pub data: Value,
}

impl Emulator {
    /// The one whose interface is at `address`.
    pub fn at(address: &str) -> Emulator {
        Emulator { control: address.to_owned(), control_token: None }
    }

    /// Asks, and gives the answer.
    ///
    /// # Errors
    /// No emulator, or one that refuses: its own message.
    pub fn ask(&self, method: Method, path: &str, body: Option<&Value>) -> Result<Value, Failure> {
        let text = body.map(Value::to_string);
        let request = self.request(method, path, text.is_some());
        let mut response = match text {
            Some(text) => self.send(request.body(text), Some(ANSWER_WITHIN)),
            None => self.send(request.body(()), Some(ANSWER_WITHIN)),
        }?;
        let answer: Value = response.body_mut().read_json().map_err(|error| self.strange(error))?;
        if response.status().is_success() {
            return Ok(answer);
        }
        let message = answer["error"].as_str().map_or_else(|| response.status().to_string(), str::to_owned);
        Err(Failure::input(message))
    }

    /// Follows what happens, until the emulator ends, or lets a client go that fell behind.
    ///
    /// # Errors
    /// No emulator, or one that refuses.
    pub fn follow(&self) -> Result<impl Iterator<Item = Told> + use<>, Failure> {
        let mut response = self.send(self.request(Method::GET, "/api/events", false).body(()), None)?;
        if !response.status().is_success() {
            let answer: Value = response.body_mut().read_json().unwrap_or_default();
            let message = answer["error"].as_str().map_or_else(|| response.status().to_string(), str::to_owned);
            return Err(Failure::input(message));
        }
        let mut lines = BufReader::new(response.into_body().into_reader()).lines();
        let mut name = String::new();
        Ok(std::iter::from_fn(move || {
            loop {
                let line = lines.next()?.ok()?;
                if let Some(told) = line.strip_prefix("event:") {
                    told.trim().clone_into(&mut name);
                } else if let Some(data) = line.strip_prefix("data:")
                    && let Ok(data) = serde_json::from_str(data)
                {
                    return Some(Told { name: name.clone(), data });
                }
            }
        }))
    }

    fn request(&self, method: Method, path: &str, has_body: bool) -> ureq::http::request::Builder {
        let address = self.control.trim_start_matches("http://").trim_end_matches('/');
        let mut request = Request::builder().method(method).uri(format!("http://{address}{path}"));
        if has_body {
            request = request.header("content-type", "application/json");
        }
        match &self.control_token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }

    fn send<B: AsSendBody>(
        &self,
        request: ureq::http::Result<Request<B>>,
        within: Option<Duration>,
    ) -> Result<ureq::http::Response<ureq::Body>, Failure> {
        let request = request.map_err(|error| {
            Failure::input(format!(
                "--control {}: {error}; expected HOST:PORT, such as {DEFAULT_ADDRESS}",
                self.control
            ))
        })?;
        AGENT.run(AGENT.configure_request(request).timeout_global(within).build()).map_err(|error| {
            Failure::failed(format!(
                "--control {}: {error}; expected a running emulator there: geu run says its address as it starts",
                self.control
            ))
        })
    }

    fn strange(&self, error: ureq::Error) -> Failure {
        Failure::failed(format!("--control {}: {error}; expected the answer of an emulator", self.control))
    }
}
