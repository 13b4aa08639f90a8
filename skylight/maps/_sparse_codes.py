"""Environment maps to sparse codes and back, with a figure of a code; files to files."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from skylight._figures import STYLE, save, show, white_of, write_numbers
from skylight._names import PLAIN_READING, BuiltinName, MapReading, Sign
from skylight.csc._code import SparseCode
from skylight.csc._coder import SphericalSparseCoder, coder_for
from skylight.csc._greedy import PursuitOptions
from skylight.csc._sub_dictionaries import BoxDictionary
from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb, tone_map
from skylight.io._files import read_environment_map, write_environment_map
from skylight.io._hdr import check_suffix
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, direction_from_angles, pixel_from_direction
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._rotation import matrix_from_euler
from skylight.work._device import Device, choose_device
from skylight.work._progress import StageProgress

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_ROWS = 128
DECODED_ROWS = (8, 2048)
ROUND = 1.15  # longest over shortest half-width below which a filter's twist is not shown
_RIPPLES = 0.1  # of the largest value
_AROUND = 96  # points of an outline
# Of a Gaussian f, whose square has half its variance: half-width where f is half its height.
_HALF_HEIGHT = 2 * math.sqrt(math.log(2))


@dataclass(frozen=True, kw_only=True)
class CodedMap:
    """A map as it was coded (averaged down), its code, and the coder that made it."""

    environment: EnvironmentMap
    code: SparseCode
    coder: SphericalSparseCoder

    @property
    def map_floats(self) -> int:
        return self.environment.radiance.numel()


@dataclass(frozen=True, kw_only=True)
class Outline:
    """Where a rotated filter has about half its height, or a box its border: world directions.

    ``axis`` is a stroke along its longest extent; None for a filter that is round.
    """

    around: Float[Tensor, "n 3"]
    axis: Float[Tensor, "k 3"] | None


def code_map(
    probe: Path,
    *,
    dictionary: str,
    activations: int = 64,
    weights: Sign = "l1",
    height: int | None = None,
    device: Device = "cpu",
    reading: MapReading = PLAIN_READING,
    progress: StageProgress | None = None,
) -> CodedMap:
    """The sparse code of a lat-long file, of ``height`` rows (its own, 128 at most).

    Raises
    ------
    InputError
        The file is no whole, bright lat-long map of ``height`` rows or more, or there is no such
        dictionary.
    """
    tell = progress or (lambda _stage, _share: None)
    environment = read_environment_map(probe, **vars(reading))
    rows = environment.layout[0]
    if environment.is_sky:
        raise InputError(
            f"{probe}: {environment.layout[1]}x{rows} is the upper half of a map: a code is of the "
            "whole sphere, so give a map of width 2 heights"
        )
    height = min(rows, MOST_ROWS) if height is None else height
    if height > rows:
        raise InputError(
            f"{probe} has {rows} rows, fewer than --height {height}: leave --height out"
        )
    environment = environment.resize(height)
    tell("preparing the filters", 0.0)
    coder = SphericalSparseCoder(
        dictionary,
        height=height,
        activations=activations,
        options=PursuitOptions(weights=weights),
    ).to(choose_device(device))
    code = coder.path(
        environment.radiance, [activations], lambda share: tell("choosing activations", share)
    )[0]
    return CodedMap(environment=environment, code=code, coder=coder.cpu())


def write_code(folder: Path, name: str, coded: CodedMap, *, title: str) -> None:
    """The code as ``name``, and beside it its picture, ending in .png."""
    coded.code.save(folder / name)
    write_picture((folder / name).with_suffix(".png"), coded, title=title)


def check_code_name(out: Path) -> None:
    """Raise :class:`InputError` unless a code may be called that."""
    if out.suffix.lower() != ".json":
        raise InputError(f"--out {out}: a code is JSON, so its name must end in .json")


def summarise_code(coded: CodedMap) -> str:
    """A few lines for the terminal."""
    return "\n".join(f"{name:<14} {value}" for name, value in _rows(coded))


def decode_file(
    path: Path, out: Path, *, height: int | None = None, dictionary: Path | None = None
) -> float:
    """Write the map of a code; returned is the share that was cut off below zero.

    That is ``int max(0, -L) / int |L|``, over all colours.

    Raises
    ------
    InputError
        The file is no code, or its dictionary is not built in and not given, or is another one.
    """
    check_suffix(out)
    low, high = DECODED_ROWS
    if height is not None and not low <= height <= high:
        raise InputError(f"--height must be from {low} to {high}, got {height}")
    code = SparseCode.load(path)
    if dictionary is None and code.dictionary not in get_args(BuiltinName):
        raise InputError(
            f"{path} was made with a dictionary {code.dictionary!r} that is not built in: give its "
            "file with --dictionary"
        )
    if not low <= code.height <= high:
        raise InputError(f"{path} is damaged: it tells of a map with {code.height} rows")
    radiance = coder_for(code, dictionary).decode(code, height).detach()
    if not bool(radiance.float().isfinite().all()):
        raise InputError(f"{path} is damaged: its map is not finite; code the map again")
    rows = radiance.shape[0]
    solid_angles = DirectionGrid.latlong(rows).solid_angles.reshape(rows, -1, 1)
    total = float((solid_angles * radiance.abs()).sum())
    taken = float((solid_angles * (-radiance).clamp(min=0)).sum())
    environment = EnvironmentMap(radiance=radiance.clamp(min=0).float())
    write_environment_map(out, environment)
    return taken / total if total > 0 else 0.0


def outlines(coder: SphericalSparseCoder, code: SparseCode) -> list[Outline | None]:
    """Of each activation; None where the filter is a pixel, or the same everywhere.

    The border of a box of pixels; else an ellipse of the second moments of the filter's square
    about the zenith, in angles from there; rotated as the activation is. A Gaussian's is where it
    has half its height.
    """
    found: list[Outline | None] = [None] * len(code)
    last = coder.count
    for part in reversed(coder.parts):
        mine = torch.nonzero((code.filters >= part.first) & (code.filters < last))[:, 0]
        last = part.first
        if not len(mine):
            continue
        if isinstance(part, BoxDictionary):
            for number, span in zip(
                mine.tolist(), part.spans(code.filters[mine], code.rotations[mine]), strict=True
            ):
                if int(span[1] * span[3]) > 1:
                    found[number] = Outline(around=_border(span, coder.height), axis=None)
            continue
        filters, degree = part.bank.coefficients.detach().cpu(), part.bank.degree
        transform = LatLongTransform(degree, 2 * degree + 2)
        for number in mine.tolist():
            filter_ = int(code.filters[number])
            if filter_ not in part.constant:
                values = transform.synthesise(filters[filter_ - part.first])
                turn = matrix_from_euler(*code.rotations[number])
                found[number] = _outline(values.flatten(), transform.grid, turn)
    return found


def _outline(
    values: Float[Tensor, " n"], grid: DirectionGrid, turn: Float[Tensor, "3 3"]
) -> Outline:
    # far ripples of a sharp filter are small, but their distance is large
    near = values.abs() > _RIPPLES * values.abs().max()
    share = values.square() * grid.solid_angles * near
    share = share / share.sum()
    x, y, z = grid.directions.unbind(1)
    theta, phi = torch.atan2(torch.hypot(x, z), y), torch.atan2(x, z)
    place = theta[:, None] * torch.stack([torch.cos(phi), torch.sin(phi)], 1)
    centre = share @ place
    variances, axes = torch.linalg.eigh(((place - centre) * share[:, None]).T @ (place - centre))
    radii = _HALF_HEIGHT * variances.clamp(min=0).sqrt()  # the longest last
    angle = torch.arange(_AROUND + 1, dtype=torch.float64) * (2 * math.pi / _AROUND)
    circle = torch.stack([torch.cos(angle), torch.sin(angle)], 1) * radii
    along = torch.linspace(-1, 1, _AROUND // 2 + 1, dtype=torch.float64)[:, None]
    is_round = bool(radii[1] < ROUND * radii[0])
    return Outline(
        around=_on_sphere(centre + circle @ axes.T, turn),
        axis=None if is_round else _on_sphere(centre + along * radii[1] * axes[:, 1], turn),
    )


def _border(span: Int[Tensor, "4"], height: int) -> Float[Tensor, "n 3"]:
    """The border of a box (first row, rows, first column, columns) of a map's pixels."""
    top, rows, left, columns = span.double()
    step = torch.linspace(0, 1, _AROUND // 4 + 1, dtype=torch.float64)[:-1]
    still = torch.zeros_like(step)
    down = torch.cat([still, step, still + 1, 1 - step, still[:1]])
    along = torch.cat([step, still + 1, 1 - step, still, still[:1]])
    azimuth = math.pi * ((left + along * columns) / height - 1)
    return direction_from_angles(azimuth, math.pi * (top + down * rows) / height)


def _on_sphere(place: Float[Tensor, "n 2"], turn: Float[Tensor, "3 3"]) -> Float[Tensor, "n 3"]:
    """World directions of places about the zenith, rotated; phi = 0 is +Z there, 90 degrees +X."""
    theta, phi = place.norm(dim=1), torch.atan2(place[:, 1], place[:, 0])
    canonical = direction_from_angles(math.pi - phi, theta)
    turned = canonical[:, [2, 0, 1]] @ turn.T
    return turned[:, [1, 2, 0]]


def write_picture(path: Path, coded: CodedMap, *, title: str) -> None:
    """The map, its code decoded, and the activations over the map, as a PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    decoded = coded.coder.decode(coded.code).detach().clamp(min=0).float()
    radiance = coded.environment.radiance
    white = white_of(radiance.reshape(-1, 3))
    with rc_context(STYLE):
        figure = Figure(figsize=(15, 8.4), dpi=120, facecolor="white")
        figure.text(0.02, 0.955, f"Sparse code of {title}", fontsize=17, fontweight="bold")
        rows = figure.add_gridspec(
            2, 2, left=0.02, right=0.98, top=0.9, bottom=0.02, wspace=0.04, hspace=0.1
        )
        show(figure.add_subplot(rows[0, 0]), tone_map(radiance, white=white), "Map")
        show(figure.add_subplot(rows[0, 1]), tone_map(decoded, white=white), "Code, decoded")
        axes = figure.add_subplot(rows[1, 0])
        show(
            axes,
            tone_map(radiance, white=white),
            "Activations in their colours (+ a pixel, dashed: below zero)",
        )
        _draw(axes, coded)
        below = rows[1, 1].subgridspec(1, 2, width_ratios=(1, 0.9))
        write_numbers(figure.add_subplot(below[0]), "In numbers", _rows(coded), pitch=0.07)
        save(figure, path)


def _draw(axes: "Axes", coded: CodedMap) -> None:
    """Each activation at its place: an outline, or a cross for a pixel; dashed where negative."""
    from matplotlib.patheffects import Normal, Stroke

    code, layout = coded.code, coded.environment.layout
    axes.set_autoscale_on(False)
    strengths = code.weights.sum(1)
    everywhere, found_outlines = _everywhere(coded), outlines(coded.coder, code)
    # the strongest last, so that it lies on top
    for number in strengths.abs().argsort().tolist():
        if int(code.filters[number]) in everywhere:
            continue
        colour = tuple(_shown_colour(code.weights[number]).tolist())
        line: dict[str, Any] = {
            "color": colour,
            "linewidth": 1.3,
            "linestyle": (0, (3, 1.5)) if strengths[number] < 0 else "-",
            "path_effects": [Stroke(linewidth=2.6, foreground="black", alpha=0.75), Normal()],
        }
        found = found_outlines[number]
        if found is None:
            columns, rows = _unrolled(code.directions[number : number + 1], layout)
            axes.plot(columns, rows, marker="+", markersize=7, markeredgewidth=1.3, **line)
            continue
        for curve in (found.around, found.axis):
            if curve is not None:
                axes.plot(*_unrolled(curve, layout), **line)


def _unrolled(
    curve: Float[Tensor, "n 3"], layout: tuple[int, int]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """(columns, rows) of a curve on a map, thrice, a turn apart, so that no seam cuts it."""
    row, column = (x.numpy() for x in pixel_from_direction(curve, *layout))
    width = layout[1]
    column = np.unwrap(column, period=width)
    gap = np.full(1, np.nan)
    columns = [x for turn in (-width, 0, width) for x in (column + turn, gap)]
    return np.concatenate(columns), np.concatenate([row, gap] * 3)


def _shown_colour(weight: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """The colour at full brightness, of a negative weight what it takes away, as sRGB."""
    weight = weight if float(weight.sum()) >= 0 else -weight
    return linear_to_srgb((weight / weight.abs().max().clamp(min=1e-300)).clamp(0, 1))


def _everywhere(coded: CodedMap) -> frozenset[int]:
    return frozenset().union(*(part.constant for part in coded.coder.parts))


def _rows(coded: CodedMap) -> list[tuple[str, str]]:
    code, height = coded.code, coded.code.height
    share = 100 * code.floats / coded.map_floats
    return [
        ("map", f"{height} x {2 * height}"),
        ("dictionary", code.dictionary),
        ("activations", f"{len(code)}"),
        ("relative error", f"{100 * code.relative_error:.1f} %"),
        ("floats", f"{code.floats} for {coded.map_floats} ({share:.2g} %)"),
    ]
