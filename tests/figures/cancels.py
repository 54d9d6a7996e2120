"""Measures how soon a cancelled job frees a worker: cancels endless jobs of a farm, and renders a tiny one right after.

Usage: sdfarm serve --workers 1 --device cuda & python3 tests/figures/cancels.py http://127.0.0.1:8080
Prints the milliseconds from each cancel to the tiny job's picture.
"""

import json
import random
import sys
import time
import urllib.request

GLASS = {"surface": {"transmission": 1, "ior": 1.5}}


def call(method, path, body=None):
    request = urllib.request.Request(
        sys.argv[1] + path,
        method=method,
        data=None if body is None else json.dumps(body).encode(),
        headers={"content-type": "application/json", "cache-control": "no-cache"},
    )
    return json.load(urllib.request.urlopen(request))


def fractals(width, height, seed):
    """Rough fractals of glass, with up to 32 bounces."""
    bulb = {"mandelbulb": {"iterations": 64, "power": 8}}
    rough = {"surface": {**GLASS["surface"], "roughness": 0.3}}
    return {
        "scene": {
            "camera": {"position": [0, 0, 5], "look_at": [0, 0, 0]},
            "march": {"max_bounces": 32, "max_distance": 100_000, "max_steps": 65_536},
            "objects": [{"material": rough, "shape": {"repeat": {"cell": [2.4, 2.4, 2.4], "child": bulb}}}],
        },
        "image": {"width": width, "height": height, "samples": 65_536, "seed": seed},
    }


def balls(width, height, seed):
    """2,000 glass balls."""
    ball = {"sphere": {"radius": 0.6}}
    places = [[index % 10, index // 10 % 10, index // 100] for index in range(2000)]
    union = {"smooth": 0.1, "of": [{"translate": {"by": place, "child": ball}} for place in places]}
    return {
        "scene": {
            "camera": {"position": [3, 3, -9], "look_at": [4, 4, 4]},
            "objects": [{"shape": {"union": union}, "material": GLASS}],
        },
        "image": {"width": width, "height": height, "samples": 65_536, "seed": seed},
    }


def render_tiny(seed):
    scene = {"camera": {"position": [0, 0, 5], "look_at": [0, 0, 0]}, "objects": [{"shape": {"sphere": {"radius": 1}}}]}
    job = call("POST", "/v1/jobs", {"scene": scene, "image": {"width": 32, "height": 32, "seed": seed}})["id"]
    while (state := call("GET", f"/v1/jobs/{job}")["state"]) in ("queued", "running"):
        time.sleep(0.002)
    assert state == "succeeded", state


def ms_of(action):
    start = time.monotonic()
    action()
    return round((time.monotonic() - start) * 1e3)


def ms_after_cancel(job, seed):
    identity = call("POST", "/v1/jobs", job)["id"]
    while call("GET", f"/v1/jobs/{identity}")["state"] == "queued":
        time.sleep(0.01)
    time.sleep(1 + random.random())

    def cancel_and_render():
        call("POST", f"/v1/jobs/{identity}/cancel")
        render_tiny(seed)

    return ms_of(cancel_and_render)


def main():
    base = random.randrange(1 << 24)
    render_tiny(base)
    print("nothing to cancel:", *(ms_of(lambda: render_tiny(base + turn)) for turn in range(1, 9)))
    for scene in (fractals, balls):
        for size in ((1, 1), (16, 16), (1920, 1080)):
            times = [ms_after_cancel(scene(*size, base + turn), base + 100 + turn) for turn in range(8)]
            print(f"{scene.__name__}, {size[0]}x{size[1]}:", *times, flush=True)
            base += 200


main()
