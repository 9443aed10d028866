//! Serial bytes as they arrive, for programs.

use geu_archive::{Columns, DeviceColumns, RecordBatch, UnitColumns};
use geu_recording::{Decode, Decoder, DecoderOptions, Defect, DeviceDecoder, Sink};

use crate::command_error::CommandError;
use crate::device::{DEFAULT_DEVICE, device};

/// Samples that bytes complete, and the number of defects until then.
type Decoding = dyn FnMut(&[u8]) -> (RecordBatch, u64) + Send + Sync;

/// Decodes the serial bytes of a link as they arrive.
pub struct StreamDecoder {
    decode: Box<Decoding>,
    /// Number of defects until now.
    pub defects: u64,
}

struct Rows<R> {
    rows: Vec<R>,
    defects: u64,
}

impl<R: Clone> Sink<R> for Rows<R> {
    fn row(&mut self, row: &R) {
        self.rows.push(row.clone());
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
            return Ok(StreamDecoder::with(Decoder::new(&options), UnitColumns::default()));
        };
        let device = device(name)?;
        if device.serial.is_none() {
            return Err(CommandError::input(format!("{name}: expected a unit with a serial link, got one without")));
        }
        Ok(StreamDecoder::with(DeviceDecoder::new(&device, &options), DeviceColumns::new(&device)))
    }

    fn with<D, C>(mut decoder: D, columns: C) -> StreamDecoder
    where
        D: Decode<Row: Clone + Send + Sync> + Send + Sync + 'static,
        C: Columns<Row = D::Row> + Send + Sync + 'static,
    {
        let mut rows = Rows { rows: Vec::new(), defects: 0 };
        decoder.begin("stream", &mut rows);
        let decode = move |bytes: &[u8]| {
            decoder.serial(bytes, None, &mut rows);
            let batch = columns.batch(&rows.rows);
            rows.rows.clear();
            (batch, rows.defects)
        };
        StreamDecoder { decode: Box::new(decode), defects: 0 }
    }

    /// Samples that these bytes complete.
    pub fn feed(&mut self, bytes: &[u8]) -> RecordBatch {
        let (batch, defects) = (self.decode)(bytes);
        self.defects = defects;
        batch
    }
}
