//! Copies of shapes at random placements that follow from a seed.

mod region;
mod surface;
mod throw;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

pub use region::{BallRegion, BoxRegion, DiscRegion, ScatterRegion};

use self::surface::SurfaceBelow;
use self::throw::throw;
use super::bvh::UnionBvh;
use super::copies::{Placement, PlacementCount, Placements};
use super::cut::{Cut, Part};
use super::modifiers::cached::Kept;
use super::operators::{default_smooth, is_grouped, seam_sink, union_indexed};
use super::{Child, Exactness, Node, NodeError, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::real::{Real, Vec3};
use crate::seek::{FrameTime, Seek};
use crate::values::{ConstantDegrees, ConstantLengthOrZero, ConstantScale, LengthOrZero, integer_in_range};

/// Evaluations of `on` for each copy, on average, after which the search for places ends.
const EVALUATIONS_PER_COPY: u64 = 128;

/// Copies this many times the region's half width below most others have probably missed the shape that they should be on.
const FAR_BELOW: f32 = 4.0;

/// Copies of shapes at random placements, combined like a `union`. The placements follow from the numbers here, and are
/// the same in all frames; numbers of the shapes may be animated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Scatter {
    /// The shapes, one or more; each copy is one of them.
    #[schemars(length(min = 1))]
    pub of: Vec<Node>,
    /// Number of copies.
    pub count: PlacementCount,
    /// Another seed gives other placements.
    #[serde(default, deserialize_with = "seed")]
    #[schemars(range(min = 0, max = u32::MAX))]
    pub seed: u32,
    /// The region of the copies, around the origin: `{ "box": { "size": [x, y, z] } }`, `{ "disc": { "radius": r } }`, at
    /// height 0, or `{ "sphere": { "radius": r } }`, in scene units.
    pub within: ScatterRegion,
    /// A shape on which the copies are placed, upright: each is moved along y to the highest point of its surface. It is
    /// not shown, and has no animated numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub on: Option<Child>,
    /// Minimum distance between the origins of copies, in scene units.
    #[serde(default = "default_apart")]
    pub apart: ConstantLengthOrZero,
    /// Maximum angle by which a copy is rotated about its y axis, in degrees.
    #[serde(default = "default_turn")]
    pub turn: ConstantDegrees,
    /// Minimum and maximum scale factor of a copy.
    #[serde(default = "default_scale")]
    pub scale: [ConstantScale; 2],
    /// Width of the smooth seam; 0 is sharp.
    #[serde(default = "default_smooth")]
    pub smooth: LengthOrZero,
    /// The placements.
    #[serde(skip)]
    #[schemars(skip)]
    placed: Kept<Result<ScatteredCopies, NodeError>>,
    /// Bounding volume hierarchy of the copies.
    #[serde(skip)]
    #[schemars(skip)]
    bvh: UnionBvh,
}

/// Placements of copies, and the index of each one's shape.
#[derive(Clone, Debug, PartialEq)]
struct ScatteredCopies {
    placements: Placements,
    shapes: Vec<usize>,
}

impl Scatter {
    fn placed(&self) -> Result<&ScatteredCopies, &NodeError> {
        self.placed.get(|| self.place()).as_ref()
    }

