//! Signed distance functions: the family of nodes, and the trait that each implements.
//!
//! A node is one documented struct in a file of its family under `nodes/`, one `impl` of
//! [`Primitive`] or [`Sdf`], and one entry in the list below. Parsing, schema, evaluation in every
//! arithmetic, the contract tests and its picture in docs/nodes.md follow from those.

#[cfg(feature = "added")]
mod added;
mod bvh;
mod carried;
mod copies;
mod cost;
mod cut;
mod displace;
mod displacement_bounds;
mod fractals;
mod modifiers;
mod named;
mod names;
mod operators;
mod per_axis;
mod precomputed;
mod primitives;
mod rotations;
mod scatter;
mod sdf;
mod sweeps;
mod terrain;
mod transforms;
mod value;
mod warp;

#[cfg(feature = "added")]
pub use added::AddedNode;
pub use carried::Carried;
pub use copies::{
    AtPlacements, Copies, GridPlacements, LinePlacements, Placement, PlacementCount, Placements, RingPlacements,
};
pub use cut::{Cut, Part};
pub use cut::{FoldStep, for_each_step};
pub use displace::{Displace, DisplacementFunction, Sine};
pub use displacement_bounds::CachedDisplacementBounds;
pub use fractals::{
    ApollonianGasket, KaleidoscopicFolds, KaleidoscopicIfs, Mandelbox, MandelbrotRelief, Mandelbulb, MengerSponge,
    QuaternionJulia, Sierpinski,
};
pub use modifiers::{
    Bend, CopyCount, Elongate, Mirror, Onion, Paint, PolarRepeat, Repeat, Round, Stretch, Taper, Twist,
};
pub use named::Use;
pub use names::material_pointer;
pub use operators::{
    Chamfer, Columns, Difference, Engrave, Groove, Intersection, Morph, SeamKind, Stairs, Tongue, Union, Xor,
};
pub use operators::{smooth_min, union_weight};
pub use per_axis::PerAxis;
pub use precomputed::{Precompute, Precomputed};
pub use primitives::{
    BezierTube, Box, BoxFrame, CappedCone, CappedTorus, Capsule, Cone, CutHollowSphere, CutSphere, Cylinder, DeathStar,
    Diamond, Dodecahedron, Ellipsoid, Gyroid, HexagonalPrism, Horseshoe, Icosahedron, InfiniteCone, InfiniteCylinder,
    Link, OctagonalPrism, Octahedron, Plane, PolygonSides, Pyramid, Quad, RegularPyramid, Rhombus, RoundCone,
    RoundedCylinder, SchwarzP, SolidAngle, Sphere, Tetrahedron, Torus, Triangle, TriangularPrism, U, Vesica,
};
pub use rotations::rotation_error;
pub use rotations::{Aim, Rotate};
pub use scatter::{BallRegion, BoxRegion, DiscRegion, Scatter, ScatterRegion};
use sdf::FRACTAL_COST;
pub use sdf::Primitive;
pub use sweeps::{Extrude, Revolve};
pub use terrain::HeightField;
pub use transforms::{Scale, Translate};
pub use value::{Distance, DistanceWithMaterials, MaterialWeight, SdfValue};
pub use warp::Warp;

use crate::bounds::Bounds;
use crate::kinds::family;
pub use crate::kinds::{Exactness, Example, NodeError, snake_case};
use crate::materials::MaterialRef;
use crate::real::{Real, Vec3};
use crate::seek::SeekError;

/// A node inside another.
pub type Child = std::boxed::Box<Node>;

// A scene may have a million.
const _: () = assert!(size_of::<Node>() <= 120);

