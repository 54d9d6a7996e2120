//! Tests of the worker crate: pictures, blobs, frames, the agent, every arithmetic, the generated pages.

mod adaptive;
mod agent;
mod animation;
mod batches;
mod bit_identical;
mod blobs;
mod cancel;
mod changes;
mod cuda;
mod divided_cells;
mod docs;
mod evaluations;
mod fake_renderer;
mod fake_server;
mod fireflies;
mod frames;
mod keys;
mod lanes;
mod light_groups;
mod mattes;
mod motion_blur;
mod pictures;
mod read_back;
mod shipped;
mod silhouettes;
#[path = "../../../tests/skip.rs"]
mod skip;
mod source_size;
mod uses;
mod wgsl;
