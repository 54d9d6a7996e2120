//! Cache keys: what changes a picture changes its key.

use scene::values::FrameRate;
use scene::{Bits, Format, ImageSpec, Job, Layer, PICTURE_VERSION, Precision, ToneMap};

fn job(materials: &str, name: &str, radius: f32, samples: u32) -> Job {
    let text = format!(
        r#"{{ "name": "{name}", "scene": {{ "camera": {{ "position": [0, 0, 3], "look_at": [0, 0, 0] }},
            "materials": {{ {materials} }},
            "objects": [{{ "material": "{name}", "shape": {{ "sphere": {{ "radius": {radius} }} }} }}] }},
            "image": {{ "width": 8, "height": 8, "samples": {samples} }} }}"#
    );
    scene::parse(text.as_bytes()).unwrap()
}

#[test]
fn names_and_unused_materials_do_not_change_the_cache_key() {
    let a = job(r#""a": { "flat": { "color": [1, 0, 0] } }"#, "a", 1.0, 4);
    let b = job(r##""x": { "normals": {} }, "b": { "flat": { "color": "#ff0000" } }"##, "b", 1.0, 4);
    assert_eq!(a.cache_key(0), b.cache_key(0));
}

#[test]
fn each_setting_of_the_image_changes_the_cache_key() {
    type Change = fn(&mut ImageSpec);
    let png = job(r#""a": { "flat": { "color": [1, 0, 0] } }"#, "a", 1.0, 4);
    let mut exr = png.clone();
    exr.image.format = Format::Exr;
    let changes: [(&Job, Change); 10] = [
        (&png, |image| image.width = 9),
        (&png, |image| image.height = 9),
        (&png, |image| image.samples = 5.into()),
        (&png, |image| image.seed = 1),
        (&png, |image| image.bits = Bits::Sixteen),
        (&png, |image| image.tone_map = ToneMap::Filmic),
        (&png, |image| image.format = Format::Exr),
        (&exr, |image| image.layers = vec![Layer::Depth]),
        (&exr, |image| image.layers = vec![Layer::Normal]),
        (&exr, |image| image.precision = Precision::Float),
    ];
    let mut keys = vec![png.cache_key(0), png.cache_key(1)];
    for (job, change) in changes {
        let mut changed = job.clone();
        change(&mut changed.image);
        keys.push(changed.cache_key(0));
    }
    let distinct: std::collections::HashSet<_> = keys.iter().collect();
    assert_eq!(distinct.len(), keys.len());
    let at_frame = png.at(0).unwrap();
    assert_eq!(at_frame.pixels_cache_key(), at_frame.instant_key_of_version(PICTURE_VERSION));
    assert_ne!(at_frame.pixels_cache_key(), at_frame.instant_key_of_version(PICTURE_VERSION + 1));
}

#[test]
fn cache_key_changes_with_everything_that_changes_the_bytes() {
    let red = r#""a": { "flat": { "color": [1, 0, 0] } }"#;
    let first = job(red, "a", 1.0, 4);
    assert_ne!(first.cache_key(0), first.cache_key(1));
    assert_ne!(first.cache_key(0), job(red, "a", 1.5, 4).cache_key(0));
    assert_ne!(first.cache_key(0), job(red, "a", 1.0, 5).cache_key(0));
    let mut other = first.clone();
    other.image.tone_map = ToneMap::Filmic;
    assert_ne!(first.cache_key(0), other.cache_key(0));
    assert_eq!(first.at(0).unwrap().pixels_cache_key(), other.at(0).unwrap().pixels_cache_key());
    let mut other = first.clone();
    other.image.format = Format::Exr;
    assert_ne!(first.cache_key(0), other.cache_key(0));
    let mut faster = other.clone();
    faster.frames.fps = FrameRate::new(25.0).unwrap();
    assert_ne!(faster.cache_key(0), other.cache_key(0), "an EXR stores its rate");
    faster.image.format = Format::Png;
    assert_eq!(faster.cache_key(0), first.cache_key(0), "a PNG does not");
    let pixels_key = |job: &Job| job.at(0).unwrap().pixels_cache_key();
    assert_eq!(pixels_key(&first), pixels_key(&other));
}