    fn place(&self) -> Result<ScatteredCopies, NodeError> {
        let count = self.count.get();
        let on = self.on.as_deref().map(|on| {
            let mut on = on.clone();
            on.precompute(false);
            on
        });
        let evaluations = u64::from(count).saturating_mul(EVALUATIONS_PER_COPY);
        let top = self.within.half_size().y;
        let mut surface = on.as_ref().map(|on| SurfaceBelow::new(on, top, evaluations));
        let darts = throw(count, self.seed, &self.within, self.apart.get(), surface.as_mut());
        if darts.len() < count as usize {
            let fitted = darts.len();
            let cure = match &surface {
                Some(surface) if surface.is_missed() => {
                    "most places are not above \"on\": move or enlarge \"on\", or make \"within\" smaller"
                }
                Some(surface) if !surface.has_evaluations() => "use a simpler shape in \"on\", or fewer copies",
                Some(_) => "lower \"count\" or \"apart\", or enlarge \"within\" and \"on\"",
                None => "lower \"count\" or \"apart\", or enlarge \"within\"",
            };
            return Err(NodeError::new("count", format!("is {count}, but only {fitted} copies fit: {cure}")));
        }
        let [low, high] = self.scale.each_ref().map(ConstantScale::get);
        let shapes = darts.iter().map(|dart| (dart.choices[0] * self.of.len() as f32) as usize);
        let shapes = shapes.map(|shape| shape.min(self.of.len().saturating_sub(1))).collect();
        let placements = darts.iter().map(|dart| {
            let [_, turn, scale] = dart.choices;
            let scale = ((high - low) * scale + low).clamp(low, high);
            Placement::new(dart.position, [0.0, self.turn.get() * turn, 0.0], scale)
        });
        Ok(ScatteredCopies { placements: Placements::new(placements.collect()), shapes })
    }

    /// Bounds of the copies whose distance is at most `isolevel`.
    fn placed_bounds(&self, isolevel: f32) -> impl Iterator<Item = Bounds> {
        let placed = self.placed().ok().into_iter();
        placed.flat_map(move |copies| {
            copies.placements.bounds(isolevel, |index, own| self.of[copies.shapes[index]].bounds(own))
        })
    }

    /// Heights of its middle copy and of a lowest one that missed the shape that the others are on.
    fn fallen_copies(&self) -> Option<(f32, f32)> {
        let copies = self.placed().ok().filter(|_| self.on.is_some())?;
        let mut heights: Vec<f32> = copies.placements.all().iter().map(Placement::height).collect();
        heights.sort_by(f32::total_cmp);
        let (lowest, middle) = (*heights.first()?, heights[heights.len() / 2]);
        let half = self.within.half_size();
        let across = half.x.max(half.z).max(half.y);
        (middle - lowest > FAR_BELOW * across).then_some((middle, lowest))
    }

    fn is_grouped(&self) -> bool {
        is_grouped(self.count.get() as usize, &self.smooth)
    }
}

impl Node {
    fn as_scatter(&self) -> Option<&Scatter> {
        if let Self::Scatter(scatter) = self { Some(scatter) } else { None }
    }

    /// A node that it measures and does not show, if any.
    pub fn base(&self) -> Option<&Self> {
        self.as_scatter()?.on.as_deref()
    }

    /// Mutable access to that node.
    pub fn base_mut(&mut self) -> Option<&mut Self> {
        if let Self::Scatter(scatter) = self { scatter.on.as_deref_mut() } else { None }
    }

    /// Cost of measuring that node, in evaluations of a simple node for each of its evaluations per copy.
    pub fn placing_cost(&self) -> f32 {
        let cost = |scatter: &Scatter| Some(scatter.count.get() as f32 * scatter.on.as_ref()?.evaluation_cost());
        self.as_scatter().and_then(cost).unwrap_or(0.0)
    }

    /// Heights of its middle copy and of a lowest one that missed the shape that the others are on.
    pub fn fallen_copies(&self) -> Option<(f32, f32)> {
        self.as_scatter()?.fallen_copies()
    }
}

