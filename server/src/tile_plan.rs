//! Plans the frames and tiles of a job: arithmetic only.

use proto::Rect;
use proto::tile::Tiling;
use serde::{Deserialize, Serialize};

/// Edge of the tiles of a recorded job.
const RECORDED_EDGE_PX: u32 = 128;

/// How every frame of a job is cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct TilePlan {
    /// Picture width, in pixels.
    pub(crate) width_px: u32,
    /// Picture height, in pixels.
    pub(crate) height_px: u32,
    /// Rays per pixel.
    pub(crate) samples: u32,
    /// Bytes of finished data per pixel.
    pub(crate) pixel_bytes: u32,
    /// Edge of a tile, in pixels, if the rays alone do not decide it: requested by the operator, or planned by the work of a
    /// ray.
    pub(crate) edge_px: Option<u32>,
    /// Frames of the job.
    pub(crate) frames: u32,
}

impl TilePlan {
    /// Plan of a job; `edge_px` is the operator's tile edge, if any.
    pub(crate) fn new(job: &scene::Job, edge_px: Option<u32>) -> Self {
        let film = job.image.film();
        let by_rays = Self {
            width_px: film.width,
            height_px: film.height,
            samples: job.image.samples.max(),
            pixel_bytes: film.pixel_bytes(),
            edge_px,
            frames: job.frames.count,
        };
        match work_per_ray(&job.scene) {
            1 => by_rays,
            work => by_rays.with_work(work),
        }
    }

    /// The plan with smaller tiles because each ray is this many times the work of a simple one, unless the operator chose
    /// an edge.
    fn with_work(self, work: u32) -> Self {
        let by_work = Tiling { samples: self.samples.saturating_mul(work), ..self.tiling() };
        Self { edge_px: self.edge_px.or_else(|| Some(by_work.edge_px())), ..self }
    }

    /// The plan with tiles that are small enough for an edit to leave some as they are, unless the operator chose an edge.
    pub(crate) fn recorded(self) -> Self {
        Self { edge_px: self.edge_px.or(Some(RECORDED_EDGE_PX)), ..self }
    }

    /// Tiles of one frame, row by row; all frames have the same.
    pub(crate) fn tiles(&self) -> Vec<Rect> {
        self.tiling().tiles()
    }

    fn tiling(&self) -> Tiling {
        Tiling {
            width: self.width_px,
            height: self.height_px,
            samples: self.samples,
            pixel_bytes: self.pixel_bytes,
            tile_edge: self.edge_px,
        }
    }

    /// Tiles of all frames.
    pub(crate) fn tiles_total(&self) -> u64 {
        self.tiles().len() as u64 * u64::from(self.frames)
    }

    /// Camera rays of one frame.
    pub(crate) fn frame_rays(&self) -> u64 {
        self.rays(Rect::full(self.width_px, self.height_px))
    }

    /// Camera rays of all frames.
    pub(crate) fn rays_total(&self) -> u64 {
        self.frame_rays().saturating_mul(u64::from(self.frames))
    }

    /// Bytes of one frame's finished data.
    pub(crate) fn frame_bytes(&self) -> u64 {
        Rect::full(self.width_px, self.height_px).pixels() * u64::from(self.pixel_bytes)
    }

    /// Camera rays of a rectangle.
    pub(crate) fn rays(&self, rect: Rect) -> u64 {
        rect.pixels() * u64::from(self.samples)
    }
}

/// About how many times the work of a ray that meets one diffuse surface a ray of this scene is.
fn work_per_ray(scene: &scene::Scene) -> u32 {
    let goes_on = |material: &scene::materials::Material| material.is_transmissive() || material.is_medium();
    match (scene.integrator.is_path(), scene.used_materials().iter().any(goes_on)) {
        (false, false) => 1,
        (false, true) => 4,
        (true, false) => 8,
        (true, true) => 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_smaller_where_a_ray_is_more_work() {
        let plan = |integrator: &str, material: &str, edge_px| {
            let text = format!(
                r#"{{ "name": "ball", "image": {{ "width": 1024, "height": 1024, "samples": 4 }},
                    "scene": {{ "camera": {{ "position": [0, 0, 3], "look_at": [0, 0, 0] }}, "integrator": {integrator},
                        "objects": [{{ "shape": {{ "sphere": {{ "radius": 1 }} }}, "material": {material} }}] }} }}"#
            );
            TilePlan::new(&scene::parse(text.as_bytes()).expect("a valid job"), edge_px)
        };
        let (direct, path) = (r#""direct""#, r#"{ "path": {} }"#);
        let (diffuse, glass) = (r#"{ "diffuse": {} }"#, r#"{ "surface": { "transmission": 1, "ior": 1.5 } }"#);
        let edges = [(direct, diffuse), (direct, glass), (path, diffuse), (path, glass)]
            .map(|(integrator, material)| plan(integrator, material, None).tiles()[0].width);
        assert_eq!(edges, [512, 256, 192, 128]);
        assert_eq!(plan(path, glass, Some(512)).tiles()[0].width, 512, "the operator decides");
    }

    #[test]
    fn tiles_have_all_rays_of_a_frame() {
        let plan =
            TilePlan { width_px: 1920, height_px: 1080, samples: 4, pixel_bytes: 16, edge_px: Some(256), frames: 3 };
        let rays: u64 = plan.tiles().into_iter().map(|rect| plan.rays(rect)).sum();
        assert_eq!(rays, plan.frame_rays());
        assert_eq!(plan.rays_total(), 3 * rays);
        assert_eq!(plan.tiles_total(), 3 * 8 * 5);
    }
}
