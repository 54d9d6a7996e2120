#!/usr/bin/env python3
"""Compares the price of each shipped scene with what its render takes, in CPU seconds, as a Markdown table.

python3 tests/figures/prices.py target/release/sdfarm [SCENE.json …]

All pictures of a job are rendered. Scenes that take less than a second are left out: no price is needed for them.
"""

import json
import pathlib
import resource
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
MIN_SECONDS = 1.0


def used_seconds():
    """CPU time of all processes that were started, in seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rendered_seconds(program, scene, frames):
    """CPU time of a render of all pictures of a job."""
    with tempfile.TemporaryDirectory() as folder:
        command = [program, "render", scene, "--device", "cpu", "--json", "-o", f"{folder}/"]
        before = used_seconds()
        subprocess.run([*command, "--frames", f"0-{frames - 1}"], check=True, capture_output=True)
        return used_seconds() - before


def main():
    program, *scenes = sys.argv[1:]
    shipped = sorted(ROOT.glob("scenes/*.json")) + sorted(ROOT.glob("docs/scenes/*.json"))
    print("| Scene | price, s of one core | render, s of one core | ratio |")
    print("|---|---|---|---|")
    for scene in map(pathlib.Path, scenes or shipped):
        checked = subprocess.run([program, "check", scene, "--json"], check=True, capture_output=True)
        frames = json.loads(checked.stdout)["frames"]
        priced = subprocess.run([program, "price", scene, "--json"], check=True, capture_output=True)
        price = json.loads(priced.stdout)
        seconds = rendered_seconds(program, str(scene), frames)
        if seconds < MIN_SECONDS:
            continue
        error = round(100 * price["relative_error"])
        predicted = price["core_seconds"]
        print(f"| {scene.stem} | {predicted:.3g} ± {error} % | {seconds:.3g} | {predicted / seconds:.2f} |", flush=True)


if __name__ == "__main__":
    main()
