#!/usr/bin/env python3
"""Renders `chess`, and then again with a piece moved, as a job that is based on the first; prints the times and kept tiles.

python3 tests/figures/recorded.py target/release/sdfarm [SAMPLES] [RUNS]

Each run has another seed, so that no picture is in the cache.
"""

import json
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

SCENE = pathlib.Path(__file__).resolve().parents[2] / "scenes/chess.json"
# The x of the king and the z of a rook.
PIECES = {"king": (0, 0), "rook": (2, 2)}


def ask(address, method, path, body=None):
    """Sends a request; returns the JSON of the response."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(address + path, data, {"content-type": "application/json"}, method=method)
    with urllib.request.urlopen(request, timeout=120) as response:
        return json.load(response)


def finished(address, query, document):
    """Submits a job; returns its last view and its seconds from the submission."""
    begun = time.monotonic()
    job = ask(address, "POST", f"/v1/jobs{query}", document)
    while job["state"] in ("queued", "running"):
        time.sleep(0.02)
        job = ask(address, "GET", f"/v1/jobs/{job['id']}")
    assert job["state"] == "succeeded", job
    return job, time.monotonic() - begun


def moved(document, piece):
    """The same scene with a piece one square further."""
    document = json.loads(json.dumps(document))
    child, axis = PIECES[piece]
    document["scene"]["objects"][2]["shape"]["union"]["of"][child]["translate"]["by"][axis] -= 1
    return document


def main():
    program, samples, runs = sys.argv[1], int((sys.argv[2:] or ["6"])[0]), int((sys.argv[3:] or ["3"])[0])
    document = json.loads(SCENE.read_text())
    document["image"].update(width=1920, height=1080, samples=samples)
    with tempfile.TemporaryDirectory() as data:
        serve = [program, "serve", "--listen", "127.0.0.1:0", "--data", data, "--workers", "1", "--device", "cpu"]
        server = subprocess.Popen(serve, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            address = next(word for word in server.stdout.readline().split() if "://" in word)
            print("| render, s | recorded, s | " + " | ".join(f"{piece} moved, s; tiles kept" for piece in PIECES) + " |")
            print("|---|---|---|---|")
            for seed in range(runs):
                document["image"]["seed"] = seed
                (_, plain), (first, recorded) = finished(address, "", document), finished(address, "?record=true", document)
                cells = [f"{plain:.2f}", f"{recorded:.2f}"]
                for piece in PIECES:
                    job, seconds = finished(address, f"?based_on={first['id']}", moved(document, piece))
                    cells.append(f"{seconds:.2f}; {job['tiles_kept']} of {job['tiles']['total']}")
                print("| " + " | ".join(cells) + " |", flush=True)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
