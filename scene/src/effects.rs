//! What the air and the neighborhood of a surface do to light: the list of effects.
//!
//! An effect is one documented struct with an `impl` of [`HasExamples`], an entry in the list, and a field of the
//! [`Scene`](crate::scene::Scene) under the same name, `None` where there is no such effect.

use crate::ambient_occlusion::AmbientOcclusion;
use crate::fog::Fog;
pub use crate::kinds::{Example, HasExamples};

/// The list: each effect's name in a scene, and its struct.
macro_rules! effects {
    ($($Kind:ident: $Struct:ident),* $(,)?) => {
        /// Each effect's examples: their JSON is an object of the scene's key and the effect.
        pub fn examples() -> Vec<Example> {
            let mut examples = Vec::new();
            $(examples.extend(Example::keyed::<$Struct>(stringify!($Struct), stringify!($Kind)));)*
            examples
        }
    };
}

effects![Fog: Fog, AmbientOcclusion: AmbientOcclusion];
