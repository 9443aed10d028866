//! Files that a process reads and writes.
//!
//! An [`Output`] is written beside its final path and renamed when it is complete, so that a failure keeps the previous file.
//! Inputs and outputs are claimed by [`claim_input`] and [`claim_output`], so that no output is an input or another output.
//! [`interruption`] removes incomplete files when a signal ends the process.
//!
//! ```
//! use std::io::Write;
//!
//! let directory = tempfile::tempdir()?;
//! let path = directory.path().join("rows.csv");
//! std::fs::write(&path, "before")?;
//! let mut output = geu_files::Output::create(&path)?;
//! output.write_all(b"t_s\n")?;
//! assert_eq!(std::fs::read(&path)?, b"before");
//! output.persist()?;
//! assert_eq!(std::fs::read(&path)?, b"t_s\n");
//! # Ok::<(), std::io::Error>(())
//! ```

mod claims;
pub mod interruption;
mod output;
mod place;

pub use claims::{ClaimError, claim_input, claim_output, claim_standard_output};
pub use output::{Output, is_partial, persist_all, write_whole};
