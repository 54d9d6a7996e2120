"""Compares pictures with and without reweighted fireflies with the unbiased picture of 4,096 samples.

    PYTHONPATH=.whl python3 tests/judges/fireflies.py target/release/sdfarm scenes/lantern.json scenes/vitrine.json

Prints, for each scene and number of samples, the relative mean square error without and with, and how much light is lost.
"""

import pathlib
import subprocess
import sys
import tempfile

import numpy
import OpenEXR

ALL = {"image.width": 160, "image.height": 120, "image.denoise": "false", "image.format": '"exr"',
       "image.precision": '"float"', "image.exposure": 0, "image.tone_map": '"none"',
       "scene.integrator": '{ "path": { "max_bounces": 6 } }'}


def render(program, scene, **image):
    """Colors of a picture whose settings of the image are these."""
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "picture.exr"
        changes = ALL | {f"image.{key}": value for key, value in image.items()}
        arguments = [part for key, value in changes.items() for part in ("--set", f"{key}={value}")]
        subprocess.run([program, "render", scene, "-o", file, *arguments], check=True, capture_output=True)
        with OpenEXR.File(str(file), separate_channels=True) as opened:
            channels = opened.channels()
            return numpy.stack([channels[name].pixels for name in "RGB"], -1).astype(float)


def main(program, *scenes):
    """Prints the rows of the scenes."""
    for scene in scenes:
        truth = render(program, scene, samples=4096, seed=77)
        for samples in (16, 64, 256):
            row = []
            for is_reweighted in ("false", "true"):
                light = render(program, scene, samples=samples, reweight_fireflies=is_reweighted)
                error = numpy.mean((light - truth) ** 2 / (truth ** 2 + 0.01))
                row.append(f"{error:.4f}")
            lost = 100 * (1 - light.mean() / truth.mean())
            print(pathlib.Path(scene).stem, samples, *row, f"{lost:.1f} %", sep=" | ", flush=True)


main(*sys.argv[1:])
