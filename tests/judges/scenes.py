"""Scenes of the judge, each written once and translated twice: as a job of sdfarm and as a dictionary of Mitsuba.

How the definitions match:

* sdfarm leaves π out of lights. A `point` of color c is a Mitsuba `point` of intensity π·c. A `sphere` or `disc` of radius r
  has the radiance c/r², a `rectangle` the radiance π·c/(width·height): each lights a distant surface in front of it like the
  point, and a matte surface of albedo k with irradiance E has the radiance k·E/π in both programs.
* Lights are one-sided, black, and opaque in Mitsuba. They are 0.02 away from walls here, because sdfarm's rays start a
  small distance from surfaces.
* `max_bounces` n: a ray from the camera is scattered at most n times, and the lights are added at each of the n + 1
  surfaces. A path to a light has up to n + 2 edges, so Mitsuba's `max_depth` is n + 2. Russian roulette has no bias.
* `fov` is vertical: `fov_axis` is "y". A picture of sdfarm is unfiltered in each pixel's square: `rfilter` is "box".
* A lens's `aperture` is a diameter, Mitsuba's `aperture_radius` half of it; both focus on a plane.
* The gradient from `bottom` to `top` by (y + 1)/2 is an `envmap` of equal columns of 1,024 rows; the first
  and the last row are the poles.
* `diffuse` is Lambertian, `surface` is written in materials.py. A `volume` is a homogeneous medium behind a boundary that is no
  surface, which Mitsuba's `volpath` does not count as a scattering.
"""

import dataclasses
import math

import numpy as np

NO_LIGHT = [0.0, 0.0, 0.0]


