"""Writes a job like the scene of the example `sdf_renderer` of Taichi 1.7 (https://github.com/taichi-dev/taichi, Apache-2.0), for benchmarks:
python3 tests/peers/taichi.py > taichi.json

A sphere, a box and a cylinder of eight shells, which a plane cuts open, before a wall, lit by a disc. Paths have six
segments. Outer corners of the shells are round here, and walls have one color.
"""

import json
import math

STRIPE = {"diffuse": {"kd": [0.5, 0.47, 0.5]}}


def shells(solid):
    """Shells of thickness 0.01 whose middles are 0.025, 0.075, 0.125 and 0.175 inside and outside of a solid's surface."""
    for thickness in (0.2, 0.1, 0.05, 0.01):
        solid = {"onion": {"child": solid, "thickness": thickness}}
    return solid


def moved(by, child):
    return {"translate": {"by": by, "child": child}}


solids = {
    "union": {
        "of": [
            moved([0, 0.35, 0], {"sphere": {"radius": 0.185}}),
            moved([0.8, 0.3, 0], {"box": {"size": [0.25, 0.25, 0.25]}}),
            moved([-0.8, 0.3, 0], {"cylinder": {"radius": 0.125, "height": 0.25}}),
        ]
    }
}
cut = {"plane": {"normal": [0, 0.6, 0.8], "offset": 0.32}}
job = {
    "name": "nested shells",
    "image": {"width": 1280, "height": 720, "samples": 64, "exposure": 3},
    "scene": {
        "integrator": {"path": {"max_bounces": 4}},
        "background": {"color": [0, 0, 0]},
        "camera": {"position": [0, 0.32, 3.7], "look_at": [0, 0.32, 0], "fov": 2 * math.degrees(math.atan(0.23))},
        "lights": [
            {"disc": {"position": [-1.5, 0.6, 0.3], "direction": [1, 0, 0], "radius": 2, "color": [1, 1, 1], "visible": True}}
        ],
        "objects": [
            {"shape": {"intersection": {"of": [shells(solids), cut]}}, "material": STRIPE},
            {"shape": {"plane": {"normal": [0, 1, 0], "offset": -0.1}}, "material": STRIPE},
            {"shape": {"plane": {"normal": [0, 0, 1], "offset": -0.4}}, "material": STRIPE},
        ],
    },
}
print(json.dumps(job))
