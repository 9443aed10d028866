//! Interfaces of CAN inputs: which has the unit, and its rows and defects before that is known.

use geu_protocol::can::{AssembledSample, Assembler, AssemblerEvent, CanDefect, DefectBytes};

use crate::defect::DefectKind;
use crate::flow::{Flow, Stamp};
use crate::row::{ReceivedSample, Sink};

/// Defects kept of a bus before it is chosen; further ones are counted.
const MAX_EARLY: usize = 1000;

/// Choice of the interface of the rows.
#[derive(Debug)]
pub enum InterfaceSelection {
    /// The interface of this name, in every input.
    Named(Vec<u8>),
    /// The first with a row.
    First,
    /// The interface of the inputs before; another only if the present input lacks it.
    Before(usize),
    Made(usize),
}

/// An interface that carries the unit's identifiers.
#[derive(Debug)]
pub struct Bus {
    pub name: Vec<u8>,
    pub assembler: Assembler<Stamp>,
    pub tally: Tally,
    /// True if it ever had a row.
    pub is_proven: bool,
}

/// Counts and pending rows of an interface in the present input.
#[derive(Debug, Default)]
pub struct Tally {
    pub frames: u64,
    pub decoded: u64,
    pub commands: u64,
    pub replies: u64,
    /// Rows before the choice of the interface.
    pub rows: Vec<(Stamp, ReceivedSample)>,
    defects: Vec<(Stamp, CanDefect, DefectBytes)>,
    /// Counts of further defects, in the order of [`CanDefect::ALL`].
    more: [u64; CanDefect::ALL.len()],
}

impl InterfaceSelection {
    #[inline]
    pub fn is(&self, index: usize) -> bool {
        matches!(self, InterfaceSelection::Made(made) if *made == index)
    }
}

impl Tally {
    #[inline]
    pub fn assembled(
        &mut self,
        assembled: AssemblerEvent<Stamp>,
        index: usize,
        choice: &mut InterfaceSelection,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        match assembled {
            AssemblerEvent::Row(received) => self.row(received, index, choice.is(index), choice, flow, sink),
            AssemblerEvent::Defect(stamp, defect, concerned) => {
                self.defect(choice.is(index), stamp, defect, concerned, flow, sink);
            }
        }
    }

    /// Counts a row, and reports it or keeps it.
    // Inlined, so that its fields are written once: the load of a whole structure just after stores of its fields stalls, which took a
    // tenth of the time to decode a candump log.
    #[inline(always)]
    pub fn row(
        &mut self,
        AssembledSample { stamp, sample, has_clock }: AssembledSample<Stamp>,
        index: usize,
        is_chosen: bool,
        choice: &mut InterfaceSelection,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        let row = ReceivedSample::new(sample, has_clock, stamp.time);
        self.decoded += if has_clock { 3 } else { 2 };
        if is_chosen {
            flow.row(&stamp, &row, true, sink);
        } else {
            self.early_row(&stamp, &row, index, choice, flow, sink);
        }
    }

    /// Chooses the interface by its row, or keeps the row.
    #[cold]
    fn early_row(
        &mut self,
        stamp: &Stamp,
        row: &ReceivedSample,
        index: usize,
        choice: &mut InterfaceSelection,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        match choice {
            InterfaceSelection::First => {
                *choice = InterfaceSelection::Made(index);
                self.report_early(flow, sink);
                flow.row(stamp, row, true, sink);
            }
            InterfaceSelection::Before(_) => self.rows.push((*stamp, *row)),
            _ => {}
        }
    }

    #[cold]
    pub fn defect(
        &mut self,
        is_chosen: bool,
        stamp: Stamp,
        defect: CanDefect,
        concerned: DefectBytes,
        flow: &mut Flow,
        sink: &mut impl Sink,
    ) {
        if is_chosen {
            flow.defect(stamp, DefectKind::Can(defect), concerned.bytes(), 0, sink);
        } else if self.defects.len() < MAX_EARLY {
            self.defects.push((stamp, defect, concerned));
        } else {
            self.more[defect as usize] += 1;
        }
    }

    #[cold]
    pub fn report_early(&mut self, flow: &mut Flow, sink: &mut impl Sink) {
        for (stamp, row) in std::mem::take(&mut self.rows) {
            flow.row(&stamp, &row, true, sink);
        }
        for (stamp, defect, concerned) in std::mem::take(&mut self.defects) {
            flow.defect(stamp, DefectKind::Can(defect), concerned.bytes(), 0, sink);
        }
        for (defect, more) in CanDefect::ALL.into_iter().zip(std::mem::take(&mut self.more)) {
            flow.count_defects(DefectKind::Can(defect), more);
        }
    }
}
