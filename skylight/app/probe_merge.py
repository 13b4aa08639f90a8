"""An HDR probe from exposures of a mirror ball or of a 360-degree camera; files to files."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from skylight.app.exposure_files import Shots, read_views
from skylight.app.probe_merge_report import describe, doubts, summary, write_merge_report
from skylight.app.results import results_folder
from skylight.errors import InputError
from skylight.imaging.files import write_environment_map, write_json
from skylight.probes.hdr.ball import ball_of_circle, focal_from_fov, picture_camera
from skylight.probes.hdr.clipping import Clipping, find_clipping
from skylight.probes.hdr.outline import Outline, find_ball
from skylight.probes.hdr.unwrap import BallView, ProbeMap, averaged, unwrap
from skylight.probes.hdr.views import TURN_DEG, Turn, blend, match_views

Kind = Literal["ball", "360"]
Circle = tuple[float, float, float]
Tell = Callable[[str], None]
Progress = Callable[[str, float], None]
_HEIGHTS = (16, 1024)


@dataclass(frozen=True, kw_only=True)
class MergedProbe:
    """All that was found. ``outlines``, ``turn`` and ``fov_deg`` are of balls alone.

    An outline's support is None where it was given; ``fov_deg`` (vertical) is None where nothing
    tells it.
    """

    kind: Kind
    probe: ProbeMap
    views: tuple[Shots, ...]
    outlines: tuple[Outline, ...] = ()
    turn: Turn | None = None
    clipping: Clipping | None
    reflectivity: float
    fov_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class BallOptions:
    """How a mirror ball was photographed.

    ``circles``       (x, y, radius) of its outline in px in each view; None where to search.
    ``fov_deg``       vertical field of view; None where EXIF data may tell.
    ``turn_deg``      about how far apart the two cameras looked.
    ``reflectivity``  share of light that the ball throws back.
    """

    circles: tuple[Circle | None, Circle | None] = (None, None)
    fov_deg: float | None = None
    turn_deg: float = TURN_DEG
    reflectivity: float = 1.0


def merge_probe(
    photos: Sequence[Path],
    out: Path,
    *,
    kind: Kind = "ball",
    second: Sequence[Path] = (),
    times: str | None = None,
    response: str = "auto",
    ball: BallOptions = BallOptions(),
    height: int = 256,
    progress: Progress = lambda stage, share: None,
    tell: Tell = print,
    warn: Tell = print,
) -> MergedProbe:
    """Make probe.exr, probe.hdr, probe.json and report.png in ``out``.

    ``times`` and ``response`` as in :func:`skylight.app.exposure_files.read_views`. ``warn`` gets
    one line for each doubt.

    Raises
    ------
    InputError
        Files or options that cannot be used; nothing is written.
    """
    _check(kind, second, ball, height)
    with results_folder(out) as folder:
        progress("merging exposures", 0.0)
        views = read_views(photos, second, times, response)
        progress("unwrapping", 0.5)
        made = _from_360 if kind == "360" else _from_ball
        result = made(views, ball, height)
        progress("writing the results", 0.8)
        write_environment_map(folder / "probe.exr", result.probe.environment)
        write_environment_map(folder / "probe.hdr", result.probe.environment)
        write_json(folder / "probe.json", describe(result))
        write_merge_report(folder / "report.png", result)
    for line in doubts(result, ball.turn_deg):
        warn(line)
    for line in result.views[0].merged.notes:
        tell(line)
    tell(summary(out, result))
    return result


def _check(kind: Kind, second: Sequence[Path], ball: BallOptions, height: int) -> None:
    if kind == "360" and (second or ball != BallOptions()):
        raise InputError(
            "--second, --ball, --second-ball, --fov-deg, --turn-deg and --reflectivity are for "
            "--kind ball alone"
        )
    if ball.circles[1] is not None and not second:
        raise InputError("--second-ball is the ball of the --second pictures: give these as well")
    if not 10 <= abs(ball.turn_deg) <= 180:
        raise InputError(f"--turn-deg must be 10 to 180 degrees either way, got {ball.turn_deg:g}")
    if not 0 < ball.reflectivity <= 1:
        raise InputError(f"--reflectivity must be above 0, 1 at most, got {ball.reflectivity:g}")
    low, high = _HEIGHTS
    if not low <= height <= high:
        raise InputError(f"--height must be {low} to {high} rows, got {height}")


def _from_360(views: tuple[Shots, ...], ball: BallOptions, height: int) -> MergedProbe:
    """The picture is the map already; of ``ball``, nothing counts."""
    merged = views[0].merged
    rows, columns = merged.radiance.shape[:2]
    if columns != 2 * rows:
        raise InputError(
            f"{views[0].files[0]}: {columns}x{rows} pixels; a 360-degree picture is a lat-long "
            "map, twice as wide as high: export it so, or give --kind ball"
        )
    seen = np.ones((rows, columns), bool)
    clipped = merged.clipped.numpy().astype(np.float32)
    probe = averaged(merged.radiance.numpy(), clipped, seen, height)
    return MergedProbe(
        kind="360",
        probe=probe,
        views=views,
        clipping=find_clipping(probe),
        reflectivity=ball.reflectivity,
    )


def _from_ball(views: tuple[Shots, ...], options: BallOptions, height: int) -> MergedProbe:
    found = [
        _ball_view(shots, circle, options)
        for shots, circle in zip(views, options.circles, strict=False)
    ]
    balls = [view for view, _ in found]
    turn = None
    if len(balls) == 1:
        probe = unwrap(balls[0], height)
    else:
        turn = match_views(balls[0], balls[1], options.turn_deg)
        probe = blend(balls[0], balls[1], turn, height)
    known = options.fov_deg is not None or views[0].focal_px is not None
    camera = balls[0].ball.camera
    fov_deg = 2 * math.degrees(math.atan(camera.height / (2 * camera.focal_px)))
    return MergedProbe(
        kind="ball",
        probe=probe,
        views=views,
        outlines=tuple(outline for _, outline in found),
        turn=turn,
        clipping=find_clipping(probe),
        reflectivity=options.reflectivity,
        fov_deg=fov_deg if known else None,
    )


def _ball_view(
    shots: Shots, circle: Circle | None, options: BallOptions
) -> tuple[BallView, Outline]:
    merged = shots.merged
    height, width = merged.radiance.shape[:2]
    focal_px = shots.focal_px
    if options.fov_deg is not None:
        focal_px = focal_from_fov(height, options.fov_deg)
    camera = picture_camera(height, width, focal_px)
    if circle is None:
        outline = find_ball(merged.radiance, camera)
    else:
        outline = Outline(ball=ball_of_circle(camera, *circle), support=None)
    view = BallView(
        radiance=merged.radiance,
        clipped=merged.clipped,
        ball=outline.ball,
        reflectivity=options.reflectivity,
    )
    return view, outline
