//! The target of the fuzzer that has the name of this program.

#![no_main]

use geu_fuzz::{Target, target};

const TARGET: Target = target(env!("CARGO_BIN_NAME"));

libfuzzer_sys::fuzz_target!(|data: &[u8]| TARGET(data));
