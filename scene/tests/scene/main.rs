//! Tests of the picture's mathematics through the public interface: nodes, materials, profiles, noise, shadows,
//! warnings.

mod animation;
mod cache_key;
mod carried;
mod cells;
mod contract;
mod copies;
mod extremes;
mod forms;
mod formulas;
mod fractals;
mod frames;
mod kinds;
mod large;
mod lens;
mod light;
mod light_in_media;
mod materials;
mod motion;
mod noise;
mod old_jobs;
mod penumbra;
mod profiles;
mod ray_boxes;
mod repetition;
mod rotations;
mod rounded;
mod scatter;
mod seams;
mod shapes;
mod shutter;
mod surface;
mod together;
mod warnings;
mod witness;
mod wrong_uses;

// Some of these tests also run with one more kind of each family, and refer to the crate by this name.
use scene as subject;

/// Whether the contract tests check a node of this kind here: all of them.
fn is_tested(_kind: &str) -> bool {
    true
}
