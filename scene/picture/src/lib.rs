//! The definition of a picture: numbers, nodes, materials, lights, cameras, scenes, films and jobs, and the keys of pictures.
//!
//! Formulas only: no text is parsed but by serde, and no ray is traced. A kind of node, material or light is a struct and
//! its formula, in a file of its own.
//!
//! ```
//! use math::real::{Interval, vec3};
//! use picture::nodes::Node;
//!
//! let node = r#"{ "union": { "of": [
//!     { "sphere": { "radius": 1 } },
//!     { "translate": { "by": [3, 0, 0], "child": { "box": { "size": [2, 2, 2] } } } }
//! ] } }"#;
//! let node: Node = serde_json::from_str(node)?;
//! assert_eq!(node.distance(vec3(0.0, 5.0, 0.0)), 4.0);
//! assert_eq!(node.bounds(0.0).max.x, 4.0);
//!
//! // The same formula over a box: no surface is in it.
//! let side = |low, high| Interval::new(low, high);
//! let range: Interval = node.distance(vec3(side(-1.0, 1.0), side(2.0, 3.0), side(-1.0, 1.0)));
//! assert!(!range.contains(0.0));
//! # Ok::<(), serde_json::Error>(())
//! ```

pub mod ambient_occlusion;
pub mod animation;
pub mod backgrounds;
pub mod cache_key;
pub mod camera;
pub mod effects;
pub mod film;
pub mod fog;
pub mod job;
pub mod json_text;
pub mod kinds;
pub mod light_groups;
pub mod lights;
pub mod limits;
pub mod materials;
pub mod mattes;
pub mod names;
pub mod nodes;
pub mod noise;
pub mod profiles;
pub mod provenance;
pub mod sample_count;
pub mod scene;
pub mod seek;
pub mod transport;
pub mod values;
pub mod visible;
pub mod written;

use math::{bounds, color, ray, real, sampling};
