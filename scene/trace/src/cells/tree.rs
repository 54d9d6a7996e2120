//! The tree of cells, and the list of operations that can matter in each.
//!
//! A cell is a cube. It is divided into 4 × 4 × 4 as long as its list is long and it may contain a surface: when a ray
//! first enters it, or all at once. Which cells there are follows from the scene alone.

use std::collections::HashMap;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

use super::division::division_of;
use super::program::Program;
use super::prune::{EMPTY_ABOVE, Pruned, Pruner, Regions, SLAB_CELLS, SLABS, Unpruned};
use crate::bounds::Bounds;
use crate::real::list::{IS_LAST, NO_LEAF, OPERATION_WORDS, function_of};
use crate::real::{Division, INDEX_BITS, Interval, MakeWords, Table, Vec3, Words, vec3};

/// Edge of a block, in cells.
pub(super) const BLOCK_EDGE: u32 = 4;
/// Cells of a block.
pub const BLOCK_CELLS: u32 = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;
/// Maximum depth of the tree: coordinates of cells are exact in `f32`.
pub(super) const MAX_LEVELS: u32 = 10;
/// Number of leaves in a list up to which a cell is not divided.
pub(super) const SHORT_LIST: usize = 24;
/// A cell that has more than this part of its parent's leaves is hardly smaller in what matters.
pub(super) const SHORTER: f32 = 0.75;
/// Number of cells, each inside the one before, that may be hardly smaller: where shapes overlap so much, more cells would
/// not make shorter lists.
pub(super) const MAX_STALLS: u32 = 2;

/// Size of a cell that has room for many shapes, in sizes of a shape.
const MANY_SHAPES: f32 = 8.0;
/// Largest size of the smallest cells, in sizes of a shape, if the depth of the tree allows it.
const SMALL_CELL: f32 = 0.25;

/// Bits of a cell's word that are not its kind. A cell of kind 0 has no surface.
pub(super) const KIND_SHIFT: u32 = INDEX_BITS;
/// Kind of a cell that may have a surface: the index of its list.
pub(super) const LIST: u32 = 1;
/// Kind of a divided cell: the index of its block.
const BLOCK: u32 = 2;
/// Kind of a cell that is to be divided: the index of its [`Undivided`].
const UNDIVIDED: u32 = 3;

/// Index of the word of the outermost cell, after the rows.
const ROOT: u32 = 0;
/// Words a leaf that cells may take.
const WORDS_PER_LEAF: usize = 1 << 13;
/// Words that cells of few leaves may take.
const MIN_WORDS: usize = 1 << 27;

/// The cells of a scene, with their lists and rows, as one table of words.
///
/// After the rows come the word of the outermost cell, the list of all operations, and the lists of the leaves alone. A block is the words of 64 cells,
/// x fastest, then the index of the list of all of them.
#[derive(Clone, Debug)]
pub struct CellTree {
    frame: CellFrame,
    /// Index of the word of the outermost cell.
    pub(super) root: u32,
    /// Index of the list of all operations.
    pub(super) whole: u32,
    /// Index of a word that has the index of a short list.
    pub(super) brief: u32,
    pub(super) words: Table,
}

/// Where the cells are.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellFrame {
    /// Center of the outermost cell.
    pub(super) center: Vec3<f32>,
    /// Edge of the smallest cells.
    pub(super) unit: f32,
    /// Depth of the tree.
    pub(super) levels: u32,
    /// Cells up to this level may have all shapes because these are small, or far away: smaller cells will have fewer.
    pub(super) coarse_levels: u32,
}

/// A way to build cells: all at once by the scalar reference here, or by machine code when they are needed.
pub trait CellBuilder {
    /// Distances of a program's leaves.
    fn distances<'a>(&self, program: &'a Program<'_>) -> Distances<'a>;

    /// Maximum number of words that the cells may take, beyond the whole scene's.
    fn max_words(&self) -> usize {
        usize::MAX
    }
}

/// Distances of leaves, for a cell that is divided when it is needed, or for all at once.
pub enum Distances<'a> {
    /// For as long as the cells are.
    Kept(Arc<dyn LeafDistances>),
    /// For as long as the scene.
    OfScene(Box<dyn LeafDistances + 'a>),
}

