//! The tree of cells, and the list of operations that can matter in each.
//!
//! A cell is a cube. It is divided into 4 × 4 × 4 as long as its list is long and it may contain a surface.

use std::collections::HashMap;
use std::sync::OnceLock;

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
const SHORT_LIST: usize = 8;
/// Part of its parent's leaves up to which a cell is divided: where shapes overlap so much that smaller cells hardly
/// have fewer, their number would only grow.
const SHORTER: f32 = 0.75;

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
/// family and row of its leaf, then of its join. Before a leaf's row is the index of its object.
#[derive(Clone, Debug)]
pub struct CellTree {
    frame: CellFrame,
    pub(super) words: Table,
}

/// Where the cells are.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellFrame {
    /// Center of the outermost cell.
    pub(super) center: Vec3<f32>,
    /// Edge of the smallest cells, a power of two.
    pub(super) unit: f32,
    /// Depth of the tree.
    pub(super) levels: u32,
    /// Number of its outermost levels, whose innermost cells touch at the center of the shapes.
    outer_levels: u32,
}

/// A way to build cells: the scalar reference here, or machine code on several threads.
pub trait CellBuilder {
    /// A function that appends the distances of leaves at points: of the first leaf at all points, then of the second.
    fn evaluator<'a>(&self, program: &'a Program<'_>) -> Box<dyn LeafDistances + 'a>;

    /// Does independent tasks, by their index.
    fn for_each(&self, count: usize, task: &(dyn Fn(usize) + Sync));
}

/// Distances of leaves.
pub trait LeafDistances: Sync {
    /// Appends the distances of leaves at points: of the first leaf at all points, then of the second.
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>], distances: &mut Vec<f32>);
}

/// Builds cells by the scalar reference.
#[derive(Clone, Copy, Debug)]
pub struct ScalarBuilder;

impl CellBuilder for ScalarBuilder {
    fn evaluator<'a>(&self, program: &'a Program<'_>) -> Box<dyn LeafDistances + 'a> {
        Box::new(program)
    }

    fn for_each(&self, count: usize, task: &(dyn Fn(usize) + Sync)) {
        (0..count).for_each(task);
    }
}

impl LeafDistances for &Program<'_> {
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>], distances: &mut Vec<f32>) {
        for &leaf in leaves {
            distances.extend(points.iter().map(|p| self.leaves()[leaf as usize].distance(*p)));
        }
    }
}

/// A cell while the tree is built.
#[derive(Clone, Copy)]
struct Cell {
    /// Coordinates in units.
    at: [u32; 3],
    level: u32,
}

/// A part of the tree. Indices of blocks, records and lists count from its own.
#[derive(Default)]
struct Part {
    blocks: Vec<u32>,
    records: Vec<(f32, u32)>,
    lists: Vec<u32>,
    /// Lists that exist already.
    known: HashMap<Vec<Operation>, u32>,
}

struct Builder<'a, 'b> {
    program: &'b Program<'a>,
    frame: CellFrame,
    distances: Box<dyn LeafDistances + 'b>,
}

impl CellTree {
    /// Builds the cells of a program. `reach` contains every point at which it will be evaluated.
    pub(super) fn new(program: &Program<'_>, reach: Bounds, how: &dyn CellBuilder) -> Self {
        let frame = CellFrame::new(program, reach);
        let builder = Builder { program, frame, distances: how.evaluator(program) };
        let all = program.operations();
        // The cells of the outermost block, and their list there.
        let root = Cell { at: [0; 3], level: 0 };
        let children = builder.children(&root, all);
        let parts: Vec<OnceLock<(Part, u32)>> = children.iter().map(|_| OnceLock::new()).collect();
        how.for_each(parts.len(), &|index| {
            let (cell, list, value) = &children[index];
            let mut part = Part::default();
            let word = builder.cell(&mut part, cell, list, *value, program.leaf_count());
            let is_new = parts[index].set((part, word)).is_ok();
            debug_assert!(is_new, "each part is built once");
        });
        let mut words = program.rows().to_vec();
        let mut outside = Part::default();
        let whole = outside.record(program, 0.0, all);
        words[OUTSIDE as usize] = outside.append_to(&mut words, whole);
        let block: Vec<u32> = parts
            .into_iter()
            .map(|part| {
                let (part, word) = part.into_inner().expect("every part was built");
                part.append_to(&mut words, word)
            })
            .collect();
        words[ROOT] = words.len() as u32 | IS_BLOCK;
        words.extend(block);
        Self { frame, words: words.into() }
    }

    /// The table.
    pub fn words(&self) -> &Table {
        &self.words
    }

    pub(super) fn frame(&self) -> &CellFrame {
        &self.frame
    }
}

impl Part {
    fn record(&mut self, program: &Program<'_>, bound: f32, list: &[Operation]) -> u32 {
        let list = self.list(program, list);
        self.records.push((bound, list));
        self.records.len() as u32 - 1
    }

    fn list(&mut self, program: &Program<'_>, list: &[Operation]) -> u32 {
        if let Some(known) = self.known.get(list) {
            return *known;
        }
        let start = self.lists.len() as u32;
        for operation in list {
            let word = |(family, row): (usize, u32)| (family as u32) << ROW_BITS | row;
            let leaf = operation.leaf.map_or(NO_LEAF << ROW_BITS, |leaf| word(program.family_and_row(leaf)));
            let join = operation.join.map_or(0, |join| {
                let (family, row) = program.join_family_and_row(join);
                word((family + 1, row))
            });
            self.lists.extend([leaf, join]);
        }
        let last = self.lists.len() - 2;
        self.lists[last] |= IS_LAST;
        self.known.insert(list.to_vec(), start);
        start
    }

