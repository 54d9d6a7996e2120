//! The scene as each kind of ray sees it.

use super::Integrator;
use crate::visible::RayKind;

/// Names of the functions that depend on the objects that are seen: a name identifies one function.
#[derive(Debug)]
pub(super) struct CallNames {
    pub(super) distance: &'static str,
    pub(super) nearest: &'static str,
    pub(super) enter_boxes: &'static str,
    pub(super) march: &'static str,
    pub(super) march_on: &'static str,
    pub(super) march_to_depth: &'static str,
    pub(super) hit: &'static str,
    pub(super) visibility: &'static str,
    pub(super) light_visibility: &'static str,
    pub(super) optical_depth: &'static str,
}

macro_rules! call_names {
    ($suffix:literal) => {
        CallNames {
            distance: concat!("distance", $suffix),
            nearest: concat!("nearest", $suffix),
            enter_boxes: concat!("enter_boxes", $suffix),
            march: concat!("march", $suffix),
            march_on: concat!("march_on", $suffix),
            march_to_depth: concat!("march_to_depth", $suffix),
            hit: concat!("hit", $suffix),
            visibility: concat!("visibility", $suffix),
            light_visibility: concat!("light_visibility", $suffix),
            optical_depth: concat!("optical_depth", $suffix),
        }
    };
}

static OF_CAMERA: CallNames = call_names!("");
static OF_SHADOWS: CallNames = call_names!("_of_shadows");
static OF_REFLECTIONS: CallNames = call_names!("_of_reflections");

impl CallNames {
    /// Names of the functions for rays of a kind.
    pub(super) fn of(rays: RayKind) -> &'static Self {
        match rays {
            RayKind::Camera => &OF_CAMERA,
            RayKind::Shadow => &OF_SHADOWS,
            RayKind::Reflection => &OF_REFLECTIONS,
        }
    }
}

impl Integrator<'_> {
    /// The scene as shadow rays see it.
    pub(super) fn of_shadow_rays(&self) -> &Self {
        self.of_shadows.as_deref().unwrap_or(self)
    }
}
