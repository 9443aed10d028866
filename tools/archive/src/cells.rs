//! Columns of rows that have cells of text.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{Schema, SchemaRef};
use geu_model::device::columns::TIME;
use geu_protocol::capture::Timestamp;
use geu_recording::archive::{CONTENT, ColumnKind, DEVICE};

use crate::described::type_of;
use crate::{Columns, VERSION, field, time_columns, time_fields};

/// Endings of names that are units, a longer one before its end.
const UNITS: [&str; 2] = ["arcsec_per_h", "arcsec"];

/// A column after the time: name, content, and cell of a row, `None` if it is unknown.
type CellColumn<R> = (&'static str, ColumnKind, fn(&R) -> Option<String>);

/// Time and cells of rows; numbers as the cells state them.
#[derive(Debug, Clone)]
pub struct CellColumns<R> {
    schema: SchemaRef,
    time: fn(&R) -> Option<Timestamp>,
    columns: Vec<CellColumn<R>>,
}

impl<R> CellColumns<R> {
    /// Columns of rows of a unit; `content` names them in the metadata.
    pub fn new(
        content: &str,
        unit_name: &str,
        time: fn(&R) -> Option<Timestamp>,
        columns: impl Iterator<Item = CellColumn<R>>,
    ) -> CellColumns<R> {
        let columns: Vec<CellColumn<R>> = columns.collect();
        let mut fields = time_fields(TIME).to_vec();
        fields.extend(columns.iter().map(|(name, kind, _)| {
            let has_unit = |unit: &&str| name.strip_suffix(unit).is_some_and(|rest| rest.ends_with('_'));
            field(name, type_of(*kind), UNITS.into_iter().find(has_unit).unwrap_or_default(), true)
        }));
        let metadata = [(CONTENT, content), (DEVICE, unit_name), (VERSION, env!("CARGO_PKG_VERSION"))];
        let metadata: HashMap<String, String> = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        CellColumns { schema: Arc::new(Schema::new_with_metadata(fields, metadata)), time, columns }
    }
}

impl<R: Clone + Send + 'static> Columns for CellColumns<R> {
    type Row = R;

    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }

    fn batch(&self, rows: &[R]) -> RecordBatch {
        let mut columns: Vec<ArrayRef> = time_columns(rows.iter().map(self.time)).to_vec();
        columns.extend(self.columns.iter().map(|(_, kind, cell)| array(*kind, rows.iter().map(cell))));
        RecordBatch::try_new(self.schema(), columns).expect("columns as the schema has them")
    }
}

fn array(kind: ColumnKind, cells: impl Iterator<Item = Option<String>>) -> ArrayRef {
    match kind {
        ColumnKind::Text => Arc::new(cells.collect::<StringArray>()),
        ColumnKind::Flag => Arc::new(cells.map(|cell| cell.map(|cell| cell == "1")).collect::<BooleanArray>()),
        ColumnKind::Whole => Arc::new(cells.map(|cell| cell?.parse().ok()).collect::<Int64Array>()),
        ColumnKind::Real | ColumnKind::Time => Arc::new(cells.map(|cell| cell?.parse().ok()).collect::<Float64Array>()),
    }
}
