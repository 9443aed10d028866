//! Rows and defects to their outputs.

use geu_recording::{Defect, Sink};
use geu_report::rows::DefectLines;

use super::Arguments;
use super::output::RowOutput;
use crate::command_error::CommandError;
use crate::output_writer::{BUFFER, OutputWriter};

/// Writes rows and defects as they are read.
pub struct Writer<'a, O> {
    arguments: &'a Arguments,
    rows: O,
    /// True once an input, and with it the outputs, are open.
    pub is_open: bool,
    defects: Option<OutputWriter>,
    lines: DefectLines,
    /// The first failure of writing.
    pub broken: Option<CommandError>,
}

impl<'a, O> Writer<'a, O> {
    pub fn new(arguments: &'a Arguments, rows: O) -> Writer<'a, O> {
        Writer { arguments, rows, is_open: false, defects: None, lines: DefectLines::default(), broken: None }
    }

    /// Keeps the first failure.
    fn keep(&mut self, result: Result<(), CommandError>) {
        if let Err(failure) = result {
            self.broken.get_or_insert(failure);
        }
    }

    fn open<R>(&mut self) -> Result<(), CommandError>
    where
        O: RowOutput<R>,
    {
        self.rows.open()?;
        self.defects = self.arguments.defects.as_ref().map(|path| OutputWriter::open(Some(path))).transpose()?;
        Ok(())
    }

    #[cold]
    pub fn write_out<R>(&mut self)
    where
        O: RowOutput<R>,
    {
        if !self.is_open {
            return;
        }
        if let Some(output) = &mut self.defects {
            self.lines.end(&mut output.buffer);
            let written = output.flush();
            self.keep(written);
        }
        let written = self.rows.flush();
        self.keep(written);
    }

    /// The complete files; none if no input was open.
    pub fn finish<R>(self) -> Result<Vec<geu_files::Output>, CommandError>
    where
        O: RowOutput<R>,
    {
        if !self.is_open {
            return Ok(Vec::new());
        }
        let mut outputs = self.rows.finish()?;
        outputs.extend(self.defects.map(OutputWriter::complete).transpose()?);
        Ok(outputs)
    }
}

impl<R, O: RowOutput<R>> Sink<R> for Writer<'_, O> {
    fn opened(&mut self) {
        self.is_open = true;
        self.broken = self.open().err();
    }

    #[inline]
    fn row(&mut self, row: &R) {
        if let Some(output) = &mut self.defects {
            self.lines.end(&mut output.buffer);
        }
        let written = self.rows.row(row);
        self.keep(written);
    }

    fn defect(&mut self, defect: &Defect) {
        if let Some(output) = &mut self.defects {
            self.lines.push(defect, &mut output.buffer);
            if output.buffer.len() >= BUFFER {
                let written = output.flush();
                self.keep(written);
            }
        }
    }

    fn flush(&mut self) {
        self.write_out();
    }

    fn is_closed(&self) -> bool {
        self.broken.is_some()
    }
}
