//! A job's text becomes pixels: the crates of `scene/` behind one door, and what needs more than one of them.
//!
//! Pure math: no input or output, no threads, no `unsafe`, no GPU. Every formula is generic over [`real::Real`] and
//! gives bit-identical results in each arithmetic.
//!
//! ```
//! let text = r#"{
//!     "scene": {
//!         "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] },
//!         "objects": [{ "name": "ball", "shape": { "sphere": { "radius": 1 } } }]
//!     },
//!     "image": { "width": 32, "height": 32 }
//! }"#;
//! let job = scene::parse(text.as_bytes())?;
//! assert!(scene::warnings(&job).is_empty());
//!
//! // The object in the middle of the first frame, and its position in the file.
//! let seen = scene::pick(text, &job, 0, [0.5, 0.5])?.expect("the ball");
//! assert_eq!((seen.name.as_deref(), &*seen.pointer), (Some("ball"), "/scene/objects/0"));
//!
//! // Equal scenes have equal keys, whatever their names.
//! let renamed = scene::parse(text.replace("ball", "globe").as_bytes())?;
//! assert_eq!(job.cache_key(0), renamed.cache_key(0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod pick;
mod warnings;

pub use language::{
    Expansion, ParseError, ValidationError, editor_schema, error_in_frame, expansion, format, parse, plain_json,
    schema, set_value,
};
pub use math::{bounds, color, ray, real, sampling};
pub use picture::animation::{Exposure, FrameError, JobAtFrame};
pub use picture::backgrounds::Background;
pub use picture::cache_key::PICTURE_VERSION;
pub use picture::film::{Bits, Film, Format, Frames, ImageSpec, Layer, Precision, Region, ToneMap};
pub use picture::job::Job;
pub use picture::provenance::Provenance;
pub use picture::sample_count::{AdaptiveSamples, SampleCount};
pub use picture::scene::Scene;
pub use picture::values::formula::{FUNCTIONS, Function, NAMES as FORMULA_NAMES};
pub use picture::{
    ambient_occlusion, animation, backgrounds, camera, effects, film, fog, job, kinds, light_groups, lights, limits,
    materials, mattes, nodes, noise, profiles, sample_count, scene, transport, values,
};
pub use trace::changes::reached;
pub use trace::integrator::{Integrator, compiled_nodes, frame_compiled_nodes};
pub use trace::{cells, changes, integrator, march, visits};

pub use pick::{Pick, pick};
pub use warnings::of as warnings;
