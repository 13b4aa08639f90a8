"""Draws the figures of the thesis that show no measurement: slots, probes, cells and filters.

    python -m tools.draw_figures --out docs/images/figures

``transfer.png``: transfer of all slots under nine harmonics and what reconstructions leave of it
(Figs. 3.3, 3.5 and 3.9); ``star_probes.png`` (3.8); ``partitions.png`` (4.3 and 4.4);
``filters.png``: one filter at several rotations, and filters of the dictionaries (6.1 and 6.3).
"""

import math
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import torch
import tyro
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from skylight._figures import show
from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._wigner import rotated_filters
from skylight.io._atomic import atomic_path
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._picture import draw_cells
from skylight.probes.voxel._analysis import LIT, transfer_error
from skylight.probes.voxel._interreflection import ALBEDO, GlobalReconstruction, transfer_vectors
from skylight.probes.voxel._lightmap import SLOTS_ACROSS, SLOTS_DOWN
from skylight.probes.voxel._model import CONFIGURATIONS, ORIENTATIONS, exposed_faces, star_probe
from skylight.probes.voxel._reconstruct import DirectReconstruction
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid

STARS = (1, 3, 5, 7)
DESIGNS = ("6d", "14d", "38d", "110d", "14d-sun-12", "14d-outdoor")
ROWS = 48  # of a drawn filter
FILTERS = (9, 25, 50, 75, 99)  # of a hundred, wide to sharp


@dataclass(frozen=True, kw_only=True)
class Options:
    """Draw slots, probes, cells and filters."""

    out: Path = Path("docs/images/figures")
    """Folder of the pictures."""


def main(options: Options) -> None:
    options.out.mkdir(parents=True, exist_ok=True)
    for name, draw in {
        "transfer": draw_transfer,
        "star_probes": draw_stars,
        "partitions": draw_partitions,
        "filters": draw_filters,
    }.items():
        figure = draw()
        with atomic_path(options.out / f"{name}.png") as temporary:
            figure.savefig(temporary, dpi=80, format="png")
        plt.close(figure)
        print(options.out / f"{name}.png")


def draw_transfer() -> Figure:
    """Captured slots, transfer under nine harmonics (red above 0), errors (red: too little)."""
    true = transfer_vectors(ALBEDO)
    figure, axes = plt.subplots(4, 4, figsize=(15, 11.5), layout="constrained")
    known = {size: exposed_faces(star_probe(size)).counts() > 0 for size in (3, 5)}
    for index, degree in enumerate(harmonics.bands(2).tolist()):
        order = index - degree * (degree + 1)
        _signed(axes.flat[index], true[..., index], f"Y({degree}, {order})", 0.4)
    for axis, (size, mask) in zip(axes.flat[9:11], known.items(), strict=True):
        texels = mask[..., None, None].double().expand(-1, -1, *true.shape[2:4])
        title = f"slots of the {size}-probe: {int(mask.sum())} of {mask.numel()}"
        axis.imshow(_sheet(texels), cmap="gray", vmin=0, vmax=1)
        _bare(axis, title)
    axes.flat[11].axis("off")
    for row, (size, mask) in enumerate(known.items()):
        kinds = {
            "direct": DirectReconstruction(mask),
            "global": GlobalReconstruction(mask, albedo=ALBEDO),
        }
        for column, (kind, reconstruction) in enumerate(kinds.items()):
            flat = true.flatten(2)
            left = (flat - reconstruction.weights.double() @ flat).view_as(true)
            left[:, LIT:] = 0
            title = f"{size}-probe, {kind}: {transfer_error(reconstruction)}"
            _signed(axes[3, 2 * row + column], left[..., 0], title, 0.2)
    return figure


