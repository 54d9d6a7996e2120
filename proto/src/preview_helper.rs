//! Requests to the server's helper process, which draws or measures: a line of JSON on its standard input, a
//! response on its standard output. The server itself touches no pixel and evaluates no scene.

mod layer;

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use layer::{PictureLayer, StoredLayer};

/// First argument that selects the helper in the worker program.
pub const HELPER_COMMAND: &str = "preview-helper";

/// Request to a helper process.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case", deny_unknown_fields)]
pub enum HelperRequest {
    /// PNG of a frame that is not stored: its finished tiles over a coarse pass.
    Preview {
        /// The job file.
        job: String,
        /// The frame, from 0.
        frame: u32,
        /// Maximum width of the PNG, in pixels.
        width_px: u32,
        /// Blobs of finished tiles; unreadable ones are left out.
        tiles: Vec<PathBuf>,
        /// Path of the coarse pass: read if it exists, otherwise rendered and written.
        coarse: PathBuf,
        /// Maximum time for the coarse pass, in milliseconds.
        coarse_ms: u64,
    },
    /// A PNG of a stored picture, scaled down.
    Thumbnail {
        /// The picture's file.
        file: PathBuf,
        /// Maximum width of the PNG, in pixels.
        width_px: u32,
    },
    /// A [`crate::verify::Comparison`] of a stored picture with what it should be, as JSON.
    Verify {
        /// The job file.
        job: String,
        /// The frame, from 0.
        frame: u32,
        /// The picture's file.
        file: PathBuf,
        /// Number of tiles to render again.
        tiles: u32,
        /// Maximum time for rendering, in milliseconds.
        render_ms: u64,
    },
    /// A [`crate::price::PriceSample`] of a job, as JSON.
    Price {
        /// The job file.
        job: String,
        /// Threads to render on.
        threads: usize,
        /// Parts to measure, and the time for each.
        plan: PricePlan,
    },
    /// A [`ShaderView`] of a frame, as JSON.
    Shader {
        /// The job file.
        job: String,
        /// The frame, from 0.
        frame: u32,
        /// Width of the picture, in pixels; the job's if absent.
        width_px: Option<u32>,
        /// Number of samples a pixel.
        samples: u32,
        /// Program that the client has.
        program: Option<String>,
    },
    /// A [`CostSample`] of a job, as JSON.
    MeasureCost {
        /// The job file.
        job: String,
        /// Threads to render on.
        threads: usize,
        /// Maximum time for rendering, in milliseconds.
        render_ms: u64,
    },
    /// A [`HelperPicture`] of a frame that is not part of a job on the farm, rendered now.
    Draw {
        /// The job file.
        job: String,
        /// The frame, from 0.
        frame: u32,
        /// The picture.
        drawing: Drawing,
    },
    /// [`StoredAnswer::Layers`] of a stored picture, as JSON.
    ReadLayers {
        /// The picture's file.
        file: PathBuf,
    },
    /// A [`HelperPicture`] of a layer of a stored picture, or [`StoredAnswer::NoLayer`] as JSON.
    DrawLayer {
        /// The picture's file.
        file: PathBuf,
        /// The layer.
        layer: StoredLayer,
        /// Maximum width of the PNG, in pixels.
        width_px: u32,
        /// Exposure of colors, in stops.
        exposure: f32,
    },
    /// [`StoredAnswer::Pixel`] or [`StoredAnswer::Outside`] of a stored picture, as JSON.
    ReadPixel {
        /// The picture's file.
        file: PathBuf,
        /// Column, from 0.
        x: u32,
        /// Row from the top, from 0.
        y: u32,
    },
    /// A [`PickView`] of a frame, as JSON.
    Pick {
        /// The job file.
        job: String,
        /// The frame, from 0.
        frame: u32,
        /// The point: each coordinate from 0 to 1, from the picture's top left.
        at: [f32; 2],
    },
}

/// Response about a stored picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StoredAnswer {
    /// Its layers.
    Layers(LayersView),
    /// A pixel of it.
    Pixel(PixelView),
    /// It lacks the layer: it has these.
    NoLayer(Vec<StoredLayer>),
    /// The pixel is outside the picture.
    Outside {
        /// Width of the picture, in pixels.
        width: u32,
        /// Height of the picture, in pixels.
        height: u32,
    },
}

/// Layers of a stored picture.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct LayersView {
    /// The layers that can be shown.
    pub layers: Vec<StoredLayer>,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Format of the file: `png` or `exr`.
    pub format: String,
}

/// Values of a pixel of a stored picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PixelView {
    /// Column, from 0.
    pub x: u32,
    /// Row from the top, from 0.
    pub y: u32,
    /// Value of each channel of the file, by its name: of an EXR the numbers in the file, null for one that is infinite; of a
    /// PNG sRGB from 0 to 1.
    pub values: BTreeMap<String, Option<f32>>,
    /// Linear light of R, G and B of a PNG; null for an EXR, whose values are linear.
    pub linear: Option<BTreeMap<String, Option<f32>>>,
}

/// Surface at a point of a picture; every member is null where there is none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PickView {
    /// Index of the object, as in the object layer of an EXR.
    pub object: Option<u32>,
    /// Name of the object, if it has one.
    pub name: Option<String>,
    /// JSON pointer to the object in the job file.
    pub pointer: Option<String>,
    /// Name of the material there, if it has one.
    pub material: Option<String>,
    /// JSON pointer to the material in the job file; null for the default, which is not written.
    pub material_pointer: Option<String>,
    /// The point, in the scene's units.
    pub position: Option<[f32; 3]>,
    /// Normal, toward the viewer's side.
    pub normal: Option<[f32; 3]>,
    /// Distance from the camera, in the scene's units.
    pub distance: Option<f32>,
}

