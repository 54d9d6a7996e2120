//! The operations of a list that can matter in the cells of a block: in all of them at once, so that they are computed by
//! vector instructions.

use super::program::{JoinKind, Leaf, Program};
use super::tree::BLOCK_CELLS;
use crate::bounds::Bounds;
use crate::real::list::{IS_LAST, IS_UNARY, NO_LEAF, ROW_BITS, ROW_MASK, function_of};
use crate::real::{Interval, Vec3};

/// Cells of a block.
const CELLS: usize = BLOCK_CELLS as usize;
/// Distance above which a cell has no surface.
pub(super) const EMPTY_ABOVE: f32 = f32::MIN_POSITIVE;
/// Number of entries of one value from which those that matter in no cell are taken out.
const MAX_DEAD_ENTRIES: usize = 64;
/// Rounding errors of distances and coordinates, as a part of their size.
const ROUNDING: f32 = 1.0 / 65_536.0;
/// Number of levels at which the box of a leaf without a Lipschitz factor is known, each half of the one before.
const LEVELS: u32 = 10;

/// Bounds on the values of a program's leaves and joins, without their formulas.
#[derive(Debug)]
pub struct Pruner {
    leaves: Vec<LeafRange>,
    joins: Vec<JoinRange>,
    /// The program's rows: before each is the index of its leaf or join.
    rows: Vec<u32>,
}

/// How the distance of a leaf can change.
#[derive(Debug)]
enum LeafRange {
    /// At most by this factor of the way.
    Lipschitz(f32),
    /// In any way; outside of the box of a level, distances are above it. The greatest level first.
    Levels(Vec<(f32, Bounds)>),
}

/// How a join's value depends on those that it joins.
#[derive(Clone, Copy, Debug)]
enum JoinRange {
    /// The smooth minimum of two values, with the seam's width.
    Union(f32),
    /// The lesser of two values.
    Least,
    /// A value by a factor.
    Scale(f32),
}

/// The boxes of the cells of a block.
#[derive(Debug)]
pub struct Regions {
    bounds: [Bounds; CELLS],
    half_diagonals: Numbers,
    /// Greatest coordinate of each.
    sizes: Numbers,
}

impl Regions {
    pub(super) fn new(bounds: &[Bounds; CELLS]) -> Self {
        let size = |bounds: Bounds| {
            let corners = [bounds.min, bounds.max].map(|corner| corner.map(f32::abs).max_element());
            corners[0].max(corners[1])
        };
        Self { bounds: *bounds, half_diagonals: bounds.map(|bounds| 0.5 * bounds.diagonal()), sizes: bounds.map(size) }
    }

    /// The centers of the boxes.
    pub(super) fn centers(&self) -> [Vec3<f32>; CELLS] {
        self.bounds.map(|bounds| (bounds.min + bounds.max) * 0.5)
    }
}

/// Numbers of the cells of a block.
type Numbers = [f32; CELLS];

/// Intervals of a value in the cells of a block.
#[derive(Clone, Copy, Debug)]
struct Intervals {
    low: Numbers,
    high: Numbers,
}

/// Values that wait for a join, the last at `count - 1`: where the entries of each begin, and its intervals. Values are
/// computed in their places, because copies of them would cost more.
struct Stack {
    waiting: Vec<(usize, Intervals)>,
    count: usize,
}

impl Stack {
    /// A place for one more value.
    fn push(&mut self, start: usize) -> &mut Intervals {
        if self.count == self.waiting.len() {
            self.waiting.push((0, Intervals { low: [0.0; CELLS], high: [0.0; CELLS] }));
        }
        self.count += 1;
        let (at, value) = &mut self.waiting[self.count - 1];
        *at = start;
        value
    }

    /// The last two values, the second of which is taken away; `None` if there are fewer.
    #[expect(clippy::type_complexity, reason = "two values, each with its start")]
    fn pop(&mut self) -> Option<((usize, &mut Intervals), (usize, &Intervals))> {
        let [.., first, second] = &mut self.waiting[..self.count] else { return None };
        self.count -= 1;
        Some(((first.0, &mut first.1), (second.0, &second.1)))
    }
}

/// A leaf or join that can matter in some cells.
#[derive(Clone, Copy, Debug)]
struct Entry {
    word: u32,
    is_leaf: bool,
    /// A bit for each cell.
    cells: u64,
}

/// A list that is to be pruned in the cells of a block.
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

