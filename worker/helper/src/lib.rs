//! Work of the server's helper process, and of the commands that do the same on this machine: previews, thumbnails,
//! layers of stored pictures, prices, verification.
//!
//! It never calls a server: it gets a request, and returns a picture or a measurement. What it renders never kills
//! the server.

mod attempt;
mod canvas;
mod coarse;
mod cost_sample;
mod drawing;
mod layer_picture;
#[cfg(test)]
mod options;
mod preview;
mod price;
mod process;
mod shader;
mod stored_picture;
mod thumbnail;
pub mod verify;

pub use cost_sample::sample;
pub use price::price;
pub use process::run;
