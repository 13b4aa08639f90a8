"""A fitted head for the page."""

import base64
from pathlib import Path
from typing import Any

import numpy as np

from skylight.errors import InputError
from skylight.transport.mesh import read_mesh

_VERTICES_MAX = 2**16
_STEPS = 2**15 - 1


def stored_head(path: Path, eyes: list[float]) -> dict[str, Any]:
    """A mesh as the page decodes it: v = eyes + ``scale`` * code, and the codes of 16 bits.

    ``eyes`` is in the mesh's units; ``scale`` is the farthest coordinate from there over 32767, so
    that each coordinate is off by half of it at most: for a head by 5 micrometres.

    Raises
    ------
    InputError
        The mesh is missing or damaged, or has more vertices than 16 bits can number.
    """
    vertices, faces = (part.numpy() for part in read_mesh(path))
    if len(vertices) > _VERTICES_MAX:
        raise InputError(
            f"{path}: {len(vertices)} vertices are more than the {_VERTICES_MAX} of a head: "
            "estimate the photograph again"
        )
    apart = vertices - np.array(eyes)
    scale = float(np.abs(apart).max()) / _STEPS or 1.0
    return {
        "scale": scale,
        "vertices": _array_base64((apart / scale).round().astype("<i2")),
        "faces": _array_base64(faces.astype("<u2")),
    }


def _array_base64(codes: np.ndarray) -> str:
    return base64.b64encode(codes.tobytes()).decode("ascii")
