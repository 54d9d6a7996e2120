//! The tree of cells, and the list of operations that can matter in each.
//!
//! A cell is a cube. It is divided into 4 × 4 × 4 as long as its list is long and it may contain a surface.

use std::collections::HashMap;

use super::program::{Join, Operation, Program};
use crate::bounds::Bounds;
use crate::real::{Interval, Table, Vec3, vec3};

/// Edge of a block, in cells.
pub(super) const BLOCK_EDGE: u32 = 4;
/// Cells of a block.
const BLOCK_CELLS: u32 = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;
/// Maximum depth of the tree: coordinates of cells are exact in `f32`.
pub(super) const MAX_LEVELS: u32 = 10;
/// Number of leaves in a list up to which a cell is not divided.
const SHORT_LIST: usize = 4;
/// The same for scenes of more than [`MANY_LEAVES`].
const SHORT_LIST_OF_MANY: usize = 8;
const MANY_LEAVES: usize = 50_000;

/// Bit of a cell's word that tells that it is divided; the others are the index of its block or record.
pub(super) const IS_BLOCK: u32 = 1 << 31;
/// Bit of an operation's first word that tells that it is the list's last.
pub(super) const IS_LAST: u32 = 1 << 31;
/// Bits of an operation's words that are the index of a row.
pub(super) const ROW_BITS: u32 = 25;
/// Family of an operation that takes the last value that waits.
pub(super) const NO_LEAF: u32 = 63;
/// Index of the word of the outermost cell.
const ROOT: usize = 0;
/// Index of the word of all points outside.
pub(super) const OUTSIDE: u32 = 1;

/// The cells of a scene, with their lists and rows, as one table of words.
///
/// The first two words are those of the outermost cell and of all points outside. A cell's word is the index of its
/// block, with a flag, or of its record. A block is the words of 64 cells, x fastest. A record is a lower bound of the
/// distance in the cell, 0 if there may be a surface, and the index of its list. A list is two words for each operation:
/// family and row of its leaf, then of its join.
#[derive(Clone, Debug)]
pub struct CellTree {
    /// Center of the outermost cell.
    pub(super) center: Vec3<f32>,
    /// Edge of the smallest cells, a power of two.
    pub(super) unit: f32,
    /// Depth of the tree.
    pub(super) levels: u32,
    pub(super) words: Table,
    /// First word of each leaf's row, in the order of leaves.
    leaf_rows: Vec<u32>,
    join_rows: Vec<u32>,
}

/// A cell while the tree is built.
struct Cell {
    /// Coordinates in units.
    at: [u32; 3],
    level: u32,
}

struct Builder<'a, 'b> {
    program: &'b Program<'a>,
    tree: CellTree,
    words: Vec<u32>,
    /// Lists that exist already.
    lists: HashMap<Vec<Operation>, u32>,
    short_list: usize,
}

impl CellTree {
    /// Builds the cells of a program. `reach` contains every point at which it will be evaluated.
    pub(super) fn new(program: &Program<'_>, reach: Bounds) -> Self {
        let (center, unit, levels) = extent(program, reach);
        let (leaf_rows, join_rows) = (Vec::new(), Vec::new());
        let tree = Self { center, unit, levels, words: Table::default(), leaf_rows, join_rows };
        let short_list = if program.leaf_count() > MANY_LEAVES { SHORT_LIST_OF_MANY } else { SHORT_LIST };
        let mut builder = Builder { program, tree, words: vec![0; 2], lists: HashMap::new(), short_list };
        builder.rows();
        let outside = builder.record(0.0, program.operations());
        builder.words[OUTSIDE as usize] = outside;
        let root = builder.cell(&Cell { at: [0; 3], level: 0 }, program.operations());
        builder.words[ROOT] = root;
        builder.tree.words = builder.words.into();
        builder.tree
    }

    /// The table.
    pub fn words(&self) -> &Table {
        &self.words
    }

