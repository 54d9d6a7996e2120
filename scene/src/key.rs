//! What a picture is known by: hashes of all that decides its bytes, and of nothing else.

use serde::Serialize;

use crate::PICTURE_VERSION;
use crate::job::{Bits, Format, Job, Layer, Precision, ToneMap};
use crate::materials::Material;
use crate::motion::{Motion, Still};
use crate::scene::{March, Object, Scene};
use crate::sky::Background;
use crate::values::{FrameRate, Stops};

/// A scene without names, defaults filled in: equal for scenes that look the same.
#[derive(Serialize)]
struct CanonicalScene<'a> {
    camera: &'a crate::camera::Camera,
    background: &'a Background,
    lights: &'a [crate::lights::Light],
    materials: &'a [Material],
    objects: Vec<Object>,
    march: &'a March,
}

#[derive(Serialize)]
struct CanonicalPixels<'a> {
    version: u32,
    scene: CanonicalScene<'a>,
    width: u32,
    height: u32,
    samples: u32,
    seed: u32,
    frame: u32,
    layers: &'a [Layer],
}

#[derive(Serialize)]
struct CanonicalPicture {
    pixels: String,
    format: Format,
    bits: Option<Bits>,
    precision: Option<Precision>,
    /// In the header of an EXR; what else is there follows from the pixels' scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    fps: Option<FrameRate>,
    #[serde(skip_serializing_if = "Option::is_none")]
    graded: Option<(Stops, ToneMap)>,
}

fn hash(value: &impl Serialize) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    serde_json::to_writer(&mut hasher, value).expect("a hasher takes all that is written, and a job has no odd keys");
    hasher.finalize()
}

impl Scene {
    fn canonical(&self) -> CanonicalScene<'_> {
        let mut objects = self.objects.clone();
        for object in &mut objects {
            object.material = object.material.canonical();
            object.shape.name_materials_by_slot();
        }
        CanonicalScene {
            camera: &self.camera,
            background: &self.background,
            lights: &self.lights,
            materials: &self.slots,
            objects,
            march: &self.march,
        }
    }
}

impl Job {
    /// Of all that decides the bytes of a frame's picture.
    pub fn picture_key(&self, frame: u32) -> blake3::Hash {
        match self.at(frame) {
            Ok(still) => still.picture_key(),
            // No frame but this one of this text can be refused so, and it gets no picture.
            Err(refusal) => hash(&(self.motion.as_ref().map(Motion::text), frame, refusal.to_string())),
        }
    }
}

impl Still<'_> {
    /// Of the scene alone, as provenance in its picture.
    pub fn scene_hash(&self) -> blake3::Hash {
        hash(&self.job().scene.canonical())
    }

    /// Of all that decides its pixels.
    pub fn pixels_key(&self) -> blake3::Hash {
        let image = &self.job().image;
        hash(&CanonicalPixels {
            version: PICTURE_VERSION,
            scene: self.job().scene.canonical(),
            width: image.width,
            height: image.height,
            samples: image.samples,
            seed: image.seed,
            frame: self.frame(),
            layers: &image.layers,
        })
    }

    /// Of all that decides the bytes of its picture.
    pub fn picture_key(&self) -> blake3::Hash {
        let image = &self.job().image;
        let (bits, precision, fps) = match image.format {
            Format::Png => (Some(image.bits), None, None),
            Format::Exr => (None, Some(image.precision), Some(self.job().frames.fps)),
        };
        hash(&CanonicalPicture {
            pixels: self.pixels_key().to_hex().to_string(),
            format: image.format,
            bits,
            precision,
            fps,
            graded: image.is_graded().then_some((image.exposure, image.tone_map)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(materials: &str, name: &str, radius: f32, samples: u32) -> Job {
        let text = format!(
            r#"{{ "name": "{name}", "scene": {{ "camera": {{ "position": [0, 0, 3], "look_at": [0, 0, 0] }},
                "materials": {{ {materials} }},
                "objects": [{{ "material": "{name}", "shape": {{ "sphere": {{ "radius": {radius} }} }} }}] }},
                "image": {{ "width": 8, "height": 8, "samples": {samples} }} }}"#
        );
        crate::parse(text.as_bytes()).unwrap()
    }

    #[test]
    fn names_and_unused_materials_do_not_change_the_key() {
        let a = job(r#""a": { "flat": { "color": [1, 0, 0] } }"#, "a", 1.0, 4);
        let b = job(r##""x": { "normals": {} }, "b": { "flat": { "color": "#ff0000" } }"##, "b", 1.0, 4);
        assert_eq!(a.picture_key(0), b.picture_key(0));
    }

    #[test]
    fn what_changes_the_bytes_changes_the_key() {
        let red = r#""a": { "flat": { "color": [1, 0, 0] } }"#;
        let first = job(red, "a", 1.0, 4);
        assert_ne!(first.picture_key(0), first.picture_key(1));
        assert_ne!(first.picture_key(0), job(red, "a", 1.5, 4).picture_key(0));
        assert_ne!(first.picture_key(0), job(red, "a", 1.0, 5).picture_key(0));
        let mut other = first.clone();
        other.image.tone_map = ToneMap::Filmic;
        assert_ne!(first.picture_key(0), other.picture_key(0));
        assert_eq!(first.at(0).unwrap().pixels_key(), other.at(0).unwrap().pixels_key());
        let mut other = first.clone();
        other.image.format = Format::Exr;
        assert_ne!(first.picture_key(0), other.picture_key(0));
        let mut faster = other.clone();
        faster.frames.fps = FrameRate::new(25.0).unwrap();
        assert_ne!(faster.picture_key(0), other.picture_key(0), "an EXR tells its rate");
        faster.image.format = Format::Png;
        assert_eq!(faster.picture_key(0), first.picture_key(0), "a PNG does not");
        let pixels_key = |job: &Job| job.at(0).unwrap().pixels_key();
        assert_eq!(pixels_key(&first), pixels_key(&other));
    }
}
