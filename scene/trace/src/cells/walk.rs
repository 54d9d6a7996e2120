//! The cell of a point, the value of its list there, and the way of a ray through cells.

use super::tree::{BLOCK_CELLS, BLOCK_EDGE, KIND_SHIFT, LIST, MAX_LEVELS};
use super::{Cells, Program};
use crate::march::Part;
use crate::ray::Ray;
use crate::real::list::{IS_LAST, ListFunctions, OPERATION_WORDS, is_set};
use crate::real::{F32Bits, FunctionKey, Real, Vec3, bundle, vec3};

/// Maximum number of cells that a ray meets between two evaluations of a list.
const MAX_CELLS: u32 = 1 << 16;
/// 2²³: the bits of this plus an integer below it are the integer's, apart from the exponent.
const TO_INTEGER: f32 = 8_388_608.0;
/// Bit of a cell's word that tells that it has no value: it is divided, or is to be divided.
const HAS_CELLS: u32 = 31;

macro_rules! names {
    ($prefix:literal: $($index:literal)*) => { [$(concat!($prefix, $index)),*] };
}

macro_rules! function_names {
    ($($name:ident $prefix:literal),*) => { $(
        static $name: [&str; $crate::cells::program::MAX_FAMILIES] = $crate::cells::walk::names![$prefix:
            0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23
            24 25 26 27 28 29 30 31 32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47];
    )* };
}

pub(super) use {function_names, names};

function_names![LEAVES "leaf_", JOINS "join_", NEAR_LEAVES "leaf_of_object_", NEAR_JOINS "join_of_objects_",
    ID_LEAVES "leaf_of_id_", ID_JOINS "join_of_ids_"];

/// The cell of a point.
#[derive(Clone, Copy, Debug)]
pub struct Located<R> {
    /// Its word, as a number's bits.
    word: R,
    /// Index of the word that has the list of its block, as a number's bits.
    header: R,
    /// Coordinates of its corner, in units from the center.
    corner: Vec3<R>,
    /// Its edge, in units.
    edge: R,
}

bundle!(Located { word, header, corner, edge });

/// Functions of a program's lists that give distances.
#[derive(Clone, Copy, Debug)]
pub struct DistanceLists<'a, 'b>(pub &'a Program<'b>);

impl<R: Real> ListFunctions<R> for DistanceLists<'_, '_> {
    type Value = R;

    fn leaf_names(&self) -> &[&'static str] {
        &LEAVES[..self.0.family_count()]
    }

    fn join_names(&self) -> &[&'static str] {
        &JOINS[..self.0.join_family_count()]
    }

    fn depth(&self) -> usize {
        self.0.depth()
    }

    fn leaf(&self, family: usize, row: Option<u32>, p: Vec3<R>) -> R {
        let leaf = self.0.leaf_at(family, row);
        // A row begins with the index of the object.
        p.x.uniform(leaf.object as f32);
        leaf.distance(p)
    }

    fn join(&self, family: usize, row: Option<u32>, below: R, value: R) -> R {
        self.0.join_at(family, row).apply(below, value)
    }
}

/// Functions that also give the nearest object; if several are equally near, the first.
#[derive(Clone, Copy, Debug)]
struct ObjectLists<'a, 'b> {
    program: &'a Program<'b>,
    /// Whether objects are given by their ids instead of their indices.
    by_id: bool,
}

/// A distance, and the index of the nearest object, or its id.
#[derive(Clone, Copy, Debug)]
struct Nearest<R> {
    distance: R,
    object: R,
}

bundle!(Nearest { distance, object });

impl<R: Real> ListFunctions<R> for ObjectLists<'_, '_> {
    type Value = Nearest<R>;

    fn leaf_names(&self) -> &[&'static str] {
        let names = if self.by_id { &ID_LEAVES } else { &NEAR_LEAVES };
        &names[..self.program.family_count()]
    }

    fn join_names(&self) -> &[&'static str] {
        let names = if self.by_id { &ID_JOINS } else { &NEAR_JOINS };
        &names[..self.program.join_family_count()]
    }

    fn depth(&self) -> usize {
        self.program.depth()
    }

    fn leaf(&self, family: usize, row: Option<u32>, p: Vec3<R>) -> Nearest<R> {
        let leaf = self.program.leaf_at(family, row);
        let (index, distance) = (p.x.uniform(leaf.object as f32), leaf.distance(p));
        let Some(id) = leaf.id.filter(|_| self.by_id) else { return Nearest { object: index, distance } };
        // Numbers are asked for in the order in which a row has them.
        leaf.weights_by_slot(p);
        leaf.way(p);
        Nearest { object: R::from_bits(p.x.uniform_bits(id)), distance }
    }

