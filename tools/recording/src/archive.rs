//! Archives: decoded samples as columns of Parquet files, which `geu-archive` writes, read back as the rows that were decoded.

mod file;
mod find;

use geu_model::device::columns::{GROUP, IS_RECEIVED, NUMBER, START, TIME};
use geu_model::device::{DEFAULT_DEVICE, Device, TableWire};
use geu_protocol::Sample;
use geu_protocol::capture::Timestamp;
use geu_protocol::field::{
    CLOCK_MODULUS, ClockCount, Electronics, FIELDS, Field, FieldSpec, GyroFlags, Sensor, Sequence, UnitFlags,
};
use geu_protocol::layout::Quantity;

pub(crate) use file::{Archive, ArchiveRows};
pub(crate) use find::archive_files;

use crate::aem::epoch_ns;
use crate::row::{DeviceSample, ReceivedSample};
use crate::text::timestamp;

/// Key of the name of the unit in the metadata of a file.
pub const DEVICE: &str = "geu.device";
/// Key of what the rows are, where they are no samples: a track, or the truth of a recording.
pub const CONTENT: &str = "geu.content";
/// Key of its description; absent for the default unit.
pub const DESCRIPTION: &str = "geu.description";
/// Ends of the names of files.
pub const PARQUET: &str = "parquet";
pub const ARROW: &str = "arrow";

/// A range of times, from the first one to before the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimeRange {
    pub from_ns: i64,
    pub to_ns: i64,
}

/// A time in UTC, ISO 8601 such as 2026-11-27T10:00:00Z, or seconds since 1970, in ns.
pub fn instant_ns(text: &str) -> Option<i64> {
    let seconds = || timestamp(text, 1_000_000_000).filter(|_| !text.contains(' ')).map(|time| time.t_ns);
    epoch_ns(text).or_else(seconds)
}

/// Content of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColumnKind {
    /// Microseconds since 1970, UTC.
    Time,
    Whole,
    Real,
    Flag,
    Text,
}

impl ColumnKind {
    /// Kind of a value of a described unit.
    pub fn of_value(device: &Device, slot: usize) -> ColumnKind {
        match device.values()[slot].quantity {
            Quantity::Valid(_) | Quantity::Saturated(_) | Quantity::Status(_) => ColumnKind::Flag,
            _ if device.is_count(slot) => ColumnKind::Whole,
            _ => ColumnKind::Real,
        }
    }
}

/// The columns of a unit that are read from an archive, in the order of `ArchiveRows`.
#[derive(Debug, Clone)]
pub struct ArchiveUnit {
    pub(crate) name: String,
    pub(crate) description: String,
    pub(crate) columns: Vec<(String, ColumnKind)>,
}

/// Columns from which an instant is read.
fn instant([time, _, rest, decimals]: [&str; 4]) -> [(String, ColumnKind); 3] {
    [(time, ColumnKind::Time), (rest, ColumnKind::Whole), (decimals, ColumnKind::Whole)]
        .map(|(name, kind)| (name.to_owned(), kind))
}

/// Places of the columns of the default unit.
const SEQUENCE: usize = 3;
const CLOCK: usize = 4;
const INCREMENTS: usize = 5;
const FLAGS: usize = 9;
const TEMPERATURES: usize = 11;
const RECEIVED: usize = 13;
/// Place of the first value of a described unit.
const FIRST_VALUE: usize = 4;

impl ArchiveUnit {
    pub(crate) fn iras() -> ArchiveUnit {
        let of = |kind| move |field: FieldSpec| (field.name.to_owned(), kind);
        let mut columns = instant(TIME).to_vec();
        columns.extend([Sequence::SPEC, ClockCount::SPEC].map(of(ColumnKind::Whole)));
        columns.extend(FIELDS[..4].iter().copied().map(of(ColumnKind::Whole)));
        columns.extend([GyroFlags::SPEC, UnitFlags::SPEC].map(of(ColumnKind::Whole)));
        columns.extend([Electronics::SPEC, Sensor::SPEC].map(of(ColumnKind::Real)));
        columns.push((IS_RECEIVED.to_owned(), ColumnKind::Flag));
        ArchiveUnit { name: DEFAULT_DEVICE.to_owned(), description: String::new(), columns }
    }

