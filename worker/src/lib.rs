//! Renders tiles and encodes pictures: the renderers behind one trait, tile blobs, stitching, PNG and EXR, and
//! the agent that works for a server.
//!
//! Stateless: everything it holds can be rendered again.
//!
//! ```
//! use worker::{CancelFlag, CpuRenderer, Renderer, Simd, TileRequest};
//!
//! let job = scene::parse(br#"{
//!     "scene": {
//!         "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] },
//!         "objects": [{ "shape": { "torus": { "radius": 1, "tube": 0.3 } } }]
//!     },
//!     "image": { "width": 32, "height": 32 }
//! }"#)?;
//! let tile = TileRequest { job: &job, frame: 0, rect: proto::Rect::full(32, 32) };
//!
//! // Machine code or the interpreter, and plain `f32`: the same bits.
//! let [fast, reference] = [Simd::Auto, Simd::Scalar].map(|simd| {
//!     let renderer = CpuRenderer::new(Some(1), simd).expect("every CPU has both");
//!     renderer.render(&tile, &CancelFlag::new(), &|_| {}).expect("a small tile")
//! });
//! assert_eq!(fast.planes.len(), 4);
//! assert_eq!(fast, reference);
//! # Ok::<(), scene::ParseError>(())
//! ```

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
#[cfg(test)]
mod evaluators;
mod finish;
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