def draw_stars() -> Figure:
    figure = plt.figure(figsize=(12, 3.2), layout="constrained")
    for place, size in enumerate(STARS):
        axis = figure.add_subplot(1, len(STARS), place + 1, projection="3d")
        solid = star_probe(size).occupied
        axis.voxels(solid.transpose(0, 2, 1), facecolors="0.85", edgecolors="0.4", linewidth=0.5)
        counts = exposed_faces(star_probe(size)).counts()
        axis.set_title(f"{size}-probe: {int((counts > 0).sum())} slots", fontsize=9)
        axis.set_box_aspect((1, 1, 1))
        axis.axis("off")
    return figure


def draw_partitions() -> Figure:
    figure, axes = plt.subplots(2, 3, figsize=(13, 5), layout="constrained")
    for axis, name in zip(axes.flat, DESIGNS, strict=True):
        cells = Cells.of(named_design(name))
        show(axis, draw_cells(cells, size=240), f"{name}: {cells.count} cells, from two sides")
    return figure


def draw_filters() -> Figure:
    """Lat-long maps; a filter's own pole is where maps have their zenith."""
    banks = {name: builtin(name) for name in ("iso", "ani", "vmf")}
    figure, axes = plt.subplots(4, len(FILTERS), figsize=(14, 6.4), layout="constrained")
    drawn_out = _most_drawn_out(banks["ani"])
    angles = [(0.0, 0.0, 0.0), (0.0, 1.2, 0.0), (1.5, 1.2, 0.0), (1.5, 1.2, 0.8), (-1.5, 2.0, 1.6)]
    turned = rotated_filters(drawn_out.expand(len(angles), -1), torch.tensor(angles).double())
    for axis, one, (a, b, c) in zip(axes[0], turned, angles, strict=True):
        _map(axis, one, f"rotated by α {a:g}, β {b:g}, γ {c:g}")
    ahead = torch.tensor([[math.pi, math.pi / 2, 0.0]]).double()
    for row, (name, bank) in enumerate(banks.items(), start=1):
        chosen = FILTERS if len(bank) > max(FILTERS) else (0, 1)
        for axis, index in zip(axes[row], chosen, strict=False):
            one = bank.coefficients[index].detach().double()[None]
            _map(axis, rotated_filters(one, ahead)[0], f"{name} {index}")
        for axis in axes[row, len(chosen) :]:
            axis.axis("off")
    return figure


def _most_drawn_out(bank: FilterBank) -> Float[Tensor, "1 k"]:
    """The filter with the most of its power in orders other than 0."""
    coefficients = bank.coefficients.detach().double()
    bands = harmonics.bands(bank.degree)
    order = torch.arange(coefficients.shape[1]) - bands * (bands + 1)
    share = coefficients[:, order != 0].square().sum(1) / coefficients.square().sum(1)
    return coefficients[int(share.argmax())][None]


def _map(axis: Axes, coefficients: Float[Tensor, " k"], title: str) -> None:
    degree = harmonics.degree_of(len(coefficients))
    directions = DirectionGrid.latlong(ROWS, 2 * ROWS).directions
    values = harmonics.evaluate_about_zenith(directions, degree) @ coefficients
    values = values.view(ROWS, 2 * ROWS)
    most = float(values.abs().max())
    axis.imshow(values, cmap="RdBu_r", vmin=-most, vmax=most)
    _bare(axis, title)


def _signed(axis: Axes, texels: Float[Tensor, "6 32 n n"], title: str, most: float) -> None:
    axis.imshow(_sheet(texels), cmap="RdBu_r", vmin=-most, vmax=most)
    _bare(axis, title)


def _bare(axis: Axes, title: str) -> None:
    axis.set_title(title, fontsize=9)
    axis.set_xticks([])
    axis.set_yticks([])


def _sheet(texels: Float[Tensor, "6 32 n n"]) -> Float[Tensor, "h w"]:
    """Two rows of slots for each orientation."""
    assert texels.shape[:2] == (len(ORIENTATIONS), CONFIGURATIONS)
    n = texels.shape[2]
    slots = texels.reshape(SLOTS_DOWN, SLOTS_ACROSS, n, n)
    return slots.transpose(1, 2).reshape(SLOTS_DOWN * n, SLOTS_ACROSS * n)


if __name__ == "__main__":
    main(tyro.cli(Options))
