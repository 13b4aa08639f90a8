"""HDR light probes from a turning camera's photographs; files to files."""

import math
from collections.abc import Sequence
from pathlib import Path

from skylight.app.cameras.exposure_files import read_series, response_of
from skylight.app.probes.panorama.brackets import Bracket, find_brackets, read_turns
from skylight.app.probes.panorama.report import write_stitch_report
from skylight.app.probes.panorama.summary import Stitched, describe, summary, warnings
from skylight.cameras.response import Response
from skylight.errors import InputError
from skylight.io.files import write_environment_map
from skylight.io.json_files import write_json
from skylight.probes.panorama.panorama import panorama_of
from skylight.probes.panorama.shots import Shot, shot_of
from skylight.probes.radiance.exposures import Choice
from skylight.work.progress import StageProgress, Tell
from skylight.work.results_folder import results_folder

_HEIGHTS = (16, 1024)


def stitch_probe(
    shots: Sequence[Path],
    out: Path,
    *,
    bracket: int | None = None,
    times: str | None = None,
    response: str = "auto",
    focal_length_px: float | None = None,
    turns: Path | None = None,
    height: int = 256,
    progress: StageProgress = lambda stage, share: None,
    tell: Tell = print,
    warn: Tell = print,
) -> Stitched:
    """Make probe.exr, probe.hdr, probe.json and report.png in ``out``.

    ``shots``, ``bracket`` and ``times`` as in
    :func:`~skylight.app.probes.panorama.brackets.find_brackets`, ``turns`` as in
    :func:`~skylight.app.probes.panorama.brackets.read_turns`. ``warn`` gets one line for each
    warning.

    Raises
    ------
    InputError
        Files or options that cannot be used, or shots that do not overlap; nothing is written.
    """
    low, high = _HEIGHTS
    if not low <= height <= high:
        raise InputError(f"--height must be {low} to {high} rows, got {height}")
    if bracket is not None and bracket < 1:
        raise InputError(f"--bracket must be 1 or more, got {bracket}")
    if focal_length_px is not None and not (focal_length_px > 0 and math.isfinite(focal_length_px)):
        raise InputError(f"--focal-length-px must be above 0, got {focal_length_px:g}")
    with results_folder(out) as folder:
        brackets = find_brackets(shots, times, bracket)
        hints = None if turns is None else read_turns(turns, len(brackets))
        merged, focal_px, curve = _merged(brackets, response_of(response), progress)
        told_px = focal_length_px or focal_px
        panorama = panorama_of(
            merged,
            height,
            focal_px=None if told_px is None else told_px * merged[0].scale,
            hints=hints,
            progress=progress,
        )
        result = Stitched(brackets=brackets, shots=tuple(merged), panorama=panorama, response=curve)
        progress("writing the results", 0.0)
        write_environment_map(folder / "probe.exr", panorama.probe.environment)
        write_environment_map(folder / "probe.hdr", panorama.probe.environment)
        write_json(folder / "probe.json", describe(result))
        write_stitch_report(folder / "report.png", result)
    for line in warnings(result):
        warn(line)
    tell(summary(out, result))
    return result


def _merged(
    brackets: Sequence[Bracket], response: Response | Choice, progress: StageProgress
) -> tuple[list[Shot], float | None, Response | None]:
    """(shots in one unit, focal length in px of the pictures, the response used).

    The first direction's exposures choose the response of all.
    """
    longest = max((max(each.seconds) for each in brackets if each.seconds), default=1.0)
    shots: list[Shot] = []
    focal_px = curve = None
    for number, bracket in enumerate(brackets):
        progress("merging exposures", number / len(brackets))
        lone = len(bracket.files) == 1 and bracket.seconds is not None
        series = read_series(bracket.files, bracket.seconds, curve or response, lone=lone)
        if number == 0:
            focal_px, curve = series.focal_px, series.merged.response
        gain = max(bracket.seconds) if bracket.seconds else longest
        shots.append(shot_of(str(bracket.files[0]), series.merged, longest / gain))
    return shots, focal_px, curve
