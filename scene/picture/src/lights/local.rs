//! Lights with a position and a shape.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::body::{LightBody, LightShape, PointOfLight};
use super::{LightOptions, LightSample, LightSource, default_color, default_shadow, strength_of_point};
use crate::backgrounds::Day;
use crate::light_groups::LightGroup;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Color, Direction, Fraction, FullAngle, Length, Point};

/// Light from a point within a cone; its strength falls as 1/d².
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SpotLight {
    /// Position of the light.
    pub position: Point,
    /// Direction of the light; of any length.
    pub direction: Direction,
    /// The cone's full angle, in degrees.
    #[serde(default = "default_angle")]
    pub angle: FullAngle,
    /// Fraction of the cone, from its edge inward, over which the light fades in.
    #[serde(default = "default_softness")]
    pub softness: Fraction,
    /// Its color, and its strength at a distance of 1.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

/// Light from a ball. It lights distant surfaces like a point light of the same color, and its shadows have soft
/// edges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct SphereLight {
    /// Center of the ball.
    pub position: Point,
    /// Radius.
    pub radius: Length,
    /// Its color, and its strength at a distance of 1 from an equivalent point light.
    #[serde(default = "default_color")]
    pub color: Color,
    /// Whether objects cast shadows in this light.
    #[serde(default = "default_shadow")]
    pub shadow: bool,
    /// Whether the ball itself is seen.
    #[serde(default)]
    pub visible: bool,
    /// Light group, whose light an EXR has in layers of its own (`image.light_groups`).
    #[serde(default, skip_serializing)]
    pub group: Option<LightGroup>,
}

impl LightSource for SpotLight {
    const EXAMPLE: &'static str =
        r#"{ "position": [-1.6, 3.2, 2.6], "direction": [1.7, -4.4, -2.5], "angle": 30, "color": [26, 24, 21] }"#;
    const MORE_EXAMPLES: &'static [&'static str] = &[
        r#"{ "position": [-1.6, 3.2, 2.6], "direction": [1.7, -4.4, -2.5], "angle": 40, "softness": 1, "color": [26, 24, 21] }"#,
    ];

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        _: R,
        _: Option<&Day>,
        _: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let toward = Vec3::uniform(p.x, self.position.get()) - p;
        let distance = toward.length().at_least(1e-6);
        let per_distance = p.x.constant(1.0) / distance;
        let direction = toward * per_distance;
        let half = self.angle.in_frame() * (std::f32::consts::PI / 360.0);
        let (edge, full) = (Real::cos(half), Real::cos(half * (1.0 - self.softness.in_frame())));
        let inside = -direction.dot_uniform(self.direction.unit());
        let share = (inside - p.x.uniform(edge)) * p.x.uniform(1.0 / (full - edge).max(1e-6));
        let share = share.at_least(0.0).at_most(1.0);
        let fade = share.square() * (share.constant(3.0) - share * 2.0);
        let radiance = Vec3::uniform(p.x, self.color.get()) * (per_distance.square() * fade);
        Some((LightSample { direction, radiance }, distance))
    }

    fn place(&self) -> Option<(Vec3<f32>, f32)> {
        Some((self.position.in_frame(), 0.0))
    }

    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        let strength = strength_of_point(p, &self.position, &self.color, 0.0);
        let toward = (Vec3::uniform(p.x, self.position.get()) - p).normalize();
        let edge = p.x.uniform(Real::cos(self.angle.in_frame() * (std::f32::consts::PI / 360.0)));
        R::select(edge.lt(-toward.dot_uniform(self.direction.unit())), strength, p.x.constant(0.0))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.color.is_black() }
    }
}

impl LightSource for SphereLight {
    const ALIASES: &'static [&'static str] = &["area"];
    const EXAMPLE: &'static str = r#"{ "position": [-1.3, 1.5, 1.5], "radius": 0.5, "color": [4.6, 4.2, 3.6] }"#;
    const MORE_EXAMPLES: &'static [&'static str] =
        &[r#"{ "position": [-1.3, 1.5, 1.5], "radius": 0.5, "color": [4.6, 4.2, 3.6], "visible": true }"#];

    fn sample<R: Real>(
        &self,
        p: Vec3<R>,
        _: R,
        _: Option<&Day>,
        pair: impl FnOnce() -> (R, R),
    ) -> Option<(LightSample<R>, R)> {
        let body = self.shape_and_radiance();
        let PointOfLight { direction, distance, solid_angle } = body.shape.sample(p, pair());
        Some((LightSample { direction, radiance: body.arriving(solid_angle) }, distance))
    }

    fn options(&self) -> LightOptions<'_> {
        LightOptions { group: self.group.as_ref(), casts_shadows: self.shadow, is_dark: self.color.is_black() }
    }

    fn body(&self) -> Option<LightBody> {
        self.visible.then(|| self.shape_and_radiance())
    }

    fn place(&self) -> Option<(Vec3<f32>, f32)> {
        Some((self.position.in_frame(), self.radius.in_frame()))
    }

    fn strength<R: Real>(&self, p: Vec3<R>, _: Option<&Day>) -> R {
        let Self { position, radius, color, .. } = self;
        strength_of_point(p, position, color, radius.in_frame())
    }
}

impl SphereLight {
    fn shape_and_radiance(&self) -> LightBody {
        let (center, radius, color) = (self.position.in_frame(), self.radius.in_frame(), self.color.in_frame());
        let per_square = 1.0 / (radius * radius).max(1e-20);
        LightBody { shape: LightShape::Sphere { center, radius }, radiance: color.map(|c| c * per_square) }
    }
}

fn default_angle() -> FullAngle {
    FullAngle::new(40.0).expect("40 is in range")
}

fn default_softness() -> Fraction {
    Fraction::new(0.2).expect("0.2 is in range")
}
