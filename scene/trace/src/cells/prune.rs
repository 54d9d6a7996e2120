//! The operations of a list that can matter in the cells of a slab: in all of them at once, so that they are computed by
//! vector instructions.
//!
//! First the intervals of all values are found, from the leaves up. Then each value gets a *cutoff*, from the last join
//! down: where the value is at least that, it changes nothing, and neither does anything else that is at least that in
//! its place. A join of `a` and `b` with a seam of width w, itself with cutoff c, gives `b` the least of these cutoffs:
//!
//! * the greatest `a`, plus w: then the join is `a`;
//! * c, if the least `a` is at least c + w: then the join is at least c;
//! * c + w: the join is `a`, or else `a` is above c, and so is the join.
//!
//! `a` gets the same from `b`, but c where `b` is left out by the first rule, because `a` is the join there. Because each
//! of these holds for a value and for what takes its place, all values that reach their cutoffs can be left out together.
//!
//! A cell's list is the same whichever cells are pruned together with it. On a GPU, `cells.cu` finds the same lists.

use std::collections::HashMap;

use super::program::{JoinKind, Leaf, MAX_STACK, Program};
use super::tree::BLOCK_CELLS;
use crate::bounds::Bounds;
use crate::real::Interval;
use crate::real::list::{IS_LAST, IS_UNARY, NO_LEAF, ROW_BITS, ROW_MASK, function_of};

/// Cells of a slab: a quarter of a block.
pub const SLAB_CELLS: usize = 16;
/// Slabs of a block.
pub const SLABS: usize = BLOCK_CELLS as usize / SLAB_CELLS;
/// Distance above which a cell has no surface.
pub(super) const EMPTY_ABOVE: f32 = f32::MIN_POSITIVE;
/// Rounding errors of distances and coordinates, as a part of their size.
pub const ROUNDING: f32 = 1.0 / 65_536.0;
/// Number of levels at which the box of a leaf without a Lipschitz factor is known, each half of the one before.
pub(super) const LEVELS: u32 = 10;

/// Bounds on the values of a program's leaves and joins, without their formulas.
#[derive(Debug)]
pub struct Pruner {
    /// Lipschitz factor of each leaf; infinite for those that have `levels`. In memory of its own, because it is read
    /// for every leaf of every list.
    pub(super) factors: Vec<f32>,
    /// Of leaves whose distance can change in any way: outside of the box of a level, distances are above it. The greatest
    /// level first.
    pub(super) levels: HashMap<u32, Vec<(f32, Bounds)>>,
    pub(super) joins: Vec<JoinRange>,
    /// The program's rows: before each is the index of its leaf or join.
    rows: Vec<u32>,
}

/// How a join's value depends on those that it joins.
#[derive(Clone, Copy, Debug)]
pub(super) enum JoinRange {
    /// The smooth minimum of two values, with the seam's width.
    Union(f32),
    /// The lesser of two values.
    Least,
    /// A value by a factor.
    Scale(f32),
}

/// The boxes of the cells of a slab.
#[derive(Debug)]
pub struct Regions {
    bounds: [Bounds; SLAB_CELLS],
    half_diagonals: Numbers,
    /// Greatest coordinate of each.
    sizes: Numbers,
}

impl Regions {
    pub(super) fn new(bounds: &[Bounds; SLAB_CELLS]) -> Self {
        let size = |bounds: Bounds| {
            let corners = [bounds.min, bounds.max].map(|corner| corner.map(f32::abs).max_element());
            corners[0].max(corners[1])
        };
        Self { bounds: *bounds, half_diagonals: bounds.map(|bounds| 0.5 * bounds.diagonal()), sizes: bounds.map(size) }
    }
}

/// Numbers of the cells of a slab.
type Numbers = [f32; SLAB_CELLS];
/// Some of the cells of a slab: a bit for each.
type Mask = u16;

/// Intervals of a value in the cells of a slab. They are aligned to vectors, because reading across two recent writes
/// makes a processor wait.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Intervals {
    low: Numbers,
    high: Numbers,
}

