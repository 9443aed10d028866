//! Reports rows and defects in their order, and counts them.

use geu_protocol::Gyro;
use geu_protocol::capture::{CaptureRecord, RecordPosition, Timestamp};
use geu_protocol::continuity::{Continuity, SequenceStep};
use geu_protocol::field::unit_flag;

use crate::defect::{Defect, DefectKind, place_text};
use crate::row::{DeviceSample, ReceivedSample, Sink};
use crate::summary::DecodeSummary;

/// Gaps that the summary lists.
const MAX_LISTED_GAPS: usize = 20;
const POLLED: u8 = unit_flag("polled");

/// Time and position of a frame or a defect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stamp {
    pub place: RecordPosition,
    pub input: u32,
    pub time: Option<Timestamp>,
}

/// Reports rows and defects and counts them.
#[derive(Debug, Default)]
pub(crate) struct Flow {
    pub summary: DecodeSummary,
    continuity: Continuity,
    /// Receive time of the row before.
    last_t_ns: Option<i64>,
    /// True if the row before was polled.
    last_polled: bool,
    /// Kind of a gap that the sequence does not show.
    pub gap_kind: Option<DefectKind>,
    /// The longest interval and its end.
    largest: Option<(i64, RecordPosition, u32)>,
}

impl Flow {
    /// The start of the inputs of a unit with these heads.
    pub fn new(heads: impl IntoIterator<Item = String>, device: Option<String>) -> Flow {
        let heads = heads.into_iter().map(|name| (name, 0, 0)).collect();
        Flow { summary: DecodeSummary { heads, device, ..DecodeSummary::default() }, ..Flow::default() }
    }

    pub fn begin(&mut self, name: &str) {
        self.summary.inputs.push((name.to_owned(), String::new()));
    }

    #[inline]
    pub fn input(&self) -> u32 {
        self.summary.inputs.len().saturating_sub(1) as u32
    }

    pub fn stamp(&self, place: RecordPosition, time: Option<Timestamp>) -> Stamp {
        Stamp { place, input: self.input(), time }
    }

    /// Reports a row; `is_regular` unless its clock was rejected.
    // Inlined with all that it calls for each row: its values stay in registers from the frame on.
    #[inline(always)]
    pub fn row(&mut self, stamp: &Stamp, row: &ReceivedSample, is_regular: bool, sink: &mut impl Sink) {
        let sample = &row.sample;
        let summary = &mut self.summary;
        summary.rows += 1;
        summary.is_timed |= row.is_received;
        summary.without_clock += u64::from(!row.has_clock);
        if sample.gyro_flags != 0x0F {
            for (gyro, (_, invalid, saturated)) in Gyro::ALL.into_iter().zip(&mut summary.heads) {
                let bit = gyro.bit();
                *invalid += u64::from(sample.gyro_flags & bit == 0);
                *saturated += u64::from(sample.gyro_flags & bit << 4 != 0);
            }
        }
        if is_regular {
            self.follow(|| Stamp { time: row.time, ..*stamp }, row, sink);
        }
        sink.row(row);
    }

    /// Compares a row with the one before.
    #[inline(always)]
    fn follow(&mut self, stamp: impl Fn() -> Stamp, row: &ReceivedSample, sink: &mut impl Sink) {
        let sample = &row.sample;
        let summary = &mut self.summary;
        let is_polled = sample.unit_flags & POLLED != 0;
        summary.polled += u64::from(is_polled);
        if let Some(time) = row.time {
            summary.span.get_or_insert((time, time)).1 = time;
        }
        let step = self.continuity.step(sample.sequence, row.has_clock.then_some(sample.clock_count));
        let received = row.time.filter(|_| row.is_received);
        self.pace(&stamp, received, step, is_polled, sink);
        if let Some(Timestamp { t_ns, .. }) = received
            && row.has_clock
            && !is_polled
            && step != SequenceStep::Repeat
        {
            self.summary.clock.add(t_ns, sample.sequence, sample.clock_count);
        }
        if step != SequenceStep::Next {
            self.irregular(step, stamp(), sink);
        }
    }

    /// Begins a trial: its times are independent of the trial before.
    pub fn begin_trial(&mut self) {
        self.last_t_ns = None;
    }

