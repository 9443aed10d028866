//! A running `geu` as a child process: what it reports as ready, its end, and what it wrote on standard error.

use std::io::{self, BufRead, BufReader, Lines, Read};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

/// A running `geu run` or `geu replay`; killed when it is dropped.
pub struct EmulatorProcess {
    pub child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl EmulatorProcess {
    /// Starts it with its outputs piped.
    ///
    /// # Errors
    /// A program that does not start.
    pub fn start(mut command: Command) -> io::Result<EmulatorProcess> {
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let lines = BufReader::new(child.stdout.take().expect("standard output is piped")).lines();
        Ok(EmulatorProcess { child, lines })
    }

    /// The next link or interface that is ready, as standard output reports it behind `ready `.
    ///
    /// # Errors
    /// Another line, or the end of the output.
    pub fn next_ready(&mut self) -> Result<String, String> {
        let line = self.lines.next().ok_or("standard output ended")?.map_err(|error| error.to_string())?;
        line.strip_prefix("ready ").map(str::to_owned).ok_or_else(|| format!("unexpected {line:?}"))
    }

    /// HOST:PORT of the control interface, the next that is ready of its kind.
    ///
    /// # Errors
    /// None that becomes ready.
    pub fn control_address(&mut self) -> Result<String, String> {
        loop {
            let ready = self.next_ready()?;
            if let Some(address) = ready.strip_prefix("control http://") {
                return Ok(address.trim_end_matches('/').to_owned());
            }
        }
    }

    /// Sends SIGTERM.
    ///
    /// # Errors
    /// A process that does not run any more.
    pub fn terminate(&self) -> io::Result<()> {
        kill(Pid::from_raw(self.child.id() as i32), Signal::SIGTERM).map_err(io::Error::from)
    }

    /// Waits for its end; its status, and what it wrote on standard error unless that was taken.
    ///
    /// # Errors
    /// What it wrote cannot be read.
    pub fn wait(mut self) -> io::Result<(ExitStatus, String)> {
        let mut text = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            stderr.read_to_string(&mut text)?;
        }
        Ok((self.child.wait()?, text))
    }
}

impl Drop for EmulatorProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
