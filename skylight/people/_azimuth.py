"""Azimuths of the light probes in a folder of captures: candidates, and the choice of a person.

In two steps, as in the thesis (5.4.2): errors of the relit face for all azimuths, then one of
their local minima chosen by eye, from a figure that shows each, since a face lit from the left by a
low sun may look much like one lit by bright clouds further back.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor

from skylight._figures import ACCENT, INK, MUTED, STYLE, save, show, white_of
from skylight.errors import InputError, OutputError
from skylight.faces._captures import (
    CAPTURES_NAME,
    FaceCapture,
    capture_hash,
    read_captures,
    read_probe,
    write_azimuths,
)
from skylight.faces._fit import fit_visible
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import choose_face
from skylight.faces._model import HeadModel
from skylight.faces._observe import FaceView, observe_face
from skylight.imaging._colour import tone_map
from skylight.imaging._photo import Photo, read_photo
from skylight.inverse._azimuth import AzimuthCurve, azimuth_curve, relit_face
from skylight.io._bounded import json_content, write_json
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import pixel_from_direction
from skylight.work._progress import CountProgress

if TYPE_CHECKING:
    from matplotlib.axes import Axes


FEWEST_COLUMNS = 3  # a lone minimum is drawn no larger than one of two
PROBE_QUANTILE = 0.9  # shown as white: clouds and ground tell more than the sun, which is white


def write_choice(
    path: Path,
    title: str,
    photo: Photo,
    view: FaceView,
    probe: EnvironmentMap,
    curve: AzimuthCurve,
) -> None:
    """The curve with its numbered minima; for each the relit face and the turned probe."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    columns = max(FEWEST_COLUMNS, 1 + len(curve.minima))
    white = white_of(view.observation.pixels)
    with rc_context(STYLE):
        figure = Figure(figsize=(4 * columns, 12), dpi=80, facecolor="white")
        figure.text(0.02, 0.965, f"Azimuth of the probe of {title}", fontsize=17, weight="bold")
        rows = figure.add_gridspec(
            2, 1, height_ratios=(1, 1.75), left=0.02, right=0.98, top=0.92, bottom=0.03, hspace=0.2
        )
        above = rows[0].subgridspec(1, 2, width_ratios=(1, columns - 1), wspace=0.1)
        show(figure.add_subplot(above[0]), photo.encoded, "Photograph")
        _curve(figure.add_subplot(above[1]), curve)
        below = rows[1].subgridspec(2, columns, height_ratios=(2, 1), wspace=0.06, hspace=0.12)
        show(figure.add_subplot(below[0, 0]), tone_map(view.image, white=white), "Face as seen")
        for number, index in enumerate(curve.minima, start=1):
            turn = float(curve.azimuth_deg[index])
            relit = _pasted(view, relit_face(view.observation, probe, turn))
            title = f"{number}:  {turn:+.1f}°, si-RMSE {float(curve.error[index]):.3f}"
            show(figure.add_subplot(below[0, number]), tone_map(relit, white=white), title)
            _probe(figure.add_subplot(below[1, number]), probe, turn)
        save(figure, path)


def _curve(axes: "Axes", curve: AzimuthCurve) -> None:
    axes.plot(curve.azimuth_deg, curve.error, color=INK, linewidth=1.6)
    for number, index in enumerate(curve.minima, start=1):
        at = float(curve.azimuth_deg[index]), float(curve.error[index])
        axes.plot(*at, marker="o", markersize=9, color=ACCENT)
        axes.annotate(
            str(number),
            at,
            xytext=(0, -20),
            textcoords="offset points",
            ha="center",
            color=ACCENT,
            fontsize=14,
            weight="bold",
        )
    axes.set_title("si-RMSE of the relit face over the turn of the probe, degrees to the right")
    axes.set_xlim(-180, 180)
    axes.set_xticks(range(-180, 181, 45))
    axes.margins(y=0.2)
    axes.grid(color=MUTED, alpha=0.25)


def _probe(axes: "Axes", probe: EnvironmentMap, turn_deg: float) -> None:
    """The turned probe, its brightest spot ringed; the camera looks at the line."""
    turned = probe.rotate_azimuth(math.radians(turn_deg))
    show(axes, tone_map(turned.radiance, quantile=PROBE_QUANTILE), "")
    axes.axvline(turned.layout[1] / 2 - 0.5, color="white", linewidth=0.9, alpha=0.7)
    row, column = pixel_from_direction(turned.brightest_direction(), *turned.layout)
    axes.plot(
        float(column),
        float(row),
        marker="o",
        markersize=11,
        markerfacecolor="none",
        markeredgecolor=ACCENT,
        markeredgewidth=2,
    )


