"""An HDR light probe from exposures of a mirror ball or a 360-degree camera: files to files."""

import math
from collections.abc import Sequence
from pathlib import Path

from skylight._figures import ACCENT
from skylight._names import MergedFrom
from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.probes._probe_map import check_rows
from skylight.probes._probe_report import Panel, ProbeReport, exposure_number, response_number
from skylight.probes.cameras._exposure_files import read_views
from skylight.probes.cameras._response import describe_response
from skylight.probes.mirror_balls._merged import (
    BallOptions,
    MergedProbe,
    camera_distance_deg,
    merged_from_360,
    merged_from_ball,
)
from skylight.sphere._envmap import luminance
from skylight.work._progress import StageProgress, Tell
from skylight.work._resumable import results_folder

_DISAGREE = 0.1  # relative difference of exposures that is worth a warning
_SUPPORT_GOOD = 0.5  # share of a ball's outline along which an edge was seen
_TURN_GOOD_DEG = (45.0, 135.0)  # between two views that show best what the other does not
_GAIN_GOOD = 1.25  # of the second view against the first


def merge_probe(
    photos: Sequence[Path],
    out: Path,
    *,
    kind: MergedFrom = "ball",
    second: Sequence[Path] = (),
    times: str | None = None,
    response: str = "auto",
    ball: BallOptions | None = None,
    height: int = 256,
    progress: StageProgress = lambda stage, share: None,
    tell: Tell = print,
    warn: Tell = print,
) -> MergedProbe:
    """Make probe.exr, probe.hdr, probe.json and report.png in ``out``.

    ``times`` and ``response`` as in :func:`skylight.probes.cameras._exposure_files.read_views`.
    ``warn`` gets one line for each warning.

    Raises
    ------
    InputError
        Files or options that cannot be used; nothing is written.
    """
    ball = ball or BallOptions()
    _check(kind, second, ball, height)
    with results_folder(out) as folder:
        progress("merging exposures", 0.0)
        views = read_views(photos, second, times, response)
        progress("unwrapping", 0.5)
        if kind == "360":
            result = merged_from_360(views[0], height)
        else:
            result = merged_from_ball(views, ball, height)
        progress("writing the results", 0.8)
        report = _report(result, ball.turn_deg)
        report.write(folder)
    report.say(out, tell, warn)
    return result


def _check(kind: MergedFrom, second: Sequence[Path], ball: BallOptions, height: int) -> None:
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
    check_rows(height)


def _report(result: MergedProbe, turn_deg: float) -> ProbeReport:
    merged, turn = result.views[0].merged, result.turn
    facts = {
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
    }
    light = luminance(result.probe.environment.flat)
    span = float(light.max() / light[light > 0].median())
    return ProbeReport(
        title="Light merged from exposures",
        source=f"{sum(len(shots.files) for shots in result.views)} pictures; the brightest light "
        f"is {span:.3g} times the median",
        probe=result.probe,
        clipping=result.clipping,
        facts=facts,
        numbers=_numbers(result),
        panels=[
            Panel(
                title=f"Merged from {shots.files[0].name} on",
                picture=tone_map(shots.merged.radiance, quantile=0.95),
                # the outline's points count from the picture's corner
                curves=[
                    (ACCENT, each.ball.outline() - 0.5)
                    for each in result.outlines[number : number + 1]
                ],
            )
            for number, shots in enumerate(result.views)
        ],
        own_doubts=_doubts(result, turn_deg),
        notes=merged.notes,
    )


def _numbers(result: MergedProbe) -> list[tuple[str, str]]:
    rows = []
    for shots in result.views:
        if shots.seconds is not None:
            rows.append(exposure_number(shots.seconds))
        if shots.merged.disagreement is not None:
            rows.append(("they disagree by", f"{100 * shots.merged.disagreement:.1f} %"))
    rows.append(response_number(result.views[0].merged.response))
    for outline in result.outlines:
        x, y, radius = outline.ball.circle
        rows.append(("ball's middle, radius", f"{x:.1f}, {y:.1f}, {radius:.1f} px"))
    if result.turn is not None:
        rows.append(("second camera looked to", f"{result.turn.azimuth_deg:.1f}° azimuth"))
    return rows


def _doubts(result: MergedProbe, turn_deg: float) -> list[str]:
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
        lines += _turn_doubts(result, turn_deg)
    return lines


def _turn_doubts(result: MergedProbe, turn_deg: float) -> list[str]:
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