/// Distances of leaves.
pub trait LeafDistances: Send + Sync {
    /// Appends the distances of leaves at the points of a block: each slab's to its own, the first leaf's at all
    /// points of the slab, then of the second.
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>; BLOCK_CELLS as usize], distances: &mut [Vec<f32>; SLABS]);

    /// Prunes a list, with the best vector instructions.
    fn prune(&self, list: &Unpruned<'_>) -> Pruned {
        list.prune()
    }
}

/// Builds cells by the scalar reference, all at once.
#[derive(Clone, Copy, Debug)]
pub struct ScalarBuilder;

impl CellBuilder for ScalarBuilder {
    fn distances<'a>(&self, program: &'a Program<'_>) -> Distances<'a> {
        Distances::OfScene(Box::new(program))
    }
}

impl LeafDistances for &Program<'_> {
    fn append(&self, leaves: &[u32], points: &[Vec3<f32>; BLOCK_CELLS as usize], distances: &mut [Vec<f32>; SLABS]) {
        for (points, distances) in points.chunks_exact(SLAB_CELLS).zip(distances) {
            for &leaf in leaves {
                distances.extend(points.iter().map(|p| self.leaves()[leaf as usize].distance(*p)));
            }
        }
    }
}

/// A cell.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Coordinates in units.
    at: [u32; 3],
    level: u32,
}

/// A cell that is to be divided, as words of the table.
#[derive(Clone, Copy, Debug)]
struct Undivided {
    /// Index of its word.
    place: u32,
    cell: Cell,
    /// Index of its list, and number of its words.
    list: u32,
    length: u32,
    /// Number of cells around it that are hardly smaller, see [`MAX_STALLS`].
    stalls: u32,
}

impl Undivided {
    const WORDS: usize = 8;

    fn to_words(self) -> [u32; Self::WORDS] {
        let [x, y, z] = self.cell.at;
        [self.place, x, y, z, self.cell.level, self.list, self.length, self.stalls]
    }

    fn at(words: &Words, index: u32) -> Self {
        let [place, x, y, z, level, list, length, stalls] = std::array::from_fn(|word| words.get(index + word as u32));
        Self { place, cell: Cell { at: [x, y, z], level }, list, length, stalls }
    }
}

/// Divides cells.
struct Builder<D> {
    frame: CellFrame,
    pruner: Pruner,
    /// Index of the word of the outermost cell.
    root: u32,
    distances: D,
    /// One is held while a cell is divided.
    locks: Vec<Mutex<()>>,
    /// Lists that exist, by their hashes: equal lists are one, which saves memory, and lets more lanes be evaluated
    /// together.
    lists: Vec<Mutex<HashMap<u64, u32>>>,
}

impl CellTree {
    /// Builds the cells of a program. `reach` contains every point at which it will be evaluated.
    pub(super) fn new(program: &Program<'_>, reach: Bounds, how: &dyn CellBuilder) -> Self {
        let frame = CellFrame::new(program, reach);
        let rows = program.rows();
        let lists = program.list().len() + OPERATION_WORDS as usize * program.leaf_count();
        let of_scene = rows.len() + lists + 2 + Undivided::WORDS;
        let of_cells = MIN_WORDS.max(WORDS_PER_LEAF * program.leaf_count()).min(how.max_words());
        let words = Words::with_capacity((of_scene + of_cells).min(1 << KIND_SHIFT));
        let append = |part: &[u32]| words.append(part).expect("there is room for the rows and the first list");
        append(rows);
        let (root, whole) = (append(&[ROOT]), append(program.list()));
        let leaf_lists: Vec<u32> = (0..program.leaf_count() as u32).flat_map(|leaf| program.list_of(leaf)).collect();
        let leaf_lists = append(&leaf_lists);
        let brief = append(&[leaf_lists]);
        let outermost = Cell { at: [0; 3], level: 0 };
        let undivided =
            Undivided { place: root, cell: outermost, list: whole, length: program.list().len() as u32, stalls: 0 };
        let record = append(&undivided.to_words());
        words.set(root, UNDIVIDED << KIND_SHIFT | record);
        let tree = Self { frame, root, whole, brief, words: Arc::new(words) };
        let pruner = Pruner::new(program);
        match how.distances(program) {
            Distances::Kept(distances) => {
                let division = division_of(program, &frame, &pruner, [root, leaf_lists]);
                let builder = Builder::new(frame, pruner, root, distances);
                tree.words.set_maker(Box::new(LazyBuilder { builder, division }));
            }
            Distances::OfScene(distances) => {
                Builder::new(frame, pruner, root, distances).divide_until(&tree.words, &|| false);
            }
        }
        tree
    }