    /// The leaf whose row begins at a word.
    pub(super) fn leaf_of_row(&self, row: u32) -> usize {
        self.leaf_rows.binary_search(&row).expect("a row begins there")
    }

    /// The join whose row begins at a word.
    pub(super) fn join_of_row(&self, row: u32) -> usize {
        self.join_rows.binary_search(&row).expect("a row begins there")
    }

    /// The box of all points whose cell this is, and of some more, because of rounding.
    fn bounds(&self, cell: &Cell) -> Bounds {
        let half = 0.5 * (BLOCK_EDGE.pow(self.levels) as f32);
        let size = BLOCK_EDGE.pow(self.levels - cell.level) as f32;
        let side = |at: u32, center: f32| {
            let (low, high) = (at as f32 - half, at as f32 - half + size);
            let (low, high) = (low * self.unit + center, high * self.unit + center);
            let margin = 4.0 * f32::EPSILON * (low.abs().max(high.abs()) + center.abs());
            (low - margin, high + margin)
        };
        let [x, y, z] = cell.at;
        let (x, y, z) = (side(x, self.center.x), side(y, self.center.y), side(z, self.center.z));
        Bounds { min: vec3(x.0, y.0, z.0), max: vec3(x.1, y.1, z.1) }
    }
}

/// Center, smallest edge and depth of a tree that contains `reach`, and whose inner part contains all finite shapes
/// with cells that are small enough.
fn extent(program: &Program<'_>, reach: Bounds) -> (Vec3<f32>, f32, u32) {
    let finite = program.leaves().iter().map(super::program::Leaf::bounds).filter(|bounds| bounds.is_finite());
    let inner =
        finite.reduce(Bounds::union).unwrap_or(Bounds { min: vec3(-1.0, -1.0, -1.0), max: vec3(1.0, 1.0, 1.0) });
    let center = (inner.min + inner.max) * 0.5;
    let size = (inner.max - inner.min).max_element().clamp(1e-4, 1e6);
    // A power of two, so that coordinates in units are exact.
    let mut edge = 2.0_f32.powi(-20);
    while edge < size {
        edge *= 2.0;
    }
    let inner_levels: u32 = match program.leaf_count() {
        0..=64 => 3,
        65..=2_000 => 4,
        _ => 5,
    };
    let unit = edge / BLOCK_EDGE.pow(inner_levels) as f32;
    let far = |low: f32, high: f32, center: f32| (center - low).max(high - center);
    let distance = far(reach.min.x, reach.max.x, center.x).max(far(reach.min.y, reach.max.y, center.y)).max(far(
        reach.min.z,
        reach.max.z,
        center.z,
    ));
    let mut levels = inner_levels;
    let mut half = 0.5 * edge;
    while half < distance && levels < MAX_LEVELS {
        half *= BLOCK_EDGE as f32;
        levels += 1;
    }
    (center, unit, levels)
}

impl Builder<'_, '_> {
    fn rows(&mut self) {
        let words = &mut self.words;
        let mut row = |numbers: &[u32]| {
            let start = words.len() as u32;
            words.extend(numbers);
            // No two rows begin at one place.
            if numbers.is_empty() {
                words.push(0);
            }
            start
        };
        self.tree.leaf_rows = self.program.leaves().iter().map(|leaf| row(&leaf.numbers)).collect();
        self.tree.join_rows = self.program.joins().iter().map(|join| row(&join.numbers)).collect();
    }

