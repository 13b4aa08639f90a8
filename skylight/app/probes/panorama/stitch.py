"""HDR light probes from a turning camera's photographs; files to files."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skylight.app.cameras.exposure_files import read_exposure, read_series, response_of
from skylight.app.probes.panorama.brackets import Bracket, find_brackets, read_turns
from skylight.app.probes.panorama.report import write_stitch_report
from skylight.app.probes.panorama.summary import Stitched, describe, summary, warnings
from skylight.cameras.response import Response
from skylight.errors import InputError
from skylight.io.files import write_probe
from skylight.io.json_files import write_json
from skylight.probes.panorama.panorama import panorama_of
from skylight.probes.panorama.shots import Shot, shot_of
from skylight.probes.radiance.exposures import Choice, Exposure, common_response
from skylight.probes.radiance.probe_map import check_rows
from skylight.work.progress import StageProgress, Tell
from skylight.work.results_folder import results_folder

# Directions by which a response is judged, and px of their longer sides: as good as all
_JUDGED, _JUDGED_SIDE = 8, 300


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
    check_rows(height)
    if bracket is not None and bracket < 1:
        raise InputError(f"--bracket must be 1 or more, got {bracket}")
    if focal_length_px is not None and not (focal_length_px > 0 and math.isfinite(focal_length_px)):
        raise InputError(f"--focal-length-px must be above 0, got {focal_length_px:g}")
    with results_folder(out) as folder:
        brackets = find_brackets(shots, times, bracket)
        hints = None if turns is None else read_turns(turns, len(brackets))
        chosen, why = _common_response(brackets, response_of(response))
        merged, focal_px, curve = _merged(brackets, chosen, progress)
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
        write_probe(folder, panorama.probe.environment)
        write_json(folder / "probe.json", describe(result))
        write_stitch_report(folder / "report.png", result)
    for line in warnings(result):
        warn(line)
    if why:
        tell(why)
    tell(summary(out, result))
    return result


def _common_response(
    brackets: Sequence[Bracket], wanted: Response | Choice
) -> tuple[Response | Choice, str]:
    """(what linearises all shots, why), from some directions with the exposures of the first.

    A direction alone may show sky or ground only, and too few codes. These files are read once more
    when they are merged: eight whole brackets would take gigabytes until then.
    """
    first = brackets[0].seconds
    if isinstance(wanted, Response) or wanted == "srgb" or first is None or len(first) < 2:
        return wanted, ""
    alike = [each for each in brackets if each.seconds == first]
    some = [alike[k] for k in sorted({*np.linspace(0, len(alike) - 1, _JUDGED).astype(int)})]
    rows: list[list[np.ndarray]] = [[] for _ in first]
    for bracket in some:
        for row, path in zip(rows, bracket.files, strict=True):
            image = read_exposure(path, wanted)
            if image.dtype != np.uint8:
                return wanted, ""
            step = max(1, max(image.shape) // _JUDGED_SIDE)
            row.append(image[::step, ::step])
    for row in rows:
        if any(image.shape != row[0].shape for image in row):
            raise InputError(f"{some[0].files[0]}: not all shots have its size; take all in one")
    exposures = [
        Exposure(name=str(path), seconds=time, image=np.concatenate(row, 1))
        for path, time, row in zip(some[0].files, first, rows, strict=True)
    ]
    return common_response(exposures, wanted)


def _merged(
    brackets: Sequence[Bracket], response: Response | Choice, progress: StageProgress
) -> tuple[list[Shot], float | None, Response | None]:
    """(shots in one unit, focal length in px of the pictures, the response used)."""
    longest = max((max(each.seconds) for each in brackets if each.seconds), default=1.0)
    shots: list[Shot] = []
    focal_px = curve = None
    for number, bracket in enumerate(brackets):
        progress("merging exposures", number / len(brackets))
        lone = len(bracket.files) == 1 and bracket.seconds is not None
        series = read_series(bracket.files, bracket.seconds, response, lone=lone)
        if number == 0:
            focal_px, curve = series.focal_px, series.merged.response
        gain = max(bracket.seconds) if bracket.seconds else longest
        shots.append(shot_of(str(bracket.files[0]), series.merged, longest / gain))
    return shots, focal_px, curve
