//! Fake renderer of cheap pixels that are a pure function of job, frame and position, and jobs for it.

use proto::Rect;
use scene::Job;
use worker::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};

/// Every layer, in another order than the file's.
pub(crate) const ALL_LAYERS: &str = r#"["steps", "depth", "normal", "position", "albedo", "object"]"#;

/// A job whose scene hardly matters. `image` has members of the image, after the size.
pub(crate) fn job_text(width: u32, height: u32, image: &str, scene: &str) -> String {
    let comma = |members: &str| if members.is_empty() { String::new() } else { format!(", {members}") };
    format!(
        r#"{{ "scene": {{ "camera": {{ "position": [0, 0, 5], "look_at": [0, 0, 0] }},
             "objects": [ {{ "material": {{ "normals": {{}} }}, "shape": {{ "sphere": {{ "radius": 1 }} }} }} ]{} }},
             "image": {{ "width": {width}, "height": {height}{} }} }}"#,
        comma(scene),
        comma(image),
    )
}

pub(crate) fn job(width: u32, height: u32, image: &str) -> Job {
    scene::parse(job_text(width, height, image, "").as_bytes()).expect("the job is valid")
}

pub(crate) fn transparent_job(width: u32, height: u32, image: &str) -> Job {
    let text = job_text(width, height, image, r#""background": "transparent""#);
    scene::parse(text.as_bytes()).expect("the job is valid")
}

/// Smooth in some areas, noisy in others, from 0 to 1.2, and below alpha.
pub(crate) fn sample(plane: usize, x: u32, y: u32, frame: u32) -> f32 {
    let mut hash = (x / 5 + 7919 * (y / 3) + 104_729 * plane as u32).wrapping_mul(0x9E37_79B9) ^ frame;
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x85EB_CA6B);
    let noise = (hash >> 8) as f32 / (1 << 24) as f32;
    let slope = (x + y) as f32 / 997.0 + plane as f32 / 16.0;
    (slope + noise * 0.25).min(1.2)
}

/// Whether the fake scene is hit: rays that miss have no depth.
fn is_hit(x: u32, y: u32) -> bool {
    !(x / 16 + y / 16).is_multiple_of(3)
}

pub(crate) fn pixels(job: &Job, frame: u32, rect: Rect) -> TilePixels {
    let channels = job.image.film().channels();
    let mut pixels = TilePixels::zeroed(rect, channels.len());
    for (plane, (name, samples)) in channels.iter().zip(&mut pixels.planes).enumerate() {
        for (index, value) in samples.iter_mut().enumerate() {
            let (x, y) = (rect.x + index as u32 % rect.width, rect.y + index as u32 / rect.width);
            *value = match &**name {
                "A" => f32::from(u8::from(is_hit(x, y))).max(0.5),
                "Z" if !is_hit(x, y) => f32::INFINITY,
                "id" => {
                    if is_hit(x, y) {
                        0.0
                    } else {
                        -1.0
                    }
                }
                "N.X" => -0.0,
                _ => sample(plane, x, y, frame),
            };
        }
    }
    pixels
}

/// Renders [`pixels`].
pub(crate) struct FakeRenderer;

impl Renderer for FakeRenderer {
    fn device(&self) -> String {
        "cuda:7".to_owned()
    }

    fn render(
        &self,
        run: &TileRequest<'_>,
        cancel: &CancelFlag,
        progress: &(dyn Fn(u64) + Sync),
    ) -> Result<TilePixels, RenderError> {
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        progress(run.rect.pixels() * u64::from(run.job.image.samples.max()));
        Ok(pixels(run.job, run.frame, run.rect))
    }
}

/// Cuts a picture into tiles of this size, regardless of the grid.
pub(crate) fn cut(width: u32, height: u32, tile_width: u32, tile_height: u32) -> Vec<Rect> {
    let mut rects = Vec::new();
    for y in (0..height).step_by(tile_height as usize) {
        for x in (0..width).step_by(tile_width as usize) {
            rects.push(Rect { x, y, width: tile_width.min(width - x), height: tile_height.min(height - y) });
        }
    }
    rects
}
