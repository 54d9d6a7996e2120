//! The interface of a node.

use super::cut::Cut;
use super::{Node, SdfValue};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::materials::MaterialRef;
use crate::real::{Real, Vec3};
use crate::values::Rotation;

/// Cost of noise at a point, in evaluations of a simple node.
pub(super) const NOISE_COST: f32 = 20.0;
/// Cost of a fractal.
const FRACTAL_COST: f32 = 32.0;

/// A node: a shape or an operator.
pub trait Sdf {
    /// A small valid value, as a user would write it, for the picture in docs/nodes.md and for the contract tests.
    const EXAMPLE: &'static str;

    /// Further values that exercise other branches of the formula, rendered and tested like the first.
    const MORE_EXAMPLES: &'static [&'static str] = &[];

    /// All values to be rendered and tested.
    fn examples() -> Vec<String> {
        std::iter::once(&Self::EXAMPLE).chain(Self::MORE_EXAMPLES).map(ToString::to_string).collect()
    }

    /// The signed distance at `p`, negative inside, with materials where `V` keeps them. `sample` gives the value of a
    /// child, by its index, at a point in the child's space.
    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V;

    /// The way of a point of a child until the next frame, in which the node is `next`, in the space around the node. The
    /// point is `p` there and `q` in the child's space, where its way is given; `None` if nothing moves it.
    fn way_from_child<R: Real>(&self, next: &Self, [p, q]: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> {
        let _ = (next, p, q);
        way
    }

    /// Whether its children are a list under `of` instead of one under `child`.
    const HAS_CHILD_LIST: bool = false;

    /// Its child nodes, in order.
    fn children(&self) -> &[Node] {
        &[]
    }

    /// Mutable access to the children.
    fn children_mut(&mut self) -> &mut [Node] {
        &mut []
    }

    /// A node under `on` that it measures and does not show, if any.
    fn base(&self) -> Option<&Node> {
        None
    }

    /// Mutable access to that node.
    fn base_mut(&mut self) -> Option<&mut Node> {
        None
    }

    /// Cost of measuring that node, in evaluations of a simple node for each of its evaluations per copy.
    fn placing_cost(&self) -> f32 {
        0.0
    }

    /// Heights of its middle copy and of a lowest one that missed the shape that the others are on.
    fn fallen_copies(&self) -> Option<(f32, f32)> {
        None
    }

    /// How it is cut into leaves.
    fn cut(&self) -> Cut<'_> {
        Cut::Leaf
    }

    /// The point in the space of its child, if it is [`Cut::Child`].
    fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
        p
    }

    /// Bounds in the space around it, if it is [`Cut::Child`].
    fn bounds_from_child(&self, child: Bounds) -> Bounds {
        child
    }

    /// Precomputes values that speed up its evaluation; its children have been precomputed before. If the job is
    /// animated, the result must have the same form in all frames.
    fn precompute(&mut self, is_animated: bool) {
        let _ = is_animated;
    }

    /// Material of all of its shape, if it names one.
    fn material(&self) -> Option<&MaterialRef> {
        None
    }

    /// Materials that it names; one of a placement has the placement's index.
    fn materials(&self) -> Vec<(Option<usize>, &MaterialRef)> {
        Vec::new()
    }

    /// Mutable access to these materials.
    fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> {
        Vec::new()
    }

    /// Number of nodes in its children, each counted as often as it is copied; saturating. `children` has the number
    /// in each.
    fn nodes_in_children(&self, children: &mut dyn Iterator<Item = u64>) -> u64 {
        children.fold(0, u64::saturating_add)
    }

    /// A Lipschitz factor L: |d(p) − d(q)| ≤ L · |p − q|. A march divides by it.
    fn lipschitz(&self) -> f32 {
        self.children().iter().map(Node::stretch).fold(1.0, f32::max)
    }

    /// Relation of its value to the true distance: the worst of its children's.
    fn exactness(&self) -> Exactness {
        self.children().iter().map(Node::exactness).fold(Exactness::Exact, Exactness::max)
    }

    /// Whether its surface has fine detail at every scale, some of it smaller than any pixel. A normal is then
    /// averaged over a pixel.
    fn is_fine(&self) -> bool {
        self.children().iter().any(Node::is_fine)
    }

    /// Error in its numbers taken together, if any; each number alone is in range.
    fn validate(&self) -> Option<NodeError> {
        None
    }

    /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
    fn bounds(&self, isolevel: f32) -> Bounds;

    /// Its size in simple nodes, without its children.
    fn size_in_nodes(&self) -> u32 {
        1
    }

    /// Cost of its own formula beyond its weight, in evaluations of a simple node.
    fn formula_cost(&self) -> f32 {
        let is_fractal = self.children().is_empty() && self.exactness() == Exactness::Estimate;
        if is_fractal { FRACTAL_COST } else { 0.0 }
    }

    /// Maximum number of child evaluations in one evaluation of the node.
    fn child_evaluations(&self) -> f32 {
        1.0
    }

    /// Whether it subtracts its other children from the first.
    fn subtracts(&self) -> bool {
        false
    }

    /// The angles by which it rotates its child about the axes, if it does nothing else.
    fn rotation(&self) -> Option<&Rotation> {
        None
    }

    /// Whether its child's position is animated.
    fn is_placement_animated(&self) -> bool {
        false
    }

    /// Name of the shape that it stands for, if it is a `use`.
    fn used_shape(&self) -> Option<&str> {
        None
    }

    /// Advice for the warning that its Lipschitz factor is so high that steps are tiny.
    fn lipschitz_advice(&self) -> &'static str {
        "change it less, or over a greater length"
    }
}

