//! Effects: changes of light along a ray or near a surface, such as fog and ambient occlusion.
//!
//! An effect is one documented struct with `examples`, an entry in the list, and a field of the
//! [`Scene`](crate::scene::Scene) with the same name, `None` if the scene does not use the effect.

use crate::ambient_occlusion::AmbientOcclusion;
use crate::fog::Fog;
pub use crate::kinds::Example;
use crate::kinds::Kind;

/// Each effect's examples: a JSON object with the scene's member name and the effect.
pub fn examples() -> Vec<Example> {
    let effects = [
        Kind::new("Fog", "Fog", &[], Fog::examples),
        Kind::new("AmbientOcclusion", "AmbientOcclusion", &[], AmbientOcclusion::examples),
    ];
    effects.iter().flat_map(Kind::examples).collect()
}
