"""An estimate that is done at once, its light made by the test."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import torch

from skylight.io.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap

if TYPE_CHECKING:
    from playwright.sync_api import Route

REGION = slice(12, 24), slice(86, 106)  # where the sun may stand, of 64 x 128
SIZE, FOCAL, AWAY = 512, 900.0, 1.2  # of the photo, and how far away the face is said to be


def answers(radiance: torch.Tensor, folder: Path) -> "Callable[[Route], None]":
    """The part of the server that estimates, its estimate done."""
    names = ("probe.exr", "posterior.exr")
    write_environment_map(folder / "probe.exr", EnvironmentMap(radiance=radiance))
    peak = torch.full((64, 128, 3), 1e-4)
    peak[REGION] = 1.0
    write_environment_map(folder / "posterior.exr", EnvironmentMap(radiance=peak))
    result = {
        "light": "autoencoder",
        "choice": None,
        "sun": {"azimuth_deg": 90.0, "zenith_deg": 50.0},
        "lamps": [],
        "posterior": {
            "verdict": "sun",
            "is_seen": True,
            "share": 0.9,
            "region_radius_deg": 8,
            "region_edge_per_sr": 0.9,
            "region_parts": [],
        },
        "advice": [],
        "faces": [{"number": 1, "residual": 0.1, "albedo": [0.5, 0.4, 0.3]}],
        "seconds": {"all": 1.0},
        "camera": {
            "focal_px": FOCAL,
            "width": SIZE,
            "height": SIZE,
            "principal": [SIZE / 2, SIZE / 2],
        },
        "faces_at": [{"position": [0.0, 0.1, -AWAY]}],
    }
    files = [{"name": name, "size": 1} for name in names]
    done = {"job": "it", "kind": "estimate", "state": "done", "stage": "", "share": 1.0}
    done |= {"result": result, "files": files}

    def answer(route: "Route") -> None:
        path = urlsplit(route.request.url).path
        if path == "/api/jobs":
            route.fulfill(status=202, json={"job": "it"})
        elif path.endswith("/events"):
            body = f"data: {json.dumps(done)}\n\n"
            route.fulfill(body=body, content_type="text/event-stream")
        elif path.rpartition("/")[2] in names:
            route.fulfill(body=(folder / path.rpartition("/")[2]).read_bytes())
        else:
            route.fulfill(status=204)

    return answer
