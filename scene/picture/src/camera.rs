//! Camera: turns a point of the picture into a ray.

mod culling;
mod lens;
mod look_at;
mod matrices;
mod motion;
mod projections;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use lens::Lens;
pub use look_at::{Ahead, LookAt};
pub use matrices::Matrix;
pub use projections::{CameraAxes, Extent, Orthographic, Panorama, Perspective, Project, Projection};

use self::lens::Aperture;
use crate::bounds::Bounds;
use crate::film::Frames;
pub use crate::kinds::Example;
use crate::ray::{Ray, Tolerance};
use crate::real::{Real, Vec3, vec3};
use crate::seek::Seek;
use crate::values::{Direction, FieldOfView, Placement, Point, Revolutions, sin_cos_degrees};

/// Ray origins along an edge of the picture that stand for all.
const PLACES: u32 = 5;

/// Position, direction and projection of the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Position of the camera.
    pub position: Point,
    /// Point at the center of the picture, different from `position`; or how far ahead on its way the camera looks.
    pub look_at: LookAt,
    /// Direction that is up in the picture; not parallel to the view.
    #[serde(default = "default_up")]
    pub up: Direction,
    /// Vertical field of view of a perspective, in degrees; 40 when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [40]))]
    pub fov: Option<FieldOfView>,
    /// Projection of space onto the picture.
    #[serde(default, skip_serializing_if = "Projection::is_default")]
    #[schemars(extend("default" = "perspective"))]
    pub projection: Projection,
    /// Lens, which blurs what is not in focus; a pinhole when absent. Not of a panorama.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("examples" = [{ "aperture": 0.2, "focus": 4 }]))]
    pub lens: Option<Lens>,
    /// Rotates the camera around `look_at` over the frames of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turntable: Option<Turntable>,
    /// Placements of the groups that the camera belongs to, the outermost first.
    #[serde(skip_deserializing, skip_serializing_if = "Vec::is_empty")]
    #[schemars(skip)]
    pub placements: Vec<Placement>,
}

/// Rotation of the camera around `look_at`, about its `up` direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Turntable {
    /// Revolutions over all frames, counter-clockwise from above: frame i has made i/count of them.
    #[serde(default = "default_turns")]
    pub turns: Revolutions,
}

/// Camera prepared for a picture's size, ready to generate rays.
#[derive(Clone, Debug)]
pub struct View {
    projection: Projection,
    origin: Vec3<f32>,
    forward: Vec3<f32>,
    /// To the right; as long as half the picture's width at distance 1, and of length 1 in a panorama.
    right: Vec3<f32>,
    /// Up; as long as half the picture's height at distance 1, and of length 1 in a panorama.
    up: Vec3<f32>,
    /// 2/width and −2/height.
    scale: (f32, f32),
    /// The lens; `None` for a pinhole.
    lens: Option<Aperture>,
    footprint: Tolerance,
    /// Rounding error of coordinates around the camera, in scene units.
    coordinate_error: f32,
}

impl Camera {
    /// Errors in the camera: the JSON member and the message of each.
    pub fn errors(&self) -> Vec<(&'static str, &'static str)> {
        let mut errors = Vec::new();
        let view = self.view_error();
        errors.extend(view);
        errors.extend(self.fov.as_ref().and(self.projection.default_fov().err()).map(|message| ("fov", message)));
        let Some(lens) = &self.lens else { return errors };
        if let Some(message) = self.projection.validate_lens() {
            errors.push(("lens", message));
            return errors;
        }
        errors.extend(lens.errors());
        if view.is_none() {
            errors.extend(lens.focus_error(self.position.in_frame(), self.forward()));
        }
        errors
    }

    /// Error if the camera looks nowhere, or its picture has no upper edge.
    fn view_error(&self) -> Option<(&'static str, &'static str)> {
        let away = self.target() - self.position.in_frame();
        if self.look_at.is_ahead() && self.turntable.is_some() {
            return Some(("turntable", "circles the point look_at: give look_at a point, or leave turntable out"));
        }
        if self.look_at.is_ahead() && away.length() < 1e-6 {
            return Some((
                "look_at",
                "looks ahead of a camera that does not move: give position a path, a track or formulas, or look_at a point",
            ));
        }
        if away.length() < 1e-6 {
            return Some((
                "look_at",
                "is where the camera is: move look_at or position, so that the view has a direction",
            ));
        }
        if self.forward().cross(self.up.unit()).length() < 1e-4 {
            return Some((
                "up",
                "\"up\" points along the view, also if it is left out: choose an up that is not along look_at - position, such as [0, 0, -1]",
            ));
        }
        None
    }

