//! A clear sky by day.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Backdrop, Background};
use crate::kinds::NodeError;
use crate::real::{Real, Vec3, vec3};
use crate::seek::{Invalidate, Seek, SeekError};
use crate::values::{Color, Direction, Strength, Turbidity};

/// A clear sky by day, lit by the sun, with ground below the horizon. The sun itself is not visible: use the light
/// `sun` for its light.
///
/// A. J. Preetham, Peter Shirley, Brian Smits, "A practical analytic model for daylight", SIGGRAPH 1999. A radiance of
/// 1 means 32 kcd/m².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
#[seek(then = follow)]
pub struct Day {
    /// Direction toward the sun, on or above the horizon.
    pub sun: Direction,
    /// Turbidity (haze) of the air: 2 is clear, 6 is hazy.
    #[serde(default = "default_turbidity")]
    pub turbidity: Turbidity,
    /// The color of the ground.
    #[serde(default = "default_ground")]
    pub ground: Color,
    /// Factor of the background's radiance.
    #[serde(default = "default_strength")]
    pub strength: Strength,
    /// Values that all directions use.
    #[serde(skip)]
    model: PreethamModel,
}

/// Precomputed coefficients of a [`Day`].
#[derive(Clone, Debug, Default, PartialEq)]
struct PreethamModel {
    /// Perez' A to E of the luminance Y and the chromaticities x and y.
    perez: [[f32; 5]; 3],
    /// Y, x and y at the zenith, divided by the formula's value there.
    zenith: [f32; 3],
    ground: [f32; 3],
    sun_color: [f32; 3],
}

impl Invalidate for PreethamModel {
    fn invalidate(&mut self) {
        *self = Self::default();
    }
}

/// Radiance for one kcd/m².
const PER_KILOCANDELA: f32 = 1.0 / 32.0;

impl Day {
    /// Validates the sun's direction after a number in the background has changed.
    fn follow(&mut self) -> Result<(), Box<SeekError>> {
        if let Some(NodeError { pointer: place, message }) = self.validate() {
            return Err(SeekError::new(&message).inside(&place));
        }
        self.model = PreethamModel::new(self);
        Ok(())
    }

    /// Irradiance of the sun over π on a surface that faces it, after atmospheric extinction.
    pub(crate) fn sun_color(&self) -> Vec3<f32> {
        let [red, green, blue] = self.model.sun_color;
        vec3(red, green, blue)
    }
}

impl Background {
    /// The background's `day`, if it is one.
    pub fn day(&self) -> Option<&Day> {
        if let Self::Day(day) = self { Some(day) } else { None }
    }
}

impl Backdrop for Day {
    const EXAMPLE: &'static str = r#"{ "sun": [0.8, 0.5, 0.4] }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "sun": [-0.6, 0.06, -0.8], "turbidity": 5, "ground": [0.3, 0.25, 0.2], "strength": 3 }"#];

    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        let like = direction.x;
        let cosine = direction.dot_uniform(self.sun.unit());
        let angle = cosine.acos();
        let per_height = like.constant(1.0) / direction.y.at_least(0.01);
        let value = |channel: usize| {
            let [a, b, c, d, e] = self.model.perez[channel].map(|number| like.uniform(number));
            let by_height = a.mul_add((b * per_height).exp(), like.constant(1.0));
            let by_angle = e.mul_add(cosine.square(), c.mul_add((d * angle).exp(), like.constant(1.0)));
            by_height * by_angle * like.uniform(self.model.zenith[channel])
        };
        let (luminance, x, y) = (value(0), value(1), value(2));
        let per_y = luminance / y.at_least(1e-3);
        let (big_x, big_z) = (x * per_y, (like.constant(1.0) - x - y) * per_y);
        // XYZ to linear sRGB: IEC 61966-2-1.
        let sky = vec3(
            big_x * 3.240_97 - luminance * 1.537_383 - big_z * 0.498_611,
            luminance * 1.875_968 - big_x * 0.969_244 + big_z * 0.041_555,
            big_x * 0.055_63 - luminance * 0.203_977 + big_z * 1.056_972,
        );
        let sky = sky.map(|channel| channel.at_least(0.0));
        let [red, green, blue] = self.model.ground;
        let ground = Vec3::uniform(like, vec3(red, green, blue));
        let below = (-direction.y * 12.0).at_least(0.0).at_most(1.0);
        (ground - sky).mul_add(below, sky)
    }

    fn validate(&self) -> Option<NodeError> {
        (self.sun.unit().y < 0.0)
            .then(|| NodeError::new("sun", "is below the horizon: give the sun's direction a y of 0 or more"))
    }

    fn precompute(&mut self) {
        self.model = PreethamModel::new(self);
    }
}

