//! Opens any input, file or live link, and yields samples and defects.
//!
//! [`InputReader`] opens inputs one after the other and passes their bytes to a [`Decoder`], which reports rows and defects to
//! a [`Sink`] and keeps the [`DecodeSummary`]. Memory is constant for inputs of any length.
//!
//! ```
//! use geu_recording::{Decode, Decoder, Defect, DecoderOptions, ReceivedSample, Sink};
//! use geu_protocol::capture::Format;
//!
//! #[derive(Default)]
//! struct Rows(Vec<ReceivedSample>);
//! impl Sink for Rows {
//!     fn row(&mut self, row: &ReceivedSample) {
//!         self.0.push(*row);
//!     }
//!     fn defect(&mut self, defect: &Defect) {
//!         panic!("{defect:?}");
//!     }
//! }
//!
//! let log = b"(0.5) can0 1A0#FFFEFFFE00050005\n(0.5) can0 1A1#00000F070810DD5E\n(0.5) can0 1A2#00000007A1201B58\n";
//! let (mut decoder, mut rows) = (Decoder::new(&DecoderOptions::default()), Rows::default());
//! decoder.begin("example.log", &mut rows);
//! let mut reader = Format::from_name("candump").unwrap().reader().unwrap();
//! reader.read(log, true, &mut |position, record| decoder.event(position, &record, &mut rows));
//! decoder.count_records(reader.records());
//! decoder.finish(&mut rows);
//! assert_eq!(rows.0[0].sample.increments, [-2, -2, 5, 5]);
//! assert!(decoder.into_summary().account.adds_up());
//! ```

mod account;
mod aem;
pub mod archive;
mod cadence;
mod clock_fit;
mod command_link;
mod csv_table;
mod decoder;
mod defect;
mod device_decoder;
mod flow;
mod input;
mod input_reader;
mod live;
mod no_rows;
mod others;
mod parquet_text;
mod pool;
mod reference;
mod row;
mod summary;
mod text;

pub use account::DecodeAccount;
pub use cadence::IntervalStatistics;
pub use clock_fit::{ClockFit, ClockRate};
pub use command_link::{CommandLink, POLL};
pub use csv_table::{CsvTable, TableError};
pub use decoder::{Decoder, DecoderOptions};
pub use defect::{Defect, DefectKind, place_text};
pub use device_decoder::DeviceDecoder;
pub use input::{InputError, is_live, is_recording, verify_exists};
pub use input_reader::{Decode, InputReader, Stop};
pub use no_rows::no_rows_reason;
pub use others::Others;
pub use pool::{Ordered, pool};
pub use reference::{MagnitudeRow, REFERENCE, Reference, ReferenceAttitude, ReferenceParts, Trial};
pub use row::{DeviceSample, ReceivedSample, Sink};
pub use summary::DecodeSummary;
pub use text::{RowLines, RowReader, Table, open_rows, read_text};
