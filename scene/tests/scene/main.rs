//! The picture's mathematics by what the crate offers: nodes, materials, profiles, noise, shadows and warnings.

mod contract;
mod copies;
mod extremes;
mod fractals;
mod joins;
mod kinds;
mod materials;
mod motion;
mod noise;
mod penumbra;
mod profiles;
mod round;
mod surface;
mod warnings;
mod witness;

// Some of these tests run inside of the crate too, and find it under this name.
use scene as subject;

/// Whether the contract tests look at a node of this kind here: at every one.
fn is_tested(_kind: &str) -> bool {
    true
}
