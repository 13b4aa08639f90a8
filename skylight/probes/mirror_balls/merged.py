"""A light probe from merged exposures of a mirror ball or of a 360-degree camera."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skylight.errors import InputError
from skylight.probes.mirror_balls.ball import ball_of_circle, focal_from_fov, picture_camera
from skylight.probes.mirror_balls.outline import Outline, find_ball
from skylight.probes.mirror_balls.unwrap import BallView, unwrap
from skylight.probes.mirror_balls.views import TURN_DEG, Turn, blend, match_views
from skylight.probes.radiance.clipping import Clipping, find_clipping
from skylight.probes.radiance.exposures import ExposureSeries
from skylight.probes.radiance.probe_map import ProbeMap, averaged

Kind = Literal["ball", "360"]
Circle = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class MergedProbe:
    """All that was found. ``outlines``, ``turn`` and ``fov_deg`` are of balls alone.

    An outline's support is None where it was given; ``fov_deg`` (vertical) is None where nothing
    tells it.
    """

    kind: Kind
    probe: ProbeMap
    views: tuple[ExposureSeries, ...]
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


def merged_from_360(view: ExposureSeries, height: int) -> MergedProbe:
    """Of a camera whose picture is the lat-long map already."""
    merged = view.merged
    rows, columns = merged.radiance.shape[:2]
    if columns != 2 * rows:
        raise InputError(
            f"{view.files[0]}: {columns}x{rows} pixels; a 360-degree picture is a lat-long "
            "map, twice as wide as high: export it so, or give --kind ball"
        )
    seen = np.ones((rows, columns), bool)
    clipped = merged.clipped.numpy().astype(np.float32)
    probe = averaged(merged.radiance.numpy(), clipped, seen, height)
    return MergedProbe(
        kind="360",
        probe=probe,
        views=(view,),
        clipping=find_clipping(probe),
        reflectivity=1.0,
    )


def merged_from_ball(
    views: tuple[ExposureSeries, ...], options: BallOptions, height: int
) -> MergedProbe:
    """Of one view of a mirror ball, or of two from different sides."""
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
    shots: ExposureSeries, circle: Circle | None, options: BallOptions
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
