"""Submits a job through a client that openapi-python-client made of the served document, and fetches its picture."""

import json
import struct
import sys

from farm_client import AuthenticatedClient
from farm_client.api.jobs import get_job, submit_job
from farm_client.api.pictures import get_image
from farm_client.models import Job, JobState, JobView, NodeSphere, Sphere

WIDTH, HEIGHT = 60, 40


def main(server: str, key: str, file: str) -> None:
    with open(file, encoding="utf-8") as text:
        job = Job.from_dict(json.load(text))
    job.image.width, job.image.height, job.image.samples = WIDTH, HEIGHT, 1
    # A node is a class with its name.
    assert NodeSphere(sphere=Sphere(radius=1.0)).to_dict() == {"sphere": {"radius": 1.0}}
    client = AuthenticatedClient(server, key, raise_on_unexpected_status=True)
    view = submit_job.sync(client=client, body=job)
    assert isinstance(view, JobView), view
    while view.state in (JobState.QUEUED, JobState.RUNNING):
        view = get_job.sync(view.id, client=client, prefer="wait=3")
        assert isinstance(view, JobView), view
    assert view.state == JobState.SUCCEEDED, view.errors
    picture = get_image.sync_detailed(view.id, client=client)
    data = picture.parsed.payload.read()
    assert data[:8] == b"\x89PNG\r\n\x1a\n", data[:8]
    size = struct.unpack(">II", data[16:24])
    assert size == (WIDTH, HEIGHT), size
    print(f"openapi-python-client: {view.name}, {picture.headers['content-type']}, {size[0]} by {size[1]} pixels")


main(*sys.argv[1:])