    /// Direction to the center of the picture, of length 1, before the camera is placed by its groups.
    fn forward(&self) -> Vec3<f32> {
        (self.target() - self.position.in_frame()).normalize()
    }

    /// Point at the center of the picture.
    pub fn target(&self) -> Vec3<f32> {
        self.look_at.point(self.position.in_frame())
    }

    /// Tells a camera that looks ahead where it will be.
    pub fn link(&mut self) {
        self.look_at.follow(&self.position);
    }

    /// Fills in defaults, so that cameras with the same view are equal.
    pub fn fill_defaults(&mut self) {
        self.fov = self.fov.take().or_else(|| self.projection.default_fov().ok());
        self.lens = self.lens.take().and_then(Lens::reduced);
    }

    /// Applies the turntable's rotation for a frame and removes the turntable; returns whether there was one.
    pub(crate) fn apply_turntable(&mut self, frame: f64, frames: &Frames) -> bool {
        let Some(Turntable { turns }) = self.turntable.take() else { return false };
        let share = frame / f64::from(frames.count);
        let degrees = (360.0 * f64::from(turns.in_frame()) * share % 360.0) as f32;
        if degrees != 0.0 {
            let middle = self.target();
            let moved = rotate_about_axis(self.position.in_frame() - middle, self.up.unit(), degrees) + middle;
            self.position = Point::clamped(moved);
        }
        true
    }

    /// Prepares the camera for a picture of this size, in pixels from the top left; the center of pixel (0, 0) is
    /// (0.5, 0.5).
    pub fn view(&self, width: u32, height: u32) -> View {
        let origin = self.position.in_frame();
        let (to, up) = (self.target(), self.up.unit());
        let roll = self.look_at.roll(origin, up);
        let inward = self.placements.iter().rev();
        let (origin, to, up) = inward.fold((origin, to, up), |(origin, to, up), placement| {
            (placement.to_scene(origin), placement.to_scene(to), placement.direction_to_scene(up))
        });
        let forward = vec3(to.x - origin.x, to.y - origin.y, to.z - origin.z).normalize();
        let right = forward.cross(up).normalize();
        let right = if roll == 0.0 { right } else { rotate_about_axis(right, forward, roll) };
        let up = right.cross(forward);
        // A placement changes no distance.
        let focus = |lens: &Lens| lens.focus.distance(self.position.in_frame(), self.forward());
        let lens = self.lens.as_ref().map(|lens| lens.prepare(right, up, focus(lens)));
        let (width, height) = (width as f32, height as f32);
        let aspect = width / height;
        let Extent { half_width, half_height, footprint } = self.projection.extent(self.fov.as_ref(), aspect, height);
        let spread = if footprint.floor > 0.0 { half_width.max(half_height) } else { 0.0 };
        let size = origin.x.abs().max(origin.y.abs()).max(origin.z.abs()) + spread;
        let size = lens.as_ref().map_or(size, |lens| size + lens.radius());
        View {
            projection: self.projection.clone(),
            origin,
            forward,
            right: scaled(right, half_width),
            up: scaled(up, half_height),
            scale: (2.0 / width, -2.0 / height),
            lens,
            footprint,
            coordinate_error: 2e-7 * size + 1e-7,
        }
    }
}

impl View {
    /// The ray through the point (`x`, `y`) of the picture, in pixels from its top left, and through the center of the
    /// lens.
    pub fn ray<R: Real>(&self, x: R, y: R) -> Ray<R> {
        let across = x.mul_add(x.uniform(self.scale.0), x.constant(-1.0));
        let upwards = y.mul_add(y.uniform(self.scale.1), y.constant(1.0));
        let (right, up, forward) =
            (Vec3::uniform(x, self.right), Vec3::uniform(x, self.up), Vec3::uniform(x, self.forward));
        let origin = Vec3::uniform(x, self.origin);
        self.projection.ray(&CameraAxes { origin, right, up, forward }, across, upwards)
    }

