"""The summary of a merged light probe: a line, warnings, and JSON."""

import math
from dataclasses import asdict
from pathlib import Path

from skylight import __version__
from skylight.cameras.response import describe_response
from skylight.probes.mirror_balls.merged import MergedProbe
from skylight.probes.mirror_balls.views import camera_distance_deg
from skylight.sphere.envmap import luminance

_DISAGREE = 0.1
_SUPPORT_GOOD = 0.5
_TURN_GOOD_DEG = (45.0, 135.0)
_GAIN_GOOD = 1.25


def summary(out: Path, result: MergedProbe) -> str:
    """The command's result in a line."""
    height, width = result.probe.environment.layout
    count = sum(len(shots.files) for shots in result.views)
    light = luminance(result.probe.environment.flat)
    span = float(light.max() / light[light > 0].median())
    return (
        f"{out / 'probe.exr'}: {width}x{height} from {count} pictures; the brightest light is "
        f"{span:.3g} times the median"
    )


def warnings(result: MergedProbe, turn_deg: float) -> list[str]:
    """What the user should know before the map is trusted, a line each."""
    lines = []
    for shots in result.views:
        apart = shots.merged.disagreement
        if apart is not None and apart > _DISAGREE:
            lines.append(
                f"the exposures from {shots.files[0]} on disagree by {100 * apart:.0f} %: "
                "something moved, their times are wrong, or the response is another (--response)"
            )
    supports = [each.support for each in result.outlines if each.support is not None]
    if supports and min(supports) < _SUPPORT_GOOD:
        lines.append(
            f"an edge was seen along {100 * min(supports):.0f} % of a ball's outline only: look at "
            "report.png, and give --ball or --second-ball where it is not right"
        )
    if result.kind == "ball" and result.fov_deg is None:
        lines.append(
            "nothing tells the field of view, so the camera is taken to be far from the ball: give "
            "--fov-deg"
        )
    if result.kind == "ball" and result.turn is None:
        lines.append(
            f"{100 * result.probe.unseen_share:.2g} % of the sphere, behind the ball, was filled "
            "from what is beside it, and the camera is in the map: give a --second view"
        )
    if result.turn is not None:
        lines += _turn_warnings(result, turn_deg)
    if result.clipping is not None:
        lines.append(result.clipping.sentence())
    return lines


def describe(result: MergedProbe) -> dict[str, object]:
    """The content of probe.json."""
    merged = result.views[0].merged
    turn = result.turn
    return {
        "kind": "hdr probe",
        "source": result.kind,
        "frame": "lat-long, skylight's: the centre shows where the (first) camera looked",
        "unit": "1 saturates the longest exposure",
        "views": [
            {
                "files": [str(path) for path in shots.files],
                "seconds": shots.seconds,
                "disagreement": shots.merged.disagreement,
            }
            for shots in result.views
        ],
        "response": {**describe_response(merged.response), "notes": merged.notes},
        "balls": [
            {
                "circle_px": outline.ball.circle,
                "support": outline.support,
                "angular_radius_deg": None
                if result.fov_deg is None
                else math.degrees(outline.ball.half_angle_rad),
            }
            for outline in result.outlines
        ],
        "fov_deg": result.fov_deg,
        "reflectivity": result.reflectivity,
        "turn": None
        if turn is None
        else {
            "azimuth_deg": turn.azimuth_deg,
            "rotation": turn.rotation.tolist(),
            "gain": turn.gain,
            "correlation": turn.correlation,
        },
        "unseen_share": result.probe.unseen_share,
        "clipped": None if result.clipping is None else asdict(result.clipping),
        "version": __version__,
    }


def _turn_warnings(result: MergedProbe, turn_deg: float) -> list[str]:
    turn = result.turn
    assert turn is not None
    if turn.correlation is None:
        return [
            "the two views show too little in common to tell their turn: "
            f"{turn_deg:g} degrees to the right is taken as given"
        ]
    lines = []
    apart = camera_distance_deg(turn)
    if not _TURN_GOOD_DEG[0] <= apart <= _TURN_GOOD_DEG[1]:
        lines.append(
            f"the cameras looked {apart:.0f} degrees apart: with a quarter turn each shows best "
            "what the other does not"
        )
    if not 1 / _GAIN_GOOD <= turn.gain <= _GAIN_GOOD:
        lines.append(
            f"the second view was multiplied by {turn.gain:.2f} to be as bright as the first: the "
            "light changed, or aperture or ISO did"
        )
    return lines
