//! Signed distance functions: the registry of nodes, and the trait that each implements.
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

use std::sync::LazyLock;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

#[cfg(feature = "added")]
pub use added::AddedNode;
pub use carried::Carried;
use carried::carry_around;
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
pub use names::NodeExample;
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
pub use sdf::{Primitive, Sdf};
pub use sweeps::{Extrude, Revolve};
pub use terrain::HeightField;
pub use transforms::{Scale, Translate};
pub use value::{Distance, DistanceWithMaterials, MaterialWeight, SdfValue};
pub use warp::Warp;

use crate::bounds::Bounds;
pub use crate::kinds::{Exactness, NodeError, snake_case};
use crate::materials::MaterialRef;
use crate::real::{Real, Vec3};
use crate::seek::{Seek, SeekError};
use crate::values::Rotation;

/// A node inside another.
pub type Child = std::boxed::Box<Node>;

/// Contents of a node of a kind; the largest kinds are boxed, so that lists of small ones stay small.
macro_rules! payload {
    ($Kind:ident) => { $Kind };
    ($Kind:ident boxed) => { std::boxed::Box<$Kind> };
}

/// The registry.
macro_rules! nodes {
    ($($(#[$attribute:meta])* $Kind:ident $($boxed:ident)?),* $(,)?) => {
        /// A shape: one node of an object's tree; an object whose member is the node's name.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
        #[serde(rename_all = "snake_case")]
        #[seek(then = follow)]
        pub enum Node {
            $($(#[$attribute])* #[doc = concat!("See [`", stringify!($Kind), "`].")] $Kind(payload!($Kind $($boxed)?))),*
        }

        impl Node {
            /// The signed distance at `p`, with materials where `V` keeps them.
            pub fn sample<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>) -> V {
                p.x.labeled(
                    self.kind(),
                    || match self {
                        $($(#[$attribute])* Self::$Kind(node) => node.eval(p, &|index, p| node.children()[index].sample(p))),*
                    },
                )
            }

            /// Its child nodes, in order.
            pub fn children(&self) -> &[Node] {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.children()),*
                }
            }

            /// Mutable access to the children.
            pub fn children_mut(&mut self) -> &mut [Node] {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.children_mut()),*
                }
            }

            /// Like `carry`, where `child` gives the value of a child, by its index, at a point in the child's space.
            pub fn carry_around<R: Real>(
                &self,
                next: &Self,
                p: Vec3<R>,
                child: &dyn Fn(usize, Vec3<R>) -> Carried<R>,
            ) -> Carried<R> {
                match (self, next) {
                    $($(#[$attribute])* (Self::$Kind(node), Self::$Kind(next)) => {
                        carry_around::<$Kind, R>(node, next, p, child)
                    })*
                    _ => unreachable!("a job has the same nodes in all frames"),
                }
            }

            /// How it is cut into leaves.
            pub fn cut(&self) -> Cut<'_> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.cut()),*
                }
            }

            /// The point in the space of its child, if it is [`Cut::Child`].
            pub fn to_child<R: Real>(&self, p: Vec3<R>) -> Vec3<R> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.to_child(p)),*
                }
            }

            /// Bounds in the space around it, if it is [`Cut::Child`].
            pub fn bounds_from_child(&self, child: Bounds) -> Bounds {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.bounds_from_child(child)),*
                }
            }

            /// Precomputes values that speed up its evaluation; its children have been precomputed before.
            fn prepare_alone(&mut self, is_animated: bool) {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::precompute(node, is_animated)),*
                }
            }

            /// Material of all of its shape, if it names one.
            pub fn material(&self) -> Option<&MaterialRef> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.material()),*
                }
            }

            /// A node that it measures and does not show, if any.
            pub fn base(&self) -> Option<&Node> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.base()),*
                }
            }

            /// Mutable access to that node.
            pub fn base_mut(&mut self) -> Option<&mut Node> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.base_mut()),*
                }
            }

            /// Cost of measuring that node, in evaluations of a simple node for each of its evaluations per copy.
            pub fn placing_cost(&self) -> f32 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.placing_cost()),*
                }
            }

            /// Heights of its middle copy and of a lowest one that missed the shape that the others are on.
            pub fn fallen_copies(&self) -> Option<(f32, f32)> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.fallen_copies()),*
                }
            }

            /// Materials that it names; one of a placement has the placement's index.
            pub fn materials(&self) -> Vec<(Option<usize>, &MaterialRef)> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.materials()),*
                }
            }

            /// Mutable access to these materials.
            pub fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.materials_mut()),*
                }
            }

            /// Number of nodes in its children, each counted as often as it is copied; saturating. `children` has the
            /// number in each.
            pub fn nodes_in_children(&self, children: &mut dyn Iterator<Item = u64>) -> u64 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => node.nodes_in_children(children)),*
                }
            }

            /// Whether its children are a list under `of` instead of one under `child`.
            pub fn has_child_list(&self) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(_) => <$Kind as Sdf>::HAS_CHILD_LIST),*
                }
            }

            /// A Lipschitz factor L: |d(p) − d(q)| ≤ L · |p − q|.
            pub fn stretch(&self) -> f32 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::lipschitz(node)),*
                }
            }

            /// Relation of its value to the true distance.
            pub fn exactness(&self) -> Exactness {
                // Without the black box, LLVM 22 at level 2 assumes that a child's value is never exact, and the worse
                // of exact and bound becomes exact.
                std::hint::black_box(match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::exactness(node)),*
                })
            }

            /// Whether its surface has fine detail at every scale, see [`Sdf::is_fine`].
            pub fn is_fine(&self) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::is_fine(node)),*
                }
            }

            /// Error in its numbers taken together, if any.
            pub fn fault(&self) -> Option<NodeError> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::validate(node)),*
                }
            }

            /// Its type.
            fn kind(&self) -> &'static str {
                match self {
                    $($(#[$attribute])* Self::$Kind(_) => stringify!($Kind)),*
                }
            }

            /// Its name in JSON.
            pub fn name(&self) -> &'static str {
                match self {
                    $($(#[$attribute])* Self::$Kind(_) => {
                        static NAME: LazyLock<String> = LazyLock::new(|| snake_case(stringify!($Kind)));
                        &NAME
                    }),*
                }
            }

            /// Box that contains every point whose distance is at most `isolevel`, which is at least 0.
            pub fn bounds(&self, isolevel: f32) -> Bounds {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::bounds(node, isolevel)),*
                }
            }

            /// Its size in simple nodes, without its children.
            fn weight(&self) -> u32 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::size_in_nodes(node)),*
                }
            }

            /// Cost of its own formula beyond its weight, in evaluations of a simple node.
            fn formula_cost(&self) -> f32 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::formula_cost(node)),*
                }
            }

            /// Maximum number of child evaluations in one evaluation of the node.
            fn child_evaluations(&self) -> f32 {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::child_evaluations(node)),*
                }
            }

            /// Whether it subtracts its other children from the first.
            pub fn subtracts(&self) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::subtracts(node)),*
                }
            }

            /// The angles by which it rotates its child about the axes, if it does nothing else.
            pub fn rotation(&self) -> Option<&Rotation> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::rotation(node)),*
                }
            }

            /// Whether its child's position is animated.
            pub fn is_placement_animated(&self) -> bool {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::is_placement_animated(node)),*
                }
            }

            /// Name of the shape that it stands for, if it is a `use`.
            pub fn used_shape(&self) -> Option<&str> {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::used_shape(node)),*
                }
            }

            /// Advice if its Lipschitz factor is so high that steps are tiny.
            pub fn lipschitz_advice(&self) -> &'static str {
                match self {
                    $($(#[$attribute])* Self::$Kind(node) => <$Kind as Sdf>::lipschitz_advice(node)),*
                }
            }

            /// Each kind's examples, as a user would write the node.
            pub fn examples() -> Vec<NodeExample> {
                let mut examples = Vec::new();
                $(
                    $(#[$attribute])*
                    examples.extend(<$Kind as Sdf>::examples().into_iter().enumerate().map(|(index, value)| NodeExample {
                        kind: stringify!($Kind),
                        index,
                        node: format!("{{ \"{}\": {value} }}", snake_case(stringify!($Kind))),
                    }));
                )*
                examples
            }
        }
    };
}