def _pasted(view: FaceView, pixels: Float[Tensor, "m 3"]) -> Float[Tensor, "h w 3"]:
    """The relit pixels over the picture in grey and half as bright."""
    canvas = (0.5 * luminance(view.image))[..., None].repeat(1, 1, 3)
    rows, columns = view.places.unbind(1)
    canvas[rows, columns] = pixels[view.blocks]
    return canvas


FOLDER = "azimuth"  # within the folder of captures
FACE_HEIGHT_PX = 64  # as many pixels as tell shading; half of an estimate's rays


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A photograph's local minima, best first; ``hash`` names the files they are of."""

    hash: str
    azimuths_deg: tuple[float, ...]
    errors: tuple[float, ...]


def propose(
    data: Path, progress: CountProgress | None = None
) -> tuple[dict[str, Proposal], dict[str, str]]:
    """Minima for all captures without an azimuth, and why others have none, by photograph.

    For each, ``data/azimuth/PHOTO.png`` shows what there is to choose from, and ``PHOTO.json``
    keeps it: what was done is not done again unless photograph or probe changed.
    """
    captures = [c for c in read_captures(data) if c.azimuth_deg is None]
    tell = progress or (lambda done, total: None)
    proposals: dict[str, Proposal] = {}
    problems: dict[str, str] = {}
    for done, capture in enumerate(captures):
        tell(done, len(captures))
        try:
            proposals[capture.photo] = _remembered(data, capture) or _proposal(data, capture)
        except InputError as error:
            problems[capture.photo] = str(error)
    return proposals, problems


def choose(data: Path, numbers: Mapping[str, int]) -> dict[str, float]:
    """Write the chosen minima, counted from 1, into ``captures.csv``; all of them or none."""
    captures = {capture.photo: capture for capture in read_captures(data)}
    azimuths = {}
    for photo, number in numbers.items():
        if photo not in captures:
            raise InputError(f"{data / CAPTURES_NAME}: no photograph {photo} there")
        proposal = _remembered(data, captures[photo])
        if proposal is None:
            raise InputError(
                f"{photo}: nothing to choose from yet, or it changed since; run `skylight faces "
                f"calibrate-azimuth {data}` with its azimuth_deg empty and look at its picture"
            )
        if not 1 <= number <= len(proposal.azimuths_deg):
            raise InputError(
                f"{photo}: there is no minimum {number}; choose 1 to {len(proposal.azimuths_deg)}"
            )
        azimuths[photo] = proposal.azimuths_deg[number - 1]
    write_azimuths(data, azimuths)
    return azimuths


def parse_choices(texts: Iterable[str]) -> dict[str, int]:
    """{photograph: number} of "PHOTO=N"."""
    numbers: dict[str, int] = {}
    for text in texts:
        photo, _, number = text.rpartition("=")
        if not photo or not number.isdecimal():
            raise InputError(f"--choose takes PHOTO=N, such as anna.jpg=2; got {text!r}")
        if photo in numbers:
            raise InputError(f"--choose names {photo} twice; leave one of them")
        numbers[photo] = int(number)
    return numbers


def picture_path(data: Path, photo: str) -> Path:
    return data / FOLDER / f"{photo}.png"


def _record_path(data: Path, photo: str) -> Path:
    return data / FOLDER / f"{photo}.json"


def _remembered(data: Path, capture: FaceCapture) -> Proposal | None:
    """The proposal of an earlier run; None without one, or where the files are others now."""
    path = _record_path(data, capture.photo)
    if not path.is_file() or not picture_path(data, capture.photo).is_file():
        return None
    try:
        content = json_content(path)
        proposal = Proposal(
            hash=content["hash"],
            azimuths_deg=tuple(map(float, content["azimuths_deg"])),
            errors=tuple(map(float, content["errors"])),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); delete it and run again") from error
    return proposal if proposal.hash == capture_hash(data, capture) else None


def _proposal(data: Path, capture: FaceCapture) -> Proposal:
    """Measure, draw, remember."""
    named = capture_hash(data, capture)
    probe = read_probe(data, capture)
    photo = read_photo(data / capture.photo, require_colour=True)
    view = _view(photo, str(data / capture.photo))
    curve = azimuth_curve(view.observation, probe)
    proposal = Proposal(
        hash=named,
        azimuths_deg=tuple(float(curve.azimuth_deg[i]) for i in curve.minima),
        errors=tuple(float(curve.error[i]) for i in curve.minima),
    )
    picture = picture_path(data, capture.photo)
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write into {picture.parent}: {error.strerror}") from error
    write_choice(picture, capture.photo, photo, view, probe, curve)
    write_json(_record_path(data, capture.photo), asdict(proposal))
    return proposal


def _view(photo: Photo, source: str) -> FaceView:
    """The largest face with its transport."""
    model = HeadModel.load()
    face = choose_face(choose_landmarker().detect(photo.encoded), 1, source)
    fit = fit_visible(model, photo, face, source)
    return observe_face(photo.pixels, photo.clipped, model, fit, face_height_px=FACE_HEIGHT_PX)
