//! Warnings about samples that make no visible difference, or that are too few to blur.

use serde_json::Value;

use picture::film::{Bits, Format, ImageSpec};
use picture::job::Job;
use picture::lights::Light;
use picture::sample_count::SampleCount;
use picture::scene::Scene;

/// Rays per pixel with which edges are accurate to a level of 8 bits.
const MIN_SAMPLES: u32 = 256;

/// More samples than a picture without noise can show.
pub(super) fn too_many(scene: &Scene, image: &ImageSpec) -> Option<String> {
    let is_coarse = image.format == Format::Png && image.bits == Bits::Eight;
    let SampleCount::Fixed(samples) = image.samples else { return None };
    if samples <= MIN_SAMPLES || !is_coarse || has_noise(scene) {
        return None;
    }
    Some(format!(
        "/image/samples is {samples}, and the scene has no noise: more than {MIN_SAMPLES} make no difference with 8 bits; use {MIN_SAMPLES} or fewer"
    ))
}

/// Samples with which a blur does not show its single points.
const MIN_BLUR_SAMPLES: u32 = 16;

/// So few samples that the blur of a lens or of a shutter falls apart.
pub(super) fn too_few(job: &Job) -> Option<String> {
    let samples = job.image.samples.max();
    let blurs = match (job.scene.camera.lens.is_some(), job.is_blurred()) {
        _ if samples >= MIN_BLUR_SAMPLES => return None,
        (true, true) => "the lens and the shutter blur",
        (true, false) => "the lens blurs",
        (false, true) => "the shutter blurs",
        (false, false) => return None,
    };
    Some(format!(
        "/image/samples is {samples}, and {blurs}: what is blurred looks grainy; use {MIN_BLUR_SAMPLES} or more, 64 for a final picture"
    ))
}

/// Whether the scene has random sampling, so that more samples reduce noise.
fn has_noise(scene: &Scene) -> bool {
    scene
        .used_materials()
        .iter()
        .any(|material| material.is_specular() || material.is_medium() || material.is_textured())
        || scene.fog.is_some()
        || scene.integrator.is_path()
        || scene.camera.lens.is_some()
        || scene.lights.iter().any(|light| is_wide(light))
}

/// Whether a light may be an area light.
fn is_wide(light: &Light) -> bool {
    let Ok(Value::Object(light)) = serde_json::to_value(light) else { return true };
    light.iter().any(|(name, light)| {
        name == "sky"
            || ["radius", "width"].into_iter().any(|size| light.get(size).is_some())
            || light.get("angle").is_some_and(|angle| angle.as_f64() != Some(0.0))
    })
}
