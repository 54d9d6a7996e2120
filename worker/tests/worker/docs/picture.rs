//! Renders the pictures of the generated pages.

use std::io::Cursor;

use scene::Job;
use worker::image::Provenance;
use worker::{CancelFlag, CpuRenderer, Simd};

/// A job of some objects, as JSON, on a floor.
pub(crate) fn on_a_floor(objects: &str) -> Job {
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [2.6, 2.1, 3.9], "look_at": [0, -0.1, 0], "fov": 36 }},
            "lights": [{{ "directional": {{ "direction": [-0.4, 0.9, 0.6], "color": [0.9, 0.88, 0.85] }} }},
                       {{ "directional": {{ "direction": [0.9, 0.3, 0.4], "color": [0.16, 0.18, 0.22], "shadow": false }} }}],
            "objects": [{objects},
                        {{ "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": -1.25 }} }},
                           "material": {{ "diffuse": {{ "kd": [0.42, 0.45, 0.5] }} }} }}] }},
          "image": {{ "width": 240, "height": 180, "samples": 16 }} }}"#
    );
    scene::parse(text.as_bytes()).expect("an example gives a valid job")
}

/// A job with these members of a scene, as JSON, and enough samples for soft light.
pub(crate) fn stage(keys: &str, [width, height]: [u32; 2]) -> Job {
    let text =
        format!(r#"{{ "scene": {{ {keys} }}, "image": {{ "width": {width}, "height": {height}, "samples": 96 }} }}"#);
    scene::parse(text.as_bytes()).unwrap_or_else(|refusal| panic!("{refusal}\n{text}"))
}

/// A PNG of a frame of a job.
pub(crate) fn render(job: &Job, frame: u32) -> Vec<u8> {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this CPU renders");
    let mut file = Cursor::new(Vec::new());
    let scratch = std::env::temp_dir();
    worker::frame::render_frame(&renderer, job, frame, None, &scratch, &mut file, &CancelFlag::new(), &|_| ())
        .expect("a small picture renders");
    file.into_inner()
}

/// Whether a PNG's provenance names this frame of a job, and its size. The picture version is left out, because most
/// pictures are the same in the next.
pub(crate) fn says_it_shows(png: &[u8], job: &Job, frame: u32) -> bool {
    let Ok(reader) = png::Decoder::new(Cursor::new(png)).read_info() else { return false };
    let info = reader.info();
    let of_any_version = |text: &str| {
        let mut said: serde_json::Value = serde_json::from_str(text).ok()?;
        said.as_object_mut()?.remove("picture_version");
        Some(said)
    };
    let wanted = of_any_version(&Provenance::new(&job.at(frame).expect("an example is valid in all frames")).json());
    let said =
        info.utf8_text.iter().filter_map(|chunk| chunk.get_text().ok()).any(|text| of_any_version(&text) == wanted);
    said && (info.width, info.height) == (job.image.width, job.image.height)
}

/// Whether a PNG shows what this frame of a job looks like: has the same bytes but for the picture version.
pub(crate) fn shows(png: &[u8], job: &Job, frame: u32) -> bool {
    says_it_shows(png, job, frame) && pixels(png) == pixels(&render(job, frame))
}

fn pixels(png: &[u8]) -> Vec<u8> {
    let mut reader = png::Decoder::new(Cursor::new(png)).read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a small picture")];
    reader.next_frame(&mut pixels).expect("a whole PNG");
    pixels
}
