//! Record of the cells of space in which a tile's rays asked for the scene's distance, and of the materials they asked
//! for. A change of the scene that alters neither leaves the tile's pixels as they are: see `changes.rs`.
//!
//! The record is a table of words that are missing until a formula first asks for them ([`Real::made`]), so that every
//! evaluator which makes the words of cells makes a record's words, too. A word that was made is a number below all
//! others, and each recorded value becomes the greater of the two: the value itself, bit for bit.

use std::sync::{Arc, Mutex, PoisonError};

use crate::bounds::Bounds;
use crate::cache_key::PICTURE_VERSION;
use crate::ray::Ray;
use crate::real::list::is_set;
use crate::real::{Division, FunctionKey, MakeWords, Real, Table, Vec3, Words, vec3};

/// Cells along the edge of a grid.
const EDGE: u32 = 128;
/// Bits of a cell's index in its grid.
const GRID_BITS: u32 = 21;
/// Number of grids, each of twice the size of the one before.
pub(crate) const GRIDS: u32 = 4;
/// Number of cells.
pub(crate) const CELLS: u32 = GRIDS << GRID_BITS;
/// Index of the word for all points outside of the grids.
pub(crate) const OUTSIDE: u32 = CELLS;
/// Cells along the edge of a block.
const BLOCK_EDGE: u32 = 8;
/// Bits of a cell's place along an axis, and of a block's.
const CELL_BITS: u32 = 7;
const BLOCK_BITS: u32 = 4;
/// Number of blocks, and the index of the space outside of the grids.
const BLOCKS: u32 = GRIDS << (3 * BLOCK_BITS);
/// Index of the word of the first block.
const FIRST_BLOCK: u32 = CELLS + 1;
/// Index of the word of the first material.
const MATERIALS: u32 = FIRST_BLOCK + BLOCKS + 1;
/// The bits of a number below all others, −2¹⁰⁰: a word that was made.
const VISITED: u32 = 0xf180_0000;
/// Greatest number of blocks that are recorded along a ray.
const MAX_VISITS: u32 = 1 << 11;
/// Place of its sign.
const SIGN: u32 = 31;
/// 2²³: the bits of this plus an integer below it end in the integer's bits.
const TO_INTEGER: f32 = 8_388_608.0;

/// Where the cells are: nested cubes around a center.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisitGrid {
    /// Center of the cubes.
    center: [f32; 3],
    /// A quarter of the edge of the first.
    quarter: f32,
}

impl VisitGrid {
    /// Grids; the first contains a box.
    pub(crate) fn around(bounds: Bounds) -> Self {
        let middle = |low: f32, high: f32| 0.5 * (low + high);
        let Bounds { min, max } = bounds;
        let center = [middle(min.x, max.x), middle(min.y, max.y), middle(min.z, max.z)];
        let extent = [max.x - min.x, max.y - min.y, max.z - min.z].into_iter().fold(1e-6, f32::max);
        Self { center, quarter: 0.26 * extent }
    }

    /// Index of a point's cell, or [`OUTSIDE`].
    fn index<R: Real>(&self, p: Vec3<R>) -> R::Bits {
        let [x, y, z] = self.center;
        let per_quarter = p.x.uniform(1.0 / self.quarter);
        let offset = p - Vec3::uniform(p.x, vec3(x, y, z));
        let offset = offset.map(|c| c * per_quarter);
        // The first grid reaches to ±2, as numbers of exponent 0 do, and each next one to the next exponent.
        let farthest = offset.map(R::abs).max_element().at_least(1.0);
        let exponent = farthest.to_bits() & 0x7f80_0000;
        // 1 over the power of two.
        let scale = R::from_bits(exponent * u32::MAX + (254 << 23));
        let place = |c: R| {
            let cell = (c * scale * (EDGE as f32 / 4.0) + EDGE as f32 / 2.0).floor();
            (cell.at_least(0.0).at_most((EDGE - 1) as f32) + TO_INTEGER).to_bits() & (EDGE - 1)
        };
        let [x, y, z] = [offset.x, offset.y, offset.z].map(place);
        let grid = (farthest.to_bits() >> 23) + 127_u32.wrapping_neg();
        let inside = x + y * EDGE + z * (EDGE * EDGE) + grid * (1 << GRID_BITS);
        let is_outside = !farthest.below((1 << GRIDS) as f32);
        let outside = p.x.uniform_bits(OUTSIDE);
        R::select(is_outside, R::from_bits(outside), R::from_bits(inside)).to_bits()
    }

