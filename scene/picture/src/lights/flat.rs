//! Flat lights: a rectangle and a disc, which shine to one side.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::body::{LightBody, LightShape, Outline, PointOfLight};
use super::{LightOptions, LightSample, LightSource, default_color, default_shadow, strength_of_point};
use crate::backgrounds::Day;
use crate::light_groups::LightGroup;
use crate::materials::microfacet::orthonormal_basis;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Direction, Length, Point};

/// Light from a rectangle, to one side: a window, a panel. It lights distant surfaces that it faces like a point light of
/// the same color.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct RectangleLight {
    /// Center of the rectangle.
    pub position: Point,
    /// The direction in which it shines; of any length.
    pub direction: Direction,
    /// Direction of its height, as far as it is in the plane of the rectangle; of any length.
    #[serde(default = "Direction::up")]
    pub up: Direction,
    /// Width, across `up`.
    pub width: Length,
    /// Height, along `up`.
    pub height: Length,
    /// Its color, and its strength at a distance of 1 from an equivalent point light.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Whether the rectangle itself is seen.
    #[serde(default)]
    pub visible: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

/// Light from a disc, to one side. It lights distant surfaces that it faces like a point light of the same color.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct DiscLight {
    /// Center of the disc.
    pub position: Point,
    /// The direction in which it shines; of any length.
    pub direction: Direction,
    /// Radius.
    pub radius: Length,
    /// Its color, and its strength at a distance of 1 from an equivalent point light.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Whether the disc itself is seen.
    #[serde(default)]
    pub visible: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

/// A flat light.
struct FlatLight<'a> {
    position: &'a Point,
    direction: &'a Direction,
    sides: [Vec3<f32>; 2],
    outline: Outline,
    color: &'a Color,
}

impl FlatLight<'_> {
    fn body(&self) -> LightBody {
        let Self { position, direction, sides, outline, color } = *self;
        let shape = LightShape::Flat { center: position.in_frame(), normal: direction.unit(), sides, outline };
        // The irradiance over π at a distance of 1 is radiance · area/π.
        let radiance = color.in_frame().map(|c| c * (std::f32::consts::PI / outline.area().max(1e-20)));
        LightBody { shape, radiance }
    }

    fn sample<R: Real>(&self, p: Vec3<R>, pair: (R, R)) -> (LightSample<R>, R) {
        let body = self.body();
        let PointOfLight { direction, distance, solid_angle } = body.shape.sample(p, pair);
        (LightSample { direction, radiance: body.arriving(solid_angle) }, distance)
    }

    /// Strength at `p`, 0 behind the light.
    fn strength<R: Real>(&self, p: Vec3<R>) -> R {
        let size = (self.outline.area() / std::f32::consts::PI).sqrt();
        let strength = strength_of_point(p, self.position, self.color, size);
        let behind = (p - Vec3::uniform(p.x, self.position.get())).dot_uniform(self.direction.unit());
        R::select(behind.above(0.0), strength, p.x.constant(0.0))
    }
}

impl RectangleLight {
    fn flat(&self) -> FlatLight<'_> {
        let Self { position, direction, up, width, height, color, .. } = self;
        let normal = direction.unit();
        let across = up.unit().cross(normal);
        let sides = if across.length() < 1e-3 {
            let (right, up) = orthonormal_basis(normal);
            [right, up]
        } else {
            let right = across.normalize();
            [right, normal.cross(right)]
        };
        let outline = Outline::Rectangle([0.5 * width.in_frame(), 0.5 * height.in_frame()]);
        FlatLight { position, direction, sides, outline, color }
    }
}

impl DiscLight {
    fn flat(&self) -> FlatLight<'_> {
        let Self { position, direction, radius, color, .. } = self;
        let (right, up) = orthonormal_basis(direction.unit());
        FlatLight { position, direction, sides: [right, up], outline: Outline::Disc(radius.in_frame()), color }
    }
}

macro_rules! flat_light {
    ($Light:ident, $example:literal, $another:literal) => {
        impl LightSource for $Light {
            const EXAMPLE: &'static str = $example;
            const MORE_EXAMPLES: &'static [&'static str] = &[$another];

            fn sample<R: Real>(
                &self,
                p: Vec3<R>,
                _: R,
                _: Option<&Day>,
                pair: impl FnOnce() -> (R, R),
            ) -> Option<(LightSample<R>, R)> {
                Some(self.flat().sample(p, pair()))
            }

            fn options(&self) -> LightOptions<'_> {
                LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.color.is_black() }
            }

            fn place(&self) -> Option<(Vec3<f32>, f32)> {
                Some((self.position.in_frame(), self.flat().outline.radius()))
            }

            fn body(&self) -> Option<LightBody> {
                self.visible.then(|| self.flat().body())
            }

            fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
                self.flat().strength(p)
            }
        }
    };
}

flat_light!(
    RectangleLight,
    r#"{ "position": [-1.3, 1.7, 1.5], "direction": [1.3, -1.7, -1.5], "width": 1.6, "height": 0.8,
              "color": [4.6, 4.2, 3.6] }"#,
    r#"{ "position": [-1.3, 1.7, -1.2], "direction": [1.3, -1.4, 1.4],
              "up": [1, 1, 0], "width": 1.2, "height": 0.4, "color": [4.6, 4.2, 3.6], "visible": true }"#
);
flat_light!(
    DiscLight,
    r#"{ "position": [-1.3, 1.7, 1.5], "direction": [1.3, -1.7, -1.5], "radius": 0.7, "color": [4.6, 4.2, 3.6] }"#,
    r#"{ "position": [-1.3, 1.7, -1.2], "direction": [1.3, -1.4, 1.4],
              "radius": 0.4, "color": [4.6, 4.2, 3.6], "visible": true }"#
);
