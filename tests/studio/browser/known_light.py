"""An estimate that is done at once, its light made by the test."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import numpy as np
import torch

from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap

if TYPE_CHECKING:
    from playwright.sync_api import Route

REGION = slice(12, 24), slice(86, 106)  # where the sun may stand, of 64 x 128
SIZE, FOCAL = 512, 900.0  # of the photo
EYES = (0.0, 0.1, -1.2)  # where the head is said to be, metres
FAR_EYES = (0.0, 0.1, -6.2)  # and where the ground under the feet is in the picture
HEAD = (0.075, 0.115, 0.095)  # semi-axes of the ellipsoid that it is
SKIN = (0.5, 0.4, 0.3)
GAINS = (1.1, 1.0, 1 / 1.1)  # of the photo's white balance


def head(eyes: tuple[float, float, float]) -> str:
    """An ellipsoid of 24 x 48 quadrilaterals, as mesh.obj has heads."""
    rows, columns = 24, 48
    zenith, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij"
    )
    unit = [np.sin(zenith) * np.sin(azimuth), np.cos(zenith), np.sin(zenith) * np.cos(azimuth)]
    points = np.stack(unit, -1).reshape(-1, 3) * HEAD + eyes
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    for row in range(rows):
        for column in range(columns):
            first = row * (columns + 1) + column + 1
            lines.append(f"f {first} {first + columns + 1} {first + columns + 2} {first + 1}")
    return "\n".join(lines) + "\n"


def answers(
    radiance: torch.Tensor, folder: Path, eyes: tuple[float, float, float] = EYES
) -> "Callable[[Route], None]":
    """The part of the server that estimates, its estimate done; of ``folder`` every file is the
    job's."""
    names = ("probe.exr", "posterior.exr", "mesh.obj")
    (folder / "mesh.obj").write_text(head(eyes))
    write_environment_map(folder / "probe.exr", EnvironmentMap(radiance=radiance))
    peak = torch.full((64, 128, 3), 1e-4)
    peak[REGION] = 1.0
    write_environment_map(folder / "posterior.exr", EnvironmentMap(radiance=peak))
    result = {
        "light": "autoencoder",
        "choice": None,
        "sun": {"azimuth_deg": 90.0, "zenith_deg": 50.0},
        "lamps": [],
        "verdict": {
            "light": "hard light from the left",
            "direction": {"word": "sure", "reason": "within 8°"},
            "brightness": {"word": "rough", "reason": "within a factor of 1.5"},
            "colour": {"word": "rough", "reason": "within a factor of 1.2"},
            "doubt": "",
        },
        "posterior": {
            "is_seen": True,
            "share": 0.9,
            "region_radius_deg": 8,
            "region_edge_per_sr": 0.9,
            "region_parts": [],
        },
        "advice": [],
        "faces": [
            {
                "number": 1,
                "residual": 0.1,
                "albedo": SKIN,
                "eyes": eyes,
                "forward": [0.0, 0.0, 1.0],
            }
        ],
        "white_balance": GAINS,
        "edit": {"saturation": 1.0, "contrast": 1.0, "pivot": 1.0},
        "seconds": {"all": 1.0},
        "camera": {
            "focal_px": FOCAL,
            "width": SIZE,
            "height": SIZE,
            "principal": [SIZE / 2, SIZE / 2],
        },
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
        elif path == "/api/jobs/it" and route.request.method == "GET":
            route.fulfill(json=done)
        elif (folder / path.rpartition("/")[2]).is_file():
            route.fulfill(body=(folder / path.rpartition("/")[2]).read_bytes())
        else:
            route.fulfill(status=204)

    return answer


def taken_photo(path: Path, eyes: tuple[float, float, float]) -> "Callable[[Route], None]":
    """The part of the server that takes photos: one is there, with the face at its place."""
    scale = FOCAL / -eyes[2]
    left, top = SIZE / 2 + scale * (eyes[0] - HEAD[0]), SIZE / 2 - scale * (eyes[1] + HEAD[1])
    box = [left, top, 2 * scale * HEAD[0], 2 * scale * HEAD[1]]
    photo = {"photo": "it", "name": path.name, "width": SIZE, "height": SIZE}
    photo["faces"] = [{"number": 1, "box": box}]

    def answer(route: "Route") -> None:
        if route.request.method == "POST":
            route.fulfill(status=201, json=photo)
        else:
            route.fulfill(body=path.read_bytes(), content_type="image/png")

    return answer