    pub(crate) fn described(device: &Device) -> ArchiveUnit {
        let has = |column: fn(&TableWire) -> bool| device.table.as_ref().is_some_and(column);
        let mut columns = instant(TIME).to_vec();
        columns.push((NUMBER.to_owned(), ColumnKind::Whole));
        let values = device.values().iter().enumerate();
        columns.extend(values.map(|(slot, value)| (value.name.clone(), ColumnKind::of_value(device, slot))));
        columns.push((IS_RECEIVED.to_owned(), ColumnKind::Flag));
        if has(|table| table.start.is_some()) {
            columns.extend(instant(START));
        }
        if has(|table| table.group.is_some()) {
            columns.push((GROUP.to_owned(), ColumnKind::Text));
        }
        let (name, description) = (device.unit_name().to_owned(), device.description.text.clone());
        ArchiveUnit { name, description, columns }
    }
}

impl ArchiveRows {
    /// A row of the default unit.
    ///
    /// # Errors
    /// A number that no field has: column, expected and got.
    pub(crate) fn sample(&self, row: usize) -> Result<ReceivedSample, String> {
        let mut increments = [0; 4];
        for (gyro, increment) in increments.iter_mut().enumerate() {
            *increment = self.fitting(INCREMENTS + gyro, row)?;
        }
        let clock_count = self.whole(CLOCK, row);
        let clock = clock_count.map(|_| self.fitting(CLOCK, row)).transpose()?.unwrap_or(0u64);
        if clock >= CLOCK_MODULUS {
            return Err(self.unexpected(CLOCK, &format!("a count below {CLOCK_MODULUS}"), row));
        }
        let sensor_centi_c = clock_count.map(|_| self.hundredths(TEMPERATURES + 1, row)).transpose()?;
        Ok(ReceivedSample {
            time: self.instant(0, row)?,
            is_received: self.whole(RECEIVED, row) == Some(1),
            sample: Sample {
                sequence: self.fitting(SEQUENCE, row)?,
                increments,
                gyro_flags: self.fitting(FLAGS, row)?,
                unit_flags: self.fitting(FLAGS + 1, row)?,
                electronics_centi_c: self.hundredths(TEMPERATURES, row)?,
                clock_count: clock,
                sensor_centi_c: sensor_centi_c.unwrap_or(0),
            },
            has_clock: clock_count.is_some(),
        })
    }

    /// Reads a row of a described unit.
    ///
    /// # Errors
    /// A number that no row has: column, expected and got.
    pub(crate) fn device_sample(&self, row: usize, sample: &mut DeviceSample) -> Result<(), String> {
        let received = FIRST_VALUE + sample.values.len();
        for (slot, value) in sample.values.iter_mut().enumerate() {
            *value = self.number(FIRST_VALUE + slot, row);
        }
        sample.time = self.instant(0, row)?.filter(|_| self.whole(received, row) == Some(1));
        sample.number = self.fitting(FIRST_VALUE - 1, row)?;
        let (mut next, has) = (received + 1, |next: usize, kind| self.kind(next) == Some(kind));
        if has(next, ColumnKind::Time) {
            sample.start = self.instant(next, row)?;
            next += 3;
        }
        if has(next, ColumnKind::Text) {
            self.text(next, row).clone_into(&mut sample.group);
        }
        Ok(())
    }

    /// A temperature.
    fn hundredths(&self, column: usize, row: usize) -> Result<i16, String> {
        let hundredths = (self.number(column, row) * 100.0).round();
        let is_valid = hundredths >= f64::from(i16::MIN) && hundredths <= f64::from(i16::MAX);
        if is_valid {
            Ok(hundredths as i16)
        } else {
            Err(self.unexpected(column, "a number from -327.68 to 327.67", row))
        }
    }

    /// The instant in three columns.
    pub(crate) fn instant(&self, column: usize, row: usize) -> Result<Option<Timestamp>, String> {
        let Some(time_us) = self.whole(column, row) else { return Ok(None) };
        let (rest_ns, digits): (i16, u8) = (self.fitting(column + 1, row)?, self.fitting(column + 2, row)?);
        if digits > 9 {
            return Err(self.unexpected(column + 2, "0 to 9 decimals", row));
        }
        let t_ns = time_us.checked_mul(1000).and_then(|t_ns| t_ns.checked_add(rest_ns.into()));
        let t_ns = t_ns.ok_or_else(|| self.unexpected(column, "a time from 1678 to 2262", row))?;
        Ok(Some(Timestamp { t_ns, digits: digits.into() }))
    }
}
