"""HDR light probes from exposures of a mirror ball or a 360-degree camera; files to files."""

from collections.abc import Sequence
from pathlib import Path

from skylight.app.cameras.exposure_files import read_views
from skylight.app.probes.mirror_balls.report import write_merge_report
from skylight.app.probes.mirror_balls.summary import describe, summary, warnings
from skylight.errors import InputError
from skylight.io.files import write_probe
from skylight.io.json_files import write_json
from skylight.probes.mirror_balls.merged import (
    BallOptions,
    Kind,
    MergedProbe,
    merged_from_360,
    merged_from_ball,
)
from skylight.probes.radiance.probe_map import check_rows
from skylight.work.progress import StageProgress, Tell
from skylight.work.results_folder import results_folder


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

    ``times`` and ``response`` as in :func:`skylight.app.cameras.exposure_files.read_views`.
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
