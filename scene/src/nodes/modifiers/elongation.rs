//! Longer shapes: elongated in the middle, or stretched as a whole.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bounds::Bounds;
use crate::nodes::transforms::around_child;
use crate::nodes::{Child, Exactness, Node, Sample, Sdf};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Amount, Factor};

/// A shape cut through its middle and drawn apart, the gap filled with the cut.
///
/// Inigo Quilez, "Distance functions", elongation: <https://iquilezles.org/articles/distfunctions/>.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Elongate {
    /// Added length along x, y and z.
    pub by: [Amount; 3],
    /// The shape.
    pub child: Child,
}

/// Scales a shape along each axis separately.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Stretch {
    /// Factors along x, y and z.
    pub by: [Factor; 3],
    /// The shape.
    pub child: Child,
}

impl Sdf for Elongate {
    const EXAMPLE: &'static str = r#"{ "by": [0.8, 0, 0.4], "child": { "torus": { "radius": 0.4, "tube": 0.2 } } }"#;
    const MORE: &'static [&'static str] = &[r#"{ "by": [0, 0.9, 0], "child": { "sphere": { "radius": 0.6 } } }"#];

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        let [x, y, z] = &self.by;
        self.child.sample(vec3(drawn(p.x, x), drawn(p.y, y), drawn(p.z, z)))
    }

    // No two points become further apart, so the child's factor is that of the whole.
    around_child!();

    fn exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn bounds(&self, level: f32) -> Bounds {
        let Bounds { low, high } = self.child.bounds(level);
        let [x, y, z] = self.by.each_ref().map(|by| 0.5 * by.get());
        Bounds { low: vec3(low.x - x, low.y - y, low.z - z), high: vec3(high.x + x, high.y + y, high.z + z) }
    }
}

/// Coordinate before elongation.
#[inline(always)]
fn drawn<R: Real>(c: R, by: &Amount) -> R {
    let half = c.given(0.5 * by.get());
    c - c.min(half).max(-half)
}

impl Stretch {
    fn factors(&self) -> Vec3<f32> {
        let [x, y, z] = self.by.each_ref().map(Factor::get);
        vec3(x, y, z)
    }

    fn least(&self) -> f32 {
        let Vec3 { x, y, z } = self.factors();
        x.min(y).min(z)
    }
}

impl Sdf for Stretch {
    const EXAMPLE: &'static str = r#"{ "by": [1.1, 0.5, 0.8], "child": { "sphere": { "radius": 1 } } }"#;
    const MORE: &'static [&'static str] = &[r#"{ "by": [1.5, 1, 0.6], "child": { "rotate": {
        "degrees": [0, 0, 30], "child": { "torus": { "radius": 0.5, "tube": 0.2 } }
    } } }"#];

    #[inline(always)]
    fn sample<R: Real, V: Sample<R>>(&self, p: Vec3<R>) -> V {
        let per = Vec3::given(p.x, self.factors().map(|factor| 1.0 / factor));
        let child: V = self.child.sample(vec3(p.x * per.x, p.y * per.y, p.z * per.z));
        let distance = child.distance() * p.x.given(self.least());
        child.at(distance)
    }

    // Distances grow by at most 1/least, by which the value is multiplied: the child's Lipschitz factor
    // remains.
    around_child!();

    fn exactness(&self) -> Exactness {
        self.child.exactness().max(Exactness::Bound)
    }

    fn bounds(&self, level: f32) -> Bounds {
        let Bounds { low, high } = self.child.bounds(level / self.least());
        let Vec3 { x, y, z } = self.factors();
        Bounds { low: vec3(low.x * x, low.y * y, low.z * z), high: vec3(high.x * x, high.y * y, high.z * z) }
    }
}
