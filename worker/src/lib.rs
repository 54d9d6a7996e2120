//! Renders tiles and encodes pictures: the renderers behind one trait, tile blobs, stitching, PNG and EXR, and
//! the agent that works for a server.
//!
//! Stateless: everything it holds can be rendered again.

pub mod agent;
pub mod bench;
pub mod blob;
#[cfg(test)]
#[path = "../tape/src/c_program.rs"]
mod c_program;
pub mod cells;
pub mod cpu;
pub mod cuda;
mod denoise;
mod finish;
#[cfg(test)]
mod evaluators;
mod fireflies;
pub mod frame;
pub mod image;
mod picture_tape;
#[cfg(test)]
#[path = "../tape/src/random_formula.rs"]
mod random_formula;
mod recent;
pub mod renderer;
mod rounds;
#[cfg(test)]
#[path = "../../tests/skip.rs"]
mod skip;
pub mod srgb;
pub mod stitch;
pub mod wgsl;

pub use cpu::CpuRenderer;
pub use renderer::{CancelFlag, RenderError, Renderer, TilePixels, TileRequest};
pub use tape::{self, Simd};