/// Node without children, described by its distance alone.
pub trait Primitive {
    /// A small valid value, as a user would write it.
    const EXAMPLE: &'static str;

    /// Further values that exercise other branches of the formula.
    const MORE_EXAMPLES: &'static [&'static str] = &[];

    /// All values to be rendered and tested.
    fn examples() -> Vec<String> {
        std::iter::once(&Self::EXAMPLE).chain(Self::MORE_EXAMPLES).map(ToString::to_string).collect()
    }

    /// The signed distance from `p` to the surface, negative inside.
    fn distance<R: Real>(&self, p: Vec3<R>) -> R;

    /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
    fn bounds(&self, isolevel: f32) -> Bounds;

    /// A Lipschitz factor L: |d(p) − d(q)| ≤ L · |p − q|.
    fn lipschitz(&self) -> f32 {
        1.0
    }

    /// Relation of its value to the true distance.
    fn exactness(&self) -> Exactness {
        Exactness::Exact
    }

    /// Whether its surface has fine detail at every scale, see [`Sdf::is_fine`].
    fn is_fine(&self) -> bool {
        false
    }

    /// Error in its numbers taken together, if any; each number alone is in range.
    fn validate(&self) -> Option<NodeError> {
        None
    }

    /// Its size in simple nodes.
    fn size_in_nodes(&self) -> u32 {
        1
    }

    /// Cost of its own formula beyond its weight, in evaluations of a simple node.
    fn formula_cost(&self) -> f32 {
        if self.exactness() == Exactness::Estimate { FRACTAL_COST } else { 0.0 }
    }

    /// Advice for the warning that its Lipschitz factor is so high that steps are tiny.
    fn lipschitz_advice(&self) -> &'static str {
        "change it less, or over a greater length"
    }
}

impl<P: Primitive> Sdf for P {
    const EXAMPLE: &'static str = <P as Primitive>::EXAMPLE;
    const MORE_EXAMPLES: &'static [&'static str] = <P as Primitive>::MORE_EXAMPLES;

    fn examples() -> Vec<String> {
        <P as Primitive>::examples()
    }

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, _: &impl Fn(usize, Vec3<R>) -> V) -> V {
        V::new(self.distance(p))
    }

    fn lipschitz(&self) -> f32 {
        Primitive::lipschitz(self)
    }

    fn exactness(&self) -> Exactness {
        Primitive::exactness(self)
    }

    fn is_fine(&self) -> bool {
        Primitive::is_fine(self)
    }

    fn validate(&self) -> Option<NodeError> {
        Primitive::validate(self)
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        Primitive::bounds(self, isolevel)
    }

    fn size_in_nodes(&self) -> u32 {
        Primitive::size_in_nodes(self)
    }

    fn formula_cost(&self) -> f32 {
        Primitive::formula_cost(self)
    }

    fn lipschitz_advice(&self) -> &'static str {
        Primitive::lipschitz_advice(self)
    }
}
