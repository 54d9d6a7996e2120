#!/usr/bin/env python3
"""Fits the error of pictures against their samples, and prints a Markdown table.

    PYTHONPATH=.whl python3 tests/judges/slopes.py PROGRAM [--device cuda] JOB …     # .whl has OpenEXR and numpy (.ci/run)

Each job is rendered as some frames of linear light with 16, 64, 256 and 1,024 samples, twice with different seeds. Without a
bias, half of the squared difference of two such pictures is, in the mean, the squared error of one. It is relative: divided
by the square of the light plus 0.01, where the light is the mean of the two pictures with the most samples. The error is the
root of its mean over all pixels and frames; none is left out. The slope's standard error is that of the jackknife over frames:
rare bright samples make it large.
"""

import argparse
import pathlib
import subprocess
import tempfile

import numpy as np
import OpenEXR

FACTOR = 4


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="sdfarm")
    parser.add_argument("jobs", nargs="+", type=pathlib.Path, help="job files")
    parser.add_argument("--device", default="cpu", help="sdfarm's device")
    parser.add_argument("--frames", type=int, default=8, help="frames of each job, 8 by default")
    parser.add_argument("--size", default="320x240", help="WIDTHxHEIGHT, 320x240 by default")
    parser.add_argument("--most", type=int, default=1024, help="the most samples, 1,024 by default")
    chosen = parser.parse_args()
    chosen.width, chosen.height = map(int, chosen.size.split("x"))
    chosen.counts = [16]
    while chosen.counts[-1] * FACTOR <= chosen.most:
        chosen.counts.append(chosen.counts[-1] * FACTOR)
    return chosen


def render(chosen, job, count, seed):
    """The frames of a job, as an array: frames, rows, columns and colors."""
    image = f'{{"width":{chosen.width},"height":{chosen.height},"samples":{count},"seed":{seed},"format":"exr","precision":"float"}}'
    settings = ["--set", f"image={image}"]
    if '"frames":' not in job.read_text():
        settings += ["--set", f'frames={{"count":{chosen.frames}}}']
    with tempfile.TemporaryDirectory() as folder:
        command = [chosen.program, "render", job, *settings, "--frames", f"0-{chosen.frames - 1}", "--device", chosen.device]
        subprocess.run([*command, "-o", f"{folder}/"], check=True, capture_output=True, text=True)
        pictures = []
        for path in sorted(pathlib.Path(folder).glob("**/*.exr")):
            channels = OpenEXR.File(str(path)).channels()
            pictures.append(channels["RGBA" if "RGBA" in channels else "RGB"].pixels[..., :3].astype(float))
    return np.array(pictures)


def slope_of(counts, squares):
    """The slope of the error, from squared errors: counts and frames."""
    return np.polyfit(np.log(counts), 0.5 * np.log(squares.mean(1)), 1)[0]


def main():
    chosen = arguments()
    print(f"| Scene | {' | '.join(map(str, chosen.counts))} | Slope | Standard error |")
    print("|---" * (len(chosen.counts) + 3) + "|")
    for job in chosen.jobs:
        pairs = [[render(chosen, job, count, seed) for seed in (1, 2)] for count in chosen.counts]
        light = (pairs[-1][0] + pairs[-1][1]) / 2
        squares = np.array([((a - b) ** 2 / 2 / (light**2 + 0.01)).mean((1, 2, 3)) for a, b in pairs])
        if squares.max() < 1e-10:
            print(f"| {job.stem} | no noise |" + " |" * (len(chosen.counts) + 1), flush=True)
            continue
        frames = squares.shape[1]
        slopes = np.array([slope_of(chosen.counts, np.delete(squares, frame, 1)) for frame in range(frames)])
        error = np.sqrt((frames - 1) * slopes.var())
        errors = " | ".join(f"{value:.4f}" for value in np.sqrt(squares.mean(1)))
        print(f"| {job.stem} | {errors} | {slope_of(chosen.counts, squares):.2f} | {error:.2f} |", flush=True)


if __name__ == "__main__":
    main()