    /// Size of a point's block, or length that is outside of all grids.
    fn block_size<R: Real>(&self, p: Vec3<R>) -> R {
        let [x, y, z] = self.center;
        let offset = p - Vec3::uniform(p.x, vec3(x, y, z));
        let farthest = offset.map(|c| c * p.x.uniform(1.0 / self.quarter)).map(R::abs).max_element().at_least(1.0);
        // As far as the power of two of `index`.
        let size = R::from_bits(farthest.to_bits() & 0x7f80_0000).at_most((1 << (GRIDS - 1)) as f32)
            * (4.0 * BLOCK_EDGE as f32 / EDGE as f32);
        size.max(farthest - (1 << GRIDS) as f32) * p.x.uniform(self.quarter)
    }

    /// Edge of the cells of a grid.
    pub(crate) fn edge(&self, grid: u32) -> f32 {
        self.quarter * (1 << grid) as f32 * (4.0 / EDGE as f32)
    }

    /// Box that contains the points of some cells of a grid: of those from `first` up to but excluding `first + size`
    /// along each axis.
    pub(crate) fn bounds(&self, grid: u32, first: [u32; 3], size: u32) -> Bounds {
        let unit = self.edge(grid);
        let along = |axis: usize, cells: u32| Real::mul_add(cells as f32 - EDGE as f32 / 2.0, unit, self.center[axis]);
        let corner = |more: u32| vec3(along(0, first[0] + more), along(1, first[1] + more), along(2, first[2] + more));
        let bounds = Bounds { min: corner(0), max: corner(size) };
        // A point is rounded to its cell.
        bounds.with_margin(bounds.min)
    }
}

/// Grid and place of a cell with this index.
pub(crate) fn cell_place(index: u32) -> (u32, [u32; 3]) {
    (index >> GRID_BITS, [index % EDGE, index / EDGE % EDGE, index / (EDGE * EDGE) % EDGE])
}

/// A record that formulas write.
#[derive(Clone, Debug)]
pub struct Visits {
    grid: VisitGrid,
    materials: u32,
    table: Table,
    asked: Asked,
}

/// Indices of the words that were made.
type Asked = Arc<Mutex<Vec<u32>>>;

impl Visits {
    /// An empty record of the cells of a grid, and of this many materials.
    pub(crate) fn new(grid: VisitGrid, materials: usize) -> Self {
        let materials = materials as u32;
        let words = Words::with_capacity((MATERIALS + materials) as usize);
        let asked = Asked::default();
        words.set_maker(Box::new(Recorder(asked.clone())));
        Self { grid, materials, table: Arc::new(words), asked }
    }

    /// The table that formulas write to.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// Another record of the same cells and materials, which is empty.
    #[must_use]
    pub fn another(&self) -> Self {
        Self::new(self.grid, self.materials as usize)
    }

    /// Records that the scene was asked for at a point; returns a number below all others.
    pub(crate) fn at<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.call(FunctionKey::new("visit"), p, |p| {
            let index = self.grid.index(p);
            self.ask(index)
        })
    }

    /// Records that a ray passed for a length; returns a number below all others.
    ///
    /// The points whose blocks are recorded are no farther apart than the edge of either's block, so every point of the ray is
    /// in a recorded block or at most half its edge from it.
    pub(crate) fn along<R: Real>(&self, ray: &Ray<R>, length: R) -> R {
        let start = (length.constant(0.0), self.pass(ray.at(length)));
        let (end, visited) = R::repeat(MAX_VISITS, start, |(t, _)| {
            let p = ray.at(t);
            let size = self.grid.block_size(p);
            let next = t + size.min(self.grid.block_size(ray.at(t + size)));
            (next.lt(length), (next, self.pass(p)))
        });
        R::when(end.lt(length), visited, || self.ask(end.uniform_bits(FIRST_BLOCK + BLOCKS)))
    }

    /// Records the block of a point.
    fn pass<R: Real>(&self, p: Vec3<R>) -> R {
        p.x.call(FunctionKey::new("pass"), p, |p| {
            let cell = self.grid.index(p);
            let along = |axis: u32| ((cell >> (CELL_BITS * axis)) & (EDGE - BLOCK_EDGE)) << (BLOCK_BITS * axis);
            let in_grid = (along(0) + along(1) + along(2)) >> (CELL_BITS - BLOCK_BITS);
            self.ask(in_grid + ((cell >> GRID_BITS) << (3 * BLOCK_BITS)) + FIRST_BLOCK)
        })
    }

    /// Records that a material was asked for; returns a number below all others.
    pub(crate) fn of_material<R: Real>(&self, like: R, slot: usize) -> R {
        self.ask(like.uniform_bits(MATERIALS + slot as u32))
    }

    fn ask<R: Real>(&self, index: R::Bits) -> R {
        let word = R::from_bits(R::word(&self.table, index));
        let is_made = is_set::<R>(word.to_bits(), SIGN);
        R::when(!is_made, word, || R::from_bits(R::made(&self.table, index)))
    }

    /// The cells and materials that were asked for until now.
    pub fn read(&self) -> Visited {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner).clone();
        asked.sort_unstable();
        // Two threads may have made one word.
        asked.dedup();
        let mut from = |first: u32| -> Vec<u32> {
            let indices = asked.split_off(asked.partition_point(|&index| index < first));
            indices.into_iter().map(|index| index - first).collect()
        };
        let (materials, blocks) = (from(MATERIALS), from(FIRST_BLOCK));
        Visited { grid: self.grid, cells: asked, blocks, materials }
    }
}