    /// Word of a cell whose parent has this list.
    fn cell(&mut self, cell: &Cell, of_parent: &[Operation]) -> u32 {
        let bounds = self.tree.bounds(cell);
        let (list, value) = prune(self.program, of_parent, bounds);
        let leaves = list.iter().filter(|operation| operation.leaf.is_some()).count();
        let bound = value.low.max(0.0);
        if bound > 0.0 || leaves <= self.short_list || cell.level == self.tree.levels {
            return self.record(bound, &list);
        }
        let block = self.words.len();
        self.words.resize(block + BLOCK_CELLS as usize, 0);
        let size = BLOCK_EDGE.pow(self.tree.levels - cell.level - 1);
        for child in 0..BLOCK_CELLS {
            let steps = [child % BLOCK_EDGE, child / BLOCK_EDGE % BLOCK_EDGE, child / (BLOCK_EDGE * BLOCK_EDGE)];
            let at = std::array::from_fn(|axis| cell.at[axis] + steps[axis] * size);
            let word = self.cell(&Cell { at, level: cell.level + 1 }, &list);
            self.words[block + child as usize] = word;
        }
        block as u32 | IS_BLOCK
    }

    fn record(&mut self, bound: f32, list: &[Operation]) -> u32 {
        let list = self.list(list);
        self.words.extend([bound.to_bits(), list]);
        self.words.len() as u32 - 2
    }

    fn list(&mut self, list: &[Operation]) -> u32 {
        if let Some(known) = self.lists.get(list) {
            return *known;
        }
        let start = self.words.len() as u32;
        for operation in list {
            let leaf = operation.leaf.map_or(NO_LEAF << ROW_BITS, |leaf| {
                let family = self.program.leaves()[leaf as usize].family as u32;
                family << ROW_BITS | self.tree.leaf_rows[leaf as usize]
            });
            let join = operation.join.map_or(0, |join| {
                let family = self.program.joins()[join as usize].family as u32 + 1;
                family << ROW_BITS | self.tree.join_rows[join as usize]
            });
            self.words.extend([leaf, join]);
        }
        let last = self.words.len() - 2;
        self.words[last] |= IS_LAST;
        self.lists.insert(list.to_vec(), start);
        start
    }
}

/// A value that waits for a join: where its operations begin, and its interval.
struct Waiting {
    start: usize,
    value: Interval,
}

/// The operations of a list that can matter in a box, and the interval of their value.
pub(super) fn prune(program: &Program<'_>, list: &[Operation], bounds: Bounds) -> (Vec<Operation>, Interval) {
    let mut kept: Vec<Operation> = Vec::new();
    let mut stack: Vec<Waiting> = Vec::new();
    for operation in list {
        if let Some(leaf) = operation.leaf {
            let value = program.leaves()[leaf as usize].interval(bounds);
            stack.push(Waiting { start: kept.len(), value });
            kept.push(Operation { leaf: Some(leaf), join: None });
        }
        if let Some(join) = operation.join {
            apply(&program.joins()[join as usize], join, &mut stack, &mut kept);
        }
    }
    let value = stack.pop().map_or(Interval::new(f32::NEG_INFINITY, f32::INFINITY), |all| all.value);
    (kept, value)
}

fn apply(join: &Join<'_>, index: u32, stack: &mut Vec<Waiting>, kept: &mut Vec<Operation>) {
    let second = stack.pop().expect("a value waits");
    if join.kind.is_unary() {
        let value = join.kind.apply_to_intervals(second.value, second.value);
        kept.push(Operation { leaf: None, join: Some(index) });
        stack.push(Waiting { value, ..second });
        return;
    }
    let first = stack.pop().expect("a value waits");
    let width = join.kind.width();
    // Of equal values, the first is taken.
    if second.value.low - first.value.high >= width {
        kept.truncate(second.start);
        stack.push(first);
    } else if first.value.low - second.value.high >= width && first.value.low > second.value.high {
        kept.drain(first.start..second.start);
        stack.push(Waiting { start: first.start, ..second });
    } else {
        let value = join.kind.apply_to_intervals(first.value, second.value);
        let is_leaf = kept.len() == second.start + 1 && kept[second.start].join.is_none();
        if is_leaf {
            kept[second.start].join = Some(index);
        } else {
            kept.push(Operation { leaf: None, join: Some(index) });
        }
        stack.push(Waiting { start: first.start, value });
    }
}
