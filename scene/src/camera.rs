//! From a point of the picture to a ray.

mod culling;
mod matrices;
mod projections;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use matrices::Matrix;
pub use projections::{
    CameraAxes, Example, Extent, HasExamples, Orthographic, Panorama, Perspective, Project, Projection,
};

use crate::job::Frames;
use crate::march::Tolerance;
use crate::real::{Real, Vec3, bundle, vec3};
use crate::seek::Seek;
use crate::values::{Direction, FieldOfView, Point, Revolutions, sin_cos_degrees};

/// Where the scene is seen from, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where it is.
    pub position: Point,
    /// A point in the middle of the picture; not where the camera is.
    pub look_at: Point,
    /// A direction that is up in the picture; not along the view.
    #[serde(default = "default_up")]
    pub up: Direction,
    /// The vertical field of view of a perspective, 40 degrees when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov: Option<FieldOfView>,
    /// How space becomes a picture.
    #[serde(default, skip_serializing_if = "Projection::is_default")]
    pub projection: Projection,
    /// Carries it around what it looks at, over the frames of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turntable: Option<Turntable>,
}

/// A camera's way around what it looks at, about the direction that is up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Seek)]
#[serde(deny_unknown_fields)]
pub struct Turntable {
    /// Turns over all frames, counter-clockwise from above: frame i is i/count of them on the way.
    #[serde(default = "default_turns")]
    pub turns: Revolutions,
}

/// A camera in front of a picture of some size, ready to make rays.
#[derive(Clone, Debug)]
pub struct View {
    projection: Projection,
    origin: Vec3<f32>,
    forward: Vec3<f32>,
    /// To the right, by the distance of half the picture's width; of length 1 in a panorama.
    right: Vec3<f32>,
    /// Up, by the distance of half the picture's height; of length 1 in a panorama.
    up: Vec3<f32>,
    /// 2/width and −2/height.
    scale: (f32, f32),
    footprint: Tolerance,
    /// What numbers around the camera are right to, in scene units.
    coordinate_error: f32,
}

/// A half line.
#[derive(Clone, Copy, Debug)]
pub struct Ray<R> {
    /// Where it starts.
    pub origin: Vec3<R>,
    /// Where it goes; of length 1.
    pub direction: Vec3<R>,
}

bundle!(Ray { origin, direction });

impl<R: Real> Ray<R> {
    /// The point at a distance.
    #[inline(always)]
    pub fn at(&self, distance: R) -> Vec3<R> {
        self.direction.mul_add(distance, self.origin)
    }
}

impl Camera {
    /// What is wrong with this camera, if anything: the key and the fault.
    pub(crate) fn validate(&self) -> Option<(&'static str, &'static str)> {
        let (from, to) = (self.position.get(), self.look_at.get());
        let away = vec3(to.x - from.x, to.y - from.y, to.z - from.z);
        if away.length() < 1e-6 {
            return Some((
                "look_at",
                "is where the camera is: move look_at or position, so that there is a direction to look in",
            ));
        }
        let forward = away.normalize();
        if forward.cross(self.up.unit()).length() < 1e-4 {
            return Some(("up", "points along the view: choose an up that is not along look_at - position"));
        }
        self.fov.as_ref().and(self.projection.validate_fov()).map(|message| ("fov", message))
    }

    /// Says what was left open, so that cameras that see the same are equal.
    pub(crate) fn fill_defaults(&mut self) {
        self.fov = self.fov.take().or_else(|| self.projection.default_fov());
    }

    /// Goes where the turntable has carried it in a frame, and steps off; whether there was one.
    pub(crate) fn apply_turntable(&mut self, frame: u32, frames: &Frames) -> bool {
        let Some(Turntable { turns }) = self.turntable.take() else { return false };
        let share = f64::from(frame) / f64::from(frames.count);
        let degrees = (360.0 * f64::from(turns.get()) * share % 360.0) as f32;
        if degrees != 0.0 {
            let middle = self.look_at.get();
            let moved = rotate_about_axis(self.position.get() - middle, self.up.unit(), degrees) + middle;
            self.position = Point::clamped(moved);
        }
        true
    }

    /// Prepares the camera for a picture of this size, in pixels from the top left; the center of pixel (0, 0) is (0.5, 0.5).
    pub fn view(&self, width: u32, height: u32) -> View {
        let (origin, to) = (self.position.get(), self.look_at.get());
        let forward = vec3(to.x - origin.x, to.y - origin.y, to.z - origin.z).normalize();
        let right = forward.cross(self.up.unit()).normalize();
        let up = right.cross(forward);
        let (width, height) = (width as f32, height as f32);
        let aspect = width / height;
        let Extent { half_width, half_height, footprint } = self.projection.extent(self.fov.as_ref(), aspect, height);
        let spread = if footprint.floor > 0.0 { half_width.max(half_height) } else { 0.0 };
        let size = origin.x.abs().max(origin.y.abs()).max(origin.z.abs()) + spread;
        View {
            projection: self.projection.clone(),
            origin,
            forward,
            right: scaled(right, half_width),
            up: scaled(up, half_height),
            scale: (2.0 / width, -2.0 / height),
            footprint,
            coordinate_error: 2e-7 * size + 1e-7,
        }
    }
}