// A scene may have a million.
const _: () = assert!(size_of::<Node>() <= 120);

nodes![
    Sphere,
    Box,
    Plane,
    Cylinder,
    InfiniteCylinder,
    TriangularPrism,
    Pyramid,
    Torus,
    Capsule,
    Mandelbulb,
    Union,
    Intersection,
    Difference,
    Translate,
    Rotate boxed,
    Aim boxed,
    Scale,
    Paint,
    CappedTorus,
    Link,
    Cone,
    InfiniteCone,
    CappedCone,
    RoundCone,
    RoundedCylinder,
    CutSphere,
    CutHollowSphere,
    DeathStar,
    Ellipsoid,
    Vesica boxed,
    SolidAngle,
    Horseshoe,
    U,
    Triangle,
    Quad,
    BezierTube,
    BoxFrame,
    Rhombus,
    HexagonalPrism,
    OctagonalPrism,
    RegularPyramid,
    Tetrahedron,
    Octahedron,
    Dodecahedron,
    Icosahedron,
    Gyroid,
    SchwarzP,
    Diamond,
    Extrude boxed,
    Revolve boxed,
    HeightField boxed,
    Xor,
    Chamfer,
    Stairs,
    Columns,
    Engrave,
    Groove,
    Tongue,
    Morph,
    Round,
    Onion,
    Elongate,
    Stretch,
    Repeat boxed,
    PolarRepeat,
    Mirror,
    Twist,
    Bend,
    Taper,
    Displace boxed,
    Warp boxed,
    ApollonianGasket,
    KaleidoscopicIfs,
    Mandelbox,
    MandelbrotRelief,
    MengerSponge,
    QuaternionJulia,
    Sierpinski,
    Use,
    Copies boxed,
    Scatter boxed,
    #[cfg(feature = "added")]
    AddedNode,
];

impl Node {
    /// Precomputes values that speed up its evaluation and its children's. If the job is animated, they have the same
    /// form in all frames.
    pub(crate) fn precompute(&mut self, is_animated: bool) {
        self.children_mut().iter_mut().for_each(|child| child.precompute(is_animated));
        self.prepare_alone(is_animated);
    }

    /// Validates its numbers together after one has changed, and recomputes its derived values.
    fn follow(&mut self) -> Result<(), std::boxed::Box<SeekError>> {
        if let Some(NodeError { pointer: place, message }) = self.fault() {
            return Err(SeekError::new(message).inside(&place).inside(self.name()));
        }
        self.prepare_alone(true);
        Ok(())
    }

    /// Its size in simple nodes, children included, each counted as often as it is copied.
    pub fn node_count(&self) -> u32 {
        let inside = self.nodes_in_children(&mut self.children().iter().map(|child| child.node_count().into()));
        self.weight().saturating_add(u32::try_from(inside).unwrap_or(u32::MAX))
    }

    /// Whether any node in it names a material.
    pub fn has_own_materials(&self) -> bool {
        !self.materials().is_empty() || self.children().iter().any(Self::has_own_materials)
    }

    /// The signed distance at `p`.
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.sample::<R, Distance<R>>(p).0
    }
}
