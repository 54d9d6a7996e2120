//! Backgrounds without a sky model: one color, a gradient, and an empty one.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Backdrop, Background};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::Color;

/// One color.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
pub struct SolidColor(pub Color);

/// A gradient from `bottom` to `top` by t = (dir.y + 1)/2 of the ray's direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SkyGradient {
    /// Color straight down.
    pub bottom: Color,
    /// Color straight up.
    pub top: Color,
}

/// Empty: alpha is 0.
#[derive(Clone, Copy, Debug)]
pub struct Transparent;

impl Backdrop for SolidColor {
    const EXAMPLE: &'static str = r##""#8fb3c9""##;

    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        Vec3::uniform(direction.x, self.0.get())
    }

    fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> {
        Some(self.radiance(normal))
    }
}

impl Backdrop for SkyGradient {
    const EXAMPLE: &'static str = r##"{ "bottom": "#f2c9a0", "top": "#35507f" }"##;

    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        gradient_at(&self.bottom, &self.top, direction.y, 0.5)
    }

    /// The mean of a gradient's t is ½ + n.y/3.
    fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> {
        Some(gradient_at(&self.bottom, &self.top, normal.y, 1.0 / 3.0))
    }
}

impl Background {
    /// Whether the background is empty, so that alpha is 0.
    pub fn is_transparent(&self) -> bool {
        matches!(self, Self::Transparent)
    }
}

impl Backdrop for Transparent {
    const EXAMPLE: &'static str = r#""transparent""#;

    fn radiance<R: Real>(&self, direction: Vec3<R>) -> Vec3<R> {
        let zero = direction.x.constant(0.0);
        vec3(zero, zero, zero)
    }

    fn cosine_mean<R: Real>(&self, normal: Vec3<R>) -> Option<Vec3<R>> {
        Some(self.radiance(normal))
    }
}

/// Color of a gradient at ½ + `share` · `height`.
fn gradient_at<R: Real>(bottom: &Color, top: &Color, height: R, share: f32) -> Vec3<R> {
    let share = height.mul_add(height.constant(share), height.constant(0.5));
    let (bottom, top) = (bottom.in_frame(), top.in_frame());
    let rise = vec3(top.x - bottom.x, top.y - bottom.y, top.z - bottom.z);
    Vec3::uniform(height, rise).mul_add(share, Vec3::uniform(height, bottom))
}

#[cfg(test)]
mod tests {
    use crate::backgrounds::Background;
    use crate::real::{Real, vec3};

    #[test]
    fn a_gradients_mean_is_that_of_many_directions() {
        let sky = Background::default();
        let normal = vec3(0.48_f32, 0.6, 0.64);
        let mean = sky.cosine_mean(normal).unwrap();
        let (mut sum, mut weight) = (vec3(0.0, 0.0, 0.0), 0.0);
        for step in 0..40_000 {
            let (height, turn) = ((step as f32 + 0.5) / 20_000.0 - 1.0, step as f32 * 2.399_963);
            let (s, c) = Real::sin_cos(turn % std::f32::consts::TAU);
            let across = Real::sqrt(1.0 - height * height);
            let direction = vec3(across * c, height, across * s);
            let cosine = direction.dot(normal).max(0.0);
            sum = sky.radiance(direction).mul_add(cosine, sum);
            weight += cosine;
        }
        assert!((sum.x / weight - mean.x).abs() < 2e-3, "{} {}", sum.x / weight, mean.x);
    }
}
