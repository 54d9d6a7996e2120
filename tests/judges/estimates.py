"""Statistics of the judge: tests for bias between two sets of pictures with independent seeds, and their errors.

Each set is an array [seed, row, column, channel]. This module knows neither of the programs.
"""

import math

import numpy as np

BLOCK = 8
# Probability that a normal variable is beyond three standard deviations.
THREE_SIGMA = math.erfc(3 / math.sqrt(2))
# Relative change of a picture's mean by a shift of one pixel: parts of shapes and shadows that grow outweigh others.
MEAN_SHIFT = 0.01
# Keeps dark pixels from dominating a relative error.
DARK = 1e-2


def tail(t, freedom):
    """P(|T| > t) for Student's t and an even number of degrees of freedom, Abramowitz and Stegun 26.7.4."""
    angle = math.atan(t / math.sqrt(freedom))
    term = total = 1.0
    for k in range(1, freedom // 2):
        term *= (2 * k - 1) / (2 * k) * math.cos(angle) ** 2
        total += term
    return 1 - math.sin(angle) * total


def limit(tests, freedom):
    """The |t| that one of `tests` exceeds by chance as rarely as one normal variable exceeds 3 (Bonferroni)."""
    low, high = 0.0, 1e3
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if tail(middle, freedom) > THREE_SIGMA / tests else (low, middle)
    return high


def error_of_mean(pictures):
    """Standard error of the mean over seeds (axis 0); 0 for a single picture, which is a known value."""
    if len(pictures) == 1:
        return np.zeros_like(pictures[0])
    return pictures.std(0, ddof=1) / math.sqrt(len(pictures))


def z_scores(a, b, allowed):
    """Difference of the means of two sets, beyond what is allowed, over its standard error."""
    middle = b.mean(0)
    difference = a.mean(0) - middle
    # Rounding to 32 bits, so that pixels without noise have a scale.
    error = np.hypot(np.hypot(error_of_mean(a), error_of_mean(b)), 1e-6 * np.abs(middle) + 1e-9)
    beyond = np.maximum(np.abs(difference) - allowed, 0)
    return np.sign(difference) * beyond / error


def change_by_shift(pictures, shift):
    """How much a pixel may change when the picture is shifted by a fraction of a pixel.

    It is the largest difference from a pixel above, below or beside, less three standard errors of that difference.
    """
    middle, error = pictures.mean(0), error_of_mean(pictures)
    change = np.zeros_like(middle)
    for axis in (0, 1):
        step = np.abs(np.diff(middle, axis=axis))
        before = np.delete(error, -1, axis)
        after = np.delete(error, 0, axis)
        step = np.maximum(step - 3 * np.hypot(before, after), 0)
        first, last = [(0, 0)] * 3, [(0, 0)] * 3
        first[axis], last[axis] = (1, 0), (0, 1)
        change = np.maximum(change, np.maximum(np.pad(step, first), np.pad(step, last)))
    return shift * change


def blocks(pictures, counted):
    """Means of the counted pixels in squares of 8 × 8, of each picture, where at least a quarter is counted.

    A rest at the right and lower edge is left out. Squares are along axis 1.
    """
    seeds, rows, columns, channels = pictures.shape
    rows, columns = rows // BLOCK, columns // BLOCK
    share = counted[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK).mean((1, 3))
    cut = np.where(counted[:, :, None], pictures, 0)[:, : rows * BLOCK, : columns * BLOCK]
    means = cut.reshape(seeds, rows, BLOCK, columns, BLOCK, channels).mean((2, 4))
    enough = share >= 0.25
    return means[:, enough] / share[enough][:, None]


def bias(a, b, counted, shift=0.0):
    """Tests two sets for equal means: of the picture, of blocks by channel, and of pixels' gray values.

    `counted` is by row and column whether the tests take a pixel. A difference that a shift by `shift` pixels makes
    is not counted.
    """
    freedom = min(len(s) for s in (a, b) if len(s) > 1) - 1
    allowed = change_by_shift(b, shift)[None]
    mean = b[:, counted].mean(1)
    of_mean = z_scores(a[:, counted].mean(1), mean, MEAN_SHIFT * shift * mean.mean(0))
    of_blocks = z_scores(blocks(a, counted), blocks(b, counted), blocks(allowed, counted)[0])
    everywhere = z_scores(a.mean(3), b.mean(3), allowed[0].mean(2))
    of_pixels = everywhere[counted]
    expected = tail(3, freedom)
    found = {
        "difference": a[:, counted].mean() / b[:, counted].mean() - 1,
        "mean_z": np.abs(of_mean).max(),
        "mean_limit": limit(of_mean.size, freedom),
        "block_z": np.abs(of_blocks).max(),
        "block_limit": limit(of_blocks.size, freedom),
        "pixels": (np.abs(of_pixels) > 3).mean(),
        "pixel_limit": expected + 3 * math.sqrt(expected / of_pixels.size),
        "rms_z": math.sqrt((of_pixels**2).mean()),
        "map": everywhere,
    }
    found["ok"] = bool(
        found["mean_z"] <= found["mean_limit"]
        and found["block_z"] <= found["block_limit"]
        and found["pixels"] <= found["pixel_limit"]
    )
    return found


def relative_error(pictures, others):
    """relMSE of one picture: mean of (x − reference)² / (reference² + 0.01) over seeds, pixels and channels.

    The reference of a set is the mean of the other set, which is independent of it; the square of the reference's own
    error is estimated from the spread over seeds and subtracted. The divisor is the mean of both sets.
    """
    reference = others.mean(0)
    squares = ((pictures - reference) ** 2).mean(0)
    if len(others) > 1:
        squares = squares - others.var(0, ddof=1) / len(others)
    middle = (pictures.mean(0) + reference) / 2
    return float((squares / (middle**2 + DARK)).mean())
