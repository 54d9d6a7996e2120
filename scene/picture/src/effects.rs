//! Registry of effects: changes of light along a ray or near a surface, such as fog and ambient occlusion.
//!
//! An effect is one documented struct with an `impl` of [`HasExamples`], an entry in the list, and a field of the
//! [`Scene`](crate::scene::Scene) with the same name, `None` if the scene does not use the effect.

use crate::ambient_occlusion::AmbientOcclusion;
use crate::fog::Fog;
pub use crate::kinds::{Example, HasExamples};

/// The list: the member name of each effect in a scene, and its struct.
macro_rules! effects {
    ($($Kind:ident: $Struct:ident),* $(,)?) => {
        /// Each effect's examples: a JSON object with the scene's member name and the effect.
        pub fn examples() -> Vec<Example> {
            let mut examples = Vec::new();
            $(examples.extend(Example::keyed::<$Struct>(stringify!($Struct), stringify!($Kind)));)*
            examples
        }
    };
}

effects![Fog: Fog, AmbientOcclusion: AmbientOcclusion];
