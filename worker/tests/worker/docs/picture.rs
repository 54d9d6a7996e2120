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
fn render(job: &Job, frame: u32) -> Vec<u8> {
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this CPU renders");
    let mut file = Cursor::new(Vec::new());
    let scratch = std::env::temp_dir();
    worker::frame::render_frame(&renderer, job, frame, None, &scratch, &mut file, &CancelFlag::new(), &|_| ())
        .expect("a small picture renders");
    file.into_inner()
}

/// Pixels of a picture.
#[derive(Clone)]
pub(crate) struct Pixels {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// 8-bit sRGB and coverage, row by row.
    pub(crate) rgba: Vec<u8>,
    /// The lower bytes of a picture of 16 bits; else none.
    pub(crate) low: Vec<u8>,
}

/// Pixels of a frame of a job; its file says what it shows.
pub(crate) fn pixels(job: &Job, frame: u32) -> Pixels {
    let file = render(job, frame);
    let mut reader = png::Decoder::new(Cursor::new(file)).read_info().expect("a PNG");
    let said: Vec<_> = reader.info().utf8_text.iter().filter_map(|chunk| chunk.get_text().ok()).collect();
    assert!(said.contains(&provenance(job, frame).json()), "{said:?} does not say what it shows");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a small picture")];
    let info = reader.next_frame(&mut bytes).expect("a whole PNG");
    let [rgba, low] = match (info.color_type, info.bit_depth) {
        (png::ColorType::Rgba, png::BitDepth::Eight) => [bytes, Vec::new()],
        (png::ColorType::Rgb, png::BitDepth::Eight) => {
            let opaque = bytes.chunks_exact(3).flat_map(|color| [color[0], color[1], color[2], 255]);
            [opaque.collect(), Vec::new()]
        }
        (png::ColorType::Rgba, png::BitDepth::Sixteen) => {
            [0, 1].map(|byte| bytes.iter().skip(byte).step_by(2).copied().collect())
        }
        other => panic!("{other:?} is no documented picture"),
    };
    Pixels { width: info.width, height: info.height, rgba, low }
}

fn provenance(job: &Job, frame: u32) -> Provenance {
    Provenance::new(&job.at(frame).expect("an example is valid in all frames"))
}

/// Hash of what a picture shows: a frame of a job, and its size. The picture version is left out, because most pictures
/// are the same in the next.
pub(crate) fn shown_hash(job: &Job, frame: u32) -> String {
    let said = Provenance { picture_version: 0, ..provenance(job, frame) }.json();
    hash(format!("{said} {}x{}", job.image.width, job.image.height).as_bytes())
}

/// Hash of every pixel, and of the size.
pub(crate) fn pixels_hash(Pixels { width, height, rgba, low }: &Pixels) -> String {
    hash(&[&width.to_le_bytes(), &height.to_le_bytes(), rgba.as_slice(), low.as_slice()].concat())
}

/// The first half of a BLAKE3, in hex.
pub(crate) fn hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex()[..32].to_owned()
}