    /// Checksum of the cells, which must all exist.
    pub fn checksum(&self) -> u64 {
        checksum(&self.words, self.root)
    }

    /// The table.
    pub fn words(&self) -> &Table {
        &self.words
    }

    /// Word of the points outside of all cells.
    pub(super) fn whole_word(&self) -> u32 {
        LIST << KIND_SHIFT | self.whole
    }

    pub(super) fn frame(&self) -> &CellFrame {
        &self.frame
    }
}

/// A number of all cells and their lists, however they are placed in the table, from the index of the outermost cell's word.
/// All cells must exist.
pub fn checksum(words: &Words, root: u32) -> u64 {
    let list = |first: u32| {
        let mut sum = 0_u64;
        for operation in (first..).step_by(OPERATION_WORDS as usize) {
            for index in operation..operation + OPERATION_WORDS {
                sum = mix(sum, words.get(index));
            }
            if words.get(operation) & IS_LAST != 0 {
                return sum;
            }
        }
        sum
    };
    let (mut sum, mut open) = (0_u64, vec![words.get(root)]);
    while let Some(word) = open.pop() {
        let index = index_of(word);
        sum = match word >> KIND_SHIFT {
            LIST => sum.wrapping_mul(3).wrapping_add(list(index)),
            BLOCK => {
                open.extend((index..index + BLOCK_CELLS).map(|place| words.get(place)));
                mix(sum, BLOCK).wrapping_add(list(words.get(index + BLOCK_CELLS)))
            }
            _ => mix(sum, word),
        };
    }
    sum
}

/// Mixes a word into a sum (the constant of Knuth's linear congruential generator MMIX).
fn mix(sum: u64, word: u32) -> u64 {
    (sum ^ u64::from(word)).wrapping_mul(6_364_136_223_846_793_005).rotate_left(23)
}

/// Words of the undivided cells at these places, or in their blocks.
fn undivided(words: &Words, places: &[u32]) -> Vec<u32> {
    let of_place = |&place: &u32| {
        let word = words.get(place);
        let (first, count) = match word >> KIND_SHIFT {
            BLOCK => (index_of(word), BLOCK_CELLS),
            _ => (place, 1),
        };
        (first..first + count).map(|place| words.get(place)).filter(|word| word >> KIND_SHIFT == UNDIVIDED)
    };
    places.iter().flat_map(of_place).collect()
}

/// The index in a cell's word.
fn index_of(word: u32) -> u32 {
    word & ((1 << KIND_SHIFT) - 1)
}