/// A leaf or join of a list, with the cells in which it can matter.
#[derive(Clone, Copy, Debug)]
struct Entry {
    word: u32,
    of: EntryKind,
    cells: Mask,
}

/// Kind of an entry.
#[derive(Clone, Copy, Debug)]
enum EntryKind {
    /// A leaf.
    Leaf,
    /// A value by a factor.
    Scale(f32),
    /// A join of two values with a seam of this width: the entry with the second value is before it, that with the first
    /// has this index. The intervals of both have the other index.
    Join { width: f32, first: u32, operands: u32 },
}

/// Maximum number of values that wait: with that of a leaf which is joined at once.
const MAX_WAITING: usize = MAX_STACK + 1;

impl Intervals {
    const UNKNOWN: Self = Self { low: [f32::NEG_INFINITY; SLAB_CELLS], high: [f32::INFINITY; SLAB_CELLS] };
}

/// Values that wait for a join. They are in memory of a known size, so that each is written where it stays.
struct Waiting {
    values: [Intervals; MAX_WAITING],
    /// Of each, the indices of its first entry, and of the first operands after the earlier values' operands.
    firsts: [(usize, usize); MAX_WAITING],
    count: usize,
}

impl Waiting {
    /// Adds a value, which is to be set.
    #[inline(always)]
    fn push(&mut self, firsts: (usize, usize)) -> Option<&mut Intervals> {
        *self.firsts.get_mut(self.count)? = firsts;
        self.count += 1;
        self.values.get_mut(self.count - 1)
    }

    /// The values.
    #[inline(always)]
    fn values(&mut self) -> &mut [Intervals] {
        self.values.get_mut(..self.count).unwrap_or_default()
    }
}

/// A list that is to be pruned in the cells of a slab.
#[derive(Clone, Copy, Debug)]
pub struct Unpruned<'a> {
    pub(super) pruner: &'a Pruner,
    pub(super) list: &'a [u32],
    /// Indices of the list's leaves.
    pub(super) leaves: &'a [u32],
    pub(super) regions: &'a Regions,
    /// Distances of the leaves at the cells' centers, one leaf after another.
    pub(super) distances: &'a [f32],
}

/// The lists of the cells of a slab, and the intervals of their values.
#[derive(Debug)]
pub struct Pruned {
    entries: Vec<Entry>,
    value: Intervals,
}

impl Pruned {
    /// Interval of the value in a cell.
    pub(super) fn value(&self, cell: usize) -> Interval {
        Interval::new(self.value.low[cell], self.value.high[cell])
    }

    /// Words of the leaves and joins that can matter in a cell, whether it may have a surface or not.
    pub(super) fn words(&self, cell: usize) -> impl Iterator<Item = (bool, u32)> + '_ {
        let of_cell = self.entries.iter().filter(move |entry| entry.cells & (1 << cell) != 0);
        of_cell.map(|entry| (matches!(entry.of, EntryKind::Leaf), entry.word))
    }

    /// Lists of the cells that may have a surface; of the others, nothing.
    pub(super) fn lists(&self) -> [Vec<u32>; SLAB_CELLS] {
        let near = !cells_where(|cell| self.value.low[cell] > EMPTY_ABOVE);
        let cells_of = |entry: &Entry| {
            let rest = |cells: &Mask| Some(cells & (cells - 1)).filter(|rest| *rest != 0);
            let first = Some(entry.cells & near).filter(|cells| *cells != 0);
            std::iter::successors(first, rest).map(|cells| cells.trailing_zeros() as usize)
        };
        let mut lengths = [0; SLAB_CELLS];
        for entry in &self.entries {
            cells_of(entry).for_each(|cell| lengths[cell] += 2);
        }
        let mut lists = lengths.map(Vec::<u32>::with_capacity);
        for entry in &self.entries {
            for cell in cells_of(entry) {
                let list = &mut lists[cell];
                match list.last_mut() {
                    _ if matches!(entry.of, EntryKind::Leaf) => list.extend([entry.word, 0]),
                    // A leaf that nothing has joined yet is the second value alone.
                    Some(join) if *join == 0 && entry.word & IS_UNARY == 0 => *join = entry.word,
                    _ => list.extend([NO_LEAF << ROW_BITS, entry.word]),
                }
            }
        }
        for list in &mut lists {
            if let Some(last) = list.len().checked_sub(2) {
                list[last] |= IS_LAST;
            }
        }
        lists
    }
}

