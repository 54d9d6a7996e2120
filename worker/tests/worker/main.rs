//! The worker through its public doors: pictures, blobs, frames, the agent.

mod agent;
mod blobs;
mod fake_renderer;
mod fake_server;
mod frames;
mod pictures;
mod read_back;
mod silhouettes;