/// Word of a cell without a surface, of kind 0: the bits of a lower bound of the distance, above 0, but for the sign and
/// the last.
fn empty(bound: f32) -> u32 {
    bound.to_bits() >> 1
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
        let largest = |bounds: Bounds| (bounds.max - bounds.min).max_element();
        let mut sizes: Vec<f32> = finite.clone().map(largest).collect();
        let inner =
            finite.reduce(Bounds::union).unwrap_or(Bounds { min: vec3(-1.0, -1.0, -1.0), max: vec3(1.0, 1.0, 1.0) });
        let center = (inner.min + inner.max) * 0.5;
        let size = largest(inner).clamp(1e-4, 1e6);
        let far = |low: f32, high: f32, center: f32| (center - low).max(high - center);
        let distance = far(reach.min.x, reach.max.x, center.x).max(far(reach.min.y, reach.max.y, center.y)).max(far(
            reach.min.z,
            reach.max.z,
            center.z,
        ));
        // Without outer cells, if the points are not much farther away than the shapes. The size is one of few, so that the
        // cells of two frames are the same although their cameras differ.
        let steps = if distance <= size { (16.0 * distance / size).ceil().max(8.0) } else { 8.0 };
        // A little larger, so that rounding leaves every point inside.
        let edge = size * (steps / 8.0) * (1.0 + 64.0 * f32::EPSILON);
        let few_levels: u32 = match program.leaf_count() {
            0..=64 => 4,
            65..=20_000 => 5,
            _ => 6,
        };
        // Among large or distant shapes, the others may be small.
        let middle = sizes.len() / 2;
        let typical = if sizes.is_empty() { edge } else { *sizes.select_nth_unstable_by(middle, f32::total_cmp).1 };
        let (mut outer_levels, mut half) = (0, 0.5 * edge);
        while half < distance && outer_levels + few_levels < MAX_LEVELS {
            half *= BLOCK_EDGE as f32;
            outer_levels += 1;
        }
        let mut inner_levels = few_levels;
        while edge / BLOCK_EDGE.pow(inner_levels) as f32 > SMALL_CELL * typical
            && outer_levels + inner_levels < MAX_LEVELS
        {
            inner_levels += 1;
        }
        let levels = outer_levels + inner_levels;
        let unit = edge / BLOCK_EDGE.pow(inner_levels) as f32;
        let is_coarse = |level: &u32| BLOCK_EDGE.pow(levels - level) as f32 * unit > MANY_SHAPES * typical;
        let coarse_levels = (0..=levels).take_while(is_coarse).count() as u32;
        Self { center, unit, levels, coarse_levels: coarse_levels.max(outer_levels + 2) - 1 }
    }
}

/// Divides cells when they are needed.
struct LazyBuilder {
    builder: Builder<Arc<dyn LeafDistances>>,
    division: Division,
}

impl MakeWords for LazyBuilder {
    fn make(&self, words: &Words, missing: u32) -> u32 {
        self.builder.divide(words, missing)
    }

    fn make_until(&self, words: &Words, is_enough: &dyn Fn() -> bool) {
        self.builder.divide_until(words, is_enough);
    }

    fn outermost(&self, words: &Words) -> Vec<u32> {
        /// Words of a list that is not long.
        const SHORT: u32 = 1 << 14;
        let is_long = |missing: &u32| Undivided::at(words, index_of(*missing)).length > SHORT;
        undivided(words, &[self.builder.root]).into_iter().filter(is_long).collect()
    }

    fn division(&self) -> Option<&Division> {
        Some(&self.division)
    }
}

impl<'a, D: Deref<Target = dyn LeafDistances + 'a> + Sync> Builder<D> {
    fn new(frame: CellFrame, pruner: Pruner, root: u32, distances: D) -> Self {
        let locks = std::iter::repeat_with(Mutex::default).take(64).collect();
        let lists = std::iter::repeat_with(Mutex::default).take(64).collect();
        Self { frame, pruner, root, distances, locks, lists }
    }

    /// Index of a list, which is appended if there is none like it.
    fn list(&self, words: &Words, list: &[u32]) -> Option<u32> {
        let hash = list.iter().fold(0, |hash, &word| mix(hash, word));
        let known = &self.lists[hash as usize % self.lists.len()];
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(&index) = known.get(&hash)
            && list.iter().zip(index..).all(|(&word, index)| words.get(index) == word)
        {
            return Some(index);
        }
        let index = words.append(list)?;
        known.insert(hash, index);
        Some(index)
    }

    /// Divides the cells that are to be divided, level by level, until `is_enough` is true.
    fn divide_until(&self, words: &Words, is_enough: &dyn Fn() -> bool) {
        let mut level = undivided(words, &[self.root]);
        while !level.is_empty() && !words.is_full() && !is_enough() {
            for &missing in level.iter().take_while(|_| !is_enough()) {
                self.divide(words, missing);
            }
            let places = level.iter().map(|word| Undivided::at(words, index_of(*word)).place);
            level = undivided(words, &places.collect::<Vec<u32>>());
        }
    }

