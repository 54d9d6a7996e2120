//! Bricks or tiles with mortar between them, on every side of a shape.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Pattern;
use super::checker::default_softness;
use super::wave::{kept, softened};
use crate::materials::param::lerp_colors;
use crate::materials::{ColorParam, ShadingPoint};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Fraction, Length, LengthOrZero};

/// Bricks in rows with mortar between them, or tiles if rows are not shifted.
///
/// The flat pattern is projected along all three axes and blended by the normal: triplanar mapping
/// (Ryan Geiss, "Generating complex procedural terrains using the GPU", GPU Gems 3, 2007, chapter 1,
/// <https://developer.nvidia.com/gpugems/gpugems3/part-i-geometry/chapter-1-generating-complex-procedural-terrains-using-gpu>).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Bricks {
    /// Width and height of a brick with its mortar.
    #[serde(default = "default_size")]
    pub size: [Length; 2],
    /// Width of the mortar.
    #[serde(default = "default_mortar")]
    pub mortar: LengthOrZero,
    /// Shift of a row relative to the row below, as a fraction of a brick's width.
    #[serde(default = "default_shift")]
    pub shift: Fraction,
    /// Each brick has a color between these two.
    #[serde(default = "default_colors")]
    pub colors: [ColorParam; 2],
    /// Color of the mortar.
    #[serde(default = "default_mortar_color")]
    pub mortar_color: ColorParam,
    /// Width of the transition from brick to mortar.
    #[serde(default = "default_softness")]
    pub softness: LengthOrZero,
}

/// Sample of the flat pattern: brick mask, color position.
type BrickSample<R> = (R, R);

impl Bricks {
    /// Sample at a point of the plane with a footprint: 1 in a brick and 0 in mortar, and the position of the brick's
    /// color between its two colors.
    fn sample_plane<R: Real>(&self, across: (R, R), up: (R, R), plane: u32) -> BrickSample<R> {
        let (width, height) = (self.size[0].in_frame(), self.size[1].in_frame());
        let ((across, seen_across), (up, seen_up)) = (across, up);
        let v = up * up.uniform(1.0 / height);
        let row = v.floor();
        let u = row.mul_add(row.uniform(self.shift.get()), across * across.uniform(1.0 / width));
        let column = u.floor();
        let inside = self.inside(u - column, width, seen_across) * self.inside(v - row, height, seen_up);
        let kept = kept(seen_across, 2.0 * width).min(kept(seen_up, 2.0 * height));
        (inside, (random(column, row, plane) - 0.5).mul_add(kept, u.constant(0.5)))
    }

    /// Fraction of brick along one edge of it, at the fraction `part` of its length, averaged over a footprint.
    fn inside<R: Real>(&self, part: R, length: f32, seen: R) -> R {
        let half = part.uniform(0.5 * self.mortar.get());
        let window = softened(self.softness.in_frame(), seen);
        // Fraction of the footprint before a distance from the joint's center: mortar is between the joint's edges.
        let from_middle = (part - 0.5).abs().mul_add(part.uniform(-length), part.uniform(0.5 * length));
        let before = |edge: R| ((edge - from_middle) / window + 0.5).at_least(0.0).at_most(1.0);
        let mortar = before(half) - before(-half);
        let mean = part.uniform((self.mortar.in_frame() / length).min(1.0));
        let kept = kept(seen, 2.0 * length);
        part.constant(1.0) - (mortar - mean).mul_add(kept, mean).at_most(1.0)
    }
}

/// A pseudorandom number from 0 to 1 for each brick of a plane.
///
/// The hash is Chris Wellons' lowbias32, "Prospecting for hash functions", 2018,
/// <https://nullprogram.com/blog/2018/07/31/>.
fn random<R: Real>(column: R, row: R, plane: u32) -> R {
    /// 1.5·2²³: added to an integer of up to seven digits, it leaves the integer in the low bits.
    const INTEGER_BIAS: f32 = 12_582_912.0;
    let word = (column + INTEGER_BIAS).to_bits() * 0x9e37_79b1 + (row + INTEGER_BIAS).to_bits() * 0x85eb_ca77 + plane;
    let word = (word ^ (word >> 16)) * 0x7feb_352d;
    let word = (word ^ (word >> 15)) * 0x846c_a68b;
    let word = word ^ (word >> 16);
    R::from_bits((word >> 9) | 0x3f80_0000) - 1.0
}

