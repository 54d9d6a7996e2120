//! The cell of a point, the value of its list there, and the way of a ray out of it.

use super::Cells;
use super::program::{JoinKind, MAX_FAMILIES, MAX_STACK};
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
pub const FAMILY_NAMES: [&str; MAX_FAMILIES] = names!["leaf_": 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29
    30 31 32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47];

/// The bits of an operation's word that are a row.
const ROW_MASK: u32 = (1 << ROW_BITS) - 1;

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

/// Value of a list.
trait FoldValue<R: Real>: Bundle<R> {
    /// A value that is not used.
    fn nothing(like: R) -> Self;
    fn distance(&self) -> R;
    fn select(mask: R::Mask, yes: Self, no: Self) -> Self;
    /// The join of two values, whose distance is this.
    fn joined(self, value: Self, distance: R, kind: JoinKind<'_>) -> Self;
}

impl<R: Real> FoldValue<R> for R {
    fn nothing(like: R) -> R {
        like.constant(0.0)
    }

    fn distance(&self) -> R {
        *self
    }

    fn select(mask: R::Mask, yes: R, no: R) -> R {
        <R as Real>::select(mask, yes, no)
    }

    fn joined(self, _: R, distance: R, _: JoinKind<'_>) -> R {
        distance
    }
}

/// A distance, and the index of the nearest object; if several are equally near, of the first.
#[derive(Clone, Copy, Debug)]
struct Nearest<R> {
    distance: R,
    object: R,
}

bundle!(Nearest { distance, object });

impl<R: Real> FoldValue<R> for Nearest<R> {
    fn nothing(like: R) -> Self {
        Self { distance: like.constant(0.0), object: like.constant(0.0) }
    }

    fn distance(&self) -> R {
        self.distance
    }

    fn select(mask: R::Mask, yes: Self, no: Self) -> Self {
        let select = <R as Real>::select;
        Self { distance: select(mask, yes.distance, no.distance), object: select(mask, yes.object, no.object) }
    }

    fn joined(self, value: Self, distance: R, kind: JoinKind<'_>) -> Self {
        let object = match kind {
            JoinKind::Objects => <R as Real>::select(value.distance.lt(self.distance), value.object, self.object),
            // Both are of one object.
            JoinKind::Union(_) | JoinKind::Scale(_) => value.object,
        };
        Self { distance, object }
    }
}

/// Values that wait for a join, the last first; absent beyond the depth of the scene's joins.
#[derive(Clone, Copy, Debug)]
struct Stack<V> {
    top: V,
    waiting: [Option<V>; MAX_STACK - 1],
}

impl<R: Real, V: Bundle<R>> Bundle<R> for Stack<V> {
    fn merge(self, other: Self, how: &mut impl Merge<R>) -> Self {
        let mut waiting = self.waiting;
        for (place, other) in waiting.iter_mut().zip(other.waiting) {
            *place = place.merge(other, how);
        }
        Self { top: self.top.merge(other.top, how), waiting }
    }
}

impl<V: Copy> Stack<V> {
    fn new(nothing: V, depth: usize) -> Self {
        Self { top: nothing, waiting: std::array::from_fn(|index| (index + 1 < depth).then_some(nothing)) }
    }

    /// The last value that waits, below the top.
    fn below(&self) -> V {
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
            let (tree, frame) = (&self.tree, self.tree.frame());
            let units = p - Vec3::uniform(p.x, frame.center);
            let units = units.map(|c| (c * c.uniform(1.0 / frame.unit)).floor());
            let half = p.x.uniform(0.5 * BLOCK_EDGE.pow(frame.levels) as f32);
            let outermost = units.map(Real::abs).max_element();
            // The outermost cell has the low end of each axis, but not the high end.
            let is_outside = (half - 1.0).lt(outermost);
            // Two bits for each level, the outermost first.
            let to_top = p.x.uniform_bits(1 << (32 - 2 * frame.levels));
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
        p.x.call("fold", (cell.list, p), |(list, p)| self.fold_values(list, p, |_, distance| distance))
    }

    /// The scene's value at a point, and the index of the nearest object.
    pub fn nearest<R: Real>(&self, p: Vec3<R>) -> (R, R) {
        let cell = self.locate(p);
        let object = |row: R::Bits, _: R| R::from_bits(R::word(&self.tree.words, row + u32::MAX));
        let Nearest { distance, object } =
            self.fold_values(cell.list, p, |row, distance| Nearest { distance, object: object(row, distance) });
        (distance, object)
    }

    /// The value of a list at a point. `value_of` makes a value of a leaf's row and distance.
    fn fold_values<R: Real, V: FoldValue<R>>(&self, list: R, p: Vec3<R>, value_of: impl Fn(R::Bits, R) -> V) -> V {
        let words = &self.tree.words;
        let nothing = V::nothing(p.x);
        let start = (list, Stack::new(nothing, self.program.depth()));
        let (_, stack) = R::repeat(MAX_OPERATIONS, start, |(at, stack)| {
            let place = at.to_bits();
            let (leaf, join) = (R::word(words, place), R::word(words, place + 1));
            let takes_leaf = is_other(p.x, family(leaf), NO_LEAF);
            let value = R::when(takes_leaf, stack.top, || value_of(leaf & ROW_MASK, self.leaf(leaf, p)));
            let below = V::select(takes_leaf, stack.top, stack.below());
            let joined = self.join(join, below, value);
            let joins = is_other(p.x, family(join), 0);
            let stack = R::when(takes_leaf & !joins, stack, || stack.pushed());
            let stack = R::when(!takes_leaf & self.is_binary(p.x, join), stack, || stack.popped());
            let next = R::from_bits(place + 2);
            (!is_set(p.x, leaf), (next, Stack { top: joined, ..stack }))
        });
        stack.top
    }

    /// Distance of a leaf.
    fn leaf<R: Real>(&self, word: R::Bits, p: Vec3<R>) -> R {
        let row = R::from_bits(word & ROW_MASK);
        let mut value = p.x.constant(0.0);
        for (index, name) in FAMILY_NAMES.into_iter().enumerate().take(self.program.family_count()) {
            let is_this = is_equal(p.x, family(word), index as u32);
            let inside = || {
                let distance =
                    |(row, p): (R, Vec3<R>)| self.program.family_distance(&self.tree.words, index, row.to_bits(), p);
                p.x.call(name, (row, p), distance)
            };
            value = if self.program.family_count() == 1 { inside() } else { R::when(is_this, value, inside) };
        }
        value
    }

    /// Joins a value with the one below.
    fn join<R: Real, V: FoldValue<R>>(&self, word: R::Bits, below: V, value: V) -> V {
        let row = word & ROW_MASK;
        let mut joined = value;
        for index in 0..self.program.join_families().len() {
            let is_this = is_equal(value.distance(), family(word), index as u32 + 1);
            joined = R::when(is_this, joined, || {
                let kind = self.program.family_join::<R>(index, row);
                let distance = R::with_row(&self.tree.words, row, || kind.apply(below.distance(), value.distance()));
                below.joined(value, distance, kind)
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
        let x = self.locate(p).corner.x * self.tree.frame().unit + self.tree.frame().center.x;
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
            let wall = wall.mul_add(wall.uniform(self.tree.frame().unit), wall.uniform(center));
            (wall - origin) / slope
        };
        let Vec3 { x, y, z } = self.tree.frame().center;
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