@dataclasses.dataclass
class Scene:
    """A scene, with what both programs need to know."""

    name: str
    position: list
    look_at: list
    fov: float = 36.0
    max_bounces: int = 6
    integrator: str = "path"
    # Whether the camera sees the lights in Mitsuba; sdfarm's lights have a member `visible`.
    hides_lights: bool = False
    # A color, or a pair of colors: the gradient's bottom and top.
    sky: object = None
    lens: dict = None
    has_media: bool = False
    # How much glass magnifies displacements of its surface in the picture, at most.
    magnified: float = 1.0
    # The radiance of every pixel, where it is known.
    known: float = None
    job_objects: list = dataclasses.field(default_factory=list)
    job_lights: list = dataclasses.field(default_factory=list)
    peer_shapes: list = dataclasses.field(default_factory=list)

    # Shapes

    def box(self, center, size, material, degrees=0.0):
        """A box, turned about the y axis."""
        turned = {"box": {"size": size}}
        if degrees:
            turned = {"rotate": {"degrees": [0, degrees, 0], "child": turned}}
        self.add_object({"translate": {"by": center, "child": turned}}, material)
        half = [s / 2 for s in size]
        self.add_peer("cube", lambda t: t.translate(center).rotate([0, 1, 0], degrees).scale(half), material)

    def ball(self, center, radius, material):
        self.add_object({"translate": {"by": center, "child": {"sphere": {"radius": radius}}}}, material)
        self.add_peer("sphere", None, material, center=center, radius=radius)

    def hollow(self, radius, material):
        """A spherical room around the origin."""
        outer = {"box": {"size": [2.5 * radius] * 3}}
        self.add_object({"difference": {"of": [outer, {"sphere": {"radius": radius}}]}}, material)
        self.add_peer("sphere", None, material, center=[0, 0, 0], radius=radius, flip_normals=True)

    def room(self, left, right, white, width=2.8, height=2.0, depth=2.4, wall=0.2):
        """Floor, ceiling, back and side walls; open toward +z."""
        x, z = (width + wall) / 2, (depth + wall) / 2
        self.box([0, -wall / 2, 0], [width + 2 * wall, wall, depth], white)
        self.box([0, height + wall / 2, 0], [width + 2 * wall, wall, depth], white)
        self.box([0, height / 2, -z], [width + 2 * wall, height + 2 * wall, wall], white)
        self.box([-x, height / 2, 0], [wall, height, depth], left)
        self.box([x, height / 2, 0], [wall, height, depth], right)

    # Lights

    def sphere_light(self, position, radius, color, visible=True):
        light = {"position": position, "radius": radius, "color": color}
        self.job_lights.append({"sphere": {**light, "visible": True} if visible else light})
        self.add_emitter("sphere", None, [c / radius**2 for c in color], center=position, radius=radius)

    def disc_light(self, position, direction, radius, color):
        light = {"position": position, "direction": direction, "radius": radius, "color": color, "visible": True}
        self.job_lights.append({"disc": light})
        self.add_emitter("disk", placed(position, direction, [0, 1, 0], radius, radius), [c / radius**2 for c in color])

    def rectangle_light(self, position, direction, up, width, height, color):
        light = {"position": position, "direction": direction, "up": up, "width": width, "height": height}
        self.job_lights.append({"rectangle": {**light, "color": color, "visible": True}})
        radiance = [math.pi * c / (width * height) for c in color]
        self.add_emitter("rectangle", placed(position, direction, up, width / 2, height / 2), radiance)

    def point_light(self, position, color):
        self.job_lights.append({"point": {"position": position, "color": color}})
        self.peer_shapes.append(
            lambda mi: {"type": "point", "position": position, "intensity": rgb([math.pi * c for c in color])}
        )

    # Translations

    def add_object(self, shape, material):
        self.job_objects.append({"shape": shape, "material": material.job})

    def add_peer(self, kind, placing, material, **members):
        self.has_media |= material.medium is not None

        def shape(mi):
            entry = {"type": kind, **members, "bsdf": material.bsdf}
            if material.medium:
                entry["interior"] = material.medium
            if material.emission:
                entry["emitter"] = {"type": "area", "radiance": rgb(material.emission)}
            if placing:
                entry["to_world"] = placing(mi.ScalarTransform4f())
            return entry

        self.peer_shapes.append(shape)

    def add_emitter(self, kind, placing, radiance, **members):
        self.add_peer(kind, placing, Material(None, black(), radiance), **members)

    def job(self, width, height, samples, seed):
        """The job file."""
        camera = {"position": self.position, "look_at": self.look_at, "fov": self.fov}
        if self.lens:
            camera["lens"] = self.lens
        lights = list(self.job_lights)
        scene = {"camera": camera, "objects": self.job_objects, "lights": lights}
        if self.sky is None:
            scene["background"] = {"color": NO_LIGHT}
        else:
            lights.append({"sky": {}})
            pair = np.ndim(self.sky) == 2
            scene["background"] = {"gradient": {"bottom": self.sky[0], "top": self.sky[1]}} if pair else {"color": self.sky}
        if self.integrator == "path":
            scene["integrator"] = {"path": {"max_bounces": self.max_bounces}}
        else:
            scene["march"] = {"max_bounces": self.max_bounces}
        image = {"width": width, "height": height, "samples": samples, "seed": seed, "format": "exr", "precision": "float"}
        return {"name": f"judge-{self.name}", "scene": scene, "image": image}

    def edges(self, mi, width, height):
        """Whether a pixel is at a silhouette or a crease: an array of rows, from Mitsuba's shapes and normals.

        A lens blurs edges, so that none are left out.
        """
        if self.lens:
            return np.zeros((height, width), bool)
        fine = 4
        scene = self.peer(mi, fine * width, fine * height, "independent")
        scene["integrator"] = {"type": "aov", "aovs": "shape:shape_index,normal:sh_normal"}
        layers = np.array(mi.render(mi.load_dict(scene), spp=1, seed=0))
        layers = np.pad(layers, ((1, 1), (1, 1), (0, 0)), "edge")
        steps = [np.abs(np.diff(layers[:, :, -4], axis=axis)) > 0.5 for axis in (0, 1)]
        turns = [np.linalg.norm(np.diff(layers[:, :, -3:], axis=axis), axis=-1) > 0.3 for axis in (0, 1)]
        (down, across), (turn_down, turn_across) = steps, turns
        down, across = down | turn_down, across | turn_across
        beside = down[:-1, 1:-1] | down[1:, 1:-1] | across[1:-1, :-1] | across[1:-1, 1:]
        return beside.reshape(height, fine, width, fine).any((1, 3))

    def peer(self, mi, width, height, sampler):
        """The dictionary for mitsuba.load_dict."""
        camera = {
            "type": "perspective",
            "fov": self.fov,
            "fov_axis": "y",
            "near_clip": 1e-3,
            "to_world": mi.ScalarTransform4f().look_at(self.position, self.look_at, [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": sampler},
        }
        if self.lens:
            camera.update(type="thinlens", aperture_radius=self.lens["aperture"] / 2, focus_distance=self.lens["focus"])
        kind = "volpath" if self.has_media else "path"
        integrator = {"type": kind, "max_depth": self.max_bounces + 2, "hide_emitters": self.hides_lights}
        scene = {"type": "scene", "integrator": integrator, "sensor": camera}
        for number, shape in enumerate(self.peer_shapes):
            scene[f"shape{number}"] = shape(mi)
        if self.sky is not None:
            scene["sky"] = environment(mi, self.sky)
        return scene


@dataclasses.dataclass
class Material:
    """A material of both programs, and its emitted radiance."""

    job: dict
    bsdf: dict
    emission: list = None
    # The inside, if the boundary is not a surface.
    medium: dict = None


def rgb(color):
    """An unbounded color for Mitsuba."""
    return {"type": "rgb", "value": list(color)}


def black():
    return {"type": "diffuse", "reflectance": rgb(NO_LIGHT)}


def matte(*color):
    return Material({"diffuse": {"kd": list(color), "ambient": NO_LIGHT}}, {"type": "diffuse", "reflectance": rgb(color)})


def surface(base_color, **numbers):
    """A metal or a dielectric; `numbers` are members of sdfarm's `surface`."""
    return Material(
        {"surface": {"base_color": base_color, **numbers}},
        {"type": "sdfarm_surface", "base_color": rgb_tuple(base_color), **{k: float(v) for k, v in numbers.items()}},
    )


def glass(ior=1.5):
    return Material(
        {"surface": {"base_color": [1, 1, 1], "roughness": 0, "transmission": 1, "ior": ior}},
        {"type": "sdfarm_glass", "ior": ior},
    )


def emitter(*color):
    """A black body: with an index of refraction of 1 it reflects nothing."""
    job = {"surface": {"base_color": NO_LIGHT, "ior": 1, "roughness": 1, "emission": list(color)}}
    return Material(job, black(), list(color))


def volume(density, albedo, anisotropy):
    """A medium of even density; its extinction has no color."""
    phase = {"type": "hg", "g": anisotropy} if anisotropy else {"type": "isotropic"}
    medium = {"type": "homogeneous", "sigma_t": float(density), "albedo": rgb(albedo), "phase": phase}
    return Material({"volume": {"density": density, "albedo": albedo, "anisotropy": anisotropy}}, {"type": "null"}, None, medium)


def rgb_tuple(color):
    """A color as a property that a BSDF written in Python can read."""
    import mitsuba as mi

    return mi.ScalarVector3f(*color)


def placed(position, direction, up, across, along):
    """Places a shape of the x-y plane with its normal along `direction`."""
    target = [p + d for p, d in zip(position, direction)]
    return lambda t: t.look_at(position, target, up).scale([across, along, 1])


def environment(mi, sky):
    if np.ndim(sky) == 1:
        return {"type": "constant", "radiance": rgb(sky)}
    rows = 1024
    height = np.cos(np.arange(rows) * math.pi / (rows - 1))[:, None, None]
    bottom, top = np.array(sky, np.float32)
    column = bottom + (top - bottom) * (height + 1) / 2
    return {"type": "envmap", "bitmap": mi.Bitmap(np.repeat(column, 8, 1).astype(np.float32))}


WHITE = (0.73, 0.73, 0.73)
RED = (0.63, 0.065, 0.05)
GREEN = (0.14, 0.45, 0.091)
GRADIENT = [[0.9, 0.6, 0.3], [0.3, 0.6, 1.4]]
CEILING = {"position": [0.1, 1.98, -0.1], "direction": [0, -1, 0], "up": [0, 0, 1], "width": 0.9, "height": 0.6}


def room(name, **members):
    """A scene in the room with colored side walls."""
    scene = Scene(name, [0.1, 1.05, 4.2], [0, 1, 0], **members)
    scene.room(matte(*RED), matte(*GREEN), matte(*WHITE))
    return scene


def cornell():
    scene = room("cornell")
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.box([-0.5, 0.6, -0.4], [0.6, 1.2, 0.6], matte(*WHITE), 18)
    scene.box([0.5, 0.3, 0.3], [0.6, 0.6, 0.6], matte(*WHITE), -16)
    return scene


def glass_ball():
    scene = room("glass", max_bounces=8, magnified=4)
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.ball([0.4, 0.5, 0.2], 0.45, glass())
    scene.box([-0.5, 0.6, -0.4], [0.6, 1.2, 0.6], matte(*WHITE), 18)
    return scene


def furnace():
    """A matte hollow around a luminous ball: its wall has the same radiance everywhere, a·F·L·Σ (a·(1 − F))^k.

    The ball of radius r in a hollow of radius R takes F = (r/R)² of the light that arrives at the wall; a is the albedo, L the
    ball's radiance, and k counts the bounces from 0 to `max_bounces`.
    """
    albedo, hollow, ball, color, bounces = 0.8, 2.0, 0.5, 0.5, 8
    fraction = (ball / hollow) ** 2
    again = albedo * (1 - fraction)
    known = albedo * fraction * color / ball**2 * (1 - again ** (bounces + 1)) / (1 - again)
    scene = Scene("furnace", [0.9, 0.5, 0], [2, 0.3, 0.4], fov=50, max_bounces=bounces, known=known)
    scene.hollow(hollow, matte(albedo, albedo, albedo))
    scene.sphere_light([0, 0, 0], ball, [color] * 3)
    return scene


def white():
    """White shapes in white light from everywhere: the picture is white."""
    scene = Scene("white", [2.2, 1.8, 3.2], [0, 0.4, 0], max_bounces=32, sky=[1, 1, 1], known=1.0)
    white = matte(1, 1, 1)
    scene.box([0, -0.25, 0], [3, 0.5, 3], white)
    scene.ball([0.5, 0.5, 0.2], 0.5, white)
    scene.box([-0.5, 0.4, -0.2], [0.7, 0.8, 0.7], white, 30)
    return scene


def sky():
    scene = Scene("sky", [2.2, 1.8, 3.2], [0, 0.4, 0], sky=GRADIENT)
    scene.box([0, -0.25, 0], [4, 0.5, 4], matte(0.6, 0.55, 0.5))
    scene.ball([0.5, 0.5, 0.2], 0.5, matte(0.7, 0.3, 0.2))
    scene.box([-0.6, 0.4, -0.2], [0.7, 0.8, 0.7], matte(0.3, 0.5, 0.7), 30)
    return scene


def metal():
    scene = room("metal")
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.ball([-0.5, 0.45, -0.2], 0.45, surface([1.0, 1.0, 1.0], metallic=1, roughness=0.4))
    scene.ball([0.6, 0.4, 0.3], 0.4, surface([0.95, 0.64, 0.54], metallic=1, roughness=0.6))
    return scene


def plastic():
    scene = room("plastic")
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.ball([-0.5, 0.45, -0.2], 0.45, surface([0.8, 0.25, 0.1], roughness=0.3))
    scene.box([0.5, 0.3, 0.3], [0.6, 0.6, 0.6], surface([0.2, 0.4, 0.7], roughness=0.6, ior=1.8), -16)
    return scene


def mirrors():
    """Two mirrors that face each other over a matte floor."""
    scene = Scene("mirrors", [0.1, 1.05, 4.2], [0, 0.9, 0])
    mirror = surface([0.92, 0.94, 0.9], metallic=1, roughness=0)
    scene.room(mirror, mirror, matte(*WHITE))
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.ball([-0.4, 0.4, 0.1], 0.4, matte(*RED))
    scene.box([0.6, 0.3, 0.2], [0.5, 0.6, 0.5], matte(*GREEN), 25)
    return scene


def sphere_light():
    scene = room("sphere-light")
    scene.sphere_light([-0.5, 1.3, 0.1], 0.25, [0.5, 0.42, 0.3])
    scene.box([0.5, 0.3, 0.1], [0.6, 0.6, 0.6], matte(*WHITE), -16)
    return scene


def disc_light():
    scene = room("disc-light")
    scene.disc_light([1.1, 1.3, -0.3], [-1, -0.5, 0.5], 0.15, [1.0, 0.9, 0.8])
    scene.ball([-0.3, 0.4, 0.1], 0.4, matte(*WHITE))
    return scene


def emissive():
    scene = room("emissive")
    scene.box([-0.7, 0.5, -0.3], [0.3, 1.0, 0.3], emitter(4, 2.8, 1.6), 30)
    scene.ball([0.5, 0.4, 0.2], 0.4, matte(*WHITE))
    return scene


def lens():
    scene = room("lens", lens={"aperture": 0.3, "focus": 4.0})
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    for number, (x, z) in enumerate([(-0.9, -0.9), (-0.1, 0.1), (0.7, 1.0)]):
        scene.ball([x, 0.3, z], 0.3, matte(*[RED, WHITE, GREEN][number]))
    return scene


def medium():
    """A ball of a medium that scatters forward, in a room with a lamp."""
    scene = room("medium", max_bounces=16)
    scene.rectangle_light(color=[1.6, 1.3, 0.9], **CEILING)
    scene.ball([0.3, 0.8, 0.2], 0.6, volume(5, [0.95, 0.8, 0.6], 0.5))
    scene.box([-0.6, 0.5, -0.5], [0.5, 1.0, 0.5], matte(*WHITE), 18)
    return scene


def medium_sky():
    """A box of a medium with a ball inside of it, under a gradient."""
    scene = Scene("medium-sky", [2.2, 1.8, 3.2], [0, 0.5, 0], sky=GRADIENT, max_bounces=24)
    scene.box([0, -0.25, 0], [4, 0.5, 4], matte(0.6, 0.55, 0.5))
    scene.box([0, 0.72, 0], [1.6, 1.4, 1.2], volume(3, [1.0, 0.9, 0.7], -0.3), 20)
    scene.ball([0.2, 0.6, 0.1], 0.3, matte(0.7, 0.3, 0.2))
    return scene


def medium_furnace():
    """A white ball of a medium in white light from everywhere cannot be seen: the picture is white."""
    scene = Scene("medium-furnace", [0, 0, 3], [0, 0, 0], sky=[1, 1, 1], max_bounces=32, known=1.0)
    scene.ball([0, 0, 0], 0.8, volume(1.5, [1.0, 1.0, 1.0], 0.3))
    return scene


def direct_ball():
    """Light of a ball that is not visible, by the integrator `direct`: camera, shapes and units without bounces."""
    scene = room("direct-ball", integrator="direct", hides_lights=True, max_bounces=0)
    scene.sphere_light([0.5, 1.5, 0.3], 0.2, [1.2, 1.0, 0.8], visible=False)
    scene.box([-0.5, 0.6, -0.4], [0.6, 1.2, 0.6], matte(*WHITE), 18)
    scene.ball([0.6, 0.35, 0.4], 0.35, matte(*GREEN))
    return scene


def direct_sky():
    """A point light and a gradient, by the integrator `direct`; the picture shows no sky."""
    scene = Scene("direct-sky", [1.2, 4.5, 3.2], [0, 0.2, 0], integrator="direct", max_bounces=0, sky=GRADIENT)
    scene.box([0, -0.25, 0], [20, 0.5, 20], matte(0.6, 0.55, 0.5))
    scene.ball([0.6, 0.5, 0.2], 0.5, matte(0.7, 0.3, 0.2))
    scene.box([-0.6, 0.6, -0.2], [0.7, 1.2, 0.7], matte(0.3, 0.5, 0.7), 30)
    scene.point_light([1.5, 3.0, 1.0], [3, 3, 2])
    return scene


def direct_surface():
    """Highlights of a ball of light on `surface`, by the integrator `direct`, without bounces."""
    scene = room("direct-surface", integrator="direct", hides_lights=True, max_bounces=0)
    scene.sphere_light([0.5, 1.5, 0.6], 0.3, [1.2, 1.0, 0.8], visible=False)
    scene.ball([-0.6, 0.5, -0.2], 0.5, surface([0.95, 0.64, 0.54], metallic=1, roughness=0.6))
    scene.ball([0.5, 0.5, 0.1], 0.5, surface([0.8, 0.25, 0.1], roughness=0.5, ior=1.8))
    return scene


def direct_bounces():
    """Glass and metal under a gradient, by the integrator `direct`: bounces without lights."""
    scene = Scene("direct-bounces", [1.2, 1.5, 4.2], [0, 0.4, 0], integrator="direct", max_bounces=16, sky=GRADIENT)
    scene.magnified = 4
    scene.ball([0.6, 0.5, 0.4], 0.5, glass())
    scene.ball([-0.6, 0.5, 0.4], 0.5, surface([0.95, 0.64, 0.54], metallic=1, roughness=0.4))
    scene.box([0, 0.6, -0.8], [2.4, 1.2, 0.2], surface([0.92, 0.94, 0.9], metallic=1, roughness=0), 12)
    return scene


SCENES = [
    direct_ball, direct_sky, direct_surface, direct_bounces, cornell, glass_ball, furnace, white, sky, metal, plastic,
    mirrors, sphere_light, disc_light, emissive, lens, medium, medium_sky, medium_furnace,
]  # fmt: skip
