//! Copies of a shape at given placements, which are stored as a list of small structs instead of a tree.

mod at;
mod placement;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use at::{AtPlacements, GridPlacements, LinePlacements, PlacementCount, RingPlacements};
pub use placement::{Placement, Placements};

use super::bvh::UnionBvh;
use super::cut::{Cut, Part};
use super::modifiers::cached::Kept;
use super::operators::{default_smooth, is_grouped, seam_sink, union_indexed};
use super::transforms::around_child;
use super::{Child, Exactness, Node, NodeError, Sdf, SdfValue};
use crate::bounds::Bounds;
use crate::materials::MaterialRef;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::LengthOrZero;

/// Copies of a shape at given placements, combined like a `union`. The placements are the same in all frames; numbers
/// of the shape may be animated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Copies {
    /// The shape.
    pub child: Child,
    /// The placements: a list of `{ "by", "degrees", "scale", "material" }`, each key optional;
    /// `{ "grid": [nx, ny, nz], "step": [dx, dy, dz] }`, centered on the origin;
    /// `{ "ring": n, "radius": r }`, about the y axis, each copy turned outward; `{ "along": points, "count": n }`, at
    /// equal distances; or columns: `{ "by": [...], "degrees": [...], "scale": [...], "material": [...] }`. Offsets in
    /// scene units, angles in degrees.
    pub at: AtPlacements,
    /// Width of the smooth seam; 0 is sharp.
    #[serde(default = "default_smooth")]
    pub smooth: LengthOrZero,
    /// Placements that a formula makes.
    #[serde(skip)]
    #[schemars(skip)]
    computed: Kept<Placements>,
    /// Bounding volume hierarchy of the copies.
    #[serde(skip)]
    #[schemars(skip)]
    bvh: UnionBvh,
}

impl Copies {
    /// The placements of all copies.
    fn placements(&self) -> &Placements {
        match &self.at {
            AtPlacements::List(list) => list,
            AtPlacements::Grid(_) | AtPlacements::Ring(_) | AtPlacements::Along(_) => {
                self.computed.get(|| self.at.computed())
            }
        }
    }

    /// Bounds of the copies of a shape whose distance is at most `isolevel`.
    fn placed_bounds(&self, isolevel: f32) -> impl Iterator<Item = Bounds> {
        let whole = self.child.bounds(isolevel);
        self.placements().bounds(isolevel, move |_, own| {
            if own.to_bits() == isolevel.to_bits() { whole } else { self.child.bounds(own) }
        })
    }
}

impl Sdf for Copies {
    const EXAMPLE: &'static str = r##"{
        "child": { "box": { "size": [0.5, 0.7, 0.3] } },
        "at": [
            { "by": [-0.8, 0, 0], "material": { "diffuse": { "kd": "#d9481c" } } },
            { "by": [0, 0.2, 0], "degrees": [0, 40, 20], "scale": 1.4 },
            { "by": [0.9, -0.1, 0.2], "scale": 0.7 }
        ]
    }"##;

    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "child": { "sphere": { "radius": 0.3 } }, "at": { "grid": [3, 2, 2], "step": [0.8, 0.7, 0.9] }, "smooth": 0.3 }"#,
        r#"{ "child": { "box": { "size": [0.3, 0.8, 0.5] } }, "at": { "ring": 7, "radius": 0.9 } }"#,
        r#"{ "child": { "torus": { "radius": 0.2, "tube": 0.08 } }, "at": { "along": [[-1, 0, 0], [0, 0.8, 0], [1, 0, 0.3]], "count": 9 } }"#,
        r#"{ "child": { "capsule": { "a": [0, -0.3, 0], "b": [0, 0.4, 0], "radius": 0.1 } }, "smooth": 0.1, "at": {
            "by": [[-0.6, 0, 0], [0, 0, 0], [0.6, 0, 0]], "degrees": [[0, 0, 30], [0, 0, 0], [40, 0, -30]], "scale": [1, 1.6, 0.8]
        } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let placements = self.placements();
        let copy = |index| placements.sample(index, |q| sample(0, q), p);
        union_indexed(placements.all().len(), &self.smooth, &self.bvh, &copy, p)
    }

    fn prepare(&mut self, is_animated: bool) {
        let nodes = self.child.node_count();
        let in_groups = is_grouped(self.placements().all().len(), &self.smooth);
        self.bvh = UnionBvh::new(self.placed_bounds(0.0).map(|bounds| (bounds, nodes)), in_groups, is_animated);
    }

    around_child!();

    fn cut(&self) -> Cut<'_> {
        let placements = self.placements();
        let copy = |index| Part::Copy(placements, index, &self.child);
        Cut::Union(&self.smooth, (0..placements.all().len()).map(copy).collect())
    }

    fn materials(&self) -> Vec<(Option<usize>, &MaterialRef)> {
        match &self.at {
            AtPlacements::List(list) => {
                let all = list.all().iter().enumerate();
                all.filter_map(|(index, copy)| Some((Some(index), copy.material()?))).collect()
            }
            AtPlacements::Grid(_) | AtPlacements::Ring(_) | AtPlacements::Along(_) => Vec::new(),
        }
    }

    fn materials_mut(&mut self) -> Vec<(Option<usize>, &mut MaterialRef)> {
        match &mut self.at {
            AtPlacements::List(list) => list.materials_mut(),
            AtPlacements::Grid(_) | AtPlacements::Ring(_) | AtPlacements::Along(_) => Vec::new(),
        }
    }

    fn own_exactness(&self) -> Exactness {
        self.child.exactness().capped_at_bound()
    }

    fn validate(&self) -> Option<NodeError> {
        self.at.validate().map(|error| error.inside("at"))
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let count = self.placements().all().len();
        let isolevel = isolevel + self.smooth.in_frame() * seam_sink(count, is_grouped(count, &self.smooth));
        self.placed_bounds(isolevel).reduce(Bounds::union).unwrap_or(Bounds::EMPTY)
    }

    fn nodes_in_children(&self, children: &mut dyn Iterator<Item = u64>) -> u64 {
        self.at.count().saturating_mul(children.fold(0, u64::saturating_add))
    }

    fn child_evaluations(&self) -> f32 {
        self.at.count() as f32
    }
}
