#!/usr/bin/env python3
"""Compares sdfarm's pictures with pictures by Mitsuba 3, an independent renderer, and prints a Markdown table.

    pip install --target .whl/mitsuba mitsuba==3.9.1 numpy      # .whl is ignored by git
    apt-get install libllvm19                                   # 17 or newer; older ones fail on AVX-512
    PYTHONPATH=.whl/mitsuba python3 tests/judges/judge.py target/release/sdfarm [--quick] [SCENE …]

Every scene of scenes.py is rendered by both programs with the same samples per pixel, several times with other seeds. Each
row has:

* difference: of the mean of the two sets of pictures, in percent;
* z: that difference over its standard error, the largest of the three channels, and its limit;
* blocks: the same for 8 × 8 pixels, the largest of all blocks and channels; pixels: the fraction with |z| above 3 and its
  limit; rms z: about 1 without bias. Errors are estimated from the spread over seeds, and limits follow Student's
  distribution with seeds − 1 degrees of freedom, at the probability of three standard deviations, divided by the number of
  tests (Bonferroni);
* relMSE: mean of (x − r)² / (r² + 0.01) of one picture, where r is the other program's mean, less that mean's own error;
* seconds: of one picture, with start and file of sdfarm, and without Mitsuba's compilation.

sdfarm's rays end within 1/4000 of their length before a surface, and go on or cast shadows from four times as far, so that
silhouettes, shadows and refracted shapes are displaced by small fractions of a pixel. Pixels at silhouettes and creases are
left out, and so is a difference that a shift by 0.05 pixels makes (0.2 through glass; 0.05 % of the mean). `--edges --shift 0`
tests everything strictly. `--fine 8` lets sdfarm render 8 × 8 pixels for each, with fewer samples: rays end closer to
surfaces, and what remains of a bias is not theirs.

`known` rows compare sdfarm with a value from a formula. The exit code is 0 if every scene was rendered and none shows a
bias. A scene that PROGRAM rejects is named, and counts as a failure.
"""

import argparse
import glob
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np

import estimates
import scenes

SHIFT = 0.05
SAMPLERS = ("multijitter", "independent", "stratified", "orthogonal", "ldsampler")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="sdfarm")
    parser.add_argument("scenes", nargs="*", help="names of scenes; all by default")
    parser.add_argument("--quick", action="store_true", help="small pictures with few samples, less than 2 minutes")
    parser.add_argument("--seeds", type=int, help="pictures of each program, odd, 41 by default")
    parser.add_argument("--samples", type=int, help="samples of each picture, a power of 4, 256 by default")
    parser.add_argument("--size", help="WIDTHxHEIGHT, 64x48 by default")
    parser.add_argument("--sampler", choices=SAMPLERS, default=SAMPLERS[0], help="Mitsuba's sampler")
    parser.add_argument("--shift", type=float, default=SHIFT, help="pixels by which sdfarm's surfaces may be displaced")
    parser.add_argument(
        "--fine", type=int, default=1, help="columns and rows of sdfarm's pixels in each pixel of a test, 1 by default"
    )
    parser.add_argument("--edges", action="store_true", help="test pixels at silhouettes and creases, too")
    parser.add_argument("--set", action="append", default=[], help="PATH=VALUE for all jobs of sdfarm; may be repeated")
    parser.add_argument("--device", default="cpu", help="sdfarm's device")
    parser.add_argument("--keep", help="folder for jobs, pictures, and maps of z")
    parser.add_argument("--self-test", action="store_true", help="compare materials.py with Mitsuba's own BSDFs instead")
    chosen = parser.parse_args()
    seeds, samples, size = (11, 64, "48x32") if chosen.quick else (41, 256, "64x48")
    chosen.seeds = chosen.seeds or seeds
    chosen.samples = chosen.samples or samples
    chosen.width, chosen.height = map(int, (chosen.size or size).split("x"))
    if chosen.samples % chosen.fine**2 or chosen.samples < 2 * chosen.fine**2:
        parser.error("--samples must be a multiple of the square of --fine, at least twice it")
    if chosen.seeds < 3 or chosen.seeds % 2 == 0:
        parser.error("--seeds must be odd and at least 3")
    return chosen


