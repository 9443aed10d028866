//! Outputs of rows: text, columns, or none.

use std::io::{ErrorKind, IsTerminal};
use std::mem;
use std::sync::Arc;

use geu_archive::{BatchFile, Columns, FileFormat, Partition};
use geu_files::Output;
use geu_recording::{Ordered, pool};
use rayon::ThreadPool;

use crate::command_error::CommandError;
use crate::output_writer::{BUFFER, OutputWriter};
use crate::outputs::{OutputDirectory, OutputFile};

/// An output of rows. It is written until the end, complete or absent.
pub trait RowOutput<R> {
    /// Starts the output.
    fn open(&mut self) -> Result<(), CommandError>;
    fn row(&mut self, row: &R) -> Result<(), CommandError>;
    /// Writes what was kept, for a live input.
    fn flush(&mut self) -> Result<(), CommandError>;
    /// The complete files, still beside their final paths.
    fn finish(self) -> Result<Vec<Output>, CommandError>;
}

/// No rows.
pub struct NoRows;

impl<R> RowOutput<R> for NoRows {
    fn open(&mut self) -> Result<(), CommandError> {
        Ok(())
    }

    fn row(&mut self, _row: &R) -> Result<(), CommandError> {
        Ok(())
    }

    fn flush(&mut self) -> Result<(), CommandError> {
        Ok(())
    }

    fn finish(self) -> Result<Vec<Output>, CommandError> {
        Ok(Vec::new())
    }
}

/// Rows as text that `write` appends. Of many rows, other threads write blocks, which are put out in their order.
pub struct TextRows<'a, R, W> {
    out: Option<&'a OutputFile>,
    header: String,
    write: Arc<W>,
    writer: Option<OutputWriter>,
    /// Rows until now, up to a block.
    count: usize,
    blocks: Option<Blocks<R>>,
}

/// Rows of a block; their text is about as long as the buffer of an output.
const BLOCK_ROWS: usize = 1 << 12;

struct Blocks<R> {
    /// Rows that are not passed on yet.
    open: Block<R>,
    pending: Ordered<Block<R>>,
    spare: Vec<Block<R>>,
}

/// Rows, and then their text.
struct Block<R> {
    rows: Vec<R>,
    text: Vec<u8>,
}

impl<R, W> TextRows<'_, R, W> {
    pub fn new(out: Option<&OutputFile>, header: String, write: W) -> TextRows<'_, R, W> {
        TextRows { out, header, write: Arc::new(write), writer: None, count: 0, blocks: None }
    }
}

impl<R> Block<R> {
    fn new() -> Block<R> {
        Block { rows: Vec::with_capacity(BLOCK_ROWS), text: Vec::new() }
    }

    fn written(mut self, write: &impl Fn(&R, &mut Vec<u8>)) -> Block<R> {
        self.rows.drain(..).for_each(|row| write(&row, &mut self.text));
        self
    }
}

impl<R: Clone + Send + 'static> Blocks<R> {
    fn new(pool: &'static ThreadPool) -> Blocks<R> {
        Blocks { open: Block::new(), pending: Ordered::new(pool), spare: Vec::new() }
    }

    #[cold]
    fn pass_on<W>(&mut self, write: &Arc<W>, writer: &mut OutputWriter) -> Result<(), CommandError>
    where
        W: Fn(&R, &mut Vec<u8>) + Send + Sync + 'static,
    {
        let block = mem::replace(&mut self.open, self.spare.pop().unwrap_or_else(Block::new));
        let write = Arc::clone(write);
        self.pending.start(move || block.written(&*write));
        while self.pending.is_full() {
            self.put_out(writer)?;
        }
        Ok(())
    }

    /// Puts out the text of the next block; false if there is none.
    fn put_out(&mut self, writer: &mut OutputWriter) -> Result<bool, CommandError> {
        let Some(mut block) = self.pending.wait() else { return Ok(false) };
        if writer.buffer.is_empty() {
            mem::swap(&mut writer.buffer, &mut block.text);
        }
        writer.buffer.append(&mut block.text);
        self.spare.push(block);
        if writer.buffer.len() >= BUFFER { writer.flush() } else { Ok(()) }.map(|()| true)
    }

    fn put_out_all(
        &mut self,
        write: &impl Fn(&R, &mut Vec<u8>),
        writer: &mut OutputWriter,
    ) -> Result<(), CommandError> {
        while self.put_out(writer)? {}
        self.open.rows.drain(..).for_each(|row| write(&row, &mut writer.buffer));
        Ok(())
    }
}