    /// Divides a cell, unless that has been done; returns its word.
    fn divide(&self, words: &Words, missing: u32) -> u32 {
        let undivided = Undivided::at(words, index_of(missing));
        let lock = &self.locks[undivided.place as usize % self.locks.len()];
        let _held = lock.lock().unwrap_or_else(PoisonError::into_inner);
        let word = words.get(undivided.place);
        if word >> KIND_SHIFT != UNDIVIDED {
            return word;
        }
        // Without room, the cell passes for an empty one, so that rays soon end: `Words::is_full` tells that what was
        // computed is meaningless.
        let word = self.block(words, &undivided).unwrap_or(empty(self.frame.unit));
        words.set(undivided.place, word);
        word
    }

    /// Appends the block of a cell; returns its word.
    fn block(&self, words: &Words, parent: &Undivided) -> Option<u32> {
        let list: Vec<u32> = (parent.list..parent.list + parent.length).map(|index| words.get(index)).collect();
        let cells = self.cells(&parent.cell);
        let bounds = cells.map(|cell| self.frame.bounds(&cell));
        let leaves: Vec<u32> = self.pruner.leaves(&list).collect();
        let mut distances = std::array::from_fn(|_| Vec::with_capacity(leaves.len() * SLAB_CELLS));
        self.distances.append(&leaves, &bounds.map(|bounds| (bounds.min + bounds.max) * 0.5), &mut distances);
        let block = words.append(&[0; BLOCK_CELLS as usize + 1])?;
        words.set(block + BLOCK_CELLS, parent.list);
        for (slab, (bounds, distances)) in bounds.as_chunks::<SLAB_CELLS>().0.iter().zip(&distances).enumerate() {
            let (list, leaves, regions) = (&list, &leaves, &Regions::new(bounds));
            let unpruned = Unpruned { pruner: &self.pruner, list, leaves, regions, distances };
            let pruned = self.distances.prune(&unpruned);
            for (index, list) in pruned.lists().iter().enumerate() {
                let of_block = slab * SLAB_CELLS + index;
                let place = block + of_block as u32;
                let word = match pruned.value(index) {
                    value if value.low > EMPTY_ABOVE => empty(value.low),
                    value => self.near(words, parent, leaves.len(), (cells[of_block], place), value, list)?,
                };
                words.set(place, word);
            }
        }
        Some(BLOCK << KIND_SHIFT | block)
    }

    /// Word of a cell of a block that may have a surface.
    fn near(
        &self,
        words: &Words,
        parent: &Undivided,
        leaves_of_parent: usize,
        (cell, place): (Cell, u32),
        value: Interval,
        list: &[u32],
    ) -> Option<u32> {
        let length = list.len() as u32;
        let leaves =
            list.iter().step_by(OPERATION_WORDS as usize).filter(|word| function_of(**word) != NO_LEAF).count();
        let index = if length == parent.length { parent.list } else { self.list(words, list)? };
        // A ray enters the inside of shapes only through a surface, or from a camera there.
        let has_surface = value.high >= 0.0;
        let is_coarse = cell.level <= self.frame.coarse_levels;
        let is_shorter = is_coarse || leaves as f32 <= SHORTER * leaves_of_parent as f32;
        let stalls = if is_shorter { 0 } else { parent.stalls + 1 };
        if has_surface && leaves > SHORT_LIST && stalls < MAX_STALLS && cell.level < self.frame.levels {
            let undivided = Undivided { place, cell, list: index, length, stalls };
            return Some(UNDIVIDED << KIND_SHIFT | words.append(&undivided.to_words())?);
        }
        Some(LIST << KIND_SHIFT | index)
    }

    /// The 64 cells of a cell.
    fn cells(&self, parent: &Cell) -> [Cell; BLOCK_CELLS as usize] {
        let size = BLOCK_EDGE.pow(self.frame.levels - parent.level - 1);
        std::array::from_fn(|index| {
            let index = index as u32;
            let steps = [index % BLOCK_EDGE, index / BLOCK_EDGE % BLOCK_EDGE, index / (BLOCK_EDGE * BLOCK_EDGE)];
            Cell { at: std::array::from_fn(|axis| parent.at[axis] + steps[axis] * size), level: parent.level + 1 }
        })
    }
}
