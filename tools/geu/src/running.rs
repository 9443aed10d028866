//! Finds the emulator that a command is for: the one that is named by a link, or the only one that runs.

use geu_daemon::running::{self, Running};

use crate::failure::{CommandError, note};

/// Address of the control interface of the emulator that has the link `at`, else of the only one that runs.
///
/// # Errors
/// None or several, or one without a control interface.
pub fn control(at: Option<&str>) -> Result<String, CommandError> {
    let found = find(at)?;
    found.control.clone().ok_or_else(|| {
        CommandError::failed(format!(
            "{found}: expected an emulator with a control interface; start it without --control off"
        ))
    })
}

/// The link over which a command reaches the only emulator that runs.
///
/// # Errors
/// None or several, or none of its links can be opened beside it.
pub fn link() -> Result<String, CommandError> {
    let found = find(None)?;
    // Of a pty another reader takes bytes; a serial port has its other end elsewhere.
    let link = ["tcp", "can", "pty"].iter().find_map(|kind| found.links.iter().find(|(own, _)| own == kind));
    let (_, address) = link.ok_or_else(|| {
        CommandError::failed(format!("{found}: expected a link that can be opened from here: --tcp, --can or --pty"))
    })?;
    Ok(address.replace(' ', ":"))
}

/// Says which emulator is spoken to, and gives what it said.
pub fn say_which(control: &str) -> String {
    let own = |running: &Running| running.control.as_deref() == Some(control);
    let found = running::all().unwrap_or_default().into_iter().find(own);
    let which = found.map_or_else(|| format!("control http://{control}/"), |running| running.to_string());
    note(format_args!("geu: {which}\n"));
    which
}

/// Says over which link.
pub fn say_link(link: &str) {
    match running::all().unwrap_or_default().into_iter().find(|running| running.has_link(link)) {
        Some(running) => note(format_args!("geu: {link} of process {}\n", running.pid)),
        None => note(format_args!("geu: {link}\n")),
    }
}

fn find(at: Option<&str>) -> Result<Running, CommandError> {
    let all = running::all().map_err(CommandError::failed)?;
    let listed = |all: &[Running]| all.iter().map(|running| format!("\n  {running}")).collect::<String>();
    let mut meant: Vec<Running> =
        all.iter().filter(|running| at.is_none_or(|link| running.has_link(link))).cloned().collect();
    match (meant.len(), at) {
        (1, _) => Ok(meant.remove(0)),
        (0, _) if all.is_empty() => Err(CommandError::failed(
            "expected a running emulator, got none; start one with geu run, or name its control interface with --control ADDRESS",
        )),
        (0, Some(link)) => Err(CommandError::input(format!(
            "--at {link}: expected a link of a running emulator, of these:{}",
            listed(&all)
        ))),
        (count, _) => Err(CommandError::input(format!(
            "expected one running emulator, got {count}; name one of its links or its control interface:{}",
            listed(&meant)
        ))),
    }
}
