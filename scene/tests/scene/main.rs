//! The picture's mathematics by what the crate offers: nodes, materials, profiles, noise, shadows and warnings.

mod animation;
mod contract;
mod extremes;
mod fractals;
mod kinds;
mod materials;
mod noise;
mod penumbra;
mod profiles;
mod repetition;
mod rounded;
mod seams;
mod surface;
mod warnings;
mod witness;

// Some of these tests run inside of the crate too, and find it under this name.
use scene as subject;

/// Whether the contract tests look at a node of this kind here: at every one.
fn is_tested(_kind: &str) -> bool {
    true
}
