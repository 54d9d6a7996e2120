//! Traces rays: marches to surfaces, divides scenes into cells, and gathers the light that reaches a pixel.
//!
//! Scenes come from a document by way of the crate `language`, which is not needed but for this example.
//!
//! ```
//! let job = language::parse(br#"{
//!     "scene": {
//!         "camera": { "position": [0, 0, 4], "look_at": [0, 0, 0] },
//!         "background": { "color": [0, 0, 1] },
//!         "objects": [{ "shape": { "sphere": { "radius": 1 } }, "material": { "flat": { "color": [1, 0, 0] } } }]
//!     },
//!     "image": { "width": 32, "height": 32 }
//! }"#)?;
//! let frame = job.at(0)?;
//! let integrator = trace::integrator::Integrator::new(&frame);
//! let [middle, corner] = [[16.0_f32, 16.0], [0.0, 0.0]].map(|[x, y]| integrator.pixel(x, y).color);
//! assert_eq!(<[f32; 3]>::from(middle), [1.0, 0.0, 0.0]);
//! assert_eq!(<[f32; 3]>::from(corner), [0.0, 0.0, 1.0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cells;
pub mod changes;
pub mod integrator;
pub mod march;
pub mod visits;

use math::{bounds, ray, real, sampling};
use picture::{
    ambient_occlusion, animation, cache_key, camera, film, fog, job, kinds, lights, limits, materials, mattes, nodes,
    sample_count, scene, transport, values, visible,
};
