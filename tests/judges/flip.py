"""Compares two programs by HDR-FLIP at equal time: how far their pictures seem from one of many samples of the second.

    PYTHONPATH=.whl:.whl/flip python3 tests/judges/flip.py OLD NEW SCENE ...

Pontus Andersson et al., "Visualizing errors in rendered high dynamic range images", Eurographics 2021, short papers.
"""

import os
import re
import resource
import subprocess
import sys
import tempfile

import flip_evaluator

SCALE = "20%"
SAMPLES = 16
REFERENCE_SAMPLES = 1024
SEEDS = 5


def render(program, scene, samples, seed, path):
    """Renders a scene as linear EXR; returns the CPU's seconds."""
    command = [program, "render", scene, "--device", "cpu", "--scale", SCALE, "--samples", str(samples), "-o", path]
    for value in ("image.format=exr", "image.tone_map=none", "image.layers=[]", f"image.seed={seed}"):
        command += ["--set", value]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stderr)
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def per_sample(program, scene, path):
    """CPU seconds of a sample: the difference of two renders."""
    pairs = [(render(program, scene, SAMPLES, 1, path), render(program, scene, 5 * SAMPLES, 1, path)) for _ in range(3)]
    return sorted((more - few) / (4 * SAMPLES) for few, more in pairs)[1]


def main():
    old, new, *scenes = sys.argv[1:]
    print("| Scene | Samples | HDR-FLIP | Samples | HDR-FLIP | Ratio |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        reference, picture = os.path.join(folder, "reference.exr"), os.path.join(folder, "picture.exr")
        for scene in scenes:
            render(new, scene, REFERENCE_SAMPLES, 99, reference)
            times = [per_sample(program, scene, picture) for program in (old, new)]
            samples = [SAMPLES, max(1, round(SAMPLES * times[0] / times[1]))]
            errors = []
            for program, count in zip((old, new), samples):
                of_seeds = []
                for seed in range(SEEDS):
                    render(program, scene, count, seed, picture)
                    of_seeds.append(flip_evaluator.evaluate(reference, picture, "HDR")[1])
                errors.append(sum(of_seeds) / SEEDS)
            name = re.sub(r".*/|\.json", "", scene)
            cells = [f"{count} | {error:.4f}" for count, error in zip(samples, errors)]
            print(f"| {name} | {' | '.join(cells)} | {errors[1] / errors[0]:.2f} |", flush=True)


main()