/// The cells in which `is` holds, as bits.
// Two loops over words of 32 bits each become vector instructions; one with a sum does not.
#[inline(always)]
fn cells_where(is: impl Fn(usize) -> bool) -> Mask {
    let mut bits = [0_u32; SLAB_CELLS];
    for (cell, bit) in bits.iter_mut().enumerate() {
        *bit = if is(cell) { 1 << cell } else { 0 };
    }
    bits.iter().fold(0, |all, bit| all | bit) as Mask
}

/// A number for each cell. Unlike `std::array::from_fn`, it is part of the function that calls it.
#[inline(always)]
fn numbers(of: impl Fn(usize) -> f32) -> Numbers {
    let mut numbers = [0.0; SLAB_CELLS];
    for (cell, number) in numbers.iter_mut().enumerate() {
        *number = of(cell);
    }
    numbers
}

/// Boxes of levels around a leaf without a Lipschitz factor.
fn levels(leaf: &Leaf<'_>) -> Vec<(f32, Bounds)> {
    let bounds = leaf.bounds();
    let size = if bounds.is_finite() { bounds.diagonal() } else { 1.0 };
    let levels = (0..LEVELS).map(|halvings| size * 4.0 / (1_u32 << halvings) as f32);
    levels.map(|level| (level, leaf.bounds_of(level))).collect()
}

/// Sets intervals to those that contain every distance of a leaf with a Lipschitz factor in the cells, given those at
/// their centers.
#[inline(always)]
fn set_by_factor(intervals: &mut Intervals, factor: f32, regions: &Regions, at_centers: &Numbers) {
    for (cell, at_center) in at_centers.iter().enumerate() {
        let change = factor * regions.half_diagonals[cell] + ROUNDING * (regions.sizes[cell] + at_center.abs());
        intervals.low[cell] = at_center - change;
        intervals.high[cell] = at_center + change;
    }
}

/// Intervals of a leaf with these levels.
fn level_intervals(levels: &[(f32, Bounds)], regions: &Regions) -> Intervals {
    let low = regions.bounds.map(|region| {
        let is_outside = |bounds: Bounds| bounds.with_margin(region.min).gap(region) > 0.0;
        levels.iter().find(|(_, bounds)| is_outside(*bounds)).map_or(f32::NEG_INFINITY, |(level, _)| *level)
    });
    Intervals { low, high: [f32::INFINITY; SLAB_CELLS] }
}

impl JoinRange {
    fn new(kind: &JoinKind) -> Self {
        match kind {
            JoinKind::Union(smooth) if smooth.in_frame() > 0.0 => Self::Union(smooth.in_frame()),
            JoinKind::Union(_) | JoinKind::Objects => Self::Least,
            JoinKind::Scale(by) => Self::Scale(*by),
        }
    }

    /// All values of the join of two values in two intervals: it grows with either value, but for rounding.
    #[inline(always)]
    fn apply(self, a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
        match self {
            Self::Least => [a[0].min(b[0]), a[1].min(b[1])],
            Self::Scale(by) => {
                let ends = [b[0] * by, b[1] * by];
                [ends[0].min(ends[1]), ends[0].max(ends[1])]
            }
            Self::Union(width) => {
                let joined = |a: f32, b: f32, side: f32| {
                    let overlap = (width - (a - b).abs()).max(0.0);
                    let slack = 8.0 * f32::EPSILON * (a.abs() + b.abs() + width);
                    a.min(b) - overlap * overlap * (0.25 / width) + side * slack
                };
                [joined(a[0], b[0], -1.0), joined(a[1], b[1], 1.0)]
            }
        }
    }
}

