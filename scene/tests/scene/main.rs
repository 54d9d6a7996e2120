//! The picture's mathematics by what the crate offers: nodes, materials, profiles, noise, shadows and warnings.

mod contract;
mod copies;
mod extremes;
mod fractals;
mod joins;
mod materials;
mod motion;
mod noise;
mod penumbra;
mod profiles;
mod round;
mod surface;
mod warnings;
