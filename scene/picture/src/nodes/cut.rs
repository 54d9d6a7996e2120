//! How a scene is cut into leaves: unions are cut into their parts, and what only moves or paints its child is passed.

use super::copies::Placements;
use super::operators::{fold_indexed, is_grouped};
use super::{Distance, Node, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::values::LengthOrZero;
use std::cell::RefCell;

/// A node as seen from its children.
#[derive(Debug)]
pub enum Cut<'a> {
    /// A leaf, with all that is below it.
    Leaf,
    /// Its value is its child's, at the point that `to_child` gives.
    Child(&'a Node),
    /// The union of these parts, in order, with a seam of this width.
    Union(&'a LengthOrZero, Vec<Part<'a>>),
}

/// Part of a union.
#[derive(Clone, Copy, Debug)]
pub enum Part<'a> {
    /// A shape.
    Shape(&'a Node),
    /// A copy of a shape, at a placement of this index.
    Copy(&'a Placements, usize, &'a Node),
}

/// Step of the combination of a union's parts.
#[derive(Clone, Copy, Debug)]
pub enum FoldStep<'a> {
    /// A group begins with a part.
    First(Part<'a>),
    /// A part joins its group.
    Next(Part<'a>),
    /// A group joins the one before.
    Join,
}

impl<'a> Part<'a> {
    /// The signed distance at `p`.
    pub fn distance<R: Real>(self, p: Vec3<R>) -> R {
        let Distance(distance) = self.sample(p);
        distance
    }

    /// Its value at `p`.
    pub fn sample<R: Real, V: SdfValue<R>>(self, p: Vec3<R>) -> V {
        match self {
            Self::Shape(shape) => shape.sample(p),
            Self::Copy(placements, index, shape) => placements.sample(index, |q| shape.sample(q), p),
        }
    }

    /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
    pub fn bounds(self, isolevel: f32) -> Bounds {
        match self {
            Self::Shape(shape) => shape.bounds(isolevel),
            Self::Copy(placements, index, shape) => placements.bounds_of(index, isolevel, |own| shape.bounds(own)),
        }
    }

    /// The node that it is or copies.
    pub fn node(self) -> &'a Node {
        match self {
            Self::Shape(shape) | Self::Copy(_, _, shape) => shape,
        }
    }
}

impl Node {
    /// Whether it is a sharp union of shapes, perhaps moved as a whole.
    pub fn is_union(&self) -> bool {
        match self.cut() {
            Cut::Child(child) => child.is_union(),
            Cut::Union(smooth, parts) => {
                smooth.is_zero() && parts.len() > 1 && parts.iter().all(|part| matches!(part, Part::Shape(_)))
            }
            Cut::Leaf => false,
        }
    }
}

/// Calls `see` with the steps in which the parts of a union are combined, in order.
pub fn for_each_step<'a>(parts: &[Part<'a>], smooth: &LengthOrZero, see: impl FnMut(FoldStep<'a>)) {
    let see = RefCell::new(see);
    // The value of a part whose step comes with its join; none of a group whose steps have been seen.
    // The order of sharp joins changes no value, and groups are left out of lists together.
    let in_groups = smooth.is_zero() || is_grouped(parts.len(), smooth);
    let all = fold_indexed(parts.len(), in_groups, &mut |index| Some(parts[index]), &|first, second| {
        let see = &mut *see.borrow_mut();
        if let Some(first) = first {
            see(FoldStep::First(first));
        }
        see(second.map_or(FoldStep::Join, FoldStep::Next));
        None
    });
    if let Some(only) = all {
        see.into_inner()(FoldStep::First(only));
    }
}
