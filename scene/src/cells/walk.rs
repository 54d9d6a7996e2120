//! The cell of a point, the value of its list there, and the way of a ray out of it.

use super::Cells;
use super::program::MAX_STACK;
use super::tree::{BLOCK_EDGE, MAX_LEVELS, NO_LEAF, OUTSIDE, ROW_BITS};
use crate::camera::Ray;
use crate::real::{Bits, Bundle, Merge, Real, Vec3, bundle, vec3};

/// Maximum number of operations of a list.
const MAX_OPERATIONS: u32 = 1 << 24;
/// 2²³: the bits of this plus an integer below it are those of the integer, apart from the exponent.
const TO_INTEGER: f32 = 8_388_608.0;

macro_rules! names {
    ($prefix:literal: $($index:literal)*) => { [$(concat!($prefix, $index)),*] };
}

/// Names of the families' functions in compiled texts.
const LEAVES: [&str; 48] = names!["leaf_": 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29
    30 31 32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47];

/// The cell of a point.
#[derive(Clone, Copy, Debug)]
pub struct Located<R> {
    /// Index of its list, as a number's bits.
    list: R,
    /// Lower bound of the distance in the cell, 0 if there may be a surface.
    pub bound: R,
    /// Coordinates of its corner, in units from the center.
    corner: Vec3<R>,
    /// Its edge, in units.
    edge: R,
}

bundle!(Located { list, bound, corner, edge });

/// Result of a step along a ray: either the distance, or a way that is free.
#[derive(Clone, Copy, Debug)]
pub struct Sampled<R: Real> {
    /// The distance, or a lower bound of it.
    pub distance: R,
    /// Length of the ray's next step.
    pub ahead: R,
    /// Whether there is no surface in the cell.
    pub is_empty: crate::real::MaskValue<R>,
}

/// Values that wait for a join, the last first; absent beyond the depth of the scene's joins.
#[derive(Clone, Copy, Debug)]
struct Stack<R> {
    top: R,
    waiting: [Option<R>; MAX_STACK - 1],
}

impl<R: Real> Bundle<R> for Stack<R> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        let mut waiting = self.waiting;
        for (place, other) in waiting.iter_mut().zip(other.waiting) {
            *place = place.merge(other, how);
        }
        Self { top: self.top.merge(other.top, how), waiting }
    }
}

impl<R: Real> Stack<R> {
    fn new(nothing: R, depth: usize) -> Self {
        Self { top: nothing, waiting: std::array::from_fn(|index| (index + 1 < depth).then_some(nothing)) }
    }

    /// The last value that waits, below the top.
    fn below(&self) -> R {
        self.waiting[0].unwrap_or(self.top)
    }

    /// All values one place down, to make room.
    fn pushed(self) -> Self {
        let mut waiting = self.waiting;
        let mut above = self.top;
        for place in waiting.iter_mut().flatten() {
            std::mem::swap(place, &mut above);
        }
        Self { waiting, ..self }
    }

    /// All values one place up.
    fn popped(self) -> Self {
        let mut waiting = self.waiting;
        for index in 1..waiting.len() {
            if waiting[index].is_some() {
                waiting[index - 1] = waiting[index];
            }
        }
        Self { waiting, ..self }
    }
}

