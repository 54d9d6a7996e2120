//! Renders tiles and makes pictures of them: the renderers behind one trait, tile
//! blobs, stitching, PNG and EXR, and the agent that works for a server.
//!
//! It keeps no state that matters: whatever it holds can be rendered again.

pub mod blob;
pub mod frame;
pub mod image;
pub mod renderer;
pub mod stitch;

pub use renderer::{Cancel, Pixels, RenderError, Renderer, TileRun};
