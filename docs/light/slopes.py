#!/usr/bin/env python3
"""Fits the error of pictures against their samples, and prints a Markdown table.

    PYTHONPATH=.whl python3 docs/light/slopes.py FOLDER     # .whl has OpenEXR and numpy (.ci/run)

FOLDER has EXRs of each scene with 16, 64, 256 and 2,048 samples, the last with another seed: scenes_chess-16.exr. The error is the
root of the mean square of the values of a PNG, against the last, whose own error is taken out as that of its number of
samples. The hundredth of the pixels that differ most is left out: a few of them, in which a sample meets the sun in a
mirror once in thousands, would decide the slope alone.
"""

import pathlib
import re
import sys

import numpy as np
import OpenEXR

COUNTS = (16, 64, 256)
REFERENCE = 2048


def read(path):
    channels = OpenEXR.File(str(path)).channels()
    linear = np.clip(channels["RGBA" if "RGBA" in channels else "RGB"].pixels[..., :3].astype(float), 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def lesser(squares):
    """Squared differences of the pixels without the hundredth that is greatest."""
    of_pixels = np.sort(squares.mean(2).ravel())
    return of_pixels[: len(of_pixels) * 99 // 100]


def main():
    folder = pathlib.Path(sys.argv[1])
    names = sorted({re.sub(r"-\d+$", "", path.stem) for path in folder.glob("*.exr")})
    steep = 0
    print("| Scene | 16 | 64 | 256 | Slope |")
    print("|---|---|---|---|---|")
    for name in names:
        files = [folder / f"{name}-{count}.exr" for count in (*COUNTS, REFERENCE)]
        if not all(file.exists() for file in files):
            continue
        *pictures, reference = map(read, files)
        squares = np.array([lesser((picture - reference) ** 2).mean() for picture in pictures])
        if squares.max() < 1e-12:
            print(f"| {name} | no noise | | | |")
            continue
        # The reference's own error is that of the slope from 256 samples on.
        slope = -0.5
        for _ in range(20):
            of_reference = (REFERENCE / COUNTS[-1]) ** (2 * slope)
            own = squares - squares[-1] * of_reference / (1 + of_reference)
            slope = np.polyfit(np.log(COUNTS), 0.5 * np.log(np.maximum(own, 1e-16)), 1)[0]
        steep += slope <= -0.5
        print(f"| {name} | " + " | ".join(f"{error:.5f}" for error in np.sqrt(own)) + f" | {slope:.2f} |")
    print(f"{steep} are −0.5 or steeper")


if __name__ == "__main__":
    main()
