"""The drawings of the page of conventions, drawn by the package itself whenever the site is built.

python docs/drawings.py FOLDER
"""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import matplotlib

matplotlib.use("Agg")
import torch
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from skylight.sphere import _harmonics as harmonics
from skylight.sphere._cube_layouts import laid_out
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import Convention, DirectionGrid, convert_latlong, pixel_from_direction
from skylight.sphere._projections import FACES, Projection, from_latlong

# the axes' usual colours, and what lies opposite in the colour that is left
AXES = {
    "+X": ((1, 0, 0), (0.85, 0.25, 0.2)),
    "-X": ((-1, 0, 0), (0.2, 0.75, 0.8)),
    "+Y": ((0, 1, 0), (0.35, 0.7, 0.25)),
    "-Y": ((0, -1, 0), (0.75, 0.4, 0.75)),
    "+Z": ((0, 0, 1), (0.25, 0.4, 0.85)),
    "-Z": ((0, 0, -1), (0.95, 0.8, 0.3)),
}
ROWS = 96


def axis_map() -> EnvironmentMap:
    """Each direction in the colour of its closest axis, paler away from it."""
    directions = DirectionGrid.latlong(ROWS, 2 * ROWS).directions
    axes = torch.tensor([axis for axis, _ in AXES.values()]).double()
    colours = torch.tensor([colour for _, colour in AXES.values()]).double()
    near, which = (directions @ axes.T).max(1)
    pale = (1 - (near - 0.57) / 0.43)[:, None].clamp(0, 1) * 0.55
    colour = colours[which] * (1 - pale) + pale
    return EnvironmentMap(radiance=colour.reshape(ROWS, 2 * ROWS, 3).float())


def write(folder: Path) -> None:
    """All drawings, as .svg."""
    folder.mkdir(parents=True, exist_ok=True)
    plt.rcParams["svg.hashsalt"] = "skylight"  # the same file at every build
    for name, draw in {
        "frame": draw_frame,
        "latlong": draw_latlong,
        "conventions": draw_conventions,
        "projections": draw_projections,
        "cube_layouts": draw_cube_layouts,
        "harmonics": draw_harmonics,
    }.items():
        figure = draw()
        figure.savefig(folder / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})
        plt.close(figure)


def draw_frame() -> Figure:
    """The camera, its axes, and the two angles of a direction."""
    figure = plt.figure(figsize=(6.4, 5))
    axis = figure.add_subplot(projection="3d", computed_zorder=False)

    def put(points: Float[Tensor, "n 3"], **style: Any) -> None:
        x, y, z = points.double().T.numpy()
        axis.plot(x, -z, y, **style)  # matplotlib has z up

    def say(place: Sequence[float], text: str, **style: Any) -> None:
        x, y, z = place
        axis.text(x, -z, y, text, ha="center", va="center", **style)

    for name, (towards, colour) in AXES.items():
        long = {"+X": 1.25, "+Y": 1.1, "-Z": 1.25, "+Z": 0.8}.get(name, 0.0)
        if long:
            put(torch.tensor([[0, 0, 0], towards]) * long, color=colour, linewidth=2.5)
            say([(long + 0.15) * t for t in towards], name, color=colour, weight="bold")
    azimuth, zenith = math.radians(50), math.radians(48)
    arc = torch.linspace(0, 1, 40)
    around, down = azimuth * arc, zenith * arc
    flat = torch.stack([torch.sin(around), 0 * arc, -torch.cos(around)], 1)
    put(0.75 * flat, color="0.35")
    sweep = torch.stack(
        [
            torch.sin(down) * math.sin(azimuth),
            torch.cos(down),
            -torch.sin(down) * math.cos(azimuth),
        ],
        1,
    )
    put(0.75 * sweep, color="0.35")
    tip = sweep[-1]
    put(torch.stack([0 * tip, 1.15 * tip]), color="#e4572e", linewidth=2.5)
    foot = tip * torch.tensor([1, 0, 1])
    put(torch.stack([0 * tip, 1.15 * foot, 1.15 * tip]), color="0.6", linestyle=":")
    say((0.95 * flat[20]).tolist(), "azimuth")
    say((0.98 * sweep[18] + torch.tensor([0.1, 0.05, 0.0])).tolist(), "zenith")
    say((0.0, -0.22, 0.0), "camera")
    say((0.0, 0.2, -1.3), "it looks", color="0.35")
    axis.set_box_aspect((1, 1, 0.8), zoom=1.15)  # pyright: ignore
    axis.view_init(elev=22, azim=-118)
    axis.set_axis_off()
    return figure


