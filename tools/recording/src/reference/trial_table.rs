//! A table of the rows of trials, read whole or by parts.

use std::io::Read;

use super::columns::{COLUMNS, Columns, MotionKind, SIGMA_COLUMNS};
use super::trial_rows::TrialRows;
use super::{Gaps, ReferenceAttitude};
use crate::csv_table::{CsvTable, TableError};

/// Each trial has drifts of its own.
const MAX_TRIALS: usize = 1000;
/// Rows that a part has in common with the next one on either side of its end: a spline forgets its end by a factor of
/// 3.7 a row, and of f64 within 28 rows.
const MARGIN_ROWS: usize = 64;

/// Rows of a table, which go to their trials.
pub struct TrialTable<R> {
    name: String,
    table: CsvTable<R>,
    columns: Columns,
    gaps: Gaps,
    trials: Vec<TrialRows>,
}

impl<R: Read> TrialTable<R> {
    /// Finds the columns of a table, before its first row.
    ///
    /// # Errors
    /// Columns that are missing, or that rows of these gaps have not.
    pub fn new(name: &str, table: CsvTable<R>, gaps: Gaps) -> Result<TrialTable<R>, TableError> {
        let columns = Columns::find(&table).and_then(|columns| match columns.kind {
            MotionKind::Magnitude => Err(COLUMNS),
            _ => Ok(columns),
        });
        let columns = columns.map_err(|expected| table.without_columns(expected))?;
        if is_single(gaps) && columns.kind != MotionKind::Attitude && columns.sigma.is_some() {
            return Err(table.without_columns(SIGMA_COLUMNS));
        }
        Ok(TrialTable { name: name.to_owned(), table, columns, gaps, trials: Vec::new() })
    }

    /// Reads a row; false at the end.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    fn read_row(&mut self) -> Result<bool, TableError> {
        let TrialTable { table, columns, gaps, trials, .. } = self;
        if !table.read()? {
            return Ok(false);
        }
        let own = columns.trial.map_or("", |trial| table.text(trial));
        let place = trials.iter().rposition(|trial| trial.name == own).unwrap_or(trials.len());
        if place == trials.len() {
            if place > 0 && is_single(*gaps) {
                return Err(table.unexpected(columns.trial.unwrap_or(0), "a single trial"));
            }
            if place == MAX_TRIALS {
                return Err(table.unexpected(columns.trial.unwrap_or(0), &format!("at most {MAX_TRIALS} trials")));
            }
            trials.push(TrialRows::new(own));
        }
        trials[place].push(columns, table, !is_single(*gaps))?;
        Ok(true)
    }

    /// Reads all rows as one truth.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read(mut self) -> Result<ReferenceAttitude, TableError> {
        while self.read_row()? {}
        TrialRows::finish(self.trials, &self.name, &self.columns, self.gaps)
    }

    /// Start of the first row's interval, ns, by the first rows, which stay; they may leave gaps.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn start_ns(&mut self) -> Result<i64, TableError> {
        while self.trials.first().is_none_or(|own| own.rows.len() < MARGIN_ROWS) && self.read_row()? {}
        let first = self.trials.first().map(|own| own.without_first(0));
        let gaps = Gaps::All { has_own_times: false };
        Ok(TrialRows::finish(first.into_iter().collect(), &self.name, &self.columns, gaps)?.start_ns)
    }

    /// Reads the rows that are left, and keeps none.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn finish(mut self) -> Result<(), TableError> {
        while self.read_row()? {
            self.trials.clear();
        }
        Ok(())
    }

    /// Reads the rows of a single trial up to `end_ns` and [`MARGIN_ROWS`] behind it as a truth, which begins as many rows before the end of
    /// the part before.
    ///
    /// # Errors
    /// [`TableError`], with the line.
    pub fn read_to(&mut self, end_ns: i64) -> Result<ReferenceAttitude, TableError> {
        let behind = |trials: &[TrialRows]| {
            let own = trials.first()?;
            Some(own.rows.iter().rev().take_while(|row| own.t_ns(row) > end_ns).take(MARGIN_ROWS).count())
        };
        let mut is_end = false;
        while !is_end && behind(&self.trials).is_none_or(|rows| rows < MARGIN_ROWS) {
            is_end = !self.read_row()?;
        }
        let next = self.trials.first().map(|own| {
            let place = own.rows.partition_point(|row| own.t_ns(row) <= end_ns);
            own.without_first(place.saturating_sub(MARGIN_ROWS))
        });
        let rows = std::mem::replace(&mut self.trials, next.into_iter().collect());
        TrialRows::finish(rows, &self.name, &self.columns, self.gaps)
    }
}

/// True for rows of a single trial.
fn is_single(gaps: Gaps) -> bool {
    !matches!(gaps, Gaps::All { .. })
}
