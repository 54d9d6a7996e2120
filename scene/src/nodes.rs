//! Everything that has a distance: the list of nodes, and what a node must say of itself.
//!
//! A node is one documented struct in a file of its family under `nodes/`, one `impl` of
//! [`Primitive`] or [`Sdf`], and one word in the list below. Parsing, schema, evaluation in every
//! arithmetic, the contract tests and its picture in docs/nodes.md follow from those.

mod fractals;
mod modifiers;
mod operators;
mod primitives;
mod runs;
mod sample;
mod transforms;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use fractals::Mandelbulb;
pub use modifiers::Paint;
pub use operators::{Difference, Intersection, Union};
pub use primitives::{Box, Capsule, Cylinder, InfiniteCylinder, Plane, Pyramid, Sphere, Torus, TriangularPrism};
pub use sample::{Coat, Distance, Painted, Sample};
pub use transforms::{Rotate, Scale, Translate};

use crate::bounds::Bounds;
use crate::materials::MaterialUse;
use crate::real::{Real, Vec3};

/// A node inside another.
pub type Child = std::boxed::Box<Node>;

/// What a node means.
pub trait Sdf {
    /// A small valid value, as a user would write it: the picture in docs/nodes.md and the contract tests use it.
    const EXAMPLE: &'static str;

    /// The signed distance at `p`, negative inside, with materials where `V` keeps them.
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V;

    /// Whether its children are a list under `of`, and not one under `child`.
    const HAS_LIST: bool = false;

    /// The nodes inside, in order.
    fn children(&self) -> &[Node] {
        &[]
    }

    /// The same, to be changed.
    fn children_mut(&mut self) -> &mut [Node] {
        &mut []
    }

    /// Finds what makes it faster to look at, in it and in the nodes inside.
    fn prepare(&mut self) {
        self.children_mut().iter_mut().for_each(Node::prepare);
    }

    /// The material it says, if it says one.
    fn material(&self) -> Option<&MaterialUse> {
        None
    }

    /// The same, to be changed.
    fn material_mut(&mut self) -> Option<&mut MaterialUse> {
        None
    }

    /// A Lipschitz factor: |d(p) − d(q)| ≤ stretch · |p − q|. A march divides by it.
    fn stretch(&self) -> f32 {
        self.children().iter().map(Node::stretch).fold(1.0, f32::max)
    }

    /// Whether some distance in it is an estimate, which no Lipschitz factor bounds everywhere.
    fn is_estimate(&self) -> bool {
        self.children().iter().any(Node::is_estimate)
    }

    /// A box that holds every point whose distance is at most `level`, which is not below 0.
    fn bounds(&self, level: f32) -> Bounds;
}

/// A node without children: its distance says it all.
pub trait Primitive {
    /// A small valid value, as a user would write it.
    const EXAMPLE: &'static str;

    /// The signed distance from `p` to the surface, negative inside.
    fn distance<R: Real>(&self, p: Vec3<R>) -> R;

    /// A box that holds every point whose distance is at most `level`, which is not below 0.
    fn bounds(&self, level: f32) -> Bounds;

    /// A Lipschitz factor: |d(p) − d(q)| ≤ stretch · |p − q|.
    fn stretch(&self) -> f32 {
        1.0
    }

    /// Whether the distance is an estimate, which no Lipschitz factor bounds everywhere;
    /// then a step of distance/stretch still passes no surface.
    fn is_estimate(&self) -> bool {
        false
    }
}

impl<P: Primitive> Sdf for P {
    const EXAMPLE: &'static str = <P as Primitive>::EXAMPLE;

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        V::new(self.distance(p))
    }

    fn stretch(&self) -> f32 {
        Primitive::stretch(self)
    }

    fn is_estimate(&self) -> bool {
        Primitive::is_estimate(self)
    }

    fn bounds(&self, level: f32) -> Bounds {
        Primitive::bounds(self, level)
    }
}