    /// Reports a sample of a described unit.
    #[inline]
    pub fn sample(&mut self, stamp: Stamp, step: SequenceStep, row: &DeviceSample, sink: &mut impl Sink<DeviceSample>) {
        self.summary.rows += 1;
        self.summary.is_timed |= row.time.is_some();
        if let Some(time) = row.time {
            self.summary.span.get_or_insert((time, time)).1 = time;
        }
        self.pace(|| stamp, row.time, step, false, sink);
        if step != SequenceStep::Next {
            self.irregular(step, stamp, sink);
        }
        sink.row(row);
    }

    /// Compares the receive time of a row with that of the row before.
    #[inline(always)]
    fn pace<R>(
        &mut self,
        stamp: impl Fn() -> Stamp,
        received: Option<Timestamp>,
        step: SequenceStep,
        is_polled: bool,
        sink: &mut impl Sink<R>,
    ) {
        if let Some(Timestamp { t_ns, .. }) = received
            && let Some(last_t_ns) = self.last_t_ns.replace(t_ns)
        {
            let interval_ns = t_ns.saturating_sub(last_t_ns);
            if interval_ns < 0 {
                self.defect(stamp(), DefectKind::TimeBackwards, &[], 0, sink);
            } else if step != SequenceStep::Repeat && !is_polled && !self.last_polled {
                if step == SequenceStep::Next {
                    self.summary.cadence.add(interval_ns);
                }
                if self.largest.is_none_or(|(largest_ns, ..)| interval_ns > largest_ns) {
                    let Stamp { place, input, .. } = stamp();
                    self.largest = Some((interval_ns, place, input));
                }
            }
        }
        self.last_polled = is_polled;
    }

    #[cold]
    fn irregular<R>(&mut self, step: SequenceStep, at: Stamp, sink: &mut impl Sink<R>) {
        match step {
            SequenceStep::First | SequenceStep::Next => {}
            SequenceStep::Repeat => self.summary.repeats += 1,
            SequenceStep::Reset => self.summary.resets += 1,
            SequenceStep::Jump => self.defect(at, DefectKind::SequenceJump, &[], 0, sink),
            SequenceStep::Gap(lost) => {
                self.summary.lost = self.summary.lost.saturating_add(lost);
                if self.summary.gaps.len() < MAX_LISTED_GAPS {
                    let place = place_text(&self.summary.inputs[at.input as usize].0, at.place);
                    self.summary.gaps.push((place, at.time, lost));
                }
                self.defect(at, self.gap_kind.unwrap_or(DefectKind::SequenceGap), &[], lost, sink);
            }
        }
    }

    #[cold]
    pub fn defect<R>(&mut self, at: Stamp, kind: DefectKind, bytes: &[u8], lost: u64, sink: &mut impl Sink<R>) {
        self.count_defects(kind, 1);
        if kind == DefectKind::ReceiverDropped {
            self.summary.dropped += lost;
        }
        let input = self.summary.inputs.get(at.input as usize).map_or("", |(name, _)| name);
        sink.defect(&Defect { input, place: at.place, kind, bytes, time: at.time, lost });
    }

    /// Counts a record of a capture that is no frame.
    pub fn other_record<R>(&mut self, place: RecordPosition, record: &CaptureRecord, sink: &mut impl Sink<R>) {
        let account = &mut self.summary.account;
        match record {
            CaptureRecord::Frame(_) => {}
            CaptureRecord::Line(_) => account.other += 1,
            CaptureRecord::Remote => account.remote += 1,
            CaptureRecord::Fd => account.fd += 1,
            CaptureRecord::Error => account.error += 1,
            CaptureRecord::Remark => account.remarks += 1,
            CaptureRecord::Dropped(count) => {
                account.remarks += 1;
                self.dropped(place, *count, sink);
            }
            CaptureRecord::Broken { bytes, cut } => {
                let kind = if *cut { DefectKind::CutRecord } else { DefectKind::BrokenRecord };
                self.defect(self.stamp(place, None), kind, bytes, 0, sink);
            }
        }
    }

    /// Reports that the receiver lost `count` frames.
    pub fn dropped<R>(&mut self, place: RecordPosition, count: u64, sink: &mut impl Sink<R>) {
        self.defect(self.stamp(place, None), DefectKind::ReceiverDropped, &[], count, sink);
    }

    pub fn count_defects(&mut self, kind: DefectKind, count: u64) {
        if count > 0 {
            *self.summary.account.defects.entry(kind).or_default() += count;
        }
    }

    pub fn finish(&mut self) {
        if let Some((interval_ns, place, input)) = self.largest {
            let place = place_text(&self.summary.inputs[input as usize].0, place);
            self.summary.largest = Some((interval_ns, place));
        }
    }
}
