//! Serial bytes as they arrive, for programs.

use geu_archive::{Columns, DeviceColumns, RecordBatch, UnitColumns};
use geu_recording::{Decode, Decoder, DecoderOptions, Defect, DeviceDecoder, Sink};

use crate::command_error::CommandError;
use crate::device::{DEFAULT_DEVICE, device};

/// Decodes the serial bytes of a link as they arrive.
pub struct StreamDecoder(Unit);

enum Unit {
    Default(Box<Decoder>, Rows<UnitColumns>),
    Described(Box<DeviceDecoder>, Rows<DeviceColumns>),
}

struct Rows<C> {
    columns: C,
    defects: u64,
}

impl<C: Columns> Sink<C::Row> for Rows<C> {
    fn row(&mut self, row: &C::Row) {
        self.columns.push(row);
    }

    fn defect(&mut self, _defect: &Defect) {
        self.defects += 1;
    }
}

impl StreamDecoder {
    /// A decoder for the default unit, or for this name or description.
    ///
    /// # Errors
    /// No such unit, or one without a serial link.
    pub fn new(name: Option<&str>) -> Result<StreamDecoder, CommandError> {
        let options = DecoderOptions::default();
        let Some(name) = name.filter(|name| *name != DEFAULT_DEVICE) else {
            let (mut decoder, mut rows) =
                (Decoder::new(&options), Rows { columns: UnitColumns::default(), defects: 0 });
            decoder.begin("stream", &mut rows);
            return Ok(StreamDecoder(Unit::Default(Box::new(decoder), rows)));
        };
        let device = device(name)?;
        if device.serial.is_none() {
            return Err(CommandError::input(format!("{name}: expected a unit with a serial link, got one without")));
        }
        let mut decoder = DeviceDecoder::new(&device, &options);
        let mut rows = Rows { columns: DeviceColumns::new(&device), defects: 0 };
        decoder.begin("stream", &mut rows);
        Ok(StreamDecoder(Unit::Described(Box::new(decoder), rows)))
    }

    /// Samples that these bytes complete.
    pub fn feed(&mut self, bytes: &[u8]) -> RecordBatch {
        match &mut self.0 {
            Unit::Default(decoder, rows) => {
                decoder.serial(bytes, None, rows);
                rows.columns.take_batch()
            }
            Unit::Described(decoder, rows) => {
                decoder.serial(bytes, None, rows);
                rows.columns.take_batch()
            }
        }
    }

    /// Number of defects until now.
    pub fn defects(&self) -> u64 {
        match &self.0 {
            Unit::Default(_, rows) => rows.defects,
            Unit::Described(_, rows) => rows.defects,
        }
    }
}
