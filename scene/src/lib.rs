//! The job and scene language, and the exact arithmetic that turns a scene into pixels.
//!
//! Pure math: no input or output, no threads, no `unsafe`, no GPU. Every formula is generic over [`real::Real`] and
//! gives bit-identical results in each arithmetic.

#[cfg(test)]
mod added;
pub mod ambient_occlusion;
mod animation;
pub mod backgrounds;
pub mod bounds;
mod cache_key;
pub mod camera;
pub mod cells;
pub mod changes;
pub mod color;
mod document;
pub mod effects;
mod error;
pub mod film;
pub mod fog;
mod format;
mod groups;
pub mod integrator;
pub mod job;
mod json_scan;
pub mod json_text;
pub mod kinds;
pub mod light_groups;
pub mod lights;
pub mod limits;
pub mod march;
pub mod materials;
pub mod mattes;
pub mod names;
pub mod nodes;
pub mod noise;
mod parse;
mod pick;
pub mod profiles;
mod provenance;
pub mod ray;
pub mod real;
pub mod sample_count;
pub mod sampling;
pub mod scene;
pub mod schema;
mod seek;
mod shapes;
pub mod transport;
pub mod values;
mod visible;
pub mod visits;
mod warnings;
pub mod written;

pub use animation::{Exposure, FrameError, JobAtFrame};
pub use backgrounds::Background;
pub use cache_key::PICTURE_VERSION;
pub use changes::reached;
pub use error::{ParseError, ValidationError};
pub use film::{Bits, Crop, Format, Frames, Image, Layer, Precision, Region, ToneMap};
pub use format::format;
pub use integrator::{Integrator, compiled_nodes, frame_compiled_nodes};
pub use job::Job;
pub use parse::{error_in_frame, parse, plain_json, set_value};
pub use pick::{Pick, pick};
pub use provenance::Provenance;
pub use sample_count::{AdaptiveSamples, SampleCount};
pub use scene::Scene;
pub use schema::{editor_schema, schema};
pub use values::formula::{FUNCTIONS, Function, NAMES as FORMULA_NAMES};
pub use warnings::of as warnings;

// Some tests of the public interface also run inside the crate, and refer to it by this name.
#[cfg(test)]
use {crate as subject, added::is_tested};
