"""Reads a job file with models that datamodel-code-generator made of the served document, and submits what they write."""

import json
import struct
import sys
import time
import urllib.request

from models import Job, JobState, JobView, NodeSphere

WIDTH, HEIGHT = 50, 30


def main(server: str, key: str, file: str) -> None:
    def ask(path: str, body: bytes | None = None) -> bytes:
        headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/json"}
        with urllib.request.urlopen(urllib.request.Request(server + path, body, headers)) as answer:
            return answer.read()

    with open(file, encoding="utf-8") as text:
        job = Job.model_validate(json.load(text))
    job.image.width, job.image.height, job.image.samples = WIDTH, HEIGHT, 1
    # A node is a class with its name.
    NodeSphere.model_validate({"sphere": {"radius": 1}})
    body = job.model_dump_json(exclude_unset=True, by_alias=True).encode()
    view = JobView.model_validate_json(ask("/v1/jobs", body))
    while view.state in (JobState.queued, JobState.running):
        view = JobView.model_validate_json(ask(f"/v1/jobs/{view.id.root}"))
        time.sleep(0.05)
    assert view.state == JobState.succeeded, view.errors
    data = ask(f"/v1/jobs/{view.id.root}/image")
    assert data[:8] == b"\x89PNG\r\n\x1a\n", data[:8]
    size = struct.unpack(">II", data[16:24])
    assert size == (WIDTH, HEIGHT), size
    print(f"datamodel-code-generator: {view.name}, {size[0]} by {size[1]} pixels")


main(*sys.argv[1:])
