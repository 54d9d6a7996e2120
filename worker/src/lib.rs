//! Renders tiles and encodes pictures: the renderers behind one trait, tile blobs, stitching, PNG and EXR, and
//! the agent that works for a server.
//!
//! Stateless: everything it holds can be rendered again.

pub mod agent;
pub mod bench;
pub mod blob;
#[cfg(test)]
mod c_program;
pub mod cells;
pub mod cpu;
pub mod cuda;
mod denoise;
mod evaluator;
mod finish;
mod fireflies;
pub mod frame;
pub mod image;
mod picture_tape;
mod portable;
#[cfg(test)]
mod random_formula;
mod recent;
pub mod renderer;
mod rounds;
pub mod simd;
#[cfg(test)]
#[path = "../../tests/skip.rs"]
mod skip;
pub mod srgb;
pub mod stitch;
pub mod tape;
pub mod wgsl;
mod x86;

pub use cpu::CpuRenderer;
pub use renderer::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};
pub use simd::Simd;