    /// Appends the part to a table; returns a word of the part, as it is there.
    fn append_to(self, words: &mut Vec<u32>, word: u32) -> u32 {
        let lists = words.len() as u32;
        words.extend(&self.lists);
        let records = words.len() as u32;
        words.extend(self.records.iter().flat_map(|(bound, list)| [bound.to_bits(), list + lists]));
        let blocks = words.len() as u32;
        let there = |word: u32| {
            if word & IS_BLOCK == 0 { records + 2 * word } else { ((word & !IS_BLOCK) + blocks) | IS_BLOCK }
        };
        words.extend(self.blocks.iter().map(|word| there(*word)));
        there(word)
    }
}

impl CellFrame {
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

    /// Place of a tree that contains `reach`, and whose inner part contains all finite shapes
    /// with cells that are small enough.
    fn new(program: &Program<'_>, reach: Bounds) -> Self {
        let finite = program.leaves().iter().map(super::program::Leaf::bounds).filter(|bounds| bounds.is_finite());
        let inner =
            finite.reduce(Bounds::union).unwrap_or(Bounds { min: vec3(-1.0, -1.0, -1.0), max: vec3(1.0, 1.0, 1.0) });
        let center = (inner.min + inner.max) * 0.5;
        let size = (inner.max - inner.min).max_element().clamp(1e-4, 1e6);
        // Powers of two from 2⁻²⁰, so that coordinates in units are exact.
        let mut edge = f32::from_bits(0x3580_0000);
        while edge < size {
            edge *= 2.0;
        }
        let inner_levels: u32 = match program.leaf_count() {
            0..=64 => 3,
            65..=20_000 => 4,
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
        Self { center, unit, levels, outer_levels: levels - inner_levels }
    }
}

impl Builder<'_, '_> {
    /// Word of a cell in its part, from its list, the interval of its value, and the number of its parent's leaves.
    fn cell(&self, part: &mut Part, cell: &Cell, list: &[Operation], value: Interval, of_parent: usize) -> u32 {
        let leaves = list.iter().filter(|operation| operation.leaf.is_some()).count();
        let bound = value.low.max(0.0);
        // A ray enters the inside of shapes only through a surface, or from a camera there.
        let has_surface = value.low <= 0.0 && value.high >= 0.0;
        // In the outer part of the tree, one cell may have all shapes.
        let is_shorter = leaves as f32 <= SHORTER * of_parent as f32 || cell.level <= self.frame.outer_levels + 1;
        if !has_surface || leaves <= SHORT_LIST || !is_shorter || cell.level == self.frame.levels {
            return part.record(self.program, bound, list);
        }
        let words: Vec<u32> = self
            .children(cell, list)
            .iter()
            .map(|(cell, list, value)| self.cell(part, cell, list, *value, leaves))
            .collect();
        part.blocks.extend(words);
        (part.blocks.len() as u32 - BLOCK_CELLS) | IS_BLOCK
    }

    /// The 64 cells of a cell, with the operations of its list that can matter in each, and the interval of their value.
    fn children(&self, cell: &Cell, list: &[Operation]) -> Vec<(Cell, Vec<Operation>, Interval)> {
        let size = BLOCK_EDGE.pow(self.frame.levels - cell.level - 1);
        let child = |index: u32| {
            let steps = [index % BLOCK_EDGE, index / BLOCK_EDGE % BLOCK_EDGE, index / (BLOCK_EDGE * BLOCK_EDGE)];
            Cell { at: std::array::from_fn(|axis| cell.at[axis] + steps[axis] * size), level: cell.level + 1 }
        };
        let cells: Vec<Cell> = (0..BLOCK_CELLS).map(child).collect();
        let regions: Vec<Bounds> = cells.iter().map(|cell| self.frame.bounds(cell)).collect();
        let centers: Vec<Vec3<f32>> = regions.iter().map(|region| (region.min + region.max) * 0.5).collect();
        let leaves: Vec<u32> = list.iter().filter_map(|operation| operation.leaf).collect();
        let mut distances = Vec::with_capacity(leaves.len() * centers.len());
        self.distances.append(&leaves, &centers, &mut distances);
        let of_cell = |(index, cell): (usize, Cell)| {
            let at_center = distances.iter().skip(index).step_by(centers.len()).copied();
            let (list, value) = prune(self.program, list, regions[index], at_center);
            (cell, list, value)
        };
        cells.into_iter().enumerate().map(of_cell).collect()
    }
}

/// A value that waits for a join: where its operations begin, and its interval.
struct Waiting {
    start: usize,
    value: Interval,
}

/// The operations of a list that can matter in a box, and the interval of their value. `at_center` are the distances of
/// the list's leaves at the box' center.
fn prune(
    program: &Program<'_>,
    list: &[Operation],
    region: Bounds,
    mut at_center: impl Iterator<Item = f32>,
) -> (Vec<Operation>, Interval) {
    let mut kept: Vec<Operation> = Vec::new();
    let mut stack: Vec<Waiting> = Vec::new();
    for operation in list {
        if let Some(leaf) = operation.leaf {
            let at_center = at_center.next().expect("a distance of each leaf");
            let value = program.leaves()[leaf as usize].interval(region, at_center);
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