impl Pattern for Bricks {
    const ALIASES: &'static [&'static str] = &["brick"];
    const EXAMPLE: &'static str = r#"{ "size": [0.5, 0.2], "mortar": 0.03, "softness": 0.01 }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[r##"{ "size": [0.3, 0.3], "shift": 0, "mortar": 0.02,
        "colors": ["#2f6f8f", "#8cc7c1"], "mortar_color": "#f2f0e6" }"##];

    fn color<R: Real>(&self, place: &ShadingPoint<R>) -> Vec3<R> {
        let p = place.local_point;
        // A face more than 73° away from a plane's normal shows nothing of that plane.
        let weights = place.local_normal.map(|n| (n.abs() - 0.3).at_least(0.0).square());
        let whole = (weights.x + weights.y + weights.z).at_least(1e-6);
        let mut sum = (p.x.constant(0.0), p.x.constant(0.0));
        let x = (p.x, place.width_along(vec3(1.0, 0.0, 0.0)));
        let y = (p.y, place.width_along(vec3(0.0, 1.0, 0.0)));
        let z = (p.z, place.width_along(vec3(0.0, 0.0, 1.0)));
        for (plane, weight, across, up) in [(1, weights.x, z, y), (2, weights.y, x, z), (3, weights.z, x, y)] {
            sum = R::when(weight.above(0.0), sum, || {
                let (brick, color) = self.sample_plane(across, up, plane);
                (brick.mul_add(weight, sum.0), color.mul_add(weight, sum.1))
            });
        }
        let brick = lerp_colors(self.colors[0].at(place), self.colors[1].at(place), (sum.1 / whole).at_most(1.0));
        lerp_colors(self.mortar_color.at(place), brick, (sum.0 / whole).at_most(1.0))
    }

    fn color_params(&self) -> Vec<&ColorParam> {
        self.colors.iter().chain([&self.mortar_color]).collect()
    }

    fn looks_at_footprint(&self) -> bool {
        true
    }

    fn uses_local_normal(&self) -> bool {
        true
    }
}

fn default_size() -> [Length; 2] {
    [0.5, 0.2].map(|edge| Length::new(edge).expect("a size in range"))
}

fn default_mortar() -> LengthOrZero {
    LengthOrZero::new(0.03).expect("a size in range")
}

fn default_shift() -> Fraction {
    Fraction::new(0.5).expect("0.5 is in range")
}

fn default_colors() -> [ColorParam; 2] {
    [ColorParam::constant(0.25, 0.05, 0.03), ColorParam::constant(0.45, 0.14, 0.07)]
}

fn default_mortar_color() -> ColorParam {
    ColorParam::constant(0.5, 0.48, 0.44)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::materials::texture::tests::at;

    const WALL: &str =
        r#"{ "size": [1, 0.5], "mortar": 0.1, "colors": [[1, 0, 0], [1, 1, 0]], "mortar_color": [0, 0, 1] }"#;

    fn wall(x: f32, y: f32) -> Vec3<f32> {
        let bricks: Bricks = serde_json::from_str(WALL).unwrap();
        bricks.color(&ShadingPoint { local_normal: vec3(0.0, 0.0, 1.0), ..at(x, y, 0.3) })
    }

    #[test]
    fn mortar_is_between_bricks_and_rows_are_shifted() {
        let mortar = |x, y| wall(x, y).z;
        assert_eq!(
            [mortar(0.5, 0.25), mortar(0.94, 0.25), mortar(0.97, 0.25), mortar(1.03, 0.25)],
            [0.0, 0.0, 1.0, 1.0]
        );
        assert_eq!(
            [mortar(0.25, 0.48), mortar(0.25, 0.75), mortar(0.5, 0.75), mortar(1.0, 0.75)],
            [1.0, 0.0, 1.0, 0.0]
        );
    }

    #[test]
    fn a_brick_has_one_color_and_its_neighbors_have_others() {
        assert_eq!(wall(0.2, 0.2).y, wall(0.8, 0.4).y);
        let colors: Vec<f32> = (0..50).map(|column| wall(column as f32 + 0.5, 0.25).y).collect();
        let mean = colors.iter().sum::<f32>() / 50.0;
        assert!((mean - 0.5).abs() < 0.15, "{mean}");
        assert!(colors.windows(2).all(|pair| pair[0] != pair[1]));
    }
}
