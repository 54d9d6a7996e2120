//! Motion of surfaces and of the background until the next frame.

use super::{Hit, Integrator};
use crate::animation::JobAtFrame;
use crate::camera::View;
use crate::film::ImageSpec;
use crate::ray::Ray;
use crate::real::{Real, Vec3};
use crate::scene::Scene;

/// The next frame, as far as motion depends on it.
#[derive(Clone, Debug)]
pub(super) struct NextFrame<'a> {
    scene: &'a Scene,
    view: View,
}

impl<'a> NextFrame<'a> {
    /// The next frame of a job whose pictures show motion; `None` of others, and if nothing in the job is animated.
    pub(super) fn of(at_frame: &'a JobAtFrame<'_>) -> Option<Self> {
        let scene = at_frame.next_scene()?;
        let &ImageSpec { width, height, .. } = at_frame.image();
        Some(Self { scene, view: scene.camera.view(width, height) })
    }
}

impl Integrator<'_> {
    /// The way of the background along a ray in the picture, in pixels to the right and up; `None` if nothing moves.
    pub(super) fn background_motion<R: Real>(&self, ray: &Ray<R>) -> Option<(R, R)> {
        self.next_frame.as_ref().map(|next| self.view.way_of_background(&next.view, ray.direction))
    }

    /// The way of an object's surface at a hit in the picture, in pixels to the right and up; `None` if nothing moves.
    pub(super) fn surface_motion<R: Real>(&self, hit: &Hit<R>, object: R) -> Option<(R, R)> {
        let next = self.next_frame.as_ref()?;
        let p = hit.position;
        let way = match &self.cells {
            Some(cells) => cells.way(p),
            None => self.way_of_object(next.scene, p, object),
        };
        Some(self.view.way_of_point(&next.view, [p, way.map_or(p, |way| p + way)]))
    }

    /// The way of an object's surface in space; `None` if no object is moved.
    fn way_of_object<R: Real>(&self, next: &Scene, p: Vec3<R>, object: R) -> Option<Vec3<R>> {
        let ways = self.surfaces.iter().filter_map(|&index| {
            let [shape, moved] = [self.scene, next].map(|scene| &scene.objects[index].shape);
            let is_here = (object - index as f32).abs().below(0.5);
            shape.carry(moved, p).way().map(|way| way.map(|c| R::select(is_here, c, c.constant(0.0))))
        });
        ways.reduce(|sum, way| sum + way)
    }
}
