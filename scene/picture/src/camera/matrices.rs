//! The two view matrices that OpenEXR files store.
//!
//! Both multiply row vectors, `p · M`, and store rows one after another, as OpenEXR does:
//! OpenEXR, "Standard Attributes", <https://openexr.com/en/latest/StandardAttributes.html>.

use super::View;
use crate::real::Vec3;

/// Rows one after another; a point is the row vector (x, y, z, 1).
pub type Matrix = [f32; 16];

/// A vector of doubles: the entries are sums of products, rounded once.
type Vector = [f64; 3];

impl View {
    /// Matrix from the scene to the camera: x to the right of the picture, y up, z away from the viewer; left-handed.
    pub fn world_to_camera(&self) -> Matrix {
        let [right, up, forward] = [self.right, self.up, self.forward].map(|axis| wide(axis.normalize()));
        let origin = wide(self.origin);
        matrix([right, up, forward, [0.0; 3]], [-dot(origin, right), -dot(origin, up), -dot(origin, forward), 1.0])
    }

    /// Matrix from the scene to the picture: (0, 0) is its top left corner and (1, 1) its bottom right one; z only
    /// orders points by depth. `None` for a projection that no matrix describes.
    pub fn world_to_ndc(&self) -> Option<Matrix> {
        self.projection.world_to_ndc(self)
    }

    /// Matrix of a pinhole camera.
    pub(super) fn pinhole_ndc(&self) -> Matrix {
        let (origin, forward) = (wide(self.origin), wide(self.forward));
        let (across, down) = self.half_axes();
        let (x, y) = (add(across, forward, 0.5), add(down, forward, 0.5));
        let last = [-dot(origin, x), -dot(origin, y), -dot(origin, forward) - 1.0, -dot(origin, forward)];
        matrix([x, y, forward, forward], last)
    }

    /// Matrix of parallel rays.
    pub(super) fn parallel_ndc(&self) -> Matrix {
        let (origin, forward) = (wide(self.origin), wide(self.forward));
        let (across, down) = self.half_axes();
        let last = [0.5 - dot(origin, across), 0.5 - dot(origin, down), -dot(origin, forward), 1.0];
        matrix([across, down, forward, [0.0; 3]], last)
    }

    /// Scale from distance to halves of the picture, along its right and its down direction.
    fn half_axes(&self) -> (Vector, Vector) {
        let half = |axis: Vec3<f32>, sign: f64| {
            let axis = wide(axis);
            axis.map(|c| 0.5 * sign * c / dot(axis, axis))
        };
        (half(self.right, 1.0), half(self.up, -1.0))
    }
}

/// Matrix of four columns above its last row.
fn matrix(columns: [Vector; 4], last: [f64; 4]) -> Matrix {
    std::array::from_fn(|index| {
        let (row, column) = (index / 4, index % 4);
        // Adding 0.0 turns -0.0 into 0.0.
        (columns[column].get(row).copied().unwrap_or(last[column]) + 0.0) as f32
    })
}

fn wide(v: Vec3<f32>) -> Vector {
    [v.x, v.y, v.z].map(f64::from)
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn add(a: Vector, b: Vector, factor: f64) -> Vector {
    [0, 1, 2].map(|axis| a[axis] + factor * b[axis])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;

    fn view(camera: &str) -> View {
        serde_json::from_str::<Camera>(camera).expect("a camera").view(200, 100)
    }

    fn apply(p: [f32; 3], m: &Matrix) -> [f32; 4] {
        std::array::from_fn(|column| p[0] * m[column] + p[1] * m[4 + column] + p[2] * m[8 + column] + m[12 + column])
    }

    fn is_near(got: &[f32], want: &[f32]) -> bool {
        got.iter().zip(want).all(|(got, want)| (got - want).abs() < 1e-5)
    }

    #[test]
    fn camera_space_is_left_handed_and_begins_at_the_camera() {
        let matrix = view(r#"{ "position": [1, 2, 5], "look_at": [1, 2, 0], "fov": 90 }"#).world_to_camera();
        assert!(is_near(&apply([1.0, 2.0, 5.0], &matrix), &[0.0, 0.0, 0.0, 1.0]));
        assert!(is_near(&apply([4.0, 2.5, -5.0], &matrix), &[3.0, 0.5, 10.0, 1.0]));
    }

    #[test]
    fn points_on_a_pixels_ray_project_to_that_pixel() {
        let slanted = r#""position": [3, 2, 5], "look_at": [-1, 0.5, 0], "up": [0.3, 1, 0]"#;
        for projection in ["\"fov\": 35", "\"projection\": { \"orthographic\": { \"height\": 3 } }"] {
            let view = view(&format!("{{ {slanted}, {projection} }}"));
            let matrix = view.world_to_ndc().expect("a matrix");
            for (x, y, distance) in [(0.5_f32, 0.5, 2.0), (100.0, 50.0, 7.0), (31.5, 88.5, 0.5), (199.5, 3.5, 40.0)] {
                let p = view.ray(x, y).at(distance);
                let [u, v, _, w] = apply([p.x, p.y, p.z], &matrix);
                let off = (200.0 * u / w - x).abs().max((100.0 * v / w - y).abs());
                assert!(off < 1e-3, "{projection}: {x}, {y} at {distance} is {off} pixels off");
            }
        }
    }

    #[test]
    fn a_panorama_has_a_camera_but_no_plane() {
        let view = view(r#"{ "position": [0, 1, 0], "look_at": [0, 1, -2], "projection": "panorama" }"#);
        assert_eq!(view.world_to_ndc(), None);
        assert!(is_near(&apply([0.0, 1.0, -2.0], &view.world_to_camera()), &[0.0, 0.0, 2.0, 1.0]));
    }
}
