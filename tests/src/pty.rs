//! A pseudo-terminal that no program of another test holds open.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;

use nix::fcntl::OFlag;
use nix::libc::O_NOCTTY;
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};

/// Master and slave, closed in programs from the start, and the path of the slave. With `openpty` a program that another test starts
/// before they are marked would hold them open.
///
/// # Panics
/// Without one.
pub fn open_pty() -> (PtyMaster, File, String) {
    let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).expect("a pty");
    grantpt(&master).expect("its own");
    unlockpt(&master).expect("its own");
    let path = ptsname_r(&master).expect("its name");
    let slave = OpenOptions::new().read(true).write(true).custom_flags(O_NOCTTY).open(&path).expect("a slave");
    (master, slave, path)
}
