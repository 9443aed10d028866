//! Nodes in blocks of ten, and the blocks that are not usable.

use geu_calibration::{AccumulatedCounts, BreakKind, Discontinuity};

use super::{CHANNELS, TIMING};

/// Nodes averaged into one block, of the default unit 5 s. Rounding and the limit cycle average out; a missing effect changes an angle over
/// minutes.
pub const BLOCK: usize = 10;
/// Ten nodes of one channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// True if its nodes are usable.
    pub is_good: bool,
    /// True if, in addition, the reference has a row in it.
    pub is_compared: bool,
    /// True if the sum restarts in it or before it: the counts of a break are unknown.
    pub restarts: bool,
    /// True if a further trial begins in it: the drift is another one.
    pub begins_trial: bool,
}

impl Block {
    pub const COMPARED: Block = Block { is_good: true, is_compared: true, restarts: false, begins_trial: false };
    pub const BROKEN: Block = Block { is_good: false, is_compared: false, restarts: true, begins_trial: false };
}

/// Nodes of a block: node 0 is the start.
pub fn nodes(block: usize) -> std::ops::Range<usize> {
    1 + block * BLOCK..1 + (block + 1) * BLOCK
}

/// Leaves blocks without a row of the reference out of the comparison; empty, each has one.
pub fn leave_out_without_rows(has_rows: &[bool], blocks: &mut [Vec<Block>; CHANNELS]) {
    for channel in &mut blocks[..TIMING] {
        channel.iter_mut().zip(has_rows).for_each(|(block, has_row)| block.is_compared &= has_row);
    }
}

/// Leaves out the blocks of each channel that contain a break.
pub fn leave_out(breaks: &[Discontinuity], blocks: &mut [Vec<Block>; CHANNELS]) {
    for found in breaks {
        let moves_times = matches!(found.kind, BreakKind::TimeJump | BreakKind::Jump | BreakKind::Reset);
        let last = found.to.saturating_sub(1) / BLOCK;
        for (index, channel) in blocks.iter_mut().enumerate() {
            let is_affected = if index == TIMING { moves_times } else { found.gyros[index] };
            for block in channel.iter_mut().take(last + 1).skip(found.from / BLOCK).filter(|_| is_affected) {
                *block = Block::BROKEN;
            }
        }
    }
}

/// The blocks of each channel up to the end of the reference. Usable are, of the times, blocks with a receive time, of the gyros, blocks of
/// which the reference covers all nodes.
pub fn covered_blocks(
    counts: &AccumulatedCounts,
    samples: usize,
    late: &[f64],
    is_covered: impl Fn(usize) -> bool,
) -> [Vec<Block>; CHANNELS] {
    let heads = counts.gyros.heads();
    let block = |channel: usize, number: usize| match channel {
        TIMING => {
            let is_good = nodes(number).any(|node| !late[node].is_nan());
            Block { is_good, is_compared: is_good, ..Block::COMPARED }
        }
        _ if nodes(number).all(&is_covered) => Block::COMPARED,
        _ => Block::BROKEN,
    };
    std::array::from_fn(|channel| {
        let count = if channel < heads || channel == TIMING { samples / BLOCK } else { 0 };
        (0..count).map(|number| block(channel, number)).collect()
    })
}

/// Number of the block at an instant, s since node 0; the first one before it.
pub fn block_at(counts: &AccumulatedCounts, t_s: f64) -> usize {
    counts.node_s.partition_point(|&node_s| node_s <= t_s).saturating_sub(1) / BLOCK
}

/// Marks the blocks in which further trials begin, s since node 0.
pub fn begin_trials(
    counts: &AccumulatedCounts,
    starts_s: impl Iterator<Item = f64>,
    blocks: &mut [Vec<Block>; CHANNELS],
) {
    for start_s in starts_s {
        let number = block_at(counts, start_s);
        blocks[..TIMING].iter_mut().filter_map(|own| own.get_mut(number)).for_each(|own| own.begins_trial = true);
    }
}
