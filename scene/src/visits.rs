//! Record of the cells of space in which a tile's rays asked for the scene's distance, and of the materials they asked
//! for. A change of the scene that alters neither leaves the tile's pixels as they are: see [`crate::changes`].
//!
//! The record is a table of words that are missing until a formula first asks for them ([`Real::made`]), so that every
//! evaluator which makes the words of cells makes those of a record, too. A word that was made is a number below all
//! others, and each recorded value becomes the greater of the two: the value itself, bit for bit.

use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::cells::Division;
use crate::real::list::is_set;
use crate::real::{MakeWords, Real, Table, Vec3, Words, vec3};

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
/// Index of the word of the first material.
const MATERIALS: u32 = CELLS + 1;
/// The bits of a number below all others, −2¹⁰⁰: a word that was made.
const VISITED: u32 = 0xf180_0000;
/// Place of its sign.
const SIGN: u32 = 31;
/// 2²³: the bits of this plus an integer below it end in those of the integer.
const TO_INTEGER: f32 = 8_388_608.0;

/// Where the cells are: nested cubes around a center.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VisitGrid {
    /// Center of the cubes.
    center: [f32; 3],
    /// A quarter of the edge of the first.
    quarter: f32,
}

impl VisitGrid {
    /// Grids of which the first contains a box.
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

    /// Box that contains the points of some cells of a grid: of those from `first` up to but excluding `first + size`
    /// along each axis.
    pub(crate) fn bounds(&self, grid: u32, first: [u32; 3], size: u32) -> Bounds {
        let unit = self.quarter * (1 << grid) as f32 * (4.0 / EDGE as f32);
        let along = |axis: usize, cells: u32| (cells as f32 - EDGE as f32 / 2.0).mul_add(unit, self.center[axis]);
        let corner = |more: u32| vec3(along(0, first[0] + more), along(1, first[1] + more), along(2, first[2] + more));
        let bounds = Bounds { min: corner(0), max: corner(size) };
        // A point is rounded to its cell.
        bounds.with_margin(bounds.min)
    }
}

/// Index of a cell.
pub(crate) fn cell_index(grid: u32, [x, y, z]: [u32; 3]) -> u32 {
    ((grid * EDGE + z) * EDGE + y) * EDGE + x
}

/// Edge of a grid, in cells.
pub(crate) const fn edge() -> u32 {
    EDGE
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
        p.x.call("visit", p, |p| {
            let index = self.grid.index(p);
            self.ask(index)
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
        let materials = asked.split_off(asked.partition_point(|&index| index < MATERIALS));
        let materials = materials.into_iter().map(|index| index - MATERIALS).collect();
        Visited { grid: self.grid, cells: asked, materials }
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

/// The cells and materials that a tile's rays asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visited {
    /// Where the cells are.
    pub(crate) grid: VisitGrid,
    /// Indices of the cells, in order; the last may be that of the space outside of all cells.
    pub(crate) cells: Vec<u32>,
    /// Slots of the materials, in order.
    pub(crate) materials: Vec<u32>,
}

impl Visited {
    /// Where the cells are.
    pub fn grid(&self) -> &VisitGrid {
        &self.grid
    }

    /// Number of cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }
}