impl<R, W> RowOutput<R> for TextRows<'_, R, W>
where
    R: Clone + Send + 'static,
    W: Fn(&R, &mut Vec<u8>) + Send + Sync + 'static,
{
    fn open(&mut self) -> Result<(), CommandError> {
        let mut writer = OutputWriter::open(self.out)?;
        writer.buffer.extend_from_slice(self.header.as_bytes());
        self.writer = Some(writer);
        Ok(())
    }

    #[inline]
    fn row(&mut self, row: &R) -> Result<(), CommandError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        if let Some(blocks) = &mut self.blocks {
            blocks.open.rows.push(row.clone());
            return if blocks.open.rows.len() >= BLOCK_ROWS { blocks.pass_on(&self.write, writer) } else { Ok(()) };
        }
        (self.write)(row, &mut writer.buffer);
        self.count += 1;
        if self.count == BLOCK_ROWS {
            self.blocks = pool().map(Blocks::new);
        }
        if writer.buffer.len() >= BUFFER { writer.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<(), CommandError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        if let Some(blocks) = &mut self.blocks {
            blocks.put_out_all(&*self.write, writer)?;
        }
        writer.flush()
    }

    fn finish(mut self) -> Result<Vec<Output>, CommandError> {
        self.flush()?;
        Ok(self.writer.map(OutputWriter::complete).transpose()?.into_iter().collect())
    }
}

/// Destination of columns.
#[derive(Clone, Copy)]
pub enum ColumnPlace<'a> {
    /// A file, or standard output.
    File(Option<&'a OutputFile>),
    /// A directory with files of days; true if they replace others.
    Partition(&'a OutputDirectory, bool),
}

/// Rows as columns.
pub struct ColumnRows<'a, C: Columns> {
    columns: C,
    format: FileFormat,
    place: ColumnPlace<'a>,
    files: Option<ColumnFiles>,
    /// Rows until now, up to a batch.
    rows: Vec<C::Row>,
    has_batch: bool,
}

enum ColumnFiles {
    File(BatchFile),
    Partition(Partition),
}

/// Refuses columns on a terminal.
pub fn verify_columns_place(out: Option<&OutputFile>) -> Result<(), CommandError> {
    match out.is_none() && std::io::stdout().is_terminal() {
        true => Err(CommandError::input("--format: expected --out FILE, or a pipe, for a format that is no text")),
        false => Ok(()),
    }
}

/// Rows of a batch.
const BATCH_ROWS: usize = 1 << 16;

impl<'a, C: Columns> ColumnRows<'a, C> {
    pub fn new(columns: C, format: FileFormat, place: ColumnPlace<'a>) -> ColumnRows<'a, C> {
        ColumnRows { columns, format, place, files: None, rows: Vec::new(), has_batch: false }
    }

    fn failed(&self, error: std::io::Error) -> CommandError {
        match self.place {
            ColumnPlace::File(Some(file)) => file.write_error(error),
            ColumnPlace::Partition(directory, _) => match error.kind() {
                ErrorKind::AlreadyExists | ErrorKind::InvalidInput => CommandError::input(error),
                _ => CommandError::failed(format!("{}: cannot be written: {error}", directory.path().display())),
            },
            _ => CommandError::writing(error),
        }
    }

    #[cold]
    fn write_batch(&mut self) -> Result<(), CommandError> {
        self.has_batch = true;
        self.begin()?;
        let batch = self.columns.batch(&self.rows);
        self.rows.clear();
        let written = match &mut self.files {
            Some(ColumnFiles::File(file)) => file.write(&batch),
            Some(ColumnFiles::Partition(files)) => files.write(&batch),
            None => Ok(()),
        };
        written.map_err(|error| self.failed(error))
    }

    /// Starts the files, which begin with bytes of their format.
    fn begin(&mut self) -> Result<(), CommandError> {
        if self.files.is_some() {
            return Ok(());
        }
        let (format, schema) = (self.format, self.columns.schema());
        self.files = Some(match self.place {
            ColumnPlace::File(file) => {
                let output = match file {
                    Some(file) => file.create()?,
                    None => OutputFile::standard().create()?,
                };
                let file = BatchFile::new(output, format, &schema).map_err(|error| self.failed(error))?;
                ColumnFiles::File(file)
            }
            ColumnPlace::Partition(directory, replaces) => {
                ColumnFiles::Partition(Partition::new(directory.path(), format, &schema, replaces))
            }
        });
        Ok(())
    }
}

impl<C: Columns> RowOutput<C::Row> for ColumnRows<'_, C> {
    /// Standard output of an input that is refused stays empty.
    fn open(&mut self) -> Result<(), CommandError> {
        if matches!(self.place, ColumnPlace::File(None)) { Ok(()) } else { self.begin() }
    }

    #[inline]
    fn row(&mut self, row: &C::Row) -> Result<(), CommandError> {
        self.rows.push(row.clone());
        if self.rows.len() >= BATCH_ROWS { self.write_batch() } else { Ok(()) }
    }

    /// The first rows of a live input open the files, so that a failure is known at once.
    fn flush(&mut self) -> Result<(), CommandError> {
        if self.has_batch || self.rows.is_empty() { Ok(()) } else { self.write_batch() }
    }

    fn finish(mut self) -> Result<Vec<Output>, CommandError> {
        if !self.rows.is_empty() {
            self.write_batch()?;
        }
        self.begin()?;
        let finished = match self.files.take() {
            Some(ColumnFiles::File(file)) => file.finish().map(|output| vec![output]),
            Some(ColumnFiles::Partition(files)) => files.finish(),
            None => Ok(Vec::new()),
        };
        finished.map_err(|error| self.failed(error))
    }
}