macro_rules! nodes {
    ($($Kind:ident),* $(,)?) => {
        /// A shape: one node of the scene's tree, keyed by its name.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Node {
            $(#[doc = concat!("See [`", stringify!($Kind), "`].")] $Kind($Kind)),*
        }

        impl Node {
            /// The signed distance at `p`, with materials where `V` keeps them.
            pub fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
                p.x.named(
                    self.kind(),
                    #[inline(always)]
                    || match self {
                        $(Self::$Kind(node) => node.sample(p)),*
                    },
                )
            }

            /// The nodes inside, in order.
            pub fn children(&self) -> &[Node] {
                match self {
                    $(Self::$Kind(node) => node.children()),*
                }
            }

            /// The same, to be changed.
            pub(crate) fn children_mut(&mut self) -> &mut [Node] {
                match self {
                    $(Self::$Kind(node) => node.children_mut()),*
                }
            }

            /// Finds what makes it faster to look at.
            pub(crate) fn prepare(&mut self) {
                match self {
                    $(Self::$Kind(node) => Sdf::prepare(node)),*
                }
            }

            /// The material it says, if it says one.
            fn material(&self) -> Option<&MaterialUse> {
                match self {
                    $(Self::$Kind(node) => node.material()),*
                }
            }

            /// The same, to be changed.
            pub(crate) fn material_mut(&mut self) -> Option<&mut MaterialUse> {
                match self {
                    $(Self::$Kind(node) => node.material_mut()),*
                }
            }

            /// Whether its children are a list under `of`, and not one under `child`.
            pub(crate) fn has_list(&self) -> bool {
                match self {
                    $(Self::$Kind(_) => <$Kind as Sdf>::HAS_LIST),*
                }
            }

            /// A Lipschitz factor: |d(p) − d(q)| ≤ stretch · |p − q|.
            pub fn stretch(&self) -> f32 {
                match self {
                    $(Self::$Kind(node) => Sdf::stretch(node)),*
                }
            }

            /// Whether some distance in it is an estimate, which no Lipschitz factor bounds everywhere.
            pub fn is_estimate(&self) -> bool {
                match self {
                    $(Self::$Kind(node) => Sdf::is_estimate(node)),*
                }
            }

            /// Its type.
            #[inline(always)]
            fn kind(&self) -> &'static str {
                match self {
                    $(Self::$Kind(_) => stringify!($Kind)),*
                }
            }

            /// Its name in JSON.
            pub fn name(&self) -> String {
                snake_case(self.kind())
            }

            /// A box that holds every point whose distance is at most `level`, which is not below 0.
            pub fn bounds(&self, level: f32) -> Bounds {
                match self {
                    $(Self::$Kind(node) => Sdf::bounds(node, level)),*
                }
            }

            /// Each kind's example, as a user would write the whole node.
            pub fn examples() -> Vec<Example> {
                vec![$(Example {
                    kind: stringify!($Kind),
                    node: format!("{{ \"{}\": {} }}", snake_case(stringify!($Kind)), <$Kind as Sdf>::EXAMPLE),
                }),*]
            }
        }
    };
}

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
    Rotate,
    Scale,
    Paint,
];

/// A node to look at and to test with.
#[derive(Clone, Debug)]
pub struct Example {
    /// The node's type.
    pub kind: &'static str,
    /// Its JSON.
    pub node: String,
}

impl Node {
    /// Names materials by their slots, all over the tree.
    pub(crate) fn name_materials_by_slot(&mut self) {
        if let Some(material) = self.material_mut() {
            *material = material.canonical();
        }
        self.children_mut().iter_mut().for_each(Self::name_materials_by_slot);
    }

    /// How many nodes it has, itself included.
    pub fn count(&self) -> u32 {
        1 + self.children().iter().map(Self::count).sum::<u32>()
    }

    /// Whether any node in it says a material of its own.
    pub fn is_painted(&self) -> bool {
        self.material().is_some() || self.children().iter().any(Self::is_painted)
    }

    /// The signed distance at `p`.
    #[inline(always)]
    pub fn distance<R: Real>(&self, p: Vec3<R>) -> R {
        self.sample::<R, Distance<R>>(p).0
    }
}

/// `InfiniteCylinder` as `infinite_cylinder`: the name in JSON.
pub fn snake_case(name: &str) -> String {
    let mut snake = String::new();
    for (index, letter) in name.char_indices() {
        if letter.is_ascii_uppercase() && index > 0 {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}
