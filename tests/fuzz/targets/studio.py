"""The studio's HTTP interface, in process: a line "METHOD PATH HEADER=VALUE ...", then a body.

``{photo}``, ``{map}`` and ``{job}`` stand for tokens of the server's. Jobs that are taken are
cancelled at once; the readers of uploads are the studio's own, in their process.
"""

import atexit
import io
import json
from functools import cache
from urllib.parse import quote

import numpy as np
import torch
from PIL import Image
from starlette.testclient import TestClient

from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.studio._guard import Limits
from skylight.studio._server import make_application
from skylight.studio._state import Studio
from tests.fuzz.files import PLACE, written

_METHODS = ("GET", "POST", "DELETE", "HEAD", "PUT", "OPTIONS", "PATCH")


def seeds() -> list[bytes]:
    jobs: list[dict[str, object]] = [
        {"kind": "estimate", "photo": "{photo}", "face": 1, "light": "sh9"},
        {"kind": "estimate", "photo": "{photo}", "face": "all", "light": "auto"},
        {"kind": "portrait", "job": "{job}"},
        {"kind": "code", "map": "{map}", "dictionary": "iso", "activations": 2},
        {"kind": "voxel", "probe": 3, "face_mm": 20, "wall_mm": 1.6, "map": "{map}"},
        {"kind": "partitions", "design": "6d", "size_mm": 80},
    ]
    return [
        b"POST /api/photos?name=me.jpg\n" + _photo(),
        b"POST /api/maps?name=light.exr\n" + _map(),
        *(
            b"POST /api/jobs Content-Type=application/json\n" + json.dumps(job).encode()
            for job in jobs
        ),
        b"GET /api/jobs/{job}\n",
        b"GET /api/jobs/{job}/events\n",
        b"GET /api/jobs/{job}/files/probe.exr?download=1\n",
        b"GET /api/jobs/{job}/files.zip\n",
        b"GET /api/jobs/{job}/lamps/face.png?azimuth_deg=9&zenith_deg=4&on=1&ambient=0\n",
        b"GET /api/photos/{photo}/preview.jpg Range=bytes=0-5\n",
        b"GET /api/examples\n",
        b"GET /api/examples/astronaut.png\n",
        b"GET /api/about Origin=http://127.0.0.1\n",
        b"GET /assets/../index.html\n",
        b"DELETE /api/jobs/none Host=example.org\n",
    ]


def read(content: bytes) -> None:
    client, tokens = _client()
    line, _, body = content.partition(b"\n")
    words = line.decode("latin-1").split(" ")
    method = words[0] if words[0] in _METHODS else "GET"
    path = words[1] if len(words) > 1 else "/"
    headers = {}
    for word in words[2:]:
        name, _, value = word.partition("=")
        if name.isascii() and name.replace("-", "").isalnum():
            headers[name] = value.encode("latin-1")
    for name, token in tokens.items():
        path = path.replace("{" + name + "}", token)
        body = body.replace(b"{" + name.encode() + b"}", token.encode())
    url = "/" + quote(path.lstrip("/"), safe="/?=&%.-_~+")
    answer = client.request(method, url, content=body, headers=headers)
    assert answer.status_code != 500, answer.text
    if answer.status_code == 202:
        client.delete(f"/api/jobs/{answer.json()['job']}")
    if answer.status_code >= 400 and method not in ("HEAD", "OPTIONS"):
        told = answer.json()["error"]
        assert told
        assert "\n" not in told
        raise InputError(told)


@cache
def _client() -> tuple[TestClient, dict[str, str]]:
    """A server of its own with something in it."""
    folder = PLACE / "studio"
    folder.mkdir(exist_ok=True)
    studio = Studio(folder, Limits(upload_mb=1, megapixels=1, jobs=4))
    client = TestClient(
        make_application(studio, host="127.0.0.1"),
        base_url="http://127.0.0.1",
        raise_server_exceptions=False,
    )
    client.__enter__()
    atexit.register(studio.end_processes)
    photo = client.post("/api/photos?name=me.png", content=_photo()).json()["photo"]
    map_ = client.post("/api/maps?name=light.exr", content=_map()).json()["map"]
    job = client.post("/api/jobs", json={"kind": "partitions", "design": "6d", "size_mm": 80})
    tokens = {"photo": photo, "map": map_, "job": job.json()["job"]}
    client.delete(f"/api/jobs/{tokens['job']}")
    return client, tokens


def _photo() -> bytes:
    codes = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    out = io.BytesIO()
    Image.fromarray(codes).save(out, format="PNG")
    return out.getvalue()


def _map() -> bytes:
    light = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    return written("light.exr", lambda path: write_environment_map(path, light))
