"""Writes a job of many shapes, for benchmarks:
python3 tests/figures/many.py spheres|boxes|painted|formulas|moving COUNT WIDTH HEIGHT SAMPLES > job.json

One smooth union: of spheres that fill a ball, or of turned boxes that stand on a square, like houses. Painted ones are the
spheres in eight materials, one of them with a texture. Formulas are COUNT formulas, four of each sphere; moving ones follow
the time in 24 frames.
"""

import json
import random
import sys

kind, count, width, height, samples = sys.argv[1], *map(int, sys.argv[2:])
numbers = random.Random(1)


def between(low, high):
    return round(numbers.uniform(low, high), 5)


def sphere():
    """A sphere in a ball of radius 1, of whose room all together have about a fifth."""
    size = count ** (-1 / 3)
    place = [1, 1, 1]
    while sum(c * c for c in place) > 1:
        place = [between(-1, 1) for _ in range(3)]
    return move(place, {"sphere": {"radius": between(0.5 * size, 0.7 * size)}})


def painted():
    """A sphere with a material."""
    return {"paint": {"material": numbers.choice(list(MATERIALS)), "child": sphere()}}


def box():
    """A box with its foot at height 0, in a square of edge 2."""
    size = count ** (-1 / 2)
    wide, deep, high = between(0.6 * size, 1.4 * size), between(0.6 * size, 1.4 * size), between(0.1, 0.4)
    solid = {"box": {"size": [wide, high, deep], "round": round(0.05 * size, 5)}}
    turned = {"rotate": {"degrees": [0, between(0, 360), 0], "child": solid}}
    return move([between(-1, 1), round(high / 2, 5), between(-1, 1)], turned)


def formulas():
    """A sphere whose place and size are formulas."""
    x, y, z = [between(-1, 1) for _ in range(3)]
    sway = " + 0.1 * sin(360 * t + 90)" if kind == "moving" else ""
    place = [{"expr": f"spread * {x}{sway}"}, {"expr": f"mix(low, 1, {abs(y)})"}, {"expr": f"spread * cos({180 * z:.3f})"}]
    return move(place, {"sphere": {"radius": {"expr": f"size * (0.5 + {abs(x)})"}}})


def move(place, child):
    return {"translate": {"by": place, "child": child}}


MATERIALS = {color: {"diffuse": {"kd": color}} for color in
             ["#c0392b", "#2456a6", "#e8e4da", "#d9a441", "#3c7a3e", "#5b3f8c", "#222428"]}
MATERIALS["tiles"] = {"diffuse": {"kd": {"checker": {"cell": 0.03, "colors": ["#f0e8d8", "#a04028"]}}}}
kinds = {"spheres": sphere, "boxes": box, "painted": painted, "formulas": formulas, "moving": formulas}
if kind in ("formulas", "moving"):
    count //= 4
shapes = [kinds[kind]() for _ in range(count)]
smooth = round(0.3 * count ** (-1 / 2 if kind == "boxes" else -1 / 3), 5)
scene = {
    "camera": {"position": [0.9, 1.5, -2.6], "look_at": [0, 0, 0], "fov": 48},
    "lights": [{"directional": {"direction": [0.5, 0.75, -0.433]}}],
    "objects": [{"shape": {"union": {"smooth": smooth, "of": shapes}}}],
}
if kind == "painted":
    scene["materials"] = MATERIALS
job = {"scene": scene, "image": {"width": width, "height": height, "samples": samples}}
if kind in ("formulas", "moving"):
    scene["numbers"] = {"spread": "0.9 + size", "low": -0.5, "size": 0.02}
if kind == "moving":
    job["frames"] = {"count": 24, "fps": 24}
print(json.dumps(job))
