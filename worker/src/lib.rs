//! Renders tiles and makes pictures of them: the renderers behind one trait, tile
//! blobs, stitching, PNG and EXR, and the agent that works for a server.
//!
//! It keeps no state that matters: whatever it holds can be rendered again.

pub mod agent;
pub mod bench;
pub mod blob;
pub mod cpu;
pub mod cuda;
pub mod frame;
pub mod image;
pub mod lanes;
pub mod renderer;
pub mod simd;
pub mod srgb;
pub mod stitch;
pub mod tape;

pub use cpu::CpuRenderer;
pub use renderer::{Cancel, Pixels, RenderError, Renderer, TileRun};
pub use simd::Simd;
