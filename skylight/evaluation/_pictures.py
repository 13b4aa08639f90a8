"""Strips and contact sheets of captioned images."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure

from skylight.imaging._colour import tone_map
from skylight.io._atomic import atomic_path
from skylight.io._files import write_png
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.transport._scene import evaluation_scene

WIDTH = 192  # of a column: the scene above, its probe below
SCENE, PROBE, LABEL = 144, 96, 16
ROW, SIDE = 96, 152  # of a row: its height, the width of its label
TILE = 80
SHEET_WIDTH = 2048
NAMES = {
    "truth": "ground truth",
    "sh9": "SH, 9 coefficients",
    "sh25": "SH, 25 coefficients",
    "sunsky": "Sun + Sky",
    "lamps": "lamps",
    "auto": "sky or lamps",
    "autoencoder_feedforward": "autoencoder, fed",
    "autoencoder": "autoencoder, fitted",
}
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


def panorama_rows(truth: EnvironmentMap, estimates: dict[str, EnvironmentMap]) -> Picture:
    """One row for the truth and for each estimate: the sky, and the scene that it lights.

    All skies of a picture have one white, and so have all scenes: thesis, Fig. 5.5. The sky's
    is the 98 % quantile of the true one's luminance.
    """
    scene = evaluation_scene()
    upper = luminance(truth.upper().flat)
    white = float(upper.kthvalue(round(0.98 * len(upper))).values)
    lit = 2.5 * float(luminance(scene.shade(truth)).mean())
    rows = []
    for name, environment in ({"truth": truth} | estimates).items():
        sky = tone_map(environment.upper().radiance, white=white)
        relit = tone_map(scene.relight(environment), white=lit)
        side = np.full((ROW, SIDE, 3), 255, np.uint8)
        side[ROW // 2 - LABEL // 2 :][:LABEL] = caption(NAMES.get(name, name), SIDE)
        pictures = [side, sized(sky, 4 * ROW, ROW), sized(relit, 4 * ROW // 3, ROW, smooth=True)]
        rows.append(np.pad(np.hstack(pictures), ((0, 4), (0, 0), (0, 0)), constant_values=255))
    return np.vstack(rows)


def captioned_rows(maps: dict[str, Picture], columns: int = 3, height: int = 2 * TILE) -> Picture:
    """Panoramas of that height, each with its name above, from left to right and downwards."""
    width = 4 * TILE
    tiles = [
        np.vstack([caption(name, width), sized(one, width, height)]) for name, one in maps.items()
    ]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)])


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


def sized(picture: Picture, width: int, height: int, *, smooth: bool = False) -> Picture:
    """Scaled; enlarged pixels stay visible unless ``smooth``."""
    way = cv2.INTER_CUBIC if smooth else cv2.INTER_AREA
    return cv2.resize(picture, (width, height), interpolation=way)


def write_sheet(
    path: Path, strips: list[Path], titles: list[str] | None = None, *, width: int = SHEET_WIDTH
) -> None:
    """The strips that exist, from left to right and downwards, in as many columns as fit.

    ``titles``, one for each strip, are written above them.
    """
    titles = titles or [""] * len(strips)
    tiles = []
    for strip_path, title in zip(strips, titles, strict=True):
        read = cv2.imread(str(strip_path)) if strip_path.is_file() else None
        if read is not None:
            tile = read[..., ::-1]
            above = [caption(title, tile.shape[1])] if title else []
            tiles.append(np.vstack([*above, tile]))
    if not tiles:
        return
    high, wide = (max(t.shape[i] for t in tiles) + 4 for i in (0, 1))
    columns = min(len(tiles), max(1, width // wide))
    sheet = np.full((-(-len(tiles) // columns) * high, columns * wide, 3), 255, np.uint8)
    for i, tile in enumerate(tiles):
        top, left = i // columns * high, i % columns * wide
        sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    write_png(path, sheet)


def save_figure(path: Path, figure: Figure, *, dpi: int = 110) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi, format="png")
