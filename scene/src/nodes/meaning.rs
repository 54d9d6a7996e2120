//! What a node must say of itself.

use super::{Node, Sample};
use crate::bounds::Bounds;
use crate::materials::MaterialUse;
use crate::real::{Real, Vec3};

/// How a node's value relates to the Euclidean distance to its surface, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Exactness {
    /// It is the distance.
    Exact,
    /// Over its Lipschitz factor it is never more than the distance.
    Bound,
    /// An estimate, which no Lipschitz factor bounds everywhere; a step of value/stretch still passes no surface.
    Estimate,
}

impl Exactness {
    /// What is left of it when a formula around it gives a bound.
    pub(crate) fn at_best_bound(self) -> Self {
        match self {
            Self::Exact | Self::Bound => Self::Bound,
            Self::Estimate => Self::Estimate,
        }
    }
}

/// What is wrong with the numbers of a node taken together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeFault {
    /// Where in the node: a key, or a path of keys and places such as `points/2`.
    pub place: String,
    /// What is wrong and what to do about it, as it reads behind the place.
    pub message: String,
}

impl NodeFault {
    /// A fault at a place of the node.
    pub fn new(place: impl Into<String>, message: impl Into<String>) -> Self {
        Self { place: place.into(), message: message.into() }
    }
}

/// What a node means.
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

    /// The same, to be changed.
    fn children_mut(&mut self) -> &mut [Node] {
        &mut []
    }

    /// Finds what makes it faster to look at, in it and in the nodes inside. Where the job `moves`,
    /// what is found must have the same form in all frames.
    fn prepare(&mut self, moves: bool) {
        self.children_mut().iter_mut().for_each(|child| child.prepare(moves));
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

    /// What its value is worth: as much as the worst of the nodes inside.
    fn exactness(&self) -> Exactness {
        self.children().iter().map(Node::exactness).fold(Exactness::Exact, Exactness::max)
    }

    /// Whether its surface has details of every size, so that some are smaller than any pixel: a normal is then
    /// the mean over a pixel.
    fn is_fine(&self) -> bool {
        self.children().iter().any(Node::is_fine)
    }

    /// What is wrong with its numbers taken together, if anything; each alone is in range.
    fn fault(&self) -> Option<NodeFault> {
        None
    }

    /// A box that holds every point whose distance is at most `level`, which is not below 0.
    fn bounds(&self, level: f32) -> Bounds;

    /// How many nodes it is as much work as, those inside not counted.
    fn weight(&self) -> u32 {
        1
    }
}

/// A node without children: its distance says it all.
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

    /// What its value is worth.
    fn exactness(&self) -> Exactness {
        Exactness::Exact
    }

    /// Whether its surface has details of every size, see [`Sdf::is_fine`].
    fn is_fine(&self) -> bool {
        false
    }

    /// What is wrong with its numbers taken together, if anything; each alone is in range.
    fn fault(&self) -> Option<NodeFault> {
        None
    }

    /// How many nodes it is as much work as.
    fn weight(&self) -> u32 {
        1
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
}
