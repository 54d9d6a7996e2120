//! Copies on a grid, correct across its cells: Inigo Quilez, "Domain repetition",
//! <https://iquilezles.org/articles/sdfrepetition/>.
//!
//! Along each axis only copies that may be the nearest are evaluated: two if the shape fits its cell, more if it
//! extends into others. The other copies are farther away.

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::cached::Cached;
use super::elongation::way_of_parts;
use super::nearest_copy::{ChildBounds, RepeatedChild, max_overlapping, nearest_whole, sample_nearest};
use crate::bounds::Bounds;
use crate::kinds::{Exactness, NodeError};
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Node, Sdf, SdfValue};
use crate::real::{Bundle, Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Spacing, integer_in_range};

/// Maximum width of a shape, in cells.
const MAX_CELLS: f32 = 4.0;
/// Maximum number of copies along an axis evaluated for one point.
const MAX_EVALUATED_COPIES: u32 = 5;
/// Maximum number of copies along an axis.
const MAX_COPIES: u32 = 1_000_000;

/// Copies of a shape on a grid, infinitely many or a number along each axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Repeat {
    /// The distance between copies along x, y and z; null along an axis without copies.
    pub cell: [Option<Spacing>; 3],
    /// Number of copies along x, y and z, centered on the shape; null for infinitely many.
    #[serde(default)]
    pub count: [Option<CopyCount>; 3],
    /// The shape, at most four cells wide.
    pub child: Child,
    /// Values derived from the fields above.
    #[serde(skip)]
    #[schemars(skip)]
    grid: Cached<GridLayout>,
}

/// Number of copies along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema, Seek)]
pub struct CopyCount(#[schemars(range(min = 1, max = MAX_COPIES))] u32);

impl<'de> Deserialize<'de> for CopyCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        integer_in_range(deserializer, 1, MAX_COPIES, "copies").map(Self)
    }
}

/// Axes along which there are copies, and the bounds of the shape.
#[derive(Clone, Debug)]
struct GridLayout {
    axes: [Option<Axis>; 3],
    held: ChildBounds,
}

/// Copies along an axis.
#[derive(Clone, Copy, Debug)]
struct Axis {
    cell: f32,
    /// Center of the shape.
    middle: f32,
    /// Width of the shape.
    width: f32,
    /// Fractional part of the copies' positions, in cells: ½ if an even number is centered on the shape.
    shift: f32,
    /// Indices of the outermost copies, if their number is finite.
    ends: Option<(f32, f32)>,
    /// Number of copies evaluated.
    evaluated: f32,
}

impl Axis {
    fn new(cell: f32, count: Option<CopyCount>, low: f32, high: f32) -> Self {
        let count = count.map(|CopyCount(count)| count);
        let width = high - low;
        let looked_at = max_overlapping(width, cell).min(MAX_EVALUATED_COPIES as f32);
        let half = count.map(|count| (count / 2) as f32);
        let is_even = count.is_some_and(|count| count % 2 == 0);
        Self {
            cell,
            middle: 0.5 * (low + high),
            width,
            shift: if is_even { 0.5 } else { 0.0 },
            ends: half.map(|half| (-half, if is_even { half - 1.0 } else { half })),
            evaluated: if count == Some(1) { 1.0 } else { looked_at },
        }
    }

    /// Offsets of the first and the last copy.
    fn reach(&self) -> (f32, f32) {
        let place = |end: f32| (end + self.shift) * self.cell;
        self.ends.map_or((-f32::INFINITY, f32::INFINITY), |(first, last)| (place(first), place(last)))
    }
}

/// Visits the copies along an axis that may be the nearest, each with the coordinate `c` in its own space.
fn for_each_copy<R: Real, T: Bundle<R>>(axis: Option<&Axis>, c: R, found: T, mut visit: impl FnMut(R, T) -> T) -> T {
    let Some(axis) = axis else {
        return visit(c, found);
    };
    let (near, side) =
        nearest_whole(c.mul_add(c.uniform(1.0 / axis.cell), c.uniform(-axis.middle / axis.cell - axis.shift)));
    let first = side.mul_add(c.uniform(-((axis.evaluated - 1.0) * 0.5).floor()), near);
    let (_, _, found) =
        R::repeat(MAX_EVALUATED_COPIES, (first, c.constant(1.0), found), |(number, looked_at, found)| {
            let copy = match axis.ends {
                Some((low, high)) => number.max(c.uniform(low)).min(c.uniform(high)),
                None => number,
            };
            let found = visit((copy + c.uniform(axis.shift)).mul_add(c.uniform(-axis.cell), c), found);
            (looked_at.lt(c.uniform(axis.evaluated)), (number + side, looked_at + 1.0, found))
        });
    found
}

