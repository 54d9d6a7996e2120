//! How the pictures of the pages are taken.

use std::io::Cursor;

use worker::{Cancel, CpuRenderer, Simd};

/// A PNG of some objects on a floor.
pub(crate) fn render(objects: &str) -> Vec<u8> {
    let text = format!(
        r#"{{ "scene": {{ "camera": {{ "position": [2.6, 2.1, 3.9], "look_at": [0, -0.1, 0], "fov": 36 }},
            "lights": [{{ "directional": {{ "direction": [-0.4, 0.9, 0.6], "color": [0.9, 0.88, 0.85] }} }},
                       {{ "directional": {{ "direction": [0.9, 0.3, 0.4], "color": [0.16, 0.18, 0.22], "shadow": false }} }}],
            "objects": [{objects},
                        {{ "shape": {{ "plane": {{ "normal": [0, 1, 0], "offset": -1.25 }} }},
                           "material": {{ "diffuse": {{ "kd": [0.42, 0.45, 0.5] }} }} }}] }},
          "image": {{ "width": 240, "height": 180, "samples": 16 }} }}"#
    );
    let job = scene::parse(text.as_bytes()).expect("an example makes a job");
    let renderer = CpuRenderer::new(None, Simd::Auto).expect("this CPU renders");
    let mut file = Cursor::new(Vec::new());
    let scratch = std::env::temp_dir();
    worker::frame::render_frame(&renderer, &job, 0, None, &scratch, &mut file, &Cancel::new(), &|_| ())
        .expect("a small picture renders");
    file.into_inner()
}