impl View {
    /// The ray through the point (`x`, `y`) of the picture, in pixels from its top left.
    #[inline(always)]
    pub fn ray<R: Real>(&self, x: R, y: R) -> Ray<R> {
        let across = x.mul_add(x.uniform(self.scale.0), x.constant(-1.0));
        let upwards = y.mul_add(y.uniform(self.scale.1), y.constant(1.0));
        let (right, up, forward) =
            (Vec3::uniform(x, self.right), Vec3::uniform(x, self.up), Vec3::uniform(x, self.forward));
        let origin = Vec3::uniform(x, self.origin);
        self.projection.ray(&CameraAxes { origin, right, up, forward }, across, upwards)
    }

    /// Half a pixel's height, by the distance along a ray.
    pub fn footprint(&self) -> Tolerance {
        self.footprint
    }

    /// How near a surface a ray must come: a quarter of half a pixel keeps silhouettes; the rest
    /// keeps depth and the limits of `f32`.
    pub fn tolerance(&self) -> Tolerance {
        let Tolerance { slope, floor } = self.footprint;
        // Parallel rays: no more than a part of what the picture shows.
        let shown = self.up.length();
        let floor = (0.25 * floor).min(5e-4 * shown) + self.coordinate_error;
        Tolerance { slope: (0.25 * slope).clamp(2e-6, 2.5e-4), floor }
    }

    /// What a distance is right to, by the distance along the ray: below it, a surface has been met.
    pub fn resolution(&self) -> Tolerance {
        Tolerance { slope: 1.5e-7, floor: self.coordinate_error }
    }

    /// Half the edge of the tetrahedron that normals are measured on, at most: half of half a pixel, and far
    /// above the limits of `f32`.
    pub fn normal_epsilon(&self) -> Tolerance {
        let Tolerance { slope, floor } = self.footprint;
        let least = if floor > 0.0 { 2e-5 } else { 3e-4 };
        Tolerance { slope: (0.5 * slope).max(least), floor: (0.5 * floor).max(100.0 * self.coordinate_error) }
    }

    /// Where the camera is.
    pub fn origin(&self) -> Vec3<f32> {
        self.origin
    }
}

/// A vector turned about an axis of length 1, by Olinde Rodrigues' formula:
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
    fn the_middle_looks_forward_and_the_edge_at_half_the_field_of_view() {
        let view = view(r#"{ "position": [0, 0, 5], "look_at": [0, 0, 0], "fov": 90 }"#, 200, 100);
        assert!(is_near(view.ray(100.0_f32, 50.0).direction, [0.0, 0.0, -1.0]));
        let top = view.ray(100.0_f32, 0.0).direction;
        assert!((top.y - top.z.abs()).abs() < 1e-6 && top.y > 0.0);
        let right = view.ray(200.0_f32, 50.0).direction;
        assert!((right.x - 2.0 * right.z.abs()).abs() < 1e-6 && right.x > 0.0);
        // Half of one of 100 pixels that are 2 high together at distance 1.
        assert_eq!((view.footprint().slope * 100.0 - 1.0).abs() < 1e-6, view.footprint().floor == 0.0);
    }

    #[test]
    fn orthographic_rays_are_parallel_and_start_in_a_plane_of_the_given_height() {
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
    fn a_panorama_sees_each_direction_where_a_map_has_it() {
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
    fn a_turntable_goes_around_what_it_looks_at() {
        let camera: Camera = serde_json::from_str(
            r#"{ "position": [1, 3, 5], "look_at": [1, 2, 0], "up": [0, 2, 0], "turntable": { "turns": -2 } }"#,
        )
        .unwrap();
        let frames = Frames { count: 16, ..Frames::default() };
        let position = |frame| {
            let mut camera = camera.clone();
            assert!(camera.apply_turntable(frame, &frames) && camera.turntable.is_none());
            camera.position.get()
        };
        for (frame, want) in [(0, [1.0, 3.0, 5.0]), (2, [-4.0, 3.0, 0.0]), (4, [1.0, 3.0, -5.0]), (8, [1.0, 3.0, 5.0])]
        {
            assert!(is_near(position(frame), want), "frame {frame}: {:?}", position(frame));
        }
        let slanted = (position(1) - vec3(1.0, 3.0, 0.0)).length();
        assert!((slanted - 5.0).abs() < 1e-5, "{slanted}");
    }
}