impl Cells<'_> {
    /// The cell of a point.
    pub fn locate<R: Real>(&self, p: Vec3<R>) -> Located<R> {
        p.x.call("locate", p, |p| {
            let tree = &self.tree;
            let units = p - Vec3::uniform(p.x, tree.center);
            let units = units.map(|c| (c * c.uniform(1.0 / tree.unit)).floor());
            let half = p.x.uniform(0.5 * BLOCK_EDGE.pow(tree.levels) as f32);
            let outermost = units.map(|c| c.abs()).max_element();
            // The outermost cell has the low end of each axis, but not the high end.
            let is_outside = (half - 1.0).lt(outermost);
            // Two bits for each level, the outermost first.
            let to_top = p.x.uniform_bits(1 << (32 - 2 * tree.levels));
            let path = units.map(|c| {
                let c = (-half).max(c.min(half - 1.0)) + half;
                R::from_bits(((c + TO_INTEGER).to_bits() & 0x7f_ffff) * to_top)
            });
            let root = R::from_bits(p.x.uniform_bits(0));
            let start = (R::from_bits(R::word(&tree.words, root.to_bits())), path, half + half);
            let divided = |word: R| is_set(p.x, word.to_bits());
            let found = R::when(divided(start.0), start, || {
                R::repeat(MAX_LEVELS, start, |(word, path, edge)| {
                    let step = |c: R| c.to_bits() >> 30;
                    let child = step(path.x) + step(path.y) * BLOCK_EDGE + step(path.z) * (BLOCK_EDGE * BLOCK_EDGE);
                    let word = R::word(&tree.words, (word.to_bits() & 0x7fff_ffff) + child);
                    let path = path.map(|c| R::from_bits(c.to_bits() << 2));
                    (is_set(p.x, word), (R::from_bits(word), path, edge * (1.0 / BLOCK_EDGE as f32)))
                })
            });
            let (word, _, edge) = found;
            let outside = R::word(&tree.words, p.x.uniform_bits(OUTSIDE));
            let record = R::select(is_outside, R::from_bits(outside), word).to_bits();
            let bound = R::from_bits(R::word(&tree.words, record));
            let list = R::from_bits(R::word(&tree.words, record + 1));
            let per_edge = p.x.constant(1.0) / edge;
            Located { list, bound, corner: units.map(|c| (c * per_edge).floor() * edge), edge }
        })
    }

    /// The value of a cell's list at a point.
    pub fn fold<R: Real>(&self, cell: &Located<R>, p: Vec3<R>) -> R {
        p.x.call("fold", (cell.list, p), |(list, p)| {
            let words = &self.tree.words;
            let start = (list, Stack::new(p.x.constant(0.0), self.program.depth()));
            let (_, stack) = R::repeat(MAX_OPERATIONS, start, |(at, stack)| {
                let place = at.to_bits();
                let (leaf, join) = (R::word(words, place), R::word(words, place + 1));
                let takes_leaf = is_other(p.x, family(leaf), NO_LEAF);
                let value = R::when(takes_leaf, stack.top, || self.leaf(leaf, p, stack.top));
                let below = R::select(takes_leaf, stack.top, stack.below());
                let joined = self.join(join, below, value);
                let joins = is_other(p.x, family(join), 0);
                let stack = R::when(takes_leaf & !joins, stack, || stack.pushed());
                let stack = R::when(!takes_leaf & self.is_binary(p.x, join), stack, || stack.popped());
                let next = R::from_bits(place + 2);
                (!is_set(p.x, leaf), (next, Stack { top: joined, ..stack }))
            });
            stack.top
        })
    }

    /// Value of a leaf.
    fn leaf<R: Real>(&self, word: R::Bits, p: Vec3<R>, before: R) -> R {
        let row = R::from_bits(word & ((1 << ROW_BITS) - 1));
        let mut value = before;
        for (index, &representative) in self.program.families().iter().enumerate() {
            let is_this = is_equal(p.x, family(word), index as u32);
            let inside = || {
                p.x.call(LEAVES[index], (row, p), |(row, p)| {
                    let leaf = R::known(row.to_bits()).map_or(representative, |row| self.tree.leaf_of_row(row));
                    R::with_row(&self.tree.words, row.to_bits(), || self.program.leaves()[leaf].distance(p))
                })
            };
            value = if self.program.families().len() == 1 { inside() } else { R::when(is_this, value, inside) };
        }
        value
    }

    /// Joins a value with the one below.
    fn join<R: Real>(&self, word: R::Bits, below: R, value: R) -> R {
        let row = word & ((1 << ROW_BITS) - 1);
        let mut joined = value;
        for (index, &representative) in self.program.join_families().iter().enumerate() {
            let is_this = is_equal(value, family(word), index as u32 + 1);
            joined = R::when(is_this, joined, || {
                let join = R::known(row).map_or(representative, |row| self.tree.join_of_row(row));
                R::with_row(&self.tree.words, row, || self.program.joins()[join].kind.apply(below, value))
            });
        }
        joined
    }

    /// Whether an operation's join takes a value that waits.
    fn is_binary<R: Real>(&self, like: R, join: R::Bits) -> R::Mask {
        let mut is_binary = is_other(like, family(join), 0);
        for (index, &join_index) in self.program.join_families().iter().enumerate() {
            if self.program.joins()[join_index].kind.is_unary() {
                is_binary = is_binary & is_other(like, family(join), index as u32 + 1);
            }
        }
        is_binary
    }

    /// The scene's value at a point.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.fold(&self.locate(p), p)
    }

    /// The point on the face of its cell at the lesser x, moved by some of the least steps of `f32`. For tests.
    pub fn on_face(&self, p: Vec3<f32>, steps: i32) -> Vec3<f32> {
        let x = self.locate(p).corner.x.mul_add(self.tree.unit, self.tree.center.x);
        let x = if x == 0.0 {
            f32::MIN_POSITIVE * steps as f32
        } else {
            f32::from_bits(x.to_bits().wrapping_add_signed(steps))
        };
        vec3(x, p.y, p.z)
    }

    /// Distance along a ray, from `t` on, to the end of the cell of that point, and a little more.
    pub fn way_out<R: Real>(&self, cell: &Located<R>, ray: &Ray<R>, t: R) -> R {
        /// Of the coordinates, so that the point at the end is in the next cell.
        const BEYOND: f32 = 8.0 * f32::EPSILON;
        let axis = |origin: R, center: f32, slope: R, corner: R| {
            let slope = R::select(slope.abs().below(1e-9), slope.constant(1e-9), slope);
            let wall = R::select(slope.below(0.0), corner, corner + cell.edge);
            let wall = wall.mul_add(wall.uniform(self.tree.unit), wall.uniform(center));
            (wall - origin) / slope
        };
        let Vec3 { x, y, z } = self.tree.center;
        let (o, d, corner) = (ray.origin, ray.direction, cell.corner);
        let end = axis(o.x, x, d.x, corner.x).min(axis(o.y, y, d.y, corner.y)).min(axis(o.z, z, d.z, corner.z));
        let size = vec3(o.x.abs(), o.y.abs(), o.z.abs()).max_element() + t;
        (end - t).at_least(0.0) + size * BEYOND
    }
}

/// The family in a word of an operation.
fn family<B: Bits>(word: B) -> B {
    (word >> ROW_BITS) & NO_LEAF
}

/// A small integer as a number.
fn small<R: Real>(word: R::Bits) -> R {
    R::from_bits(word | TO_INTEGER.to_bits()) - TO_INTEGER
}

fn is_equal<R: Real>(_: R, word: R::Bits, value: u32) -> R::Mask {
    (small::<R>(word) - value as f32).abs().below(0.5)
}

fn is_other<R: Real>(_: R, word: R::Bits, value: u32) -> R::Mask {
    (small::<R>(word) - value as f32).abs().above(0.5)
}

/// Whether the highest bit is set.
fn is_set<R: Real>(_: R, word: R::Bits) -> R::Mask {
    small::<R>(word >> 31).above(0.5)
}
