"""sdfarm's material `surface`, written as BSDFs for Mitsuba.

Mitsuba's own BSDFs have Fresnel's exact equations and Smith's separable shadowing. sdfarm documents Schlick's
approximation and shadowing that is correlated by height, so the formulas of docs/materials.md are written here a second
time; everything else, from geometry to multiple importance sampling, is Mitsuba's. `judge.py --self-test` compares them
with Mitsuba's BSDFs where the two models agree.
"""

import drjit as dr
import mitsuba as mi

MIN_ALPHA = 0.002


def schlick(f0, cosine):
    """Schlick's approximation of Fresnel's reflectance."""
    return f0 + (1 - f0) * dr.clip(1 - cosine, 0, 1) ** 5


def smith_lambda_root(alpha, cosine):
    """√(α² + (1 − α²)·cosine²)."""
    return dr.sqrt(alpha**2 + (1 - alpha**2) * cosine**2)


def visible_normal(viewer, alpha, sample):
    """A microfacet's normal that the viewer sees: Eric Heitz, JCGT 7(4), 2018."""
    stretched = dr.normalize(mi.Vector3f(alpha * viewer.x, alpha * viewer.y, viewer.z))
    across = dr.sqrt(stretched.x**2 + stretched.y**2)
    upright = across < 1e-7
    first = dr.select(upright, mi.Vector3f(1, 0, 0), mi.Vector3f(-stretched.y, stretched.x, 0) / dr.maximum(across, 1e-7))
    second = dr.cross(stretched, first)
    radius, angle = dr.sqrt(sample.x), 2 * dr.pi * sample.y
    x, y = radius * dr.cos(angle), radius * dr.sin(angle)
    half = (1 + stretched.z) / 2
    y = (1 - half) * dr.safe_sqrt(1 - x**2) + half * y
    facet = x * first + y * second + dr.safe_sqrt(1 - x**2 - y**2) * stretched
    return dr.normalize(mi.Vector3f(alpha * facet.x, alpha * facet.y, dr.maximum(facet.z, 1e-6)))


class Surface(mi.BSDF):
    """A metal or a dielectric over a diffuse body, without clear coat and transmission.

    Half of the directions are chosen by visible normals and half by the cosine; of a metal all by visible normals.
    """

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        base = mi.Color3f(props["base_color"])
        metallic = props.get("metallic", 0.0)
        self.alpha = max(props.get("roughness", 0.5) ** 2, MIN_ALPHA)
        ior = props.get("ior", 1.5)
        border = ((ior - 1) / (ior + 1)) ** 2
        self.f0 = border + (base - border) * metallic
        self.body = base * ((1 - metallic) * (21 / 20) * (1 - border))
        self.specular_share = 1.0 if metallic == 1.0 else 0.5
        self.is_separable = props.get("separable", False)
        lobes = [mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection]
        self.m_components = [lobe | mi.BSDFFlags.FrontSide for lobe in lobes]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def ggx(self, half):
        """GGX's distribution of normals."""
        return self.alpha**2 / (dr.pi * (half.x**2 + half.y**2 + (self.alpha * half.z) ** 2) ** 2)

    def shadowing(self, viewer, light):
        """Smith's G₂."""
        view, lit = smith_lambda_root(self.alpha, viewer.z), smith_lambda_root(self.alpha, light.z)
        if self.is_separable:
            return 4 * viewer.z * light.z / ((viewer.z + view) * (light.z + lit))
        return 2 * viewer.z * light.z / (light.z * view + viewer.z * lit)

    def eval_pdf(self, ctx, si, wo, active=True):
        viewer = si.wi
        active = active & (viewer.z > 0) & (wo.z > 0)
        half = dr.normalize(viewer + wo)
        normals = self.ggx(half)
        mirrored = schlick(self.f0, dr.dot(viewer, half)) * normals * self.shadowing(viewer, wo) / (4 * viewer.z)
        through = (1 - schlick(0.0, viewer.z)) * (1 - schlick(0.0, wo.z))
        value = mirrored + self.body * (through * wo.z / dr.pi)
        seen = 2 * viewer.z / (viewer.z + smith_lambda_root(self.alpha, viewer.z))
        of_mirror = seen * normals / (4 * viewer.z)
        pdf = self.specular_share * of_mirror + (1 - self.specular_share) * wo.z / dr.pi
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def sample(self, ctx, si, sample1, sample2, active=True):
        facet = visible_normal(si.wi, self.alpha, sample2)
        mirrored = 2 * dr.dot(si.wi, facet) * facet - si.wi
        chosen = sample1 < self.specular_share
        result = mi.BSDFSample3f()
        result.wo = dr.select(chosen, mirrored, mi.warp.square_to_cosine_hemisphere(sample2))
        value, pdf = self.eval_pdf(ctx, si, result.wo, active)
        result.pdf = pdf
        result.eta = 1.0
        result.sampled_type = dr.select(
            chosen, mi.UInt32(+mi.BSDFFlags.GlossyReflection), mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
        )
        result.sampled_component = dr.select(chosen, mi.UInt32(0), mi.UInt32(1))
        good = pdf > 0
        return result, dr.select(good, value / dr.maximum(pdf, 1e-30), 0)

    def to_string(self):
        return f"Surface[alpha={self.alpha}]"


