//! The command `geu`.

use std::process::ExitCode;

fn main() -> ExitCode {
    geu::command(std::env::args_os()).into()
}
