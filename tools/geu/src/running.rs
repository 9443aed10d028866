//! Selects the running emulator that a command acts on: by the name of a link, or the only one.

use geu_daemon::running::{self, Running};

use crate::command_error::{CommandError, note};

/// Address of the control interface of the emulator with the link `at`, else of the only running one.
///
/// # Errors
/// No emulator or several match, or it has no control interface.
pub fn control(at: Option<&str>) -> Result<String, CommandError> {
    let found = find(at)?;
    found.control.clone().ok_or_else(|| {
        CommandError::failed(format!(
            "{found}: expected an emulator with a control interface; start it without --control off"
        ))
    })
}

/// The link to open for a command to the only running emulator.
///
/// # Errors
/// No emulator or several run, or no link of it can be opened from here.
pub fn link() -> Result<String, CommandError> {
    let found = find(None)?;
    // Of a pty another reader takes bytes; a serial port has its other end elsewhere.
    let link = ["tcp", "can", "pty"].iter().find_map(|kind| found.links.iter().find(|link| link.kind == *kind));
    let link = link.ok_or_else(|| {
        CommandError::failed(format!("{found}: expected a link that can be opened from here: --tcp, --can or --pty"))
    })?;
    Ok(link.address.replace(' ', ":"))
}

/// Prints which emulator is used, and returns the printed name.
pub fn note_emulator(control: &str) -> String {
    let own = |running: &Running| running.control.as_deref() == Some(control);
    let found = running::all().unwrap_or_default().into_iter().find(own);
    let which = found.map_or_else(|| format!("control http://{control}/"), |running| running.to_string());
    note(format_args!("geu: {which}\n"));
    which
}

/// Prints which link is used.
pub fn note_link(link: &str) {
    match running::all().unwrap_or_default().into_iter().find(|running| running.has_link(link)) {
        Some(running) => note(format_args!("geu: {link} of process {}\n", running.pid)),
        None => note(format_args!("geu: {link}\n")),
    }
}

fn find(at: Option<&str>) -> Result<Running, CommandError> {
    let all = running::all().map_err(CommandError::failed)?;
    let listed = |all: &[Running]| all.iter().map(|running| format!("\n  {running}")).collect::<String>();
    let mut matching: Vec<Running> =
        all.iter().filter(|running| at.is_none_or(|link| running.has_link(link))).cloned().collect();
    match (matching.len(), at) {
        (1, _) => Ok(matching.remove(0)),
        (0, _) if all.is_empty() => Err(CommandError::failed(
            "expected a running emulator, got none; start one with geu run, or name its control interface with --control ADDRESS",
        )),
        (0, Some(link)) => {
            Err(CommandError::input(format!("--at {link}: expected a link of a running emulator:{}", listed(&all))))
        }
        (count, _) => Err(CommandError::input(format!(
            "expected one running emulator, got {count}; choose it by --at LINK or --control ADDRESS:{}",
            listed(&matching)
        ))),
    }
}
