//! The worker through its public doors: pictures, blobs, frames, the agent.

mod blobs;
mod fake_renderer;
mod frames;
mod pictures;
mod read_back;
