//! A reference that is the magnitude of the rate: rows with times, or windows with the mean rates of the heads
//! ([`geu_model::device::ReferenceTable`]).

use std::io::Read;

use geu_model::attitude::GAP_SPACINGS;
use geu_model::device::ReferenceTable;

use super::columns::{Columns, MotionKind, time_ns};
use crate::csv_table::{CsvTable, TableError};

/// Largest rate.
const MAX_RATE_ARCSEC_S: f64 = 1e12;

/// The mean magnitude of the rate over a window.
#[derive(Debug, Clone, PartialEq)]
pub struct MagnitudeRow {
    /// Start and end of the window, ns; `None` where the row has the rates of the heads.
    pub window_ns: Option<(i64, i64)>,
    /// Trial or group; empty without one.
    pub group: String,
    /// Mean rate of each head; empty where the samples have them.
    pub rates_arcsec_s: Vec<f64>,
    pub magnitude_arcsec_s: f64,
}

/// Columns of magnitudes: place and unit.
pub enum MagnitudeColumns {
    Timed(Columns),
    Windows { group: Option<usize>, rates: Vec<(usize, f64)>, magnitude: (usize, f64) },
}

impl MagnitudeColumns {
    /// The columns of magnitudes; `None` if the table has others. Those described take precedence.
    pub fn find(table: &CsvTable<impl Read>, described: Option<&ReferenceTable>) -> Option<MagnitudeColumns> {
        let windows = |described: &ReferenceTable| {
            let group = described.group.as_ref().map(|group| table.column(group));
            let rates = described.rates.iter().map(|own| Some((table.column(&own.column)?, own.size)));
            let (rates, magnitude) = (rates.collect::<Option<_>>()?, &described.magnitude);
            let magnitude = (table.column(&magnitude.column)?, magnitude.size);
            Some(MagnitudeColumns::Windows {
                group: group.map_or(Some(None), |place| place.map(Some))?,
                rates,
                magnitude,
            })
        };
        let timed = || Columns::find(table).ok().filter(|columns| columns.kind == MotionKind::Magnitude);
        described.and_then(windows).or_else(|| timed().map(MagnitudeColumns::Timed))
    }

    /// Reads the rows.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn rows(&self, mut table: CsvTable<impl Read>) -> Result<Vec<MagnitudeRow>, TableError> {
        let mut rows = Vec::new();
        while table.read()? {
            let rate = |(place, size): (usize, f64), min: f64, expected: &str| match table.number(place)? * size {
                rate if (min..=MAX_RATE_ARCSEC_S).contains(&rate) => Ok(rate),
                _ => Err(table.unexpected(place, expected)),
            };
            let magnitude = |column| rate(column, 0.0, "a magnitude, 0 to 1e12 arcsec/s");
            rows.push(match self {
                MagnitudeColumns::Timed(columns) => {
                    let end_ns = time_ns(&table, columns.time)?;
                    let start_ns = columns.start.map(|start| time_ns(&table, start)).transpose()?;
                    let group = columns.trial.map_or("", |trial| table.text(trial)).to_owned();
                    let before = rows.last().filter(|last: &&MagnitudeRow| last.group == group);
                    let before_ns = before.and_then(|last| last.window_ns).map(|(_, end_ns)| end_ns);
                    if before_ns >= Some(end_ns) {
                        return Err(table.unexpected(columns.time.0, "a time after that of the row before"));
                    }
                    let is_bad = |start_ns: i64| start_ns >= end_ns || before_ns > Some(start_ns);
                    if let Some((place, _)) = columns.start.filter(|_| start_ns.is_some_and(is_bad)) {
                        return Err(
                            table.unexpected(place, "a start before the end, and not before the end of the row before")
                        );
                    }
                    let window_ns = Some((start_ns.or(before_ns).unwrap_or(end_ns), end_ns));
                    let magnitude_arcsec_s = magnitude((columns.motion[0], columns.size))?;
                    MagnitudeRow { window_ns, group, rates_arcsec_s: Vec::new(), magnitude_arcsec_s }
                }
                MagnitudeColumns::Windows { group, rates, magnitude: column } => MagnitudeRow {
                    window_ns: None,
                    group: group.map_or("", |group| table.text(group)).to_owned(),
                    rates_arcsec_s: rates
                        .iter()
                        .map(|own| rate(*own, -MAX_RATE_ARCSEC_S, "a rate within 1e12 arcsec/s"))
                        .collect::<Result<_, _>>()?,
                    magnitude_arcsec_s: magnitude(*column)?,
                },
            });
        }
        if matches!(self, MagnitudeColumns::Timed(columns) if columns.start.is_none()) {
            shorten(&mut rows);
        }
        Ok(rows)
    }
}

/// Cuts rows that begin where the row before ends: the first one, and one after a gap, last for the median spacing.
fn shorten(rows: &mut [MagnitudeRow]) {
    let length = |row: &MagnitudeRow| row.window_ns.map_or(0, |(start_ns, end_ns)| end_ns.saturating_sub(start_ns));
    let mut lengths: Vec<i64> = rows.iter().map(length).filter(|length_ns| *length_ns > 0).collect();
    lengths.sort_unstable();
    let median_ns = lengths.get(lengths.len() / 2).copied().unwrap_or_default();
    let is_whole = |row: &&mut MagnitudeRow| (1.0..=GAP_SPACINGS * median_ns as f64).contains(&(length(row) as f64));
    for row in rows.iter_mut().filter(|row| !is_whole(row)) {
        row.window_ns = row.window_ns.map(|(_, end_ns)| (end_ns.saturating_sub(median_ns), end_ns));
    }
}
