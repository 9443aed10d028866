//! One target of the fuzzer: the one that this program is named after.

#![no_main]

use geu_fuzz::{Target, target};

const TARGET: Target = target(env!("CARGO_BIN_NAME"));

libfuzzer_sys::fuzz_target!(|data: &[u8]| TARGET(data));