/// Makes the words of a record: that they are asked for is what is recorded.
struct Recorder(Asked);

impl MakeWords for Recorder {
    fn make(&self, words: &Words, missing: u32) -> u32 {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(missing);
        words.set(missing, VISITED);
        VISITED
    }

    fn make_until(&self, _: &Words, _: &dyn Fn() -> bool) {}

    fn outermost(&self, _: &Words) -> Vec<u32> {
        Vec::new()
    }

    fn division(&self) -> Option<&Division> {
        None
    }
}

/// The cells and materials that a tile's rays asked for, and the blocks that they passed.
#[derive(Clone, Debug, PartialEq)]
pub struct Visited {
    /// Where the cells are.
    pub(crate) grid: VisitGrid,
    /// Indices of the cells, in order; the last may be that of the space outside of all cells.
    pub(crate) cells: Vec<u32>,
    /// Indices of the blocks, in order; the last may be that of the space outside of all blocks.
    pub(crate) blocks: Vec<u32>,
    /// Slots of the materials, in order.
    pub(crate) materials: Vec<u32>,
}

impl Visited {
    /// Whether its rays may have passed a box.
    pub(crate) fn has_passed(&self, bounds: Bounds) -> bool {
        self.blocks.iter().any(|&block| {
            if block == BLOCKS {
                return true;
            }
            let grid = block >> (3 * BLOCK_BITS);
            let first = [0, 1, 2].map(|axis| (block >> (BLOCK_BITS * axis)) % (1 << BLOCK_BITS) * BLOCK_EDGE);
            // Every point of a ray is at most half an edge from a recorded block.
            let beside = 0.51 * BLOCK_EDGE as f32 * self.grid.edge(grid);
            self.grid.bounds(grid, first, BLOCK_EDGE).expanded(beside).gap(bounds) <= 0.0
        })
    }

    /// Where the cells are.
    pub fn grid(&self) -> &VisitGrid {
        &self.grid
    }

    /// The record as bytes.
    ///
    /// ```text
    /// "sdfv" · version · picture version                 u32, little-endian
    /// center of the cells · a quarter of an edge          f32, little-endian
    /// number of cells · of blocks · of materials          u32, little-endian
    /// cells, blocks, materials: each less the one before  LEB128
    /// ```
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { grid: VisitGrid { center: [x, y, z], quarter }, cells, blocks, materials } = self;
        let mut bytes = MAGIC.to_vec();
        let counts = [cells, blocks, materials].map(|indices| indices.len() as u32);
        let numbers = [x, y, z, quarter].map(|number| number.to_bits());
        let header = [VERSION, PICTURE_VERSION].into_iter().chain(numbers).chain(counts);
        bytes.extend(header.flat_map(u32::to_le_bytes));
        for indices in [cells, blocks, materials] {
            let mut before = 0;
            for &index in indices {
                write_leb128(index - before, &mut bytes);
                before = index;
            }
        }
        bytes
    }

    /// Reads the bytes of [`Self::to_bytes`]; `None` if they are damaged, or of another version of pictures, whose pixels
    /// may differ.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (header, mut rest) = bytes.split_at_checked(HEADER_BYTES)?;
        let field = |index: usize| u32::from_le_bytes(header.as_chunks::<4>().0[index]);
        if header[..4] != MAGIC || (field(1), field(2)) != (VERSION, PICTURE_VERSION) {
            return None;
        }
        let [x, y, z, quarter] = std::array::from_fn(|index| f32::from_bits(field(3 + index)));
        let mut read = |count: u32, end: u32| {
            let mut indices = Vec::new();
            let mut index = 0_u32;
            for _ in 0..count {
                index = index.checked_add(read_leb128(&mut rest)?).filter(|index| *index < end)?;
                indices.push(index);
            }
            Some(indices)
        };
        let cells = read(field(7), CELLS + 1)?;
        let blocks = read(field(8), BLOCKS + 1)?;
        let materials = read(field(9), u32::MAX)?;
        rest.is_empty().then_some(Self { grid: VisitGrid { center: [x, y, z], quarter }, cells, blocks, materials })
    }
}