class Glass(mi.BSDF):
    """Glass with the narrow microfacets of roughness 0, sampled only: to Mitsuba a perfect mirror and refraction.

    Radiance is not scaled by the square of the index of refraction: cameras and lights are outside of the glass.
    """

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.ior = props.get("ior", 1.5)
        self.is_exact = props.get("exact", False)
        sides = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        lobes = [mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission]
        self.m_components = [lobe | sides for lobe in lobes]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def sample(self, ctx, si, sample1, sample2, active=True):
        outside = si.wi.z > 0
        side = dr.select(outside, mi.Float(1), mi.Float(-1))
        viewer = mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))
        facet = visible_normal(viewer, MIN_ALPHA, sample2)
        cosine = dr.dot(viewer, facet)
        ratio = dr.select(outside, mi.Float(1 / self.ior), mi.Float(self.ior))
        beyond = ratio**2 * (1 - cosine**2)
        cosine_beyond = dr.safe_sqrt(1 - beyond)
        if self.is_exact:
            reflected = mi.fresnel(cosine, dr.select(outside, mi.Float(self.ior), mi.Float(1 / self.ior)))[0]
        else:
            f0 = ((self.ior - 1) / (self.ior + 1)) ** 2
            reflected = schlick(f0, dr.select(outside, cosine, cosine_beyond))
        reflected = dr.select(beyond >= 1, 1, reflected)
        mirrors = sample1 < reflected
        mirrored = 2 * cosine * facet - viewer
        refracted = (ratio * cosine - cosine_beyond) * facet - ratio * viewer
        wo = dr.select(mirrors, mirrored, refracted)
        result = mi.BSDFSample3f()
        result.wo = mi.Vector3f(wo.x, wo.y, wo.z * side)
        result.pdf = dr.select(mirrors, reflected, 1 - reflected)
        result.eta = 1.0
        result.sampled_type = dr.select(
            mirrors, mi.UInt32(+mi.BSDFFlags.DeltaReflection), mi.UInt32(+mi.BSDFFlags.DeltaTransmission)
        )
        result.sampled_component = dr.select(mirrors, mi.UInt32(0), mi.UInt32(1))
        good = active & ((wo.z > 0) == mirrors)
        return result, dr.select(good, mi.Color3f(1), 0)

    def eval(self, ctx, si, wo, active=True):
        return mi.Color3f(0)

    def pdf(self, ctx, si, wo, active=True):
        return mi.Float(0)

    def eval_pdf(self, ctx, si, wo, active=True):
        return mi.Color3f(0), mi.Float(0)

    def to_string(self):
        return f"Glass[ior={self.ior}]"


mi.register_bsdf("sdfarm_surface", Surface)
mi.register_bsdf("sdfarm_glass", Glass)
