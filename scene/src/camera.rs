//! From a point of the picture to a ray.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::real::{Real, Vec3, bundle, vec3};
use crate::values::{Direction, FieldOfView, Point};

/// A pinhole camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where it is.
    pub position: Point,
    /// A point in the middle of the picture; not where the camera is.
    pub look_at: Point,
    /// A direction that is up in the picture; not along the view.
    #[serde(default = "upwards")]
    pub up: Direction,
    /// The vertical field of view.
    #[serde(default = "forty_degrees")]
    pub fov: FieldOfView,
}

/// A camera in front of a picture of some size, ready to make rays.
#[derive(Clone, Copy, Debug)]
pub struct View {
    origin: Vec3<f32>,
    forward: Vec3<f32>,
    /// To the right, by the distance of half the picture's width.
    right: Vec3<f32>,
    /// Up, by the distance of half the picture's height.
    up: Vec3<f32>,
    /// 2/width and −2/height.
    scale: (f32, f32),
    /// Half a pixel's height at distance 1.
    cone: f32,
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
    pub(crate) fn fault(&self) -> Option<(&'static str, &'static str)> {
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
        None
    }

    /// The camera in front of a picture.
    pub fn view(&self, width: u32, height: u32) -> View {
        let (origin, to) = (self.position.get(), self.look_at.get());
        let forward = vec3(to.x - origin.x, to.y - origin.y, to.z - origin.z).normalize();
        let right = forward.cross(self.up.unit()).normalize();
        let up = right.cross(forward);
        let (sine, cosine) = Real::sin_cos(self.fov.get() * (std::f32::consts::PI / 360.0));
        let tangent = sine / cosine;
        let aspect = width as f32 / height as f32;
        View {
            origin,
            forward,
            right: scaled(right, aspect * tangent),
            up: scaled(up, tangent),
            scale: (2.0 / width as f32, -2.0 / height as f32),
            cone: tangent / height as f32,
        }
    }
}

impl View {
    /// The ray through the point (`x`, `y`) of the picture, in pixels from its top left.
    #[inline(always)]
    pub fn ray<R: Real>(&self, x: R, y: R) -> Ray<R> {
        let across = x.mul_add(x.given(self.scale.0), x.splat(-1.0));
        let upwards = y.mul_add(y.given(self.scale.1), y.splat(1.0));
        let middle = Vec3::given(x, self.forward);
        let direction = Vec3::given(x, self.right).mul_add(across, Vec3::given(x, self.up).mul_add(upwards, middle));
        Ray { origin: Vec3::given(x, self.origin), direction: direction.normalize() }
    }

    /// Half a pixel's height at distance 1 from the camera.
    pub fn cone(&self) -> f32 {
        self.cone
    }

    /// Where the camera is.
    pub fn origin(&self) -> Vec3<f32> {
        self.origin
    }
}

fn scaled(v: Vec3<f32>, factor: f32) -> Vec3<f32> {
    vec3(v.x * factor, v.y * factor, v.z * factor)
}

fn upwards() -> Direction {
    serde_json::from_str("[0, 1, 0]").expect("a direction")
}

fn forty_degrees() -> FieldOfView {
    FieldOfView::new(40.0).expect("40 is in range")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_looks_forward_and_the_edge_at_half_the_field_of_view() {
        let camera: Camera =
            serde_json::from_str(r#"{ "position": [0, 0, 5], "look_at": [0, 0, 0], "fov": 90 }"#).unwrap();
        let view = camera.view(200, 100);
        let middle = view.ray(100.0_f32, 50.0).direction;
        assert!((middle.z + 1.0).abs() < 1e-6 && middle.x.abs() < 1e-6 && middle.y.abs() < 1e-6);
        let top = view.ray(100.0_f32, 0.0).direction;
        assert!((top.y - top.z.abs()).abs() < 1e-6 && top.y > 0.0);
        let right = view.ray(200.0_f32, 50.0).direction;
        assert!((right.x - 2.0 * right.z.abs()).abs() < 1e-6 && right.x > 0.0);
    }
}
