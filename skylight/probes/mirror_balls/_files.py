"""HDR light probes from exposures of a mirror ball or a 360-degree camera; files to files.

The figure of a merged probe: the ball's outline, the map at two exposures, and numbers.

The summary of a merged light probe: a line, warnings, and JSON.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from skylight import __version__
from skylight._figures import ACCENT, STYLE, save, show, show_probe, write_numbers
from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.io._bounded import write_json
from skylight.io._files import write_probe
from skylight.probes._probe_map import check_rows
from skylight.probes.cameras._exposure_files import read_views
from skylight.probes.cameras._response import describe_response
from skylight.probes.mirror_balls._merged import (
    BallOptions,
    Kind,
    MergedProbe,
    camera_distance_deg,
    merged_from_360,
    merged_from_ball,
)
from skylight.sphere._envmap import luminance
from skylight.work._progress import StageProgress, Tell
from skylight.work._resumable import results_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_DARKER = 16.0  # the second exposure of the map, against the first


def write_merge_report(path: Path, result: MergedProbe) -> None:
    """The ball's outline in the pictures, the map at two exposures, and numbers, as PNG."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    environment = result.probe.environment
    values = luminance(environment.flat)
    white = float(values.kthvalue(round(0.85 * len(values))).values)
    with rc_context(STYLE):
        figure = Figure(figsize=(16, 10.2), dpi=120, facecolor="white")
        figure.text(0.02, 0.962, "Light merged from exposures", fontsize=17, fontweight="bold")
        if result.clipping is not None:
            care = f"Take care: {result.clipping.sentence()}"
            figure.text(0.02, 0.936, care, color=ACCENT, fontsize=9.5)
        grid = figure.add_gridspec(
            2, 2, width_ratios=(1, 1.55), left=0.02, right=0.98, top=0.9, bottom=0.045
        )
        left = grid[:, 0].subgridspec(len(result.views) + 1, 1, hspace=0.16)
        for number, shots in enumerate(result.views):
            axes = figure.add_subplot(left[number])
            name = shots.files[0].name
            show(axes, tone_map(shots.merged.radiance, quantile=0.95), f"Merged from {name} on")
            if result.outlines:
                _outline(axes, result, number)
        write_numbers(figure.add_subplot(left[-1]), "In numbers", _numbers(result), pitch=0.085)
        show_probe(figure.add_subplot(grid[0, 1]), environment, "The map", white=white)
        dark = f"{_DARKER:g} times darker"
        show_probe(figure.add_subplot(grid[1, 1]), environment, dark, white=_DARKER * white)
        save(figure, path)


def _outline(axes: "Axes", result: MergedProbe, number: int) -> None:
    points = result.outlines[number].ball.outline()
    # matplotlib counts from pixel centres
    axes.plot(*(points.T - 0.5), color=ACCENT, linewidth=1.4)


def _numbers(result: MergedProbe) -> list[tuple[str, str]]:
    rows = []
    for shots in result.views:
        if shots.seconds is not None:
            low, high = min(shots.seconds), max(shots.seconds)
            times = f"{len(shots.seconds)}, {low:.3g} to {high:.3g} s"
            rows.append(("exposures", times))
        if shots.merged.disagreement is not None:
            rows.append(("they disagree by", f"{100 * shots.merged.disagreement:.1f} %"))
    response = result.views[0].merged.response
    rows.append(("response", "linear" if response is None else response.kind))
    for outline in result.outlines:
        x, y, radius = outline.ball.circle
        rows.append(("ball's middle, radius", f"{x:.1f}, {y:.1f}, {radius:.1f} px"))
    if result.turn is not None:
        rows.append(("second camera looked to", f"{result.turn.azimuth_deg:.1f}° azimuth"))
    rows.append(("not seen", f"{100 * result.probe.unseen_share:.2g} % of the sphere"))
    clipped = 0.0 if result.clipping is None else result.clipping.solid_angle_sr
    rows.append(("saturated in all exposures", f"{clipped:.2g} sr"))
    return rows


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


def merge_probe(
    photos: Sequence[Path],
    out: Path,
    *,
    kind: Kind = "ball",
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
        write_probe(folder, result.probe.environment)
        write_json(folder / "probe.json", describe(result))
        write_merge_report(folder / "report.png", result)
    for line in warnings(result, ball.turn_deg):
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
    check_rows(height)
