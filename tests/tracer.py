"""An independent tracer in double precision: numpy, without any formula of the project.

tracer.py JOB.json PICTURE.exr: the depth and normals of a float EXR against those traced here, as JSON.
It supports the paper's nodes, transforms, paints, and smooth operators.
"""

import json
import sys

import numpy as np
import OpenEXR


def vector(values):
    return np.array(values, dtype=np.float64)


def length(v):
    return np.sqrt(np.sum(v * v, axis=-1))


def rotation(degrees):
    """Rz.Ry.Rx about fixed axes."""
    x, y, z = np.radians(vector(degrees))
    about_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    about_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    about_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    return vector(about_z) @ vector(about_y) @ vector(about_x)


def inside_and_outside(q):
    return length(np.maximum(q, 0)) + np.minimum(np.max(q, axis=-1), 0)


def mandelbulb(p, power, iterations):
    z, r, dr = p.copy(), length(p), np.ones(len(p))
    going = r <= 2
    for _ in range(iterations):
        if not going.any():
            break
        zi, ri = z[going], np.maximum(r[going], 1e-12)
        theta = np.arccos(np.clip(zi[:, 2] / ri, -1, 1)) * power
        phi = np.arctan2(zi[:, 1], zi[:, 0]) * power
        dr[going] = power * ri ** (power - 1) * dr[going] + 1
        sine = np.sin(theta)
        turned = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)
        z[going] = (ri**power)[:, None] * turned + p[going]
        r[going] = length(z[going])
        going = going & (r <= 2)
    estimate = 0.5 * np.log(np.maximum(r, 1e-12)) * r / dr
    away = length(p)
    # Far outside, the estimate would exceed the distance.
    return np.where(away > 2, np.minimum(estimate, away - 1.25), estimate)


def smooth(a, b, k, sign):
    if k == 0:
        return np.minimum(a, b) if sign < 0 else np.maximum(a, b)
    h = np.maximum(k - np.abs(a - b), 0)
    return np.minimum(a, b) - h * h / (4 * k) if sign < 0 else np.maximum(a, b) + h * h / (4 * k)


def distance(node, p):
    ((name, it),) = node.items()
    if name == "sphere":
        return length(p) - it["radius"]
    if name == "box":
        rounding = it.get("round", 0)
        return inside_and_outside(np.abs(p) - vector(it["size"]) / 2 + rounding) - rounding
    if name == "plane":
        normal = vector(it["normal"])
        return p @ (normal / length(normal)) - it.get("offset", 0)
    if name == "cylinder":
        across = np.hypot(p[:, 0], p[:, 2]) - it["radius"]
        return inside_and_outside(np.stack([across, np.abs(p[:, 1]) - it["height"] / 2], axis=-1))
    if name == "infinite_cylinder":
        return np.hypot(p[:, 0], p[:, 2]) - it["radius"]
    if name == "torus":
        return np.hypot(np.hypot(p[:, 0], p[:, 2]) - it["radius"], p[:, 1]) - it["tube"]
    if name == "capsule":
        a, b = vector(it["a"]), vector(it["b"])
        way = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return length(p - a - way[:, None] * (b - a)) - it["radius"]
    if name == "mandelbulb":
        return mandelbulb(p, it.get("power", 8), it.get("iterations", 8))
    if name == "translate":
        return distance(it["child"], p - vector(it["by"]))
    if name == "rotate":
        return distance(it["child"], p @ rotation(it["degrees"]))
    if name == "scale":
        return distance(it["child"], p / it["by"]) * it["by"]
    if name == "paint":
        return distance(it["child"], p)
    if name in ("union", "intersection", "difference"):
        first, *others = it["of"]
        result, k = distance(first, p), it.get("smooth", 0)
        for other in others:
            value = distance(other, p)
            value = -value if name == "difference" else value
            result = smooth(result, value, k, -1 if name == "union" else 1)
        return result
    raise SystemExit(f"the tracer does not know {name}")


def scene_distance(scene, p):
    return np.min([distance(item["shape"], p) for item in scene["objects"]], axis=0)


def rays(job):
    camera, image = job["scene"]["camera"], job["image"]
    width, height = image["width"], image["height"]
    position = vector(camera["position"])
    forward = vector(camera["look_at"]) - position
    forward /= length(forward)
    right = np.cross(forward, vector(camera.get("up", [0, 1, 0])))
    right /= length(right)
    up = np.cross(right, forward)
    tangent = np.tan(np.radians(camera.get("fov", 40)) / 2)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    u = (x / width * 2 - 1) * tangent * width / height
    v = (1 - y / height * 2) * tangent
    direction = u[..., None] * right + v[..., None] * up + forward
    direction = direction.reshape(-1, 3)
    return position, direction / length(direction)[:, None]


def trace(scene, origin, directions, farthest):
    """Steps by the distance, then finds the first root by bisection. Infinite for rays without a hit."""
    t = np.zeros(len(directions))
    found = np.full(len(directions), np.inf)
    going = np.arange(len(directions))
    for _ in range(30000):
        if len(going) == 0:
            break
        at = t[going]
        ray = directions[going]
        value = scene_distance(scene, origin + ray * at[:, None])
        following = at + np.maximum(value, 2e-6 * (at + 0.1))
        crossed = scene_distance(scene, origin + ray * following[:, None]) <= 0
        low, high = at[crossed], following[crossed]
        for _ in range(50):
            middle = (low + high) / 2
            inside = scene_distance(scene, origin + ray[crossed] * middle[:, None]) <= 0
            low, high = np.where(inside, low, middle), np.where(inside, middle, high)
        found[going[crossed]] = high
        t[going] = following
        going = going[~crossed & (following < farthest)]
    return found


def normals(scene, p):
    step, parts = 1e-7, []
    for axis in np.eye(3) * step:
        parts.append(scene_distance(scene, p + axis) - scene_distance(scene, p - axis))
    gradient = np.stack(parts, axis=-1)
    return gradient / np.maximum(length(gradient), 1e-30)[:, None]


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        job = json.load(file)
    channels = OpenEXR.File(sys.argv[2], separate_channels=True).parts[0].channels
    depth = channels["Z"].pixels.astype(np.float64).ravel()
    normal = np.stack([channels[f"N.{axis}"].pixels.astype(np.float64).ravel() for axis in "XYZ"], axis=-1)
    scene = job["scene"]
    origin, directions = rays(job)
    want = trace(scene, origin, directions, scene.get("march", {}).get("max_distance", 1000))
    hits = np.isfinite(want)
    with np.errstate(invalid="ignore"):
        exact = (depth == want) | (np.abs(depth - want) < 1e-4 * want)
    expected = normals(scene, origin + directions[hits] * want[hits][:, None])
    cosine = np.sum(expected * normal[hits], axis=-1)
    answer = {
        "pixels": len(want),
        "hits": int(hits.sum()),
        "exact_depth": float(exact.mean()),
        "exact_normals": float((cosine > np.cos(np.radians(1))).mean()),
        "turned_over": int((cosine < 0).sum()),
    }
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
