//! Attitudes, magnitudes and knots of files: rows that are accepted are finite and in order.

use std::fs;
use std::io;
use std::path::PathBuf;
use std::sync::LazyLock;

use geu_model::attitude::{RecordedAttitude, StreamedAttitude};
use geu_recorder::received;
use geu_recording::{
    CsvTable, Decoder, DecoderOptions, InputReader, ReceivedSample, Reference, ReferenceAttitude, RowReader, Sink, Stop,
};

use crate::device::known;

/// A reference attitude: a table, or an ephemeris.
pub fn reference(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    if let Ok(reference) = ReferenceAttitude::parse("reference", text) {
        is_sound(&reference);
    }
}

/// A reference of a described unit, with trials and gaps, or of magnitudes, in a file that may be compressed.
pub fn reference_file(data: &[u8]) {
    let Some((first, data)) = data.split_first() else { return };
    let device = known(["suchai3", "tetrad", "stim300"][usize::from(first % 3)]);
    match Reference::read(&file(data), device) {
        Ok(Reference::Attitude(reference)) => is_sound(&reference),
        Ok(Reference::Magnitudes(rows)) => {
            for row in &rows {
                assert!(row.magnitude_arcsec_s >= 0.0 && row.rates_arcsec_s.iter().all(|rate| rate.is_finite()));
                assert!(row.window_ns.is_none_or(|(start_ns, end_ns)| start_ns <= end_ns), "{row:?}");
            }
        }
        Err(_) => {}
    }
}

fn is_sound(reference: &ReferenceAttitude) {
    let truth: &RecordedAttitude = &reference.truth;
    let ends_s: Vec<f64> = truth.rows().map(|(t_s, _)| t_s).collect();
    assert!(ends_s.windows(2).all(|pair| pair[0] < pair[1]), "{ends_s:?}");
    assert!(truth.rows().all(|(_, turn)| turn.iter().all(|part| part.is_finite())));
    let mut near = 0;
    for t_s in [truth.start_s(), (truth.start_s() + truth.end_s()) / 2.0, truth.end_s()] {
        let (angle, _) = truth.at(t_s, &mut near);
        assert!(angle.iter().all(|part| part.is_finite()), "{angle:?} at {t_s}");
    }
    reference.row_s();
    reference.trial_at(truth.end_s());
}

/// A CSV table: each row has the columns of the header.
pub fn csv(data: &[u8]) {
    let Ok(mut table) = CsvTable::new("table", RowReader::new(data)) else { return };
    let columns = table.titles().count();
    while let Ok(true) = table.read() {
        for column in 0..columns {
            if let Ok(number) = table.number(column) {
                assert!(number.is_finite() && !table.is_missing(column));
            }
        }
    }
}

/// The knots of a run with external truth: written and read again they are the same.
pub fn knots(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let parse = |text: &str| received::parse("received.csv", text.lines().map(|line| io::Result::Ok(line.to_owned())));
    let Ok(truth) = parse(text) else { return };
    let knots = truth.knots_from(1);
    let mut file = Vec::new();
    received::write_header(&mut file, truth.has_sun()).expect("memory");
    knots.iter().for_each(|knot| received::write_row(&mut file, knot).expect("memory"));
    if !knots.is_empty() {
        let again: StreamedAttitude = parse(str::from_utf8(&file).expect("text")).expect("what was written");
        assert_eq!(again.knots_from(1), knots);
    }
}

/// An input of any format, which may be compressed, an archive or a table.
pub fn input(data: &[u8]) {
    struct Rows(u64);
    impl Sink for Rows {
        fn row(&mut self, _row: &ReceivedSample) {
            self.0 += 1;
        }
    }
    let (mut reader, mut rows) = (InputReader::<Decoder>::new(DecoderOptions::default(), Stop::default()), Rows(0));
    let is_read = reader.read(&file(data), &mut rows).is_ok();
    let (summary, _) = reader.finish(&mut rows);
    assert_eq!(summary.rows, rows.0);
    assert!(!is_read || summary.account.adds_up(), "{:?}", summary.account);
    summary.to_string();
}

/// Name of a file in memory with this content.
fn file(content: &[u8]) -> String {
    static PATH: LazyLock<PathBuf> =
        LazyLock::new(|| PathBuf::from(format!("/dev/shm/geu-fuzz-{}", std::process::id())));
    fs::write(&*PATH, content).expect("memory");
    PATH.display().to_string()
}