    fn join(&self, family: usize, row: Option<u32>, below: Nearest<R>, value: Nearest<R>) -> Nearest<R> {
        let kind = self.program.join_at(family, row);
        let distance = kind.apply(below.distance, value.distance);
        // Values of other joins are of one object.
        let object = if kind.is_of_objects() {
            R::select(value.distance.lt(below.distance), value.object, below.object)
        } else {
            value.object
        };
        Nearest { distance, object }
    }
}

impl<R: Real> Located<R> {
    /// Lower bound of the distance in the cell, 0 if there may be a surface.
    pub fn bound(&self) -> R {
        let zero = self.word.constant(0.0);
        R::select(self.has_list(), zero, R::from_bits(self.word.to_bits() << 1))
    }

    /// Whether the cell may have a surface.
    fn has_list(&self) -> R::Mask {
        is_set::<R>(self.word.to_bits(), KIND_SHIFT)
    }

    /// Index of its list: its own, if it may have a surface.
    fn own_list(&self) -> R::Bits {
        self.word.to_bits() & ((LIST << KIND_SHIFT) - 1)
    }
}

impl Cells<'_> {
    /// Number of operations in the list of a point's cell; 0 if no surface is in the cell.
    pub fn list_length(&self, p: Vec3<f32>) -> usize {
        let (words, cell) = (self.tree.words(), self.locate(p));
        let mut starts = (cell.own_list().0..).step_by(OPERATION_WORDS as usize);
        if cell.has_list() { 1 + starts.position(|start| words.get(start) & IS_LAST != 0).unwrap_or(0) } else { 0 }
    }

    /// Coordinates of the smallest cell of a point, from the center, and whether it is outside of all cells.
    fn units<R: Real>(&self, p: Vec3<R>) -> (Vec3<R>, R::Mask) {
        let frame = self.tree.frame();
        let units = p - Vec3::uniform(p.x, frame.center);
        let units = units.map(|c| (c * c.uniform(1.0 / frame.unit)).floor());
        let half = p.x.uniform(0.5 * BLOCK_EDGE.pow(frame.levels) as f32);
        // Inside, they are from -half to half - 1.
        let farthest = units.map(|c| (c + 0.5).abs()).max_element();
        (units, half.lt(farthest))
    }

    /// The cell of a point.
    pub fn locate<R: Real>(&self, p: Vec3<R>) -> Located<R> {
        p.x.call(FunctionKey::new("locate"), p, |p| {
            let (tree, frame) = (&self.tree, self.tree.frame());
            let (units, is_outside) = self.units(p);
            let half = p.x.uniform(0.5 * BLOCK_EDGE.pow(frame.levels) as f32);
            // Two bits for each level, the outermost first.
            let to_top = p.x.uniform_bits(1 << (32 - 2 * frame.levels));
            let path = units.map(|c| {
                let c = (-half).max(c.min(half - 1.0)) + half;
                R::from_bits(((c + TO_INTEGER).to_bits() & 0x7f_ffff) * to_top)
            });
            let whole = R::from_bits(p.x.uniform_bits(tree.whole_word()));
            let place = p.x.uniform_bits(tree.root);
            let root = R::from_bits(R::word(&tree.words, place));
            let header = R::from_bits(place);
            let brief = R::from_bits(p.x.uniform_bits(tree.brief));
            let has_cells = |word: R| is_set::<R>(word.to_bits(), HAS_CELLS);
            let start = (root, header, path, half + half);
            let found = R::when(has_cells(root), start, || {
                R::repeat(MAX_LEVELS, start, |(word, _, path, edge)| {
                    let is_missing = is_set::<R>(word.to_bits(), KIND_SHIFT);
                    let word = R::when(is_missing, word, || R::from_bits(R::made(&tree.words, word.to_bits())));
                    let block = word.to_bits() & ((LIST << KIND_SHIFT) - 1);
                    let step = |c: R| c.to_bits() >> 30;
                    let child = step(path.x) + step(path.y) * BLOCK_EDGE + step(path.z) * (BLOCK_EDGE * BLOCK_EDGE);
                    // Without room for a block, it became a list; a word that stands in for it has no list of its own.
                    let is_block = has_cells(word);
                    let inner = R::from_bits(R::word(&tree.words, block + child));
                    let word = R::select(is_block, inner, word);
                    let path = path.map(|c| R::from_bits(c.to_bits() << 2));
                    let edge = R::select(is_block, edge * (1.0 / BLOCK_EDGE as f32), edge);
                    let header = R::select(is_block, R::from_bits(block + BLOCK_CELLS), brief);
                    (has_cells(word), (word, header, path, edge))
                })
            });
            let (word, header, _, edge) = found;
            let word = R::select(is_outside, whole, word);
            let per_edge = p.x.constant(1.0) / edge;
            Located { word, header, corner: units.map(|c| (c * per_edge).floor() * edge), edge }
        })
    }

    /// The value of a list at a point. The list is given by the bits of a number.
    pub(crate) fn fold<R: Real>(&self, list: R, p: Vec3<R>) -> R {
        p.x.call(FunctionKey::new("fold"), (list, p), |(list, p)| {
            R::fold(&self.tree.words, list.to_bits(), p, &DistanceLists(&self.program))
        })
    }

    /// List of a cell: also of one without a surface.
    pub(super) fn list<R: Real>(&self, cell: &Located<R>) -> R {
        let of_block = || R::from_bits(R::word(&self.tree.words, cell.header.to_bits()));
        R::when(!cell.has_list(), R::from_bits(cell.own_list()), of_block)
    }

    /// The scene's value at a point, and the index of the nearest object.
    pub fn nearest<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        let list = self.list(&self.locate(p));
        let lists = ObjectLists { program: &self.program, by_id: false };
        let nearest = R::fold(&self.tree.words, list.to_bits(), p, &lists);
        (nearest.distance, nearest.object)
    }

    /// Id of the nearest object at a point, as a number's bits; its index if the program has no ids.
    pub(crate) fn id_of_nearest<R: Real>(&self, p: Vec3<R>) -> R {
        let list = self.list(&self.locate(p));
        R::fold(&self.tree.words, list.to_bits(), p, &ObjectLists { program: &self.program, by_id: true }).object
    }

    /// The scene's value at a point.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.fold(self.list(&self.locate(p)), p)
    }

    /// The scene's value at a point by the list of all operations. For tests.
    pub fn whole_distance(&self, p: Vec3<f32>) -> f32 {
        f32::fold(&self.tree.words, F32Bits(self.tree.whole), p, &DistanceLists(&self.program))
    }

    /// Whether a point is outside of all cells. For tests.
    pub fn is_outside(&self, p: Vec3<f32>) -> bool {
        self.units(p).1
    }

    /// The point on the face of its cell at the lesser x, moved by some of the least steps of `f32`. For tests.
    pub fn on_face(&self, p: Vec3<f32>, steps: i32) -> Vec3<f32> {
        let x = self.locate(p).corner.x * self.tree.frame().unit + self.tree.frame().center.x;
        let x = if x == 0.0 {
            f32::MIN_POSITIVE * steps as f32
        } else {
            f32::from_bits(x.to_bits().wrapping_add_signed(steps))
        };
        vec3(x, p.y, p.z)
    }

    /// From a point of a ray on: the first point in a cell that may have a surface, and the way to the cell's end; or a
    /// point beyond `farthest`.
    pub(crate) fn enter<R: Real>(&self, ray: &Ray<R>, t: R, farthest: R) -> (R, Part<R>) {
        farthest.call(FunctionKey::new("enter"), (*ray, t, farthest), |(ray, t, farthest)| {
            let per_slope = ray.direction.map(|slope| {
                let slope = R::select(slope.abs().below(1e-9), slope.constant(1e-9), slope);
                slope.constant(1.0) / slope
            });
            let start = (t, Part { formula: t, end: t });
            R::repeat(MAX_CELLS, start, |(t, _)| {
                let cell = self.locate(ray.at(t));
                let (end, margin) = self.way_out(&cell, &ray, per_slope, t);
                let is_empty = !cell.has_list();
                let next = R::select(is_empty, (end + margin).max(t + cell.bound()), t);
                let part = Part { formula: R::from_bits(cell.own_list()), end: end - margin };
                (is_empty & next.lt(farthest), (next, part))
            })
        })
    }

    /// Distance along a ray to the end of the cell of the point at `t`, and its error, which moves a point into the next
    /// cell.
    fn way_out<R: Real>(&self, cell: &Located<R>, ray: &Ray<R>, per_slope: Vec3<R>, t: R) -> (R, R) {
        /// Of the coordinates.
        const ERROR: f32 = 8.0 * f32::EPSILON;
        let axis = |origin: R, center: f32, per_slope: R, corner: R| {
            let wall = R::select(per_slope.below(0.0), corner, corner + cell.edge);
            let wall = wall.mul_add(wall.uniform(self.tree.frame().unit), wall.uniform(center));
            (wall - origin) * per_slope
        };
        let Vec3 { x, y, z } = self.tree.frame().center;
        let (o, d, corner) = (ray.origin, per_slope, cell.corner);
        let end = axis(o.x, x, d.x, corner.x).min(axis(o.y, y, d.y, corner.y)).min(axis(o.z, z, d.z, corner.z));
        let size = vec3(o.x.abs(), o.y.abs(), o.z.abs()).max_element() + t;
        (end.max(t), size * ERROR)
    }
}