impl Pruner {
    pub(super) fn new(program: &Program<'_>) -> Self {
        let with_levels = program.leaves().iter().enumerate().filter(|(_, leaf)| leaf.lipschitz().is_none());
        Self {
            factors: program.leaves().iter().map(|leaf| leaf.lipschitz().unwrap_or(f32::INFINITY)).collect(),
            levels: with_levels.map(|(index, leaf)| (index as u32, levels(leaf))).collect(),
            joins: program.joins().map(JoinRange::new).collect(),
            rows: program.rows().to_vec(),
        }
    }

    /// Indices of a list's leaves.
    pub(super) fn leaves<'a>(&'a self, list: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
        let leaves = list.iter().step_by(2).filter(|word| function_of(**word) != NO_LEAF);
        leaves.map(|word| self.rows[(word & ROW_MASK) as usize - 1])
    }
}

impl Unpruned<'_> {
    /// Finds the operations of the list that can matter in each cell, and the intervals of their values. It is compiled
    /// for the vector instructions of the function that calls it, as are all functions that it calls.
    #[inline(always)]
    pub fn prune(&self) -> Pruned {
        let operations = self.list.len() / 2;
        let (mut entries, mut operands) = (Vec::with_capacity(2 * operations), Vec::with_capacity(operations));
        let value = self.values(&mut entries, &mut operands);
        cut_off(&mut entries, &operands);
        keep_joins(&mut entries);
        Pruned { entries, value }
    }

    /// Intervals of the list's value. Appends the entries that can matter, but for cutoffs, and the operands of joins.
    #[inline(always)]
    fn values(&self, entries: &mut Vec<Entry>, operands: &mut Vec<[Intervals; 2]>) -> Intervals {
        let Self { pruner, list, leaves, regions, distances } = *self;
        let mut waiting =
            Waiting { values: [Intervals::UNKNOWN; MAX_WAITING], firsts: [(0, 0); MAX_WAITING], count: 0 };
        let mut known = leaves.iter().zip(distances.as_chunks::<SLAB_CELLS>().0);
        for operation in list.chunks_exact(2) {
            let &[leaf, join] = operation else { continue };
            if function_of(leaf) != NO_LEAF
                && let Some((&index, at_centers)) = known.next()
            {
                let factor = pruner.factors[index as usize];
                let Some(value) = waiting.push((entries.len(), operands.len())) else { continue };
                if factor < f32::INFINITY {
                    set_by_factor(value, factor, regions, at_centers);
                } else {
                    let levels = pruner.levels.get(&index);
                    *value = levels.map_or(Intervals::UNKNOWN, |levels| level_intervals(levels, regions));
                }
                entries.push(Entry { word: leaf & !IS_LAST, of: EntryKind::Leaf, cells: 0 });
            }
            if join == 0 {
                continue;
            }
            let width = match pruner.joins[pruner.rows[(join & ROW_MASK) as usize - 1] as usize] {
                JoinRange::Union(width) => width,
                JoinRange::Least => 0.0,
                kind @ JoinRange::Scale(by) => {
                    entries.push(Entry { word: join, of: EntryKind::Scale(by), cells: 0 });
                    if let Some(value) = waiting.values().last_mut() {
                        for cell in 0..SLAB_CELLS {
                            let all = [value.low[cell], value.high[cell]];
                            [value.low[cell], value.high[cell]] = kind.apply(all, all);
                        }
                    }
                    continue;
                }
            };
            let Some(&(first_entry, first_operands)) = waiting.firsts.get(waiting.count.wrapping_sub(1)) else {
                continue;
            };
            let [.., a, b] = waiting.values() else { continue };
            if cells_where(|cell| b.low[cell] >= beyond(a.high[cell], width)) == Mask::MAX {
                entries.truncate(first_entry);
                operands.truncate(first_operands);
            } else {
                let of = EntryKind::Join { width, first: first_entry as u32 - 1, operands: operands.len() as u32 };
                operands.push([*a, *b]);
                entries.push(Entry { word: join, of, cells: 0 });
                if width > 0.0 {
                    join_intervals(JoinRange::Union(width), a, b);
                } else {
                    join_intervals(JoinRange::Least, a, b);
                }
            }
            waiting.count -= 1;
        }
        waiting.values().first().copied().unwrap_or(Intervals::UNKNOWN)
    }
}

