#!/usr/bin/env python3
"""Compares pictures of adaptive samples with pictures of fixed numbers, and prints a Markdown table.

    PYTHONPATH=.whl python3 tests/judges/adaptive.py FOLDER SCENE …     # .whl has OpenEXR and numpy (.ci/run)

FOLDER has EXRs: SCENE-ref.exr with very many samples, SCENE-n16.exr with 16, and SCENE-a0.02.exr with adaptive ones and the
layer `samples`. Errors are in the values of a PNG, from 0 to 1.
"""

import pathlib
import sys

import numpy as np
import OpenEXR


def shown(linear):
    """Linear light as a PNG has it."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def read(path):
    """The values of a picture, and its mean number of samples if it has that layer."""
    channels = OpenEXR.File(str(path)).channels()
    color = channels["RGBA" if "RGBA" in channels else "RGB"].pixels[..., :3].astype(float)
    samples = float(channels["samples"].pixels.mean()) if "samples" in channels else None
    return shown(color), samples


def errors(picture, reference):
    """Root of the mean square of all pixels, and the one that 99 % of the blocks do not exceed."""
    squares = ((picture - reference) ** 2).mean(2)
    height, width = (edge // 8 * 8 for edge in squares.shape)
    blocks = squares[:height, :width].reshape(height // 8, 8, width // 8, 8).mean((1, 3))
    return np.sqrt(squares.mean()), np.sqrt(np.percentile(blocks, 99))


def main():
    folder, names = pathlib.Path(sys.argv[1]), sys.argv[2:]
    print("| Scene | `error` | Rays a pixel | 99 % of the blocks | A fixed number needs | Ratio | All pixels | Ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for name in names:
        reference, _ = read(folder / f"{name}-ref.exr")
        fixed = []
        for path in folder.glob(f"{name}-n*.exr"):
            fixed.append((float(path.stem.split("-n")[-1]), *errors(read(path)[0], reference)))
        fixed.sort()
        for path in sorted(folder.glob(f"{name}-a*.exr"), key=lambda path: -float(path.stem.split("-a")[-1])):
            picture, rays = read(path)
            row = errors(picture, reference)
            needed = [
                np.exp(np.interp(-np.log(row[k]), [-np.log(one[k + 1]) for one in fixed], [np.log(one[0]) for one in fixed]))
                for k in range(2)
            ]
            goal = path.stem.split("-a")[-1]
            print(
                f"| {name} | {goal} | {rays:.1f} | {row[1]:.4f} | {needed[1]:.0f} | {rays / needed[1]:.2f} "
                f"| {row[0]:.4f} | {rays / needed[0]:.2f} |"
            )


if __name__ == "__main__":
    main()
