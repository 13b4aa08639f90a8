"""Strips and sheets of small pictures, as in the thesis' figures 5.5 to 5.7."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from skylight.imaging.colour import tone_map
from skylight.imaging.files import write_png
from skylight.sphere.envmap import EnvironmentMap, luminance
from skylight.transport.scene import evaluation_scene

WIDTH = 192  # of a column: the scene above, its probe below
SCENE, PROBE, LABEL = 144, 96, 16
Picture = UInt8[np.ndarray, "_ _ 3"]  # pictures of one call differ in size


def strip(truth: EnvironmentMap | None, estimates: dict[str, EnvironmentMap]) -> Picture:
    """One column for the truth (where known) and for each estimate.

    Each is exposed for the same mean shading of the scene: brightness is told by the tables.
    """
    columns = ({"truth": truth} if truth is not None else {}) | estimates
    return np.hstack([_column(name, e) for name, e in columns.items()])


def _column(label: str, environment: EnvironmentMap) -> Picture:
    scene = evaluation_scene()
    mean = float(luminance(scene.shade(environment)).mean())
    return np.vstack(
        [
            caption(label, WIDTH),
            sized(tone_map(scene.relight(environment), white=2 * mean), WIDTH, SCENE),
            sized(tone_map(environment.radiance, white=3 * mean), WIDTH, PROBE),
        ]
    )


def beside(picture: Picture, right: Picture, label: str) -> Picture:
    """``picture`` scaled to the height of ``right`` and put before it."""
    height = right.shape[0] - LABEL
    width = round(picture.shape[1] * height / picture.shape[0])
    return np.hstack([np.vstack([caption(label, width), sized(picture, width, height)]), right])


def caption(text: str, width: int) -> Picture:
    line = np.full((LABEL, width, 3), 255, np.uint8)
    place, black = (4, LABEL - 4), (0, 0, 0)
    cv2.putText(line, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, black, 1, cv2.LINE_AA)
    return line


def sized(picture: Picture, width: int, height: int) -> Picture:
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def write_sheet(path: Path, strips: list[Path]) -> None:
    """The strips that exist, one below the other."""
    read = [cv2.imread(str(p)) for p in strips]
    rows = [picture[..., ::-1] for picture in read if picture is not None]
    if not rows:
        return
    width = max(r.shape[1] for r in rows)
    padded = [
        np.pad(r, ((0, 4), (0, width - r.shape[1]), (0, 0)), constant_values=255) for r in rows
    ]
    write_png(path, np.ascontiguousarray(np.vstack(padded)))
