//! Rows of a table with trials, on the time scale of the reference.

use geu_protocol::capture::Timestamp;
use geu_recording::{DeviceSample, ReferenceAttitude, Trial};

/// The trials of a reference, and which of them a table has.
#[derive(Debug)]
pub struct TableTrials {
    trials: Vec<Trial>,
    /// Start of the reference, ns.
    start_ns: i64,
    /// Number of the trial of the last row that was used.
    last: usize,
    has_rows: Vec<bool>,
}

/// A row by its trial.
pub enum TrialRow {
    /// A row of a link, of a table without trials, or beside a reference without trials.
    Single,
    /// A row at its moved time, and the number of its trial.
    Moved(DeviceSample, usize),
    /// A row of a trial that the reference does not state, or far from its rows.
    Other,
    /// A row of a trial before that of the last row.
    OutOfOrder,
}

impl TableTrials {
    pub fn new(reference: &ReferenceAttitude) -> TableTrials {
        let has_rows = vec![false; reference.trials.len()];
        TableTrials { trials: reference.trials.clone(), start_ns: reference.start_ns, last: 0, has_rows }
    }

    pub fn place(&self, row: &DeviceSample) -> TrialRow {
        if self.trials.is_empty() || row.group.is_empty() {
            return TrialRow::Single;
        }
        let is_own = |trial: &Trial| trial.name == row.group;
        let is_last = self.trials.get(self.last).is_some_and(is_own);
        let number = if is_last { Some(self.last) } else { self.trials.iter().position(is_own) };
        let end_ns = row.time.map_or(0, |time| time.t_ns);
        let moved_ns = number.and_then(|number| self.trials[number].moved_ns(self.start_ns, end_ns));
        match number.zip(moved_ns) {
            None => TrialRow::Other,
            Some((number, _)) if number < self.last => TrialRow::OutOfOrder,
            Some((number, moved_ns)) => {
                let later = |time: Timestamp| Timestamp { t_ns: time.t_ns.saturating_add(moved_ns), ..time };
                let (time, start) = (row.time.map(later), row.start.map(later));
                TrialRow::Moved(DeviceSample { time, start, group: String::new(), ..row.clone() }, number)
            }
        }
    }

    /// True for the first row of a further trial.
    pub fn begins(&self, number: Option<usize>) -> bool {
        number.is_some_and(|number| number != self.last)
    }

    /// Notes that a row is used.
    pub fn note(&mut self, number: Option<usize>) {
        if let Some(number) = number {
            self.last = number;
            self.has_rows[number] = true;
        }
    }

    /// Trials of the reference without a row in a table that has trials.
    pub fn missing(&self) -> Vec<&str> {
        let is_missing = |(_, has_rows): &(&Trial, &bool)| self.has_rows.contains(&true) && !**has_rows;
        let missing = self.trials.iter().zip(&self.has_rows).filter(is_missing);
        missing.map(|(trial, _)| trial.name.as_str()).collect()
    }
}
