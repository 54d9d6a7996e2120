//! Renders on an NVIDIA GPU.

mod source;

pub use source::Source;
