//! The scene as each kind of ray sees it.

use super::Integrator;
use crate::real::FunctionKey;
use crate::visible::RayKind;

/// Declares functions whose bodies depend on the objects that rays see.
macro_rules! ray_functions {
    ($($Kind:ident: $name:literal),* $(,)?) => {
        /// A function that depends on the objects that are seen, and so on the kind of ray.
        #[derive(Clone, Copy)]
        pub(super) enum RayFunction {
            $($Kind),*
        }

        impl RayFunction {
            fn of(self, rays: RayKind) -> FunctionKey {
                FunctionKey::new(match (self, rays) {
                    $(
                        (Self::$Kind, RayKind::Camera) => $name,
                        (Self::$Kind, RayKind::Shadow) => concat!($name, "_of_shadows"),
                        (Self::$Kind, RayKind::Reflection) => concat!($name, "_of_reflections"),
                    )*
                })
            }
        }
    };
}

ray_functions! {
    Distance: "distance",
    Nearest: "nearest",
    EnterBoxes: "enter_boxes",
    March: "march",
    MarchOn: "march_on",
    MarchToDepth: "march_to_depth",
    Hit: "hit",
    Visibility: "visibility",
    LightVisibility: "light_visibility",
    OpticalDepth: "optical_depth",
}

impl Integrator<'_> {
    /// The key of a function for the rays of this integrator.
    pub(super) fn key(&self, function: RayFunction) -> FunctionKey {
        function.of(self.rays)
    }

    /// The scene as shadow rays see it.
    pub(super) fn of_shadow_rays(&self) -> &Self {
        self.of_shadows.as_deref().unwrap_or(self)
    }
}