/// The lists of the cells of a block, and the intervals of their values.
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

    /// Lists of the cells that may have a surface; of the others, nothing.
    pub(super) fn lists(&self) -> [Vec<u32>; CELLS] {
        let near = !cells_where(|cell| self.value.low[cell] > EMPTY_ABOVE);
        let cells_of = |entry: &Entry| {
            let rest = |cells: &u64| Some(cells & (cells - 1)).filter(|rest| *rest != 0);
            let first = Some(entry.cells & near).filter(|cells| *cells != 0);
            std::iter::successors(first, rest).map(|cells| cells.trailing_zeros() as usize)
        };
        let mut lengths = [0; CELLS];
        for entry in &self.entries {
            cells_of(entry).for_each(|cell| lengths[cell] += 2);
        }
        let mut lists = lengths.map(Vec::<u32>::with_capacity);
        for entry in &self.entries {
            for cell in cells_of(entry) {
                let list = &mut lists[cell];
                match list.last_mut() {
                    _ if entry.is_leaf => list.extend([entry.word, 0]),
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
#[inline(always)]
fn cells_where(is: impl Fn(usize) -> bool) -> u64 {
    // Halves of 32 bits become vector instructions.
    let half =
        |first: usize| (0..CELLS / 2).fold(0_u32, |bits, index| bits | if is(first + index) { 1 << index } else { 0 });
    u64::from(half(0)) | u64::from(half(CELLS / 2)) << 32
}

impl LeafRange {
    fn new(leaf: &Leaf<'_>) -> Self {
        if let Some(factor) = leaf.lipschitz() {
            return Self::Lipschitz(factor);
        }
        let bounds = leaf.bounds();
        let size = if bounds.is_finite() { bounds.diagonal() } else { 1.0 };
        let levels = (0..LEVELS).map(|halvings| size * 4.0 / (1_u32 << halvings) as f32);
        Self::Levels(levels.map(|level| (level, leaf.bounds_of(level))).collect())
    }

    /// Intervals that contain every distance in the cells, given those at their centers.
    #[inline(always)]
    fn intervals(&self, regions: &Regions, at_centers: &Numbers, Intervals { low, high }: &mut Intervals) {
        match self {
            Self::Lipschitz(factor) => {
                for cell in 0..CELLS {
                    let distance = at_centers[cell];
                    let change =
                        factor * regions.half_diagonals[cell] + ROUNDING * (regions.sizes[cell] + distance.abs());
                    low[cell] = distance - change;
                    high[cell] = distance + change;
                }
            }
            Self::Levels(levels) => {
                *high = [f32::INFINITY; CELLS];
                for (low, region) in low.iter_mut().zip(&regions.bounds) {
                    let is_outside = |bounds: Bounds| bounds.with_margin(region.min).gap(*region) > 0.0;
                    let level = levels.iter().find(|(_, bounds)| is_outside(*bounds)).map(|(level, _)| *level);
                    *low = level.unwrap_or(f32::NEG_INFINITY);
                }
            }
        }
    }
}

impl JoinRange {
    fn new(kind: &JoinKind) -> Self {
        match kind {
            JoinKind::Union(smooth) if smooth.get() > 0.0 => Self::Union(smooth.get()),
            JoinKind::Union(_) | JoinKind::Objects => Self::Least,
            JoinKind::Scale(by) => Self::Scale(*by),
        }
    }

    /// Width within which two values change each other.
    fn width(self) -> f32 {
        match self {
            Self::Union(width) => width,
            Self::Least | Self::Scale(_) => 0.0,
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
        Self {
            leaves: program.leaves().iter().map(LeafRange::new).collect(),
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
        let Self { pruner, list, leaves, regions, distances } = *self;
        let (mut entries, mut stack) = (Vec::new(), Stack { waiting: Vec::new(), count: 0 });
        let mut known = leaves.iter().zip(distances.as_chunks::<CELLS>().0);
        for operation in list.chunks_exact(2) {
            let &[leaf, join] = operation else { continue };
            if function_of(leaf) != NO_LEAF
                && let Some((&index, at_centers)) = known.next()
            {
                pruner.leaves[index as usize].intervals(regions, at_centers, stack.push(entries.len()));
                entries.push(Entry { word: leaf & !IS_LAST, is_leaf: true, cells: u64::MAX });
            }
            if join != 0 {
                let kind = pruner.joins[pruner.rows[(join & ROW_MASK) as usize - 1] as usize];
                join_values(kind, join, &mut stack, &mut entries);
            }
        }
        let unknown = Intervals { low: [f32::NEG_INFINITY; CELLS], high: [f32::INFINITY; CELLS] };
        Pruned { entries, value: stack.waiting.first().map_or(unknown, |(_, value)| *value) }
    }
}

/// Joins the last value that waits with the one before, or applies a join of one value to it.
#[inline(always)]
fn join_values(kind: JoinRange, word: u32, stack: &mut Stack, entries: &mut Vec<Entry>) {
    if let JoinRange::Scale(_) = kind {
        entries.push(Entry { word, is_leaf: false, cells: u64::MAX });
        if let Some((_, value)) = stack.waiting[..stack.count].last_mut() {
            for cell in 0..CELLS {
                let all = [value.low[cell], value.high[cell]];
                [value.low[cell], value.high[cell]] = kind.apply(all, all);
            }
        }
        return;
    }
    let Some(((start, a), (middle, b))) = stack.pop() else { return };
    let width = kind.width();
    let is_inert = cells_where(|cell| b.low[cell] - a.high[cell] >= width);
    if is_inert == u64::MAX {
        return entries.truncate(middle);
    }
    // Of equal values, the first is taken.
    let replaces = cells_where(|cell| a.low[cell] - b.high[cell] >= width && a.low[cell] > b.high[cell]) & !is_inert;
    if is_inert != 0 {
        entries[middle..].iter_mut().for_each(|entry| entry.cells &= !is_inert);
    }
    if replaces != 0 {
        entries[start..middle].iter_mut().for_each(|entry| entry.cells &= !replaces);
    }
    entries.push(Entry { word, is_leaf: false, cells: !(is_inert | replaces) });
    match kind {
        JoinRange::Union(_) => join_intervals(kind, a, b),
        JoinRange::Least | JoinRange::Scale(_) => join_intervals(JoinRange::Least, a, b),
    }
    if entries.len() - start > MAX_DEAD_ENTRIES {
        let mut kept = start;
        for index in start..entries.len() {
            if entries[index].cells != 0 {
                entries[kept] = entries[index];
                kept += 1;
            }
        }
        entries.truncate(kept);
    }
}

/// Replaces `a` by the join with `b`; where one can't change the other, by that.
#[inline(always)]
fn join_intervals(kind: JoinRange, a: &mut Intervals, b: &Intervals) {
    let width = kind.width();
    for cell in 0..CELLS {
        let (first, second) = ([a.low[cell], a.high[cell]], [b.low[cell], b.high[cell]]);
        let is_inert = second[0] - first[1] >= width;
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
