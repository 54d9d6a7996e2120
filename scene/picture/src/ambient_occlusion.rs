//! Ambient occlusion: the fraction of ambient light that reaches a point, computed from distances alone.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Fraction, Length};

/// Darkens ambient light in corners, computed from distances alone.
///
/// Five cones touch the surface and divide the half space over it: one along the normal and four around it. Each is
/// sampled with three balls. A cone is occluded by the fraction of its ball that is under a surface. As in Alex Evans,
/// "Fast approximations for global illumination on dynamic scenes", SIGGRAPH 2006 course, a ball is compared with the
/// distance at its center. The cones follow Cyril Crassin et al., "Interactive indirect illumination using voxel cone
/// tracing", Computer Graphics Forum 30(7), 2011. A plane keeps all of its light, a right angle half.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct AmbientOcclusion {
    /// Maximum distance at which surfaces occlude, in scene units.
    pub distance: Length,
    /// Strength of the darkening, 0 to 1.
    #[serde(default = "default_strength")]
    pub strength: Fraction,
}

/// Centers of the balls along a cone, as fractions of the reach of the last ball, and their weights.
const BALLS: [(f32, f32); 3] = [(0.1, 0.4), (0.3, 0.35), (0.73, 0.25)];
/// Sine and cosine of the angle between the normal and the cones around it: 60 degrees. Seen from the cone's tip, a
/// ball has the cosine as its radius.
const ASIDE: (f32, f32) = (0.866_025_4, 0.5);
/// Weight of the cone along the normal; the four around it divide the rest equally.
const ALONG: f32 = 0.2;

impl AmbientOcclusion {
    /// Small valid values, as a user would write them, for pictures in the docs and for tests.
    pub(crate) fn examples() -> Vec<String> {
        [r#"{ "distance": 0.8 }"#].map(str::to_owned).into()
    }

    /// Distance evaluations of one call of `visibility`.
    pub const SAMPLES: f32 = 15.0;

    /// Ambient visibility of a point, 0 (occluded) to 1. `distance` returns the distance from a point to the nearest
    /// surface.
    pub fn visibility<R: Real>(&self, p: Vec3<R>, normal: Vec3<R>, distance: impl Fn(Vec3<R>) -> R) -> R {
        let (right, up) = frame_of_dome(normal);
        let (sine, cosine) = ASIDE;
        let around = |side: Vec3<R>| normal.mul_add(normal.x.constant(cosine), side * normal.x.constant(sine));
        let cone = |axis: Vec3<R>, height: f32| self.cone(p, axis, height, &distance);
        let sides = cone(around(right), cosine) + cone(around(-right), cosine);
        let sides = sides + (cone(around(up), cosine) + cone(around(-up), cosine));
        let open = sides.mul_add(sides.constant(0.25 * (1.0 - ALONG)), cone(normal, 1.0) * ALONG);
        (open - 1.0).mul_add(open.uniform(self.strength.get()), open.constant(1.0)).at_least(0.0).at_most(1.0)
    }

    /// Unoccluded fraction of a cone. Its balls have centers `height` above the surface for each unit along the cone.
    fn cone<R: Real>(&self, p: Vec3<R>, axis: Vec3<R>, height: f32, distance: impl Fn(Vec3<R>) -> R) -> R {
        let mut open = p.x.constant(1.0);
        let mut sum = p.x.constant(0.0);
        for (share, weight) in BALLS {
            let way = self.distance.in_frame() * share;
            let found = distance(axis.mul_add(p.x.uniform(way), p));
            let part = found.mul_add(p.x.uniform(0.5 / (way * height)), p.x.constant(0.5)).at_least(0.0).at_most(1.0);
            // The fraction of a ball that a plane cuts off. A cone is as occluded as its most occluded ball so far.
            let part = part.square() * (p.x.constant(3.0) - part * 2.0);
            open = open.min(part);
            sum = open.mul_add(open.constant(weight), sum);
        }
        sum
    }
}

/// Two directions at right angles to a normal and to each other. They vary continuously with the normal, except where
/// it points straight down; every such frame has an exception. Jeppe Revall Frisvad, "Building an orthonormal basis
/// from a 3D unit vector without normalization", Journal of Graphics Tools 16(3), 2012.
fn frame_of_dome<R: Real>(n: Vec3<R>) -> (Vec3<R>, Vec3<R>) {
    let one = n.x.constant(1.0);
    let a = one / (n.y + 1.0).at_least(1e-4);
    let b = -(n.x * n.z * a);
    (vec3(one - n.x.square() * a, -n.x, b), vec3(b, -n.z, one - n.z.square() * a))
}

fn default_strength() -> Fraction {
    Fraction::new(1.0).expect("1 is in range")
}