family! {
    /// A shape: one node of an object's tree; an object whose member is the node's name.
    #[seek(then = follow)]
    pub enum Node {
        Sphere(Sphere),
        Box(Box),
        Plane(Plane),
        Cylinder(Cylinder),
        InfiniteCylinder(InfiniteCylinder),
        TriangularPrism(TriangularPrism),
        Pyramid(Pyramid),
        Torus(Torus),
        Capsule(Capsule),
        Mandelbulb(Mandelbulb),
        Union(Union),
        Intersection(Intersection),
        Difference(Difference),
        Translate(Translate),
        Rotate(Rotate boxed),
        Aim(Aim boxed),
        Scale(Scale),
        Paint(Paint),
        CappedTorus(CappedTorus),
        Link(Link),
        Cone(Cone),
        InfiniteCone(InfiniteCone),
        CappedCone(CappedCone),
        RoundCone(RoundCone),
        RoundedCylinder(RoundedCylinder),
        CutSphere(CutSphere),
        CutHollowSphere(CutHollowSphere),
        DeathStar(DeathStar),
        Ellipsoid(Ellipsoid),
        Vesica(Vesica boxed),
        SolidAngle(SolidAngle),
        Horseshoe(Horseshoe),
        U(U),
        Triangle(Triangle),
        Quad(Quad),
        BezierTube(BezierTube),
        BoxFrame(BoxFrame),
        Rhombus(Rhombus),
        HexagonalPrism(HexagonalPrism),
        OctagonalPrism(OctagonalPrism),
        RegularPyramid(RegularPyramid),
        Tetrahedron(Tetrahedron),
        Octahedron(Octahedron),
        Dodecahedron(Dodecahedron),
        Icosahedron(Icosahedron),
        Gyroid(Gyroid),
        SchwarzP(SchwarzP),
        Diamond(Diamond),
        Extrude(Extrude boxed),
        Revolve(Revolve boxed),
        HeightField(HeightField boxed),
        Xor(Xor),
        Chamfer(Chamfer),
        Stairs(Stairs),
        Columns(Columns),
        Engrave(Engrave),
        Groove(Groove),
        Tongue(Tongue),
        Morph(Morph),
        Round(Round),
        Onion(Onion),
        Elongate(Elongate),
        Stretch(Stretch),
        Repeat(Repeat boxed),
        PolarRepeat(PolarRepeat),
        Mirror(Mirror),
        Twist(Twist),
        Bend(Bend),
        Taper(Taper),
        Displace(Displace boxed),
        Warp(Warp boxed),
        ApollonianGasket(ApollonianGasket),
        KaleidoscopicIfs(KaleidoscopicIfs),
        Mandelbox(Mandelbox),
        MandelbrotRelief(MandelbrotRelief),
        MengerSponge(MengerSponge),
        QuaternionJulia(QuaternionJulia),
        Sierpinski(Sierpinski),
        Use(Use),
        Copies(Copies boxed),
        Scatter(Scatter boxed),
        #[cfg(feature = "added")]
        AddedNode(AddedNode),
    }

    /// A node: a shape or an operator.
    pub trait Sdf {
        /// The signed distance at `p`, negative inside, with materials where `V` keeps them. `sample` gives the value of a
        /// child, by its index, at a point in the child's space.
        fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V;

        /// The way of a point of a child until the next frame, in which the node is `next`, in the space around the node. Its
        /// two `points` are there and in the child's space, where its way is given; `None` if nothing moves it.
        fn way_from_child<R: Real>(&self, &next, points: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> = way;

        /// Whether its children are a list under `of` instead of one under `child`.
        fn has_child_list(&self) -> bool = false;

        /// Its child nodes, in order.
        fn children(&self) -> &[Node] = &[];

        /// Mutable access to the children.
        fn children_mut(&mut self) -> &mut [Node] = &mut [];

        /// How it is cut into leaves.
        fn cut(&self) -> Cut<'_> = Cut::Leaf;

        /// The point in the space of its child, if it is [`Cut::Child`].
        fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> = p;

        /// Bounds in the space around it, if it is [`Cut::Child`].
        fn bounds_from_child(&self, child: Bounds) -> Bounds = child;

        /// Precomputes values that speed up its evaluation; its children have been precomputed before. If the job is
        /// animated, the result must have the same form in all frames.
        fn prepare(&mut self, is_animated: bool) = ();

        /// Materials that it names; one of a placement has the placement's index.
        fn materials(&self) -> Vec<(Option<usize>, &MaterialRef)> = Vec::new();

        /// Mutable access to these materials.
        fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> = Vec::new();

        /// Number of nodes in its children, each counted as often as it is copied; saturating. `children` has the number
        /// in each.
        fn nodes_in_children(&self, children: &mut dyn Iterator<Item = u64>) -> u64
            = children.fold(0, u64::saturating_add);

        /// A Lipschitz factor L: |d(p) − d(q)| ≤ L · |p − q|. A march divides by it.
        fn lipschitz(&self) -> f32 = self.children().iter().map(Node::lipschitz).fold(1.0, f32::max);

        /// Relation of its value to the true distance: the worst of its children's.
        fn own_exactness(&self) -> Exactness
            = self.children().iter().map(Node::exactness).fold(Exactness::Exact, Exactness::max);

        /// Whether its surface has fine detail at every scale, some of it smaller than any pixel. A normal is then
        /// averaged over a pixel.
        fn is_fine(&self) -> bool = self.children().iter().any(Node::is_fine);

        /// Error in its numbers taken together, if any; each number alone is in range.
        fn validate(&self) -> Option<NodeError> = None;

        /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
        fn bounds(&self, isolevel: f32) -> Bounds;

        /// Its size in simple nodes, without its children.
        fn size_in_nodes(&self) -> u32 = 1;

        /// Cost of its own formula beyond its weight, in evaluations of a simple node.
        fn formula_cost(&self) -> f32
            = if self.children().is_empty() && self.own_exactness() == Exactness::Estimate { FRACTAL_COST } else { 0.0 };

        /// Maximum number of child evaluations in one evaluation of the node.
        fn child_evaluations(&self) -> f32 = 1.0;

        /// Whether its child's position is animated.
        fn is_placement_animated(&self) -> bool = false;

        /// Advice for the warning that its Lipschitz factor is so high that steps are tiny.
        fn lipschitz_advice(&self) -> &'static str = "change it less, or over a greater length";
    }
}

impl Node {
    /// Precomputes values that speed up its evaluation and its children's. If the job is animated, they have the same
    /// form in all frames.
    pub(crate) fn precompute(&mut self, is_animated: bool) {
        self.children_mut().iter_mut().for_each(|child| child.precompute(is_animated));
        self.prepare(is_animated);
    }

    /// Validates its numbers together after one has changed, and recomputes its derived values.
    fn follow(&mut self) -> Result<(), std::boxed::Box<SeekError>> {
        if let Some(NodeError { pointer: place, message }) = self.validate() {
            return Err(SeekError::new(message).inside(&place).inside(self.name()));
        }
        self.prepare(true);
        Ok(())
    }

    /// Its size in simple nodes, children included, each counted as often as it is copied.
    pub fn node_count(&self) -> u32 {
        let inside = self.nodes_in_children(&mut self.children().iter().map(|child| child.node_count().into()));
        self.size_in_nodes().saturating_add(u32::try_from(inside).unwrap_or(u32::MAX))
    }

    /// Whether any node in it names a material.
    pub fn has_own_materials(&self) -> bool {
        !self.materials().is_empty() || self.children().iter().any(Self::has_own_materials)
    }

    /// The signed distance at `p`, with materials where `V` keeps them.
    pub fn sample<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
        p.x.labeled(self.type_name(), || self.eval(p, &|index, p| self.children()[index].sample(p)))
    }

    /// Relation of its value to the true distance.
    pub fn exactness(&self) -> Exactness {
        // Without the black box, LLVM 22 at level 2 assumes that a child's value is never exact, and the worse of exact
        // and bound becomes exact.
        std::hint::black_box(self.own_exactness())
    }

    /// The signed distance at `p`.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.sample::<R, Distance<R>>(p).0
    }
}
