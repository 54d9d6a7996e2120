//! Lens: rays through the points of an aperture instead of one pinhole, so that only what is in focus is sharp.
//!
//! All rays of a point of the picture meet in one point of the plane of focus, as behind a thin lens. What is nearer or
//! farther becomes a circle of confusion, which has the shape of the aperture: Robert L. Cook, Thomas Porter, Loren Carpenter,
//! "Distributed ray tracing", SIGGRAPH 1984; Michael Potmesil, Indranil Chakravarty, "A lens and aperture camera model
//! for synthetic image generation", SIGGRAPH 1981. The field of view is the camera's: a lens does not change it.

#[cfg(test)]
mod tests;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize};

use super::Example;
use crate::kinds::Kind;
use crate::limits::MIN_LENGTH;
use crate::ray::Ray;
use crate::real::{Real, Vec3};
use crate::seek::Seek;
use crate::values::{Degrees, FNumber, Focus, Length, LengthOrZero, integer, sin_cos_degrees};

/// Minimum number of blades; below, an aperture's edge is not closed by blades.
const MIN_BLADES: u32 = 5;
/// Maximum number of blades.
const MAX_BLADES: u32 = 16;

/// A thin lens: what is on the plane of focus is sharp, and what is nearer or farther is blurred. Without one, the
/// camera is a pinhole, and everything is sharp.
///
/// At a distance d along the view, a point of the picture shows a disc as wide as `aperture` · |d − f| / f, where f is the
/// distance of the plane of focus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Lens {
    /// Diameter of the aperture (the entrance pupil), in scene units: wider is more blur, and 0 is a pinhole. Or give
    /// `f_stop` and `focal_length`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [0.2]))]
    pub aperture: Option<LengthOrZero>,
    /// The f-number, instead of `aperture`, which is `focal_length` / `f_stop`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [2.8]))]
    pub f_stop: Option<FNumber>,
    /// Focal length, in scene units, with `f_stop`: 0.05 for a lens of 50 mm if a unit is a meter. It does not change
    /// the field of view.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [0.05]))]
    pub focal_length: Option<Length>,
    /// The plane in focus, perpendicular to the view: at this distance along the view, or through this point.
    #[schemars(extend("examples" = [4]))]
    pub focus: Focus,
    /// Number of blades of the aperture, whose shape blurred points of light have: 0 for a circle, or 5 to 16.
    #[serde(default, deserialize_with = "blades")]
    #[schemars(range(max = MAX_BLADES), extend("not" = { "type": "integer", "minimum": 1, "maximum": 4 }))]
    pub blades: u32,
    /// Turn of the blades in the picture, in degrees, counter-clockwise; at 0, a corner of the aperture is at its top.
    #[serde(default = "default_turn")]
    pub turn: Degrees,
}

impl Lens {
    /// Small valid values, as a user would write them, for pictures in the docs and for tests.
    pub(crate) fn values() -> Vec<String> {
        [
            r#"{ "aperture": 0.4, "focus": [0.1, -0.7, 2.4] }"#,
            r#"{ "f_stop": 1.4, "focal_length": 0.6, "focus": 3.9, "blades": 6, "turn": 10 }"#,
            r#"{ "aperture": 0.4, "focus": 12 }"#,
        ]
        .map(str::to_owned)
        .into()
    }

    /// Examples of lenses, as a user would write them.
    pub fn examples() -> Vec<Example> {
        Kind::new("Lens", "Lens", &[], Self::values).plain_examples().collect()
    }

    /// The lens without what has no effect; `None` if it is a pinhole in all frames.
    pub(super) fn reduced(mut self) -> Option<Self> {
        if self.aperture.as_ref().is_some_and(LengthOrZero::is_zero) {
            return None;
        }
        if self.blades == 0 {
            self.turn = default_turn();
        }
        Some(self)
    }