def draw_latlong() -> Figure:
    """Which direction each part of a lat-long map shows."""
    figure, axis = plt.subplots(figsize=(8, 4.4))
    _latlong(axis, axis_map().radiance)
    for name, (towards, _) in AXES.items():
        row, column = pixel_from_direction(torch.tensor([towards]).double(), ROWS, 2 * ROWS)
        y = float(row.clamp(6, ROWS - 7))
        if name in ("+Y", "-Y"):
            axis.text(ROWS - 0.5, y, f"{name}, all of the row", ha="center", va="center")
            continue
        for x in {float(column) % (2 * ROWS), float(column) % (2 * ROWS) - 2 * ROWS}:
            if -3 < x < 2 * ROWS + 3:
                axis.text(
                    min(max(x, 6), 2 * ROWS - 7), y, name, ha="center", va="center", weight="bold"
                )
    axis.set_xticks(
        [t * 2 * ROWS - 0.5 for t in (0, 0.25, 0.5, 0.75, 1)],
        [
            "-180°\nbehind",
            "-90°\nleft",
            "azimuth 0\nwhere the camera looks",
            "90°\nright",
            "180°\nbehind",
        ],
    )
    axis.set_yticks([-0.5, ROWS / 2 - 0.5, ROWS - 0.5], ["zenith 0", "90°, horizon", "180°"])
    return figure


def draw_conventions() -> Figure:
    """The same light in each program's lat-long layout."""
    names = get_args(Convention)
    figure, axes = plt.subplots(2, 3, figsize=(10, 3.9), layout="constrained")
    for axis, name in zip(axes.flat, names, strict=True):
        _latlong(axis, convert_latlong(axis_map().radiance, "skylight", name))
        axis.set_title(name)
        axis.set(xticks=[], yticks=[])
        for label, (towards, _) in AXES.items():
            if label in ("+Y", "-Y"):
                continue
            shown = torch.zeros(ROWS, 2 * ROWS, 1)
            row, column = pixel_from_direction(torch.tensor([towards]).double(), ROWS, 2 * ROWS)
            shown[int(row), int(column) % (2 * ROWS)] = 1
            place = int(convert_latlong(shown, "skylight", name)[..., 0].sum(0).argmax())
            axis.text(min(max(place, 8), 2 * ROWS - 9), ROWS / 2, label, ha="center", va="center")
    return figure


def draw_projections() -> Figure:
    """The other pictures of the sphere."""
    names = [name for name in get_args(Projection) if name != "latlong"]
    figure, axes = plt.subplots(1, len(names), figsize=(10, 2.6), width_ratios=(4 / 3, 1, 1, 1))
    for axis, name in zip(axes, names, strict=True):
        picture = from_latlong(axis_map(), name, 96)
        axis.imshow(torch.where(picture.sum(2, keepdim=True) > 0, picture, 1.0).numpy())
        axis.set_title(name)
        axis.set_axis_off()
    return figure


def draw_cube_layouts() -> Figure:
    """The faces of a cube map: six files in a strip, and the cross that stands."""
    cross = from_latlong(axis_map(), "cube", 96)
    figure, axes = plt.subplots(1, 2, figsize=(10, 2.6), width_ratios=(6, 1.5))
    for axis, name in zip(axes, ("cube-row", "cube-vertical"), strict=True):
        picture = laid_out(cross, name)
        axis.imshow(torch.where(picture.sum(2, keepdim=True) > 0, picture, 1.0).numpy())
        axis.set_title(name)
        axis.set_axis_off()
    shown = ("-X", "+X", "+Y", "-Y", "+Z", "-Z")  # by the files of three.js
    for number, (file, towards) in enumerate(zip(FACES, shown, strict=True)):
        place = (number + 0.5) * 32 - 0.5
        axes[0].text(place, 15.5, f"{file}: {towards}", ha="center", va="center", fontsize=9)
    return figure


def draw_harmonics() -> Figure:
    """The first nine as lat-long maps: red above 0, blue below."""
    grid = DirectionGrid.latlong(48, 96)
    values = harmonics.evaluate(grid.directions, 2).reshape(48, 96, 9)
    figure, axes = plt.subplots(3, 5, figsize=(10, 3.4), layout="constrained")
    for axis in axes.flat:
        axis.set_axis_off()
    for index in range(9):
        degree = math.isqrt(index)
        order = index - degree * (degree + 1)
        axis = axes[degree, order + 2]
        axis.imshow(values[..., index], cmap="RdBu_r", vmin=-1.1, vmax=1.1)
        axis.set_title(f"{index}: l {degree}, m {order}", fontsize=9)
    return figure


def _latlong(axis: Axes, radiance: Float[Tensor, "h w 3"]) -> None:
    axis.imshow(radiance.numpy(), interpolation="nearest")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
