//! The language of jobs: parses, formats and describes their files.
//!
//! No ray is traced here.
//!
//! ```
//! use language::ParseError;
//!
//! let job = r#"{
//!     "scene": {
//!         "camera": { "position": [0, 1, 4], "look_at": [0, 0, 0] },
//!         "objects": [{ "shape": { "sphere": { "radius": 1 } } }] // a ball
//!     },
//!     "image": { "width": 64, "height": 48 }
//! }"#;
//! let parsed = language::parse(job.as_bytes())?;
//! assert_eq!((parsed.nodes(), parsed.image.film().pixels()), (1, 3072));
//!
//! // Every fault has a place and a cure.
//! let Err(ParseError::Invalid(faults)) = language::parse(job.replace("radius", "radios").as_bytes()) else { panic!() };
//! assert_eq!((faults[0].line, &*faults[0].pointer), (4, "/scene/objects/0/shape/sphere/radios"));
//! assert!(faults[0].message.contains("did you mean `radius`?"), "{}", faults[0]);
//! # Ok::<(), ParseError>(())
//! ```

pub(crate) mod document;
pub(crate) mod error;
pub(crate) mod format;
pub(crate) mod groups;
pub(crate) mod json;
pub(crate) mod parse;
pub mod schema;
pub(crate) mod shapes;

use picture::{
    ambient_occlusion, animation, backgrounds, camera, effects, film, fog, job, json_text, kinds, light_groups, lights,
    limits, materials, names, nodes, profiles, sample_count, scene, seek, transport, values, written,
};

pub use error::{ParseError, ValidationError};
pub use format::format;
pub use parse::{Expansion, error_in_frame, expansion, has_value, parse, plain_json, set_value};
pub use schema::{editor_schema, schema};
