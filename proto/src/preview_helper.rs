//! Requests to the server's helper process, which draws or measures: a line of JSON on its standard input, a
//! response on its standard output. The server itself touches no pixel and evaluates no scene.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
    /// A [`CostSample`] of a job, as JSON.
    MeasureCost {
        /// The job file.
        job: String,
        /// Threads to render on.
        threads: usize,
        /// Maximum time for rendering, in milliseconds.
        render_ms: u64,
    },
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
    /// CPU time, in seconds of one core.
    pub core_seconds: f64,
    /// Camera rays that the job would trace.
    pub rays: u64,
    /// Camera rays of the sample that the estimate is based on.
    pub sample_rays: u64,
    /// Memory of the worker that renders it, in bytes.
    pub memory_bytes: u64,
}
