//! Motion of surfaces until the next frame, by the lists of cells.

use super::program::{Above, Leaf};
use super::walk::function_names;
use super::{Cells, Program};
use crate::nodes::{Carried, Part};
use crate::real::list::ListFunctions;
use crate::real::{Real, Vec3, bundle, vec3};

function_names![MOTION_LEAVES "leaf_of_motion_", MOTION_JOINS "join_of_motion_"];

/// A distance, and the way of the surface's point in space.
#[derive(Clone, Copy, Debug)]
struct Moved<R> {
    distance: R,
    way: Vec3<R>,
}

bundle!(Moved { distance, way });

/// Functions of a program's lists that also give the ways of surfaces.
#[derive(Clone, Copy, Debug)]
struct MotionLists<'a, 'b>(&'a Program<'b>);

impl Leaf<'_> {
    /// The way of its surface at a point of the scene; `None` if nothing moves it, or if motion is not wanted.
    pub(super) fn way<R: Real>(&self, p: Vec3<R>) -> Option<Vec3<R>> {
        let next = self.next()?;
        let of_shape = |q: Vec3<R>| match (self.shape(), next.shape) {
            (Part::Shape(shape), Part::Shape(moved)) => shape.carry(moved, q),
            (Part::Copy(placements, index, shape), Part::Copy(_, _, moved)) => {
                placements.sample(index, |q| shape.carry(moved, q), q)
            }
            (Part::Shape(_), Part::Copy(..)) | (Part::Copy(..), Part::Shape(_)) => {
                unreachable!("a job has the same nodes in all frames")
            }
        };
        carry_above(self.above(), &next.above, p, &of_shape).way()
    }
}

/// Value at `p` of a shape below transforms, the outermost first, which are `next` in the next frame.
fn carry_above<R: Real>(
    above: &[Above<'_>],
    next: &[Above<'_>],
    p: Vec3<R>,
    shape: &dyn Fn(Vec3<R>) -> Carried<R>,
) -> Carried<R> {
    let (Some((outermost, above)), Some((moved, next))) = (above.split_first(), next.split_first()) else {
        return shape(p);
    };
    let below = |q| carry_above(above, next, q, shape);
    match (*outermost, *moved) {
        (Above::Node(node), Above::Node(moved)) => node.carry_around(moved, p, &|_, q| below(q)),
        (Above::Copy(placements, index), Above::Copy(..)) => placements.sample(index, below, p),
        (Above::Node(_), Above::Copy(..)) | (Above::Copy(..), Above::Node(_)) => {
            unreachable!("a job has the same nodes in all frames")
        }
    }
}

impl<R: Real> ListFunctions<R> for MotionLists<'_, '_> {
    type Value = Moved<R>;

    fn leaf_names(&self) -> &[&'static str] {
        &MOTION_LEAVES[..self.0.family_count()]
    }

    fn join_names(&self) -> &[&'static str] {
        &MOTION_JOINS[..self.0.join_family_count()]
    }

    fn depth(&self) -> usize {
        self.0.depth()
    }

    fn leaf(&self, family: usize, row: Option<u32>, p: Vec3<R>) -> Moved<R> {
        let leaf = self.0.leaf_at(family, row);
        // Numbers are asked for in the order in which a row has them.
        p.x.uniform(leaf.object as f32);
        let distance = leaf.distance(p);
        leaf.weights_by_slot(p);
        let zero = p.x.constant(0.0);
        Moved { distance, way: leaf.way(p).unwrap_or(vec3(zero, zero, zero)) }
    }

    fn join(&self, family: usize, row: Option<u32>, below: Moved<R>, value: Moved<R>) -> Moved<R> {
        let kind = self.0.join_at(family, row);
        let distance = kind.apply(below.distance, value.distance);
        let second = kind.second_weight(below.distance, value.distance);
        let first = second.constant(1.0) - second;
        Moved { distance, way: below.way * first + value.way * second }
    }
}

impl Cells<'_> {
    /// The way of the surface at a point until the next frame; `None` if nothing moves.
    pub(crate) fn way<R: Real>(&self, p: Vec3<R>) -> Option<Vec3<R>> {
        self.program().is_moved().then(|| {
            let list = self.list(&self.locate(p));
            R::fold(self.tree().words(), list.to_bits(), p, &MotionLists(self.program())).way
        })
    }
}