    /// A ray through the point (`x`, `y`) of the picture, like [`View::ray`], and through a point of the lens, which the
    /// pair of numbers, 0 to 1 excluding 1, chooses. All rays of a point of the picture meet in the plane of focus. A
    /// pinhole takes no pair.
    pub fn ray_through_lens<R: Real>(&self, x: R, y: R, pair: impl FnOnce() -> (R, R)) -> Ray<R> {
        let central = self.ray(x, y);
        match &self.lens {
            None => central,
            Some(lens) => lens.ray(&central, Vec3::uniform(x, self.forward), pair()),
        }
    }

    /// Half a pixel's height at a distance along a ray.
    pub fn footprint(&self) -> Tolerance {
        self.footprint
    }

    /// Tolerance for a hit: a quarter of half a pixel's height keeps silhouettes accurate; the rest covers depth and
    /// the precision of `f32`.
    pub fn tolerance(&self) -> Tolerance {
        let Tolerance { slope, floor } = self.footprint;
        // For parallel rays: at most a fraction of the picture's extent.
        let shown = self.up.length();
        let floor = (0.25 * floor).min(5e-4 * shown) + self.coordinate_error;
        Tolerance { slope: (0.25 * slope).clamp(2e-6, 2.5e-4), floor }
    }

    /// Rounding error of a distance along the ray; a surface closer than this counts as hit.
    pub fn resolution(&self) -> Tolerance {
        Tolerance { slope: 1.5e-7, floor: self.coordinate_error }
    }

    /// Upper limit of half the edge of the tetrahedron for normals: a quarter of a pixel, and far above the precision
    /// of `f32`.
    pub fn normal_epsilon(&self) -> Tolerance {
        let Tolerance { slope, floor } = self.footprint;
        let least = if self.is_parallel() { 2e-5 } else { 3e-4 };
        Tolerance { slope: (0.5 * slope).max(least), floor: (0.5 * floor).max(100.0 * self.coordinate_error) }
    }

    /// Whether all rays through the center of the lens have one direction.
    fn is_parallel(&self) -> bool {
        self.footprint.slope == 0.0
    }

    /// Origins of rays at places all over a picture of this size in pixels: one if all rays have the same.
    pub fn ray_origins(&self, width: u32, height: u32) -> Vec<Vec3<f32>> {
        let along = |place: u32, edge: u32| (place as f32 + 0.5) * edge as f32 / PLACES as f32;
        let places = (0..PLACES * PLACES).map(|place| (place % PLACES, place / PLACES));
        let mut origins: Vec<_> = places.map(|(x, y)| self.ray(along(x, width), along(y, height)).origin).collect();
        origins.dedup();
        origins
    }

    /// Position of the camera: the center of its lens.
    pub fn origin(&self) -> Vec3<f32> {
        self.origin
    }

    /// Radius of the circle around the lens' aperture, in scene units; 0 for a pinhole.
    pub fn lens_radius(&self) -> f32 {
        self.lens.as_ref().map_or(0.0, Aperture::radius)
    }

    /// Points on the rim of a lens whose center is at `origin`; none of a pinhole.
    pub fn rim_of_lens(&self, origin: Vec3<f32>) -> Vec<Vec3<f32>> {
        self.lens.as_ref().map_or_else(Vec::new, |lens| lens.rim(origin).to_vec())
    }

    /// Box expanded like [`Bounds::with_margin`] for rays from any point of the lens.
    pub fn with_margin(&self, bounds: Bounds) -> Bounds {
        let radius = self.lens_radius();
        bounds.with_margin(self.origin.map(|c| c.abs() + radius))
    }
}

/// Vector rotated about an axis of length 1, by Olinde Rodrigues' formula:
/// <https://en.wikipedia.org/wiki/Rodrigues%27_rotation_formula>.
fn rotate_about_axis(v: Vec3<f32>, axis: Vec3<f32>, degrees: f32) -> Vec3<f32> {
    let (sine, cosine) = sin_cos_degrees(degrees);
    v * cosine + axis.cross(v) * sine + axis * (axis.dot(v) * (1.0 - cosine))
}

fn scaled(v: Vec3<f32>, factor: f32) -> Vec3<f32> {
    vec3(v.x * factor, v.y * factor, v.z * factor)
}

fn default_up() -> Direction {
    serde_json::from_str("[0, 1, 0]").expect("a direction")
}

