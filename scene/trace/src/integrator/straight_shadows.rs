//! Shadow rays that go straight through glass, in its color: `straight_shadows` of path tracing. Light that glass refracts is
//! left out in turn, where shadow rays find it already.

use super::Integrator;
use super::light_path::LightPath;
use super::lighting::{NORMAL_EVALUATIONS, SHADOW_SLOPE};
use crate::march::MarchResult;
use crate::materials::bsdf::Geometry;
use crate::ray::Ray;
use crate::real::{MaskValue, Real, Vec3, bundle, vec3};
use crate::transport::{PathSettings, Transport};

/// A surface that a shadow ray has met.
#[derive(Clone, Copy)]
pub(super) struct Glass<R> {
    /// Fraction of the light that it lets through, by channel.
    pub(super) filter: Vec3<R>,
    /// Distance along the ray at which it is left behind.
    pub(super) beyond: R,
    /// Evaluations of the distance field.
    pub(super) evaluations: R,
}

bundle!(Glass { filter, beyond, evaluations });

impl<R: Real> Glass<R> {
    /// A surface that lets nothing through.
    pub(super) fn opaque(zero: R) -> Self {
        Self { filter: vec3(zero, zero, zero), beyond: zero, evaluations: zero }
    }
}

impl Integrator<'_> {
    /// Whether shadow rays go straight through the scene's glass.
    pub(super) fn has_straight_shadows(&self) -> bool {
        let Transport::Path(PathSettings { straight_shadows, max_bounces: _ }) = self.scene.integrator else {
            return false;
        };
        straight_shadows && self.lets_through
    }

    /// The surface that a path's shadow ray has met.
    pub(super) fn glass_in_the_way<R: Real>(
        &self,
        path: &LightPath<R>,
        ray: &Ray<R>,
        met: &MarchResult<R>,
    ) -> Glass<R> {
        let hit = self.hit(ray, met);
        let bsdf = self.bsdf(&hit, ray, self.object_at(&hit));
        // As from outside on both sides: what is refracted on its way in is not reflected on its way out.
        let seen = Geometry { normal: hit.normal, to_viewer: -ray.direction, is_inside: MaskValue(hit.t.below(-1.0)) };
        let cosine = hit.normal.dot(ray.direction).abs().at_least(0.1);
        let tolerance = hit.t.mul_add(hit.t.constant(SHADOW_SLOPE), path.epsilon);
        let evaluations = self.object_evaluations() + self.detail_evaluations() + NORMAL_EVALUATIONS;
        Glass {
            filter: bsdf.straight_transmittance(self.materials.lobes, &seen),
            // The march ended within the tolerance before the surface, and is to begin beyond it.
            beyond: hit.t + tolerance * 3.0 / cosine,
            evaluations: hit.t.constant(evaluations),
        }
    }
}