impl Sdf for Scatter {
    const EXAMPLE: &'static str = r#"{
        "of": [{ "sphere": { "radius": 0.2 } }, { "box": { "size": [0.3, 0.2, 0.4] } }],
        "count": 24, "within": { "disc": { "radius": 1.3 } }, "apart": 0.3, "scale": [0.5, 1.2]
    }"#;

    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "of": [{ "capsule": { "a": [0, 0, 0], "b": [0, 0.4, 0], "radius": 0.06 } }], "count": 40, "seed": 7, "turn": 0,
            "within": { "disc": { "radius": 1 } }, "on": { "sphere": { "radius": 1.1 } }, "apart": 0.15, "smooth": 0.05 }"#,
        r#"{ "of": [{ "torus": { "radius": 0.15, "tube": 0.05 } }], "count": 12, "within": { "box": { "size": [2, 1.5, 1] } }, "apart": 0.2 }"#,
        r#"{ "of": [{ "sphere": { "radius": 0.2 } }], "count": 80, "within": { "sphere": { "radius": 1 } }, "smooth": 0.2, "scale": [0.4, 1] }"#,
    ];

    fn has_child_list(&self) -> bool {
        true
    }

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        // A job with copies that do not fit is rejected.
        let Ok(ScatteredCopies { placements, shapes }) = self.placed() else { return V::new(p.x.constant(1e9)) };
        let copy = |index: usize| placements.sample(index, |q| sample(shapes[index], q), p);
        union_indexed(shapes.len(), &self.smooth, &self.bvh, &copy, p)
    }

    fn prepare(&mut self, is_animated: bool) {
        let nodes: Vec<u32> = self.of.iter().map(Node::node_count).collect();
        self.bvh = match self.placed() {
            Ok(ScatteredCopies { shapes, .. }) => {
                let nodes = shapes.iter().map(|&shape| nodes[shape]);
                UnionBvh::new(self.placed_bounds(0.0).zip(nodes), self.is_grouped(), is_animated)
            }
            Err(_) => UnionBvh::default(),
        };
    }

    fn cut(&self) -> Cut<'_> {
        let Ok(ScatteredCopies { placements, shapes }) = self.placed() else { return Cut::Leaf };
        let copy = |(index, &shape): (usize, &usize)| Part::Copy(placements, index, &self.of[shape]);
        Cut::Union(&self.smooth, shapes.iter().enumerate().map(copy).collect())
    }

    fn children(&self) -> &[Node] {
        &self.of
    }

    fn children_mut(&mut self) -> &mut [Node] {
        &mut self.of
    }

    fn own_exactness(&self) -> Exactness {
        self.of.iter().map(Node::exactness).fold(Exactness::Bound, Exactness::max)
    }

    fn validate(&self) -> Option<NodeError> {
        let [low, high] = &self.scale;
        if low > high {
            let message = format!("must not be above the maximum, {}: write [minimum, maximum]", high.get());
            return Some(NodeError::new("scale/0", message));
        }
        if self.on.as_deref().is_some_and(|on| on.clone().seek(&mut FrameTime::at(0, 0.0)) != Ok(false)) {
            let message = "is animated, but placements are the same in all frames: write numbers instead of tracks";
            return Some(NodeError::new("on", message));
        }
        self.placed().err().cloned()
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let sink = seam_sink(self.count.get() as usize, self.is_grouped());
        let isolevel = isolevel + self.smooth.in_frame() * sink;
        self.placed_bounds(isolevel).reduce(Bounds::union).unwrap_or(Bounds::EMPTY)
    }

    /// Any copy may be of the largest shape.
    fn nodes_in_children(&self, children: &mut dyn Iterator<Item = u64>) -> u64 {
        u64::from(self.count.get()).saturating_mul(children.max().unwrap_or(0))
    }

    fn child_evaluations(&self) -> f32 {
        self.count.get() as f32 / self.of.len().max(1) as f32
    }
}

fn seed<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    integer_in_range(deserializer, 0, u32::MAX, "as a seed")
}

fn default_apart() -> ConstantLengthOrZero {
    ConstantLengthOrZero::new(0.0).expect("0 is in range")
}

fn default_turn() -> ConstantDegrees {
    ConstantDegrees::new(360.0).expect("360 is in range")
}

fn default_scale() -> [ConstantScale; 2] {
    [1.0; 2].map(|factor| ConstantScale::new(factor).expect("1 is in range"))
}