impl Repeat {
    fn grid(&self) -> &GridLayout {
        self.grid.get(|| {
            let held = ChildBounds::new(&self.child);
            let bounds = held.bounds;
            let ends = [(bounds.min.x, bounds.max.x), (bounds.min.y, bounds.max.y), (bounds.min.z, bounds.max.z)];
            let axis = |index: usize| {
                let (low, high) = ends[index];
                self.cell[index].as_ref().map(|cell| Axis::new(cell.in_frame(), self.count[index], low, high))
            };
            GridLayout { axes: [axis(0), axis(1), axis(2)], held }
        })
    }
}

impl Sdf for Repeat {
    const EXAMPLE: &'static str = r#"{ "cell": [0.6, 0.6, 0.6], "count": [3, 2, 3], "child": {
        "box": { "size": [0.4, 0.4, 0.4], "round": 0.05 }
    } }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "cell": [0.8, null, 0.8], "child": { "cylinder": { "radius": 0.25, "height": 1.4 } } }"#,
        r#"{ "cell": [0.5, null, null], "count": [4, null, null], "child": {
            "capsule": { "a": [-0.5, -0.6, 0], "b": [0.5, 0.6, 0.2], "radius": 0.1 }
        } }"#,
        r#"{ "cell": [0.7, 0.6, 0.5], "count": [3, null, null], "child": { "translate": { "by": [0.3, 0.1, 0],
            "child": { "rotate": { "degrees": [20, 30, 40], "child": { "torus": { "radius": 0.2, "tube": 0.05 } } } }
        } } }"#,
    ];

    fn eval<R: Real, V: SdfValue<R>>(&self, p: Vec3<R>, sample: &impl Fn(usize, Vec3<R>) -> V) -> V {
        let GridLayout { axes: [x_axis, y_axis, z_axis], held } = self.grid();
        let original = RepeatedChild::new(&self.child, held);
        let nearest = for_each_copy(x_axis.as_ref(), p.x, RepeatedChild::start(p), |x, found| {
            for_each_copy(y_axis.as_ref(), p.y, found, |y, found| {
                for_each_copy(z_axis.as_ref(), p.z, found, |z, found| original.nearer(vec3(x, y, z), found))
            })
        });
        sample_nearest(nearest, sample)
    }

    around_child!();

    /// Copies move apart as the cells grow.
    fn way_from_child<R: Real>(&self, next: &Self, [p, q]: [Vec3<R>; 2], way: Option<Vec3<R>>) -> Option<Vec3<R>> {
        let growths = std::array::from_fn(|axis| {
            let (cell, next) = (self.cell[axis].as_ref()?, next.cell[axis].as_ref()?);
            cell.is_animated().then(|| next.in_frame() / cell.in_frame() - 1.0)
        });
        way_of_parts(growths, p - q, way)
    }

    fn own_exactness(&self) -> Exactness {
        match self.child.exactness() {
            Exactness::Exact if self.grid().axes.iter().flatten().all(|axis| axis.width < axis.cell) => {
                Exactness::Exact
            }
            Exactness::Exact => Exactness::Bound,
            // The value may jump where the set of evaluated copies changes, but it stays less
            // than the distance.
            Exactness::Bound | Exactness::Estimate => Exactness::Estimate,
        }
    }

    fn validate(&self) -> Option<NodeError> {
        if self.cell.iter().all(Option::is_none) {
            return Some(NodeError::new("cell", "repeats along no axis: give x, y or z a distance between copies"));
        }
        let bounds = self.child.bounds(0.0);
        let widths = [bounds.max.x - bounds.min.x, bounds.max.y - bounds.min.y, bounds.max.z - bounds.min.z];
        for (index, (cell, name)) in self.cell.iter().zip(["x", "y", "z"]).enumerate() {
            let (place, width) = (format!("cell/{index}"), widths[index]);
            let Some(cell) = cell.as_ref().map(Spacing::in_frame) else {
                if self.count[index].is_some() {
                    let message =
                        format!("counts copies along {name}, which is not repeated: give it a cell, or null here");
                    return Some(NodeError::new(format!("count/{index}"), message));
                }
                continue;
            };
            if !width.is_finite() {
                let message = format!(
                    "repeats a shape along {name}, where it is unbounded: use null, \
                     or bound the shape by an intersection"
                );
                return Some(NodeError::new(place, message));
            }
            if width > MAX_CELLS * cell {
                let message = format!(
                    "must be at least a quarter of the shape's width along {name}, which is {width}: \
                     make it {} or more",
                    width / MAX_CELLS
                );
                return Some(NodeError::new(place, message));
            }
        }
        None
    }

    fn bounds(&self, isolevel: f32) -> Bounds {
        let child = self.child.bounds(isolevel);
        let [x, y, z] = self.grid().axes.map(|axis| axis.map_or((0.0, 0.0), |axis| axis.reach()));
        child.translated(vec3(x.0, y.0, z.0)).union(child.translated(vec3(x.1, y.1, z.1)))
    }

    fn child_evaluations(&self) -> f32 {
        self.grid().axes.iter().flatten().map(|axis| axis.evaluated).product()
    }
}
