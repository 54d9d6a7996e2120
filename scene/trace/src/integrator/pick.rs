//! The surface that is seen at a point of a picture.

use super::Integrator;
use crate::real::Vec3;

/// Surface at a point of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Index of the object.
    pub object: usize,
    /// Slot of the material that has the greatest weight there.
    pub slot: Option<usize>,
    /// The point.
    pub position: Vec3<f32>,
    /// Normal, toward the viewer's side.
    pub normal: Vec3<f32>,
    /// Distance from the ray's origin.
    pub distance: f32,
}

impl Integrator<'_> {
    /// The surface at a point of the picture, in pixels from its top left; `None` if the ray hits none.
    pub fn seen_at(&self, x: f32, y: f32) -> Option<Seen> {
        let [x, y] = self.in_whole_picture(x, y);
        let ray = self.view.ray(x, y);
        let marched = if self.fine.is_empty() { self.march(&ray) } else { self.march_to_depth(&ray) };
        if !marched.hit.0 {
            return None;
        }
        let hit = self.hit(&ray, &marched);
        let object = self.nearest_object(hit.position).1;
        Some(Seen {
            object: object as usize,
            slot: self.heaviest_material(&hit, object),
            position: hit.position,
            normal: hit.normal,
            distance: hit.t,
        })
    }
}
