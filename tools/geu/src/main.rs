//! The command `geu`: one thin file per subcommand, nothing but arguments and printing.

use clap::{Parser, Subcommand};

/// Emulator, decoder and evaluation of a spacecraft gyro electronics unit.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {}

fn main() {
    match Arguments::parse().command {
        Some(command) => match command {},
        None => println!("not yet"),
    }
}