    /// Errors in its numbers: the member of the camera, and the message.
    pub(super) fn errors(&self) -> Option<(&'static str, &'static str)> {
        match (&self.aperture, &self.f_stop, &self.focal_length) {
            (Some(_), None, None) | (None, Some(_), Some(_)) => None,
            (Some(_), Some(_), _) => Some((
                "lens/aperture",
                "is given twice, because f_stop and focal_length are an aperture, too: remove it, or both of them",
            )),
            (_, None, Some(_)) => Some((
                "lens/focal_length",
                "has no effect without f_stop: remove it, or give f_stop instead of aperture",
            )),
            (None, Some(_), None) => Some((
                "lens/f_stop",
                "needs focal_length, because the aperture is focal_length / f_stop: add it, or give aperture instead",
            )),
            (None, None, None) => {
                Some(("lens", "has no aperture: add aperture, its diameter in scene units, or f_stop and focal_length"))
            }
        }
    }

    /// Error if its plane of focus is not ahead of a camera at `position` that looks along `forward`.
    pub(super) fn focus_error(&self, position: Vec3<f32>, forward: Vec3<f32>) -> Option<(&'static str, &'static str)> {
        let is_ahead = self.focus.distance(position, forward) >= MIN_LENGTH;
        (!is_ahead).then_some((
            "lens/focus",
            "is behind the camera or beside it: choose a point that is farther along the view, or a distance",
        ))
    }

    /// Radius of its aperture, in scene units.
    fn radius(&self) -> f32 {
        let ratio = || {
            self.focal_length.as_ref().map_or(0.0, Length::in_frame)
                / self.f_stop.as_ref().map_or(1.0, FNumber::in_frame)
        };
        0.5 * self.aperture.as_ref().map_or_else(ratio, LengthOrZero::in_frame)
    }

    /// The lens of a camera whose picture has these directions of length 1. `focus` is the distance of its plane of focus.
    pub(super) fn prepare(&self, right: Vec3<f32>, up: Vec3<f32>, focus: f32) -> Aperture {
        let radius = self.radius();
        let shape = (self.blades > 0).then(|| Blades::new(self.blades));
        // The first triangle of a polygon is to the right of its top.
        let turn = if self.blades > 0 { 90.0 - 180.0 / self.blades as f32 + self.turn.in_frame() } else { 0.0 };
        let (sine, cosine) = sin_cos_degrees(turn);
        Aperture {
            across: (right * cosine + up * sine) * radius,
            upwards: (up * cosine - right * sine) * radius,
            radius,
            focus: focus.max(MIN_LENGTH),
            shape,
        }
    }
}

/// Lens of a view, ready to generate rays.
#[derive(Clone, Debug)]
pub(super) struct Aperture {
    /// From the center of the aperture, as long as its radius: to the right of the picture if it is a circle, to the
    /// middle of the first side's arc if it is a polygon.
    across: Vec3<f32>,
    /// At a right angle to `across`, counter-clockwise in the picture.
    upwards: Vec3<f32>,
    /// Radius of the circle, or of the circle through the corners of the polygon.
    radius: f32,
    /// Distance of the plane of focus along the view.
    focus: f32,
    /// The polygon; `None` for a circle.
    shape: Option<Blades>,
}

/// Polygon of an aperture in the circle of radius 1.
#[derive(Clone, Copy, Debug)]
struct Blades {
    count: f32,
    /// Half a side.
    half_side: f32,
    /// Distance from the center to a side.
    apothem: f32,
}

impl Aperture {
    /// Radius of the circle around it.
    pub(super) fn radius(&self) -> f32 {
        self.radius
    }

    /// Distance of the plane of focus along the view.
    pub(super) fn focus(&self) -> f32 {
        self.focus
    }

    /// Points of the circle around an aperture at `center`.
    pub(super) fn rim(&self, center: Vec3<f32>) -> [Vec3<f32>; 8] {
        std::array::from_fn(|eighth| {
            let (sine, cosine) = sin_cos_degrees(45.0 * eighth as f32);
            center + self.across * cosine + self.upwards * sine
        })
    }

