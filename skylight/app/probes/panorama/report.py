"""The figure of a stitched probe: the map at two exposures, where the shots lie, and numbers."""

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from skylight.app.figures.panels import show, show_probe, write_numbers
from skylight.app.figures.style import ACCENT, STYLE, save
from skylight.app.probes.panorama.summary import Stitched, warnings
from skylight.imaging.colour import tone_map
from skylight.sphere.envmap import luminance
from skylight.sphere.frame import pixel_from_direction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DARKER = 16.0  # the second exposure of the map, against the first
_SIDE = 24  # points along each side of a shot's outline


def write_stitch_report(path: Path, result: Stitched) -> None:
    """The map at two exposures, the shots' outlines on it, and numbers, as PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    probe = result.panorama.probe
    values = luminance(probe.environment.flat)
    white = float(values.kthvalue(round(0.85 * len(values))).values)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 9.6), dpi=120, facecolor="white")
        figure.text(0.02, 0.965, "Light stitched from shots", fontsize=17, fontweight="bold")
        doubts = warnings(result)
        if doubts:
            care = f"Take care: {doubts[0]}"
            figure.text(0.02, 0.94, care[:190], color=ACCENT, fontsize=9.5)
        grid = figure.add_gridspec(2, 2, left=0.02, right=0.98, top=0.9, bottom=0.045, wspace=0.06)
        show_probe(figure.add_subplot(grid[0, 0]), probe.environment, "The map", white=white)
        dark = f"{_DARKER:g} times darker"
        show_probe(figure.add_subplot(grid[1, 0]), probe.environment, dark, white=_DARKER * white)
        axes = figure.add_subplot(grid[0, 1])
        seen = probe.seen.numpy()[..., None] > 0
        picture = np.where(seen, tone_map(probe.environment.radiance, white=white), 128)
        show(axes, picture.astype(np.uint8), "Where the shots lie; grey: in none")
        _outlines(axes, result)
        write_numbers(figure.add_subplot(grid[1, 1]), "In numbers", _numbers(result), pitch=0.085)
        save(figure, path)


def _outlines(axes: "Axes", result: Stitched) -> None:
    """The border of each shot, broken where it leaves the map at a side."""
    bundle, layout = result.panorama.bundle, result.panorama.probe.environment.layout
    width, height = bundle.lens.size
    along = np.linspace(0, 1, _SIDE)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], dtype=np.float64)
    border = np.concatenate([a + along[:, None] * (b - a) for a, b in pairwise(corners)])
    rays = bundle.lens.rays(border * (width, height))
    for number, rotation in bundle.rotations.items():
        row, column = (
            each.numpy()
            for each in pixel_from_direction(torch.from_numpy(rays @ rotation.T), *layout)
        )
        jumps = np.flatnonzero(np.abs(np.diff(column)) > layout[1] / 2) + 1
        colour = ACCENT if number in result.panorama.by_hint else "white"
        for part in np.split(np.stack([column, row], 1), jumps):
            axes.plot(*part.T, color=colour, linewidth=0.7, alpha=0.7)


def _numbers(result: Stitched) -> list[tuple[str, str]]:
    panorama, bracket = result.panorama, result.brackets[0]
    bundle = panorama.bundle
    rows = [("directions placed", f"{len(bundle.rotations)} of {len(result.shots)}")]
    if bracket.seconds is not None:
        low, high = min(bracket.seconds), max(bracket.seconds)
        rows.append(("exposures of each", f"{len(bracket.files)}, {low:.3g} to {high:.3g} s"))
    rows.append(("response", "linear" if result.response is None else result.response.kind))
    rows.append(("matches", f"{bundle.matches}"))
    rows.append(("they are off by (rms)", f"{result.rms_px:.2f} px"))
    rows.append(("focal length", f"{result.focal_px:.1f} px"))
    rows.append(("radial distortion k1", f"{bundle.lens.k1:.4f}"))
    rows.append(("in no shot", f"{100 * panorama.probe.unseen_share:.2g} % of the sphere"))
    clipped = 0.0 if panorama.clipping is None else panorama.clipping.solid_angle_sr
    rows.append(("saturated in all exposures", f"{clipped:.2g} sr"))
    return rows