fn default_turns() -> Revolutions {
    Revolutions::new(1.0).expect("1 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(camera: &str, width: u32, height: u32) -> View {
        serde_json::from_str::<Camera>(camera).unwrap().view(width, height)
    }

    fn is_near(got: Vec3<f32>, want: [f32; 3]) -> bool {
        (got - vec3(want[0], want[1], want[2])).length() < 1e-6
    }

    #[test]
    fn edge_rays_are_at_half_the_field_of_view() {
        let view = view(r#"{ "position": [0, 0, 5], "look_at": [0, 0, 0], "fov": 90 }"#, 200, 100);
        assert!(is_near(view.ray(100.0_f32, 50.0).direction, [0.0, 0.0, -1.0]));
        let top = view.ray(100.0_f32, 0.0).direction;
        assert!((top.y - top.z.abs()).abs() < 1e-6 && top.y > 0.0);
        let right = view.ray(200.0_f32, 50.0).direction;
        assert!((right.x - 2.0 * right.z.abs()).abs() < 1e-6 && right.x > 0.0);
        // Half of one of 100 pixels that together are 2 high at distance 1.
        assert_eq!((view.footprint().slope * 100.0 - 1.0).abs() < 1e-6, view.footprint().floor == 0.0);
    }

    #[test]
    fn orthographic_rays_are_parallel_and_start_in_a_plane() {
        let camera =
            r#"{ "position": [1, 2, 5], "look_at": [1, 2, 0], "projection": { "orthographic": { "height": 3 } } }"#;
        let view = view(camera, 200, 100);
        for (x, y, origin) in [
            (100.0_f32, 50.0, [1.0, 2.0, 5.0]),
            (100.0, 0.0, [1.0, 3.5, 5.0]),
            (200.0, 100.0, [4.0, 0.5, 5.0]),
            (0.0, 50.0, [-2.0, 2.0, 5.0]),
        ] {
            let ray = view.ray(x, y);
            assert!(is_near(ray.origin, origin) && is_near(ray.direction, [0.0, 0.0, -1.0]), "{x}, {y}: {ray:?}");
        }
        let footprint = view.footprint();
        assert!(footprint.slope == 0.0 && (footprint.floor - 0.015).abs() < 1e-8, "{footprint:?}");
    }

    #[test]
    fn panorama_directions_match_longitude_and_latitude() {
        let view = view(r#"{ "position": [0, 1, 0], "look_at": [0, 1, -2], "projection": "panorama" }"#, 400, 200);
        for (x, y, direction) in [
            (200.0_f32, 100.0, [0.0, 0.0, -1.0]),
            (300.0, 100.0, [1.0, 0.0, 0.0]),
            (100.0, 100.0, [-1.0, 0.0, 0.0]),
            (0.0, 100.0, [0.0, 0.0, 1.0]),
            (400.0, 100.0, [0.0, 0.0, 1.0]),
            (37.0, 0.0, [0.0, 1.0, 0.0]),
            (222.0, 200.0, [0.0, -1.0, 0.0]),
            (250.0, 50.0, [0.5, 0.5_f32.sqrt(), -0.5]),
        ] {
            let ray = view.ray(x, y);
            assert!(is_near(ray.direction, direction) && is_near(ray.origin, [0.0, 1.0, 0.0]), "{x}, {y}: {ray:?}");
        }
    }

    #[test]
    fn a_turntable_rotates_around_look_at() {
        let camera: Camera = serde_json::from_str(
            r#"{ "position": [1, 3, 5], "look_at": [1, 2, 0], "up": [0, 2, 0], "turntable": { "turns": -2 } }"#,
        )
        .unwrap();
        let frames = Frames { count: 16, ..Frames::default() };
        let position = |frame| {
            let mut camera = camera.clone();
            assert!(camera.apply_turntable(f64::from(frame), &frames) && camera.turntable.is_none());
            camera.position.in_frame()
        };
        for (frame, want) in [(0, [1.0, 3.0, 5.0]), (2, [-4.0, 3.0, 0.0]), (4, [1.0, 3.0, -5.0]), (8, [1.0, 3.0, 5.0])]
        {
            assert!(is_near(position(frame), want), "frame {frame}: {:?}", position(frame));
        }
        let slanted = (position(1) - vec3(1.0, 3.0, 0.0)).length();
        assert!((slanted - 5.0).abs() < 1e-5, "{slanted}");
    }
}