def load_mitsuba():
    """Mitsuba with its LLVM variant, and sdfarm's materials in it."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = glob.glob("/usr/lib/*/libLLVM.so.*") + glob.glob("/usr/lib/llvm-*/lib/libLLVM.so.*")
        if found:
            os.environ["DRJIT_LIBLLVM_PATH"] = max(found, key=lambda path: path.split(".so.")[1])
    try:
        import mitsuba as mi
    except ModuleNotFoundError:
        sys.exit("Mitsuba is not installed: see the first lines of tests/judges/judge.py")
    mi.set_variant("llvm_ad_rgb")
    import materials  # noqa: F401

    return mi


def read_picture(mi, path, fine):
    """The colors of an EXR; each is the mean of `fine` columns and rows."""
    colors = np.array(mi.Bitmap(str(path)), dtype=np.float64)[:, :, :3]
    rows, columns, _ = colors.shape
    return colors.reshape(rows // fine, fine, columns // fine, fine, 3).mean((1, 3))


def rejection(chosen, job):
    """The first error of a job, or None."""
    checked = subprocess.run([chosen.program, "check", job], check=False, capture_output=True, text=True)
    lines = (checked.stderr + checked.stdout).strip().splitlines()
    return None if checked.returncode == 0 else (lines or ["no message"])[0]


def render_ours(chosen, mi, scene, folder):
    """Pictures by sdfarm, one for each seed, and the seconds of one."""
    width, height, samples = chosen.width * chosen.fine, chosen.height * chosen.fine, chosen.samples // chosen.fine**2
    pictures, seconds = [], []
    for seed in range(1, chosen.seeds + 1):
        job = folder / f"{scene.name}.json"
        job.write_text(json.dumps(scene.job(width, height, samples, seed), indent=1))
        if seed == 1 and (message := rejection(chosen, job)):
            raise ValueError(message)
        picture = folder / f"{scene.name}-{seed}.exr"
        command = [chosen.program, "render", job, "-o", picture, "--device", chosen.device, "--json"]
        command += [word for value in chosen.set for word in ("--set", value)]
        begun = time.monotonic()
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        seconds.append(time.monotonic() - begun)
        if done.returncode != 0:
            raise ValueError(done.stderr.strip())
        pictures.append(read_picture(mi, picture, chosen.fine))
        if not chosen.keep:
            picture.unlink()
    return np.array(pictures), float(np.median(seconds))


def render_peer(chosen, mi, description, first=1):
    """Pictures by Mitsuba, one for each seed from the first, and the seconds of one."""
    loaded = mi.load_dict(description)
    pictures, seconds = [], []
    for seed in range(first, first + chosen.seeds):
        begun = time.monotonic()
        pictures.append(np.array(mi.render(loaded, spp=chosen.samples, seed=seed), dtype=np.float64))
        seconds.append(time.monotonic() - begun)
    return np.array(pictures), float(np.median(seconds))


def row(name, found, errors=None, seconds=None):
    """A row of the table."""
    cells = [
        name,
        "no bias" if found["ok"] else "**BIAS**",
        f"{100 * found['difference']:+.3f} %",
        f"{found['mean_z']:.1f} of {found['mean_limit']:.1f}",
        f"{found['block_z']:.1f} of {found['block_limit']:.1f}",
        f"{100 * found['pixels']:.2f} of {100 * found['pixel_limit']:.2f} %",
        f"{found['rms_z']:.2f}",
    ]
    cells += [f"{errors[0]:.2e}", f"{errors[1]:.2e}", f"{errors[0] / errors[1]:.2f}"] if errors else ["", "", ""]
    cells += [f"{seconds[0]:.2f}", f"{seconds[1]:.2f}"] if seconds else ["", ""]
    print("| " + " | ".join(cells) + " |", flush=True)
    return found["ok"]


def keep_pictures(mi, folder, name, ours, peers, found):
    """Both means, and the z of each pixel: red where sdfarm is brighter, blue where it is darker, full at 6."""
    z = found["map"] / 6
    signs = np.stack([np.clip(z, 0, 1), np.zeros_like(z), np.clip(-z, 0, 1)], -1)
    for word, picture in (("sdfarm", ours.mean(0)), ("mitsuba", peers.mean(0)), ("z", signs)):
        mi.util.write_bitmap(str(folder / f"{name}-{word}.png"), picture.astype(np.float32), write_async=False)


def judge(chosen, mi, scene, folder, ratios):
    """Compares one scene, and adds the ratio of relMSE to `ratios`; returns whether it was rendered and shows no bias."""
    try:
        ours, our_seconds = render_ours(chosen, mi, scene, folder)
    except ValueError as error:
        print(f"| {scene.name} | **SKIPPED**: {error} | | | | | | | | | | |", flush=True)
        return False
    peers, peer_seconds = render_peer(chosen, mi, scene.peer(mi, chosen.width, chosen.height, chosen.sampler))
    shift = chosen.shift * scene.magnified
    edges = scene.edges(mi, chosen.width, chosen.height)
    counted = np.full_like(edges, True) if chosen.edges else ~edges
    found = estimates.bias(ours, peers, counted, shift)
    errors = (estimates.relative_error(ours, peers), estimates.relative_error(peers, ours))
    passed = row(scene.name, found, errors, (our_seconds, peer_seconds))
    ratios.append(errors[0] / errors[1])
    if scene.known is not None:
        known = np.full_like(ours[:1], scene.known)
        passed &= row(f"{scene.name}, known", estimates.bias(ours, known, counted, shift))
    if chosen.keep:
        keep_pictures(mi, folder, scene.name, ours, peers, found)
    return passed


def self_test(chosen, mi):
    """Compares materials.py with Mitsuba's BSDFs: without Fresnel, with separable shadowing, and with exact Fresnel."""
    pairs = [
        ("metal", {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": 0.16}, {"separable": True}),
        ("glass", {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, {"exact": True}),
    ]
    passed = True
    for name, stock, switch in pairs:
        scene = next(build() for build in scenes.SCENES if build().name == name)
        ours = scene.peer(mi, chosen.width, chosen.height, chosen.sampler)
        peers = dict(ours)
        for key, entry in ours.items():
            if key.startswith("shape") and str(entry["bsdf"]["type"]).startswith("sdfarm_"):
                peers[key] = {**entry, "bsdf": stock}
                kept = {"base_color": mi.ScalarVector3f(1, 1, 1), "roughness": 0.4} if name == "metal" else {}
                ours[key] = {**entry, "bsdf": {**entry["bsdf"], **kept, **switch}}
        a, seconds = render_peer(chosen, mi, ours)
        b, others = render_peer(chosen, mi, peers, first=1001)
        counted = np.ones(a.shape[1:3], bool)
        errors = (estimates.relative_error(a, b), estimates.relative_error(b, a))
        passed &= row(f"{name}, materials.py", estimates.bias(a, b, counted, chosen.shift), errors, (seconds, others))
    return passed


def main():
    chosen = arguments()
    mi = load_mitsuba()
    built = [build() for build in scenes.SCENES]
    unknown = set(chosen.scenes) - {scene.name for scene in built}
    if unknown:
        sys.exit(f"no scene {', '.join(sorted(unknown))}: the scenes are {', '.join(scene.name for scene in built)}")
    print(
        f"{chosen.seeds} pictures of {chosen.width}×{chosen.height} by each program, {chosen.samples} samples per pixel each: "
        f"{chosen.seeds * chosen.samples} samples per pixel. Mitsuba {mi.__version__}, {mi.variant()}, {chosen.sampler}.\n"
    )
    print("| Scene | | difference | z | blocks | pixels | rms z | relMSE sdfarm | Mitsuba | ratio | s sdfarm | Mitsuba |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    if chosen.self_test:
        sys.exit(0 if self_test(chosen, mi) else 1)
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(chosen.keep or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        ratios = []
        results = [judge(chosen, mi, s, folder, ratios) for s in built if not chosen.scenes or s.name in chosen.scenes]
    print(f"\n{sum(results)} of {len(results)} scenes without bias; relMSE at most Mitsuba's in {sum(r <= 1 for r in ratios)}.")
    sys.exit(0 if all(results) else 1)


if __name__ == "__main__":
    main()
