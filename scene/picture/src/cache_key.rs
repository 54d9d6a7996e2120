//! Cache keys of pictures: hashes of everything that decides a picture's bytes, and of nothing else.

use serde::Serialize;

use crate::animation::{Exposure, JobAtFrame};
use crate::film::{Bits, Format, ImageSpec, Layer, Precision, Region, ToneMap};
use crate::job::Job;
use crate::mattes::Matte;
use crate::sample_count::SampleCount;
use crate::scene::{LightGroups, Scene};
use crate::values::{ExposureStops, FrameRate};

/// Version of the picture's exact bits: raised only when some picture's bits change, never with a release.
pub const PICTURE_VERSION: u32 = 12;

/// Everything that decides a frame's pixels.
#[derive(Serialize)]
struct CanonicalPixels<'a> {
    version: u32,
    scene: &'a Scene,
    width: u32,
    height: u32,
    samples: &'a SampleCount,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    denoise: bool,
    seed: u32,
    frame: u32,
    layers: &'a [Layer],
    #[serde(skip_serializing_if = "Option::is_none")]
    crop: Option<Crop>,
    /// The next frame's scene, if the picture shows motion.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<&'a Scene>,
    /// Names in the picture's mattes, whose hashes are in its pixels.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    mattes: Vec<Matte>,
    #[serde(skip_serializing_if = "Option::is_none")]
    light_groups: Option<LightGroups>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    reweight_fireflies: bool,
}

/// A region, and the size of the whole picture that it is a part of.
#[derive(Serialize)]
struct Crop {
    region: Region,
    full_width: u32,
    full_height: u32,
}

/// Everything that decides the bytes of a frame's picture.
#[derive(Serialize)]
struct CanonicalPicture<'a> {
    pixels: String,
    format: Format,
    bits: Option<Bits>,
    precision: Option<Precision>,
    /// Frame rate, written to the header of an EXR. The rest of the header follows from the scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    fps: Option<&'a FrameRate>,
    #[serde(skip_serializing_if = "Option::is_none")]
    graded: Option<(&'a ExposureStops, ToneMap)>,
    /// Names of the objects, stored in an EXR with the layer of objects.
    #[serde(skip_serializing_if = "Option::is_none")]
    object_names: Option<Vec<Option<String>>>,
}

fn hash(value: &impl Serialize) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    serde_json::to_writer(&mut hasher, value).expect("a hasher accepts all bytes, and member names are strings");
    hasher.finalize()
}

impl Job {
    /// Hash of everything that decides the bytes of a frame's picture.
    pub fn cache_key(&self, frame: u32) -> blake3::Hash {
        match self.at(frame) {
            Ok(at_frame) => at_frame.cache_key(),
            // A frame that fails here gets no picture, so its key only has to differ from other frames' keys.
            Err(error) => hash(&(&self.scene, frame, error.to_string())),
        }
    }
}

impl JobAtFrame<'_> {
    /// Hash of the scene alone, written into its pictures as provenance; with the next frame's if they show motion, and
    /// with the names in their mattes and their light groups.
    pub fn scene_hash(&self) -> blake3::Hash {
        let (next, mattes) = (self.next_scene(), self.mattes());
        if let Some(light_groups) = self.light_groups() {
            return hash(&(self.scene(), next, mattes, light_groups));
        }
        if next.is_none() && mattes.is_empty() {
            return hash(self.scene());
        }
        hash(&(self.scene(), next, mattes))
    }

    /// Hash of everything that decides the frame's pixels at one of its instants, but for surfaces and the materials of
    /// surfaces.
    pub fn key_without_surfaces(&self) -> blake3::Hash {
        self.with_scene(self.scene().without_surfaces()).instant_key_of_version(PICTURE_VERSION)
    }

    /// Hash of everything that decides the frame's pixels.
    pub fn pixels_cache_key(&self) -> blake3::Hash {
        if !self.is_blurred() {
            return self.instant_key_of_version(PICTURE_VERSION);
        }
        match self.exposure() {
            Ok(exposure) => exposure.pixels_cache_key(),
            // Such a frame gets no picture.
            Err(error) => hash(&(self.instant_key_of_version(PICTURE_VERSION).to_hex().as_str(), error.to_string())),
        }
    }

    /// Hash of a frame without a shutter, under a version of the picture's bits.
    pub fn instant_key_of_version(&self, version: u32) -> blake3::Hash {
        // Without `..`, so that a new field does not compile until it is handled here and in `cache_key`.
        let ImageSpec {
            width,
            height,
            samples,
            seed,
            denoise,
            layers,
            light_groups: _,
            reweight_fireflies,
            region,
            format: _,
            bits: _,
            precision: _,
            exposure: _,
            tone_map: _,
        } = self.image();
        let film = self.image().film();
        hash(&CanonicalPixels {
            version,
            scene: self.scene(),
            width: film.width,
            height: film.height,
            samples,
            denoise: *denoise,
            seed: *seed,
            frame: self.frame(),
            layers,
            crop: region.map(|region| Crop { region, full_width: *width, full_height: *height }),
            next: self.next_scene(),
            mattes: self.mattes(),
            light_groups: self.light_groups(),
            reweight_fireflies: *reweight_fireflies,
        })
    }

    /// Hash of everything that decides the distances of the frame's shapes: frames with the same one may share cells.
    pub fn shapes_cache_key(&self) -> blake3::Hash {
        let objects = &self.scene().objects;
        let (next, mattes) = (self.next_scene().map(|next| &next.objects), self.mattes());
        if next.is_none() && mattes.is_empty() {
            return hash(&(PICTURE_VERSION, self.is_animated(), objects));
        }
        // Rows of numbers also have the next frame's numbers, and ids.
        hash(&(PICTURE_VERSION, self.is_animated(), objects, next, mattes))
    }

    /// Hash of everything that decides the bytes of the frame's picture.
    pub fn cache_key(&self) -> blake3::Hash {
        let image = self.image();
        let ImageSpec {
            format,
            bits,
            precision,
            exposure,
            tone_map,
            width: _,
            height: _,
            samples: _,
            seed: _,
            denoise: _,
            layers: _,
            light_groups: _,
            reweight_fireflies: _,
            region: _,
        } = image;
        let (bits, precision, fps) = match format {
            Format::Png => (Some(*bits), None, None),
            Format::Exr => (None, Some(*precision), Some(&self.frames().fps)),
        };
        hash(&CanonicalPicture {
            pixels: self.pixels_cache_key().to_hex().to_string(),
            format: *format,
            bits,
            precision,
            fps,
            graded: image.has_display_transform().then_some((exposure, *tone_map)),
            object_names: self.stored_object_names(),
        })
    }
}

impl Exposure<'_> {
    /// Hash of everything that decides the frame's pixels, as [`JobAtFrame::pixels_cache_key`].
    pub fn pixels_cache_key(&self) -> blake3::Hash {
        let of_instant = |instant: &JobAtFrame<'_>| instant.instant_key_of_version(PICTURE_VERSION);
        match &self.instants[..] {
            [only] => of_instant(only),
            instants => {
                hash(&instants.iter().map(|instant| of_instant(instant).to_hex().to_string()).collect::<Vec<_>>())
            }
        }
    }
}