impl PreethamModel {
    fn new(day: &Day) -> Self {
        let t = day.turbidity.in_frame();
        let sun = day.sun.unit();
        let strength = day.strength.in_frame() * PER_KILOCANDELA;
        let angle = Real::acos(sun.y.max(0.0));
        let perez = [
            [
                0.1787 * t - 1.4630,
                -0.3554 * t + 0.4275,
                -0.0227 * t + 5.3251,
                0.1206 * t - 2.5771,
                -0.0670 * t + 0.3703,
            ],
            [
                -0.0193 * t - 0.2592,
                -0.0665 * t + 0.0008,
                -0.0004 * t + 0.2125,
                -0.0641 * t - 0.8989,
                -0.0033 * t + 0.0452,
            ],
            [
                -0.0167 * t - 0.2608,
                -0.0950 * t + 0.0092,
                -0.0079 * t + 0.2102,
                -0.0441 * t - 1.6537,
                -0.0109 * t + 0.0529,
            ],
        ];
        let chi = (4.0 / 9.0 - t / 120.0) * (std::f32::consts::PI - 2.0 * angle);
        let (sine, cosine) = Real::sin_cos(chi);
        let luminance = ((4.0453 * t - 4.9710) * sine / cosine - 0.2155 * t + 2.4192).max(0.05) * strength;
        let cubic = |[a, b, c, d]: [f32; 4]| ((a * angle + b) * angle + c) * angle + d;
        let chromaticity = |rows: [[f32; 4]; 3]| (cubic(rows[0]) * t + cubic(rows[1])) * t + cubic(rows[2]);
        let x = chromaticity([
            [0.00166, -0.00375, 0.00209, 0.0],
            [-0.02903, 0.06377, -0.03202, 0.00394],
            [0.11693, -0.21196, 0.06052, 0.25886],
        ]);
        let y = chromaticity([
            [0.00275, -0.00610, 0.00317, 0.0],
            [-0.04214, 0.08970, -0.04153, 0.00516],
            [0.15346, -0.26756, 0.06670, 0.26688],
        ]);
        let at_zenith = perez.map(|[a, b, c, d, e]| {
            let cosine = sun.y.max(0.0);
            (1.0 + a * Real::exp(b)) * (1.0 + c * Real::exp(d * angle) + e * cosine * cosine)
        });
        let zenith = [luminance / at_zenith[0], x / at_zenith[1], y / at_zenith[2]];
        let sun_color = sun_transmittance(t, angle).map(|channel| channel * SUN_KILOCANDELAS * strength);
        let albedo: [f32; 3] = day.ground.in_frame().into();
        let ground = std::array::from_fn(|i| albedo[i] * (sun_color[i] * sun.y.max(0.0) + luminance));
        Self { perez, zenith, ground, sun_color }
    }
}

/// The sun's illuminance above the air, 128 klx, over π.
const SUN_KILOCANDELAS: f32 = 40.7;

/// Atmospheric transmittance of the sun's red, green and blue: Rayleigh scattering and Ångström's haze, as in the
/// appendix of Preetham et al.
fn sun_transmittance(turbidity: f32, angle: f32) -> [f32; 3] {
    const WAVELENGTHS_UM: [f32; 3] = [0.615, 0.545, 0.465];
    let degrees = angle * (180.0 / std::f32::consts::PI);
    let mass = 1.0 / (Real::cos(angle) + 0.15 * Real::powf(93.885 - degrees, -1.253));
    let haze = 0.046_08 * turbidity - 0.045_86;
    WAVELENGTHS_UM.map(|wavelength| {
        let scattered = 0.008_735 * Real::powf(wavelength, -4.08) + haze * Real::powf(wavelength, -1.3);
        Real::exp(-mass * scattered)
    })
}

fn default_turbidity() -> Turbidity {
    Turbidity::new(2.5).expect("2.5 is in range")
}

fn default_ground() -> Color {
    Color::new(0.25, 0.23, 0.2)
}

fn default_strength() -> Strength {
    Strength::new(1.0).expect("1 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backgrounds::Background;

    fn day(sun: &str) -> Background {
        let mut sky: Background = serde_json::from_str(&format!(r#"{{ "day": {{ "sun": {sun} }} }}"#)).unwrap();
        sky.precompute();
        sky
    }

    #[test]
    fn noon_is_blue_above_and_the_evening_sun_is_red() {
        let noon = day("[0.2, 1, 0]").radiance(vec3(-0.3_f32, 0.9, 0.0).normalize());
        assert!(noon.z > 1.5 * noon.x && noon.x > 0.02, "{noon:?}");
        let high = day("[0, 1, 0]").day().unwrap().sun_color();
        let low = day("[1, 0.05, 0]").day().unwrap().sun_color();
        assert!(low.x > 3.0 * low.z && high.x < 1.5 * high.z, "{low:?} {high:?}");
    }
}
