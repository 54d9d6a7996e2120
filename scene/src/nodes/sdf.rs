//! The interface of a node.

use super::{Node, Sample};
use crate::bounds::Bounds;
use crate::materials::MaterialUse;
use crate::real::{Real, Vec3};

/// Cost of noise at a point, in evaluations of a simple node.
pub(super) const NOISE_COST: f32 = 20.0;
/// Cost of a fractal.
const FRACTAL_COST: f32 = 32.0;

/// How a node's value relates to the Euclidean distance to its surface, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exactness {
    /// The value is the distance.
    Exact,
    /// The value divided by its Lipschitz factor is never more than the distance.
    Bound,
    /// An estimate, which no Lipschitz factor bounds everywhere; a step of value/stretch still passes no surface.
    Estimate,
}

impl Exactness {
    /// This exactness, but at most a bound: for a formula around it that gives a bound.
    pub(crate) fn at_best_bound(self) -> Self {
        match self {
            Self::Exact | Self::Bound => Self::Bound,
            Self::Estimate => Self::Estimate,
        }
    }
}

/// What is wrong with the numbers of a node, a light or a background taken together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeFault {
    /// Where in it: a key, or a path of keys and places such as `points/2`.
    pub place: String,
    /// Message with the fix, continuing a sentence after the pointer.
    pub message: String,
}

impl NodeFault {
    /// Error at a pointer within the node.
    pub fn new(place: impl Into<String>, message: impl Into<String>) -> Self {
        Self { place: place.into(), message: message.into() }
    }

    /// The same, seen from what holds it under a key.
    pub(crate) fn inside(self, key: &str) -> Self {
        let separator = if self.place.is_empty() { "" } else { "/" };
        Self { place: format!("{key}{separator}{}", self.place), message: self.message }
    }
}

/// A node: a shape or an operator.
pub trait Sdf {
    /// A small valid value, as a user would write it: the picture in docs/nodes.md and the contract tests use it.
    const EXAMPLE: &'static str;

    /// Further values that take other ways through the formula, drawn and tested like the first.
    const MORE: &'static [&'static str] = &[];

    /// All values to be drawn and tested.
    fn examples() -> Vec<String> {
        std::iter::once(&Self::EXAMPLE).chain(Self::MORE).map(ToString::to_string).collect()
    }

    /// The signed distance at `p`, negative inside, with materials where `V` keeps them.
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V;

    /// Whether its children are a list under `of`, and not one under `child`.
    const HAS_LIST: bool = false;

    /// The nodes inside, in order.
    fn children(&self) -> &[Node] {
        &[]
    }

    /// Mutable access to the children.
    fn children_mut(&mut self) -> &mut [Node] {
        &mut []
    }

    /// Precomputes what speeds up its evaluation; its children have done so before. If the job is
    /// animated, the result must have the same form in all frames.
    fn prepare(&mut self, moves: bool) {
        let _ = moves;
    }

    /// Material that it names, if any.
    fn material(&self) -> Option<&MaterialUse> {
        None
    }

    /// Mutable access to that material.
    fn material_mut(&mut self) -> Option<&mut MaterialUse> {
        None
    }

    /// A Lipschitz factor: |d(p) − d(q)| ≤ stretch · |p − q|. A march divides by it.
    fn stretch(&self) -> f32 {
        self.children().iter().map(Node::stretch).fold(1.0, f32::max)
    }

    /// Relation of its value to the true distance: the worst of its children's.
    fn exactness(&self) -> Exactness {
        self.children().iter().map(Node::exactness).fold(Exactness::Exact, Exactness::max)
    }

    /// Whether its surface has details of every size, so that some are smaller than any pixel: a normal is then
    /// the mean over a pixel.
    fn is_fine(&self) -> bool {
        self.children().iter().any(Node::is_fine)
    }

    /// Error in its numbers taken together, if any; each alone is in range.
    fn fault(&self) -> Option<NodeFault> {
        None
    }

    /// A box that holds every point whose distance is at most `level`, which is not below 0.
    fn bounds(&self, level: f32) -> Bounds;

    /// Its size in simple nodes, without its children.
    fn weight(&self) -> u32 {
        1
    }

    /// Cost of its own formula beyond its weight, in evaluations of a simple node.
    fn formula_cost(&self) -> f32 {
        let is_fractal = self.children().is_empty() && self.exactness() == Exactness::Estimate;
        if is_fractal { FRACTAL_COST } else { 0.0 }
    }

    /// How many times one evaluation of it evaluates the nodes inside, at most.
    fn child_evaluations(&self) -> f32 {
        1.0
    }

    /// What to change if its Lipschitz factor is so high that steps are tiny: the fix in the warning of that.
    fn lipschitz_advice(&self) -> &'static str {
        "change it less, or over a greater length"
    }
}

/// Node without children, described by its distance alone.
pub trait Primitive {
    /// A small valid value, as a user would write it.
    const EXAMPLE: &'static str;

    /// Further values that take other ways through the formula.
    const MORE: &'static [&'static str] = &[];

    /// All values to be drawn and tested.
    fn examples() -> Vec<String> {
        std::iter::once(&Self::EXAMPLE).chain(Self::MORE).map(ToString::to_string).collect()
    }

    /// The signed distance from `p` to the surface, negative inside.
    fn distance<R: Real>(&self, p: Vec3<R>) -> R;

    /// A box that holds every point whose distance is at most `level`, which is not below 0.
    fn bounds(&self, level: f32) -> Bounds;

    /// A Lipschitz factor: |d(p) − d(q)| ≤ stretch · |p − q|.
    fn stretch(&self) -> f32 {
        1.0
    }

    /// Relation of its value to the true distance.
    fn exactness(&self) -> Exactness {
        Exactness::Exact
    }

    /// Whether its surface has details of every size, see [`Sdf::is_fine`].
    fn is_fine(&self) -> bool {
        false
    }

    /// Error in its numbers taken together, if any; each alone is in range.
    fn fault(&self) -> Option<NodeFault> {
        None
    }

    /// Its size in simple nodes.
    fn weight(&self) -> u32 {
        1
    }

    /// Cost of its own formula beyond its weight, in evaluations of a simple node.
    fn formula_cost(&self) -> f32 {
        if self.exactness() == Exactness::Estimate { FRACTAL_COST } else { 0.0 }
    }

    /// What to change if its Lipschitz factor is so high that steps are tiny: the fix in the warning of that.
    fn lipschitz_advice(&self) -> &'static str {
        "change it less, or over a greater length"
    }
}

impl<P: Primitive> Sdf for P {
    const EXAMPLE: &'static str = <P as Primitive>::EXAMPLE;
    const MORE: &'static [&'static str] = <P as Primitive>::MORE;

    fn examples() -> Vec<String> {
        <P as Primitive>::examples()
    }

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        V::new(self.distance(p))
    }

    fn stretch(&self) -> f32 {
        Primitive::stretch(self)
    }

    fn exactness(&self) -> Exactness {
        Primitive::exactness(self)
    }

    fn is_fine(&self) -> bool {
        Primitive::is_fine(self)
    }

    fn fault(&self) -> Option<NodeFault> {
        Primitive::fault(self)
    }

    fn bounds(&self, level: f32) -> Bounds {
        Primitive::bounds(self, level)
    }

    fn weight(&self) -> u32 {
        Primitive::weight(self)
    }

    fn formula_cost(&self) -> f32 {
        Primitive::formula_cost(self)
    }

    fn lipschitz_advice(&self) -> &'static str {
        Primitive::lipschitz_advice(self)
    }
}