const MAGIC: [u8; 4] = *b"sdfv";
const VERSION: u32 = 2;
const HEADER_BYTES: usize = 40;

fn write_leb128(mut number: u32, bytes: &mut Vec<u8>) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

fn read_leb128(bytes: &mut &[u8]) -> Option<u32> {
    let mut number = 0_u32;
    for place in (0..32).step_by(7) {
        let (first, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= u32::from(first & 0x7f).checked_shl(place)?;
        if first & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_of_a_recorded_ray_is_near_a_recorded_block() {
        let grid = VisitGrid { center: [1.0, -2.5, 0.0], quarter: 0.75 };
        let mut word = 1_u32;
        let mut random = |reach: f32| {
            word = word.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            ((word >> 8) as f32 / (1 << 23) as f32 - 1.0) * reach
        };
        for reach in [1.0, 6.0, 30.0, 300.0] {
            let mut point = || vec3(random(reach), random(reach), random(reach));
            let (origin, end) = (point(), point());
            let length = (end - origin).length();
            let ray = Ray { origin, direction: (end - origin) * (1.0 / length) };
            let visits = Visits::new(grid, 0);
            visits.along(&ray, length);
            let visited = visits.read();
            for step in 0..=1_000 {
                let p = ray.at(length * step as f32 / 1_000.0);
                assert!(visited.has_passed(Bounds { min: p, max: p }), "{p:?} on the way from {origin:?} to {end:?}");
            }
            assert!(visits.another().read().blocks.is_empty(), "another record is empty");
        }
        let visits = Visits::new(grid, 0);
        visits.along(&Ray { origin: vec3(1.0, -2.5, 0.0), direction: vec3(1.0, 0.0, 0.0) }, 0.5_f32);
        let has_passed = |p: Vec3<f32>| visits.read().has_passed(Bounds { min: p, max: p });
        assert!(has_passed(vec3(1.5, -2.4, 0.0)));
        assert!(!has_passed(vec3(1.9, -2.5, 0.0)) && !has_passed(vec3(1.2, -2.0, 0.0)));
    }

    #[test]
    fn records_are_read_back() {
        let grid = VisitGrid { center: [1.0, -2.5, 0.0], quarter: 0.75 };
        for (cells, blocks, materials) in [
            (vec![], vec![], vec![]),
            (vec![0], vec![0], vec![0]),
            (vec![0, 1, 127, 128, 255, 16_384, CELLS - 1, OUTSIDE], vec![1, 300, BLOCKS], vec![0, 3, 900]),
        ] {
            let record = Visited { grid, cells, blocks, materials };
            let bytes = record.to_bytes();
            assert_eq!(Visited::from_bytes(&bytes).as_ref(), Some(&record));
            for length in 0..bytes.len() {
                assert_eq!(Visited::from_bytes(&bytes[..length]), None, "{length} of {} bytes", bytes.len());
            }
            assert_eq!(Visited::from_bytes(&[&bytes[..], &[0]].concat()), None, "one byte more");
            for (place, name) in [(0, "magic"), (4, "version"), (8, "picture version")] {
                let mut other = bytes.clone();
                other[place] ^= 1;
                assert_eq!(Visited::from_bytes(&other), None, "another {name}");
            }
        }
        let mut many = Visited { grid, cells: vec![], blocks: vec![], materials: vec![] }.to_bytes();
        many[28..32].fill(0xff);
        assert_eq!(Visited::from_bytes(&many), None, "more cells than bytes");
    }
}