impl From<scene::Pick> for PickView {
    fn from(pick: scene::Pick) -> Self {
        let triple = |v: scene::real::Vec3<f32>| Some([v.x, v.y, v.z]);
        Self {
            object: u32::try_from(pick.object).ok(),
            name: pick.name,
            pointer: Some(pick.pointer),
            material: pick.material,
            material_pointer: pick.material_pointer,
            position: triple(pick.position),
            normal: triple(pick.normal),
            distance: Some(pick.distance),
        }
    }
}

/// Picture of a frame, as a client asks for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawing {
    /// Width, in pixels; the height follows from the job's aspect ratio.
    pub width_px: u32,
    /// Samples of a pixel, instead of the job's.
    pub samples: u32,
    /// Layer to show.
    pub layer: PictureLayer,
    /// Time after which fewer pixels are rendered, in milliseconds.
    pub limit_ms: u64,
}

/// A helper's picture and what it shows: a line of JSON, then the PNG.
#[derive(Clone, Debug, PartialEq)]
pub struct HelperPicture {
    /// Facts about the picture.
    pub about: AboutPicture,
    /// The PNG.
    pub png: Vec<u8>,
}

/// Facts about a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AboutPicture {
    /// Width of what was rendered or read, in pixels; the PNG may be larger.
    pub rendered_px: u32,
    /// Samples of each pixel that were rendered; 0 if none was.
    pub samples: u32,
    /// Values that the darkest and the brightest colors stand for, one for each channel of the layer; empty if they
    /// do not depend on the picture.
    pub range: [Vec<f32>; 2],
}

impl HelperPicture {
    /// Reads a helper's response; `None` if it is none.
    pub fn decode(mut bytes: Vec<u8>) -> Option<Self> {
        let end = bytes.iter().position(|byte| *byte == b'\n')?;
        let about = serde_json::from_slice(&bytes[..end]).ok()?;
        let png = bytes.split_off(end + 1);
        Some(Self { about, png })
    }

    /// The response of a helper.
    pub fn encode(&self) -> serde_json::Result<Vec<u8>> {
        let mut bytes = serde_json::to_vec(&self.about)?;
        bytes.push(b'\n');
        bytes.extend(&self.png);
        Ok(bytes)
    }
}

/// Parts of a price that are measured, each with a time limit for rendering in milliseconds; 0 leaves it out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PricePlan {
    /// Time and cost.
    pub sample_ms: u64,
    /// Map of the time.
    pub map_ms: u64,
    /// Numbers that would save most.
    pub savings_ms: u64,
}

/// Program of an approximate picture in a browser, and its inputs.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ShaderView {
    /// Hash of the program.
    pub program: String,
    /// Text of the program in WGSL; null if the client has it, or if there is none.
    pub wgsl: Option<String>,
    /// Numbers of the scene, each by its bits.
    pub uniforms: Vec<u32>,
    /// Words of the scene's table; empty if it has none.
    pub table: Vec<u32>,
    /// Number of samples that the program can add to a pixel.
    pub samples: u32,
    /// Width of the picture, in pixels.
    pub width: u32,
    /// Height of the picture, in pixels.
    pub height: u32,
    /// Whether the picture is bit-identical to a render: false.
    pub exact: bool,
    /// Why WebGPU can't show the scene; null if it can.
    pub reason: Option<String>,
}

/// Measured cost of a sample of a job's pixels.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CostSample {
    /// Camera rays of the sample.
    pub rays: u64,
    /// Time that one thread needs for a ray when all threads render, in seconds.
    pub thread_seconds_per_ray: f64,
    /// Time of one thread to prepare a tile, in seconds: evaluating the job at the frame, and building
    /// its integrator.
    pub setup_seconds_per_tile: f64,
    /// Time of all threads together to make what the tiles of a frame share, in seconds: the cells of its scene.
    pub shared_seconds_per_frame: f64,
    /// Time that one thread needs to encode a pixel into the picture's file, in seconds.
    pub encode_seconds_per_pixel: f64,
    /// Error of the times as a fraction of them, with a chance of 95 %: from the spread of blocks and frames.
    pub relative_error: f64,
    /// Peak memory of the sample, in bytes.
    pub memory_bytes: u64,
}

impl CostSample {
    /// Ends of the range of a time that was made from this, in seconds.
    pub fn range(&self, seconds: f64) -> (f64, f64) {
        let high = 1.0 + self.relative_error;
        (seconds / high, seconds * high)
    }

    /// Time of one thread for this many rays, tiles, frames and file pixels, in seconds.
    pub fn core_seconds(&self, rays: u64, tiles: u64, frames: u64, pixels: u64) -> f64 {
        let counts = [rays, tiles, frames, pixels].map(|count| count as f64);
        let each = [
            self.thread_seconds_per_ray,
            self.setup_seconds_per_tile,
            self.shared_seconds_per_frame,
            self.encode_seconds_per_pixel,
        ];
        counts.iter().zip(each).map(|(count, seconds)| count * seconds).sum()
    }
}

/// Estimated cost of a job, from rendering a sample of its pixels.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// Seconds until the last picture is stored, if the farm's current workers rendered nothing else; null
    /// without workers.
    pub seconds: Option<f64>,
    /// Start of the range in which `seconds` is, with a chance of 95 %.
    pub seconds_low: Option<f64>,
    /// End of that range.
    pub seconds_high: Option<f64>,
    /// CPU time, in seconds of one core.
    pub core_seconds: f64,
    /// Camera rays that the job would trace.
    pub rays: u64,
    /// Camera rays of the sample that the estimate is based on.
    pub sample_rays: u64,
    /// Memory of the worker that renders it, in bytes.
    pub memory_bytes: u64,
}