    /// The ray through a point of the aperture that meets `central`, the ray through its center, in the plane of focus.
    /// The pair of numbers, 0 to 1 excluding 1, chooses the point.
    pub(super) fn ray<R: Real>(&self, central: &Ray<R>, forward: Vec3<R>, pair: (R, R)) -> Ray<R> {
        let (x, y) = self.shape.map_or_else(|| point_of_disc(pair), |blades| blades.point(pair));
        let (across, upwards) = (Vec3::uniform(x, self.across), Vec3::uniform(x, self.upwards));
        let offset = across.mul_add(x, upwards * y);
        // Scaled so that it does not depend on the plane's distance: the central ray meets the plane after
        // focus / cosine, where the offset is gone.
        let cosine = central.direction.dot(forward);
        let toward = offset.mul_add(-(cosine * x.uniform(1.0 / self.focus)), central.direction);
        Ray { origin: central.origin + offset, direction: toward.normalize() }
    }
}

/// Point of the unit disc, evenly distributed, so that areas of equal size stay so and neighbors stay neighbors.
///
/// Peter Shirley, Kenneth Chiu, "A low distortion map between disk and square", Journal of Graphics Tools 2(3), 1997.
fn point_of_disc<R: Real>((u, v): (R, R)) -> (R, R) {
    let (a, b) = (u.mul_add(u.constant(2.0), u.constant(-1.0)), v.mul_add(v.constant(2.0), v.constant(-1.0)));
    let is_wide = b.abs().lt(a.abs());
    let (radius, along) = (R::select(is_wide, a, b), R::select(is_wide, b, a));
    // At the center both are 0.
    let divisor = R::select(radius.abs().below(1e-12), radius.constant(1.0), radius);
    // An eighth of a turn at most.
    let (sine, cosine) = (along / divisor * 0.125).sin_cos_turns();
    (radius * R::select(is_wide, cosine, sine), radius * R::select(is_wide, sine, cosine))
}

impl Blades {
    fn new(count: u32) -> Self {
        let (half_side, apothem) = sin_cos_degrees(180.0 / count as f32);
        Self { count: count as f32, half_side, apothem }
    }

    /// Point of the polygon, evenly distributed: `u` chooses one of the triangles between its center and its sides, and
    /// the rest of `u`, with `v`, a point in that. The first triangle is around the x axis.
    ///
    /// Greg Turk, "Generating random points in triangles", Graphics Gems, 1990.
    fn point<R: Real>(self, (u, v): (R, R)) -> (R, R) {
        let scaled = u * u.uniform(self.count);
        // Rounding must not make a triangle more.
        let index = scaled.floor().min(u.uniform(self.count - 1.0));
        let from_center = (scaled - index).at_most(1.0).sqrt();
        let (x, y) = (
            from_center * u.uniform(self.apothem),
            from_center * v.mul_add(u.constant(2.0), u.constant(-1.0)) * u.uniform(self.half_side),
        );
        let (sine, cosine) = (index * u.uniform(1.0 / self.count)).sin_cos_turns();
        (x.mul_add(cosine, -(y * sine)), x.mul_add(sine, y * cosine))
    }
}

fn blades<'de, D: Deserializer<'de>>(d: D) -> Result<u32, D::Error> {
    let count = integer(d)?;
    u32::try_from(count).ok().filter(|count| *count == 0 || (MIN_BLADES..=MAX_BLADES).contains(count)).ok_or_else(
        || {
            serde::de::Error::custom(format_args!(
                "must be 0, for a circle, or {MIN_BLADES} to {MAX_BLADES} blades, not {count}"
            ))
        },
    )
}

fn default_turn() -> Degrees {
    Degrees::new(0.0).expect("0 is in range")
}