/// Sets the cells of leaves and factors whose values do not reach their cutoffs.
#[inline(always)]
fn cut_off(entries: &mut [Entry], operands: &[[Intervals; 2]]) {
    let Some(last) = entries.len().checked_sub(1) else { return };
    let mut open: Vec<(usize, Mask, Numbers)> = vec![(last, Mask::MAX, [f32::INFINITY; SLAB_CELLS])];
    while let Some((index, cells, cutoff)) = open.pop() {
        entries[index].cells = cells;
        match entries[index].of {
            EntryKind::Leaf => {}
            EntryKind::Scale(by) => open.push((index - 1, cells, numbers(|cell| unscaled(cutoff[cell], by)))),
            EntryKind::Join { width, first, operands: at } => {
                let [a, b] = &operands[at as usize];
                let of = |value: &Intervals, other: &Intervals| {
                    numbers(|cell| {
                        let of_other = [other.low[cell], other.high[cell]];
                        if other.low[cell] >= beyond(value.high[cell], width) {
                            cutoff[cell]
                        } else {
                            cutoff_of(cutoff[cell], of_other, width)
                        }
                    })
                };
                let (of_a, of_b) = (of(a, b), of(b, a));
                let matters =
                    |value: &Intervals, cutoff: &Numbers| cells & !cells_where(|cell| value.low[cell] >= cutoff[cell]);
                for (index, cells, cutoff) in
                    [(first as usize, matters(a, &of_a), of_a), (index - 1, matters(b, &of_b), of_b)]
                {
                    if cells != 0 {
                        open.push((index, cells, cutoff));
                    }
                }
            }
        }
    }
}

/// A value plus the width of a seam; rounded up.
#[inline(always)]
fn beyond(value: f32, width: f32) -> f32 {
    value + width + (32.0 * f32::EPSILON * (value.abs() + width) + f32::MIN_POSITIVE)
}

/// Cutoff of a value whose join, with this cutoff, has another operand in an interval; rounded up.
#[inline(always)]
fn cutoff_of(of_join: f32, [low, high]: [f32; 2], width: f32) -> f32 {
    let apart = beyond(of_join, width);
    let through_join = if low >= apart { beyond(of_join, 0.0) } else { apart };
    through_join.min(beyond(high, width))
}

/// Cutoff of a value with one times a factor; rounded up.
#[inline(always)]
fn unscaled(cutoff: f32, by: f32) -> f32 {
    let least = cutoff / by;
    if by > 0.0 { least + 4.0 * f32::EPSILON * least.abs() + f32::MIN_POSITIVE } else { f32::INFINITY }
}

/// Takes from joins and factors the cells in which an operand is left out.
fn keep_joins(entries: &mut [Entry]) {
    let mut waiting: Vec<Mask> = Vec::new();
    for entry in entries {
        match entry.of {
            EntryKind::Leaf => waiting.push(entry.cells),
            EntryKind::Scale(_) => entry.cells = waiting.last().copied().unwrap_or(0),
            EntryKind::Join { .. } => {
                let [.., a, b] = &mut waiting[..] else { continue };
                entry.cells = *a & *b;
                *a |= *b;
                waiting.pop();
            }
        }
    }
}

/// Replaces `a` by the join with `b`; where one can't change the other, by that.
#[inline(always)]
fn join_intervals(kind: JoinRange, a: &mut Intervals, b: &Intervals) {
    let width = if let JoinRange::Union(width) = kind { width } else { 0.0 };
    for cell in 0..SLAB_CELLS {
        let (first, second) = ([a.low[cell], a.high[cell]], [b.low[cell], b.high[cell]]);
        let is_inert = second[0] - first[1] >= width;
        // Of equal values, the first is taken.
        let replaces = first[0] - second[1] >= width && first[0] > second[1];
        let joined = kind.apply(first, second);
        let choose = |a: f32, b: f32, joined: f32| {
            if is_inert {
                a
            } else if replaces {
                b
            } else {
                joined
            }
        };
        a.low[cell] = choose(first[0], second[0], joined[0]);
        a.high[cell] = choose(first[1], second[1], joined[1]);
    }
}
