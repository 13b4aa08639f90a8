"""An HDR light probe from the photographs of a turning camera: files to files.

The shots' brackets are found, their response is agreed on, each bracket is merged, the shots are
placed and blended, and what came out is written with its report.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from skylight._figures import ACCENT
from skylight.errors import InputError
from skylight.imaging._colour import tone_map
from skylight.probes._probe_map import check_rows
from skylight.probes._probe_report import Panel, ProbeReport, exposure_number, response_number
from skylight.probes.cameras._exposure_files import read_exposure, read_series, response_of
from skylight.probes.cameras._exposures import Choice, Exposure, common_response
from skylight.probes.cameras._response import Response, describe_response
from skylight.probes.panorama._brackets import Bracket, find_brackets, read_turns
from skylight.probes.panorama._matches import Shot, shot_of
from skylight.probes.panorama._panorama import Panorama, panorama_of
from skylight.sphere._frame import pixel_from_direction
from skylight.work._progress import StageProgress, Tell
from skylight.work._resumable import results_folder

# Directions by which a response is judged, and px of their longer sides: as good as all
_JUDGED, _JUDGED_SIDE = 8, 300
_UNSEEN = 0.005  # share of the sphere below which a gap is no news
_GOOD_PX = 2.0  # rms of the matches, in px of the pictures that were matched
_NAMED_MOST = 5
_SIDE = 24  # points along each side of a shot's outline


@dataclass(frozen=True, kw_only=True)
class Stitched:
    """A panorama, the files it is of, and the response that they were linearised by."""

    brackets: tuple[Bracket, ...]
    shots: tuple[Shot, ...]
    panorama: Panorama
    response: Response | None

    @property
    def rms_px(self) -> float:
        """Of the matches, in pixels of the pictures as they were taken."""
        return self.panorama.bundle.rms_px / self.shots[0].scale

    @property
    def focal_px(self) -> float:
        """In pixels of the pictures as they were taken."""
        return self.panorama.bundle.lens.focal_px / self.shots[0].scale


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
    :func:`~skylight.probes.panorama._brackets.find_brackets`, ``turns`` as in
    :func:`~skylight.probes.panorama._brackets.read_turns`. ``warn`` gets one line for each
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
        start_px = focal_length_px or focal_px
        panorama = panorama_of(
            merged,
            height,
            focal_px=None if start_px is None else start_px * merged[0].scale,
            hints=hints,
            progress=progress,
        )
        result = Stitched(brackets=brackets, shots=tuple(merged), panorama=panorama, response=curve)
        progress("writing the results", 0.0)
        report = _report(result, [why] if why else [])
        report.write(folder)
    report.say(out, tell, warn)
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


def _report(result: Stitched, notes: Sequence[str]) -> ProbeReport:
    panorama = result.panorama
    probe, bundle = panorama.probe, panorama.bundle
    facts = {
        "source": "turning camera",
        "frame": "lat-long, skylight's: +Y is up, the centre shows where the first shot looked, "
        "or azimuth 0 of the turns that were given",
        "unit": "that of the merged files"
        if result.brackets[0].seconds is None
        else "1 saturates the longest exposure",
        "views": [
            {
                "files": [str(path) for path in bracket.files],
                "seconds": bracket.seconds,
                "world_from_camera": None
                if number not in bundle.rotations
                else bundle.rotations[number].tolist(),
                "by_hint": number in panorama.by_hint,
            }
            for number, bracket in enumerate(result.brackets)
        ],
        "response": describe_response(result.response),
        "lens": {"focal_length_px": result.focal_px, "k1": bundle.lens.k1},
        "matches": bundle.matches,
        "rms_px": result.rms_px,
    }
    seen = probe.seen.numpy()[..., None] > 0
    picture = np.where(seen, tone_map(probe.environment.radiance), 128).astype(np.uint8)
    return ProbeReport(
        title="Light stitched from shots",
        source=f"{len(bundle.rotations)} of {len(result.shots)} directions, "
        f"{100 * (1 - probe.unseen_share):.3g} % of the sphere; focal length "
        f"{result.focal_px:.0f} px, matches off by {result.rms_px:.2f} px",
        probe=probe,
        clipping=panorama.clipping,
        facts=facts,
        numbers=_numbers(result),
        panels=[
            Panel(
                title="Where the shots lie (orange: by --turns alone; grey: in none)",
                picture=picture,
                curves=_outlines(result),
            )
        ],
        own_doubts=_doubts(result),
        notes=notes,
    )


def _numbers(result: Stitched) -> list[tuple[str, str]]:
    bundle, seconds = result.panorama.bundle, result.brackets[0].seconds
    return [
        ("directions placed", f"{len(bundle.rotations)} of {len(result.shots)}"),
        *([] if seconds is None else [exposure_number(seconds)]),
        response_number(result.response),
        ("matches", f"{bundle.matches}"),
        ("they are off by (rms)", f"{result.rms_px:.2f} px"),
        ("focal length", f"{result.focal_px:.1f} px"),
        ("radial distortion k1", f"{bundle.lens.k1:.4f}"),
    ]


def _outlines(result: Stitched) -> list[tuple[str, np.ndarray]]:
    """The border of each shot on the map, broken where it leaves the map at a side."""
    bundle, layout = result.panorama.bundle, result.panorama.probe.environment.layout
    width, height = bundle.lens.size
    along = np.linspace(0, 1, _SIDE)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], dtype=np.float64)
    border = np.concatenate([a + along[:, None] * (b - a) for a, b in pairwise(corners)])
    rays = bundle.lens.rays(border * (width, height))
    curves = []
    for number, rotation in bundle.rotations.items():
        row, column = (
            each.numpy()
            for each in pixel_from_direction(torch.from_numpy(rays @ rotation.T), *layout)
        )
        jumps = np.flatnonzero(np.abs(np.diff(column)) > layout[1] / 2) + 1
        colour = ACCENT if number in result.panorama.by_hint else "white"
        curves += [(colour, part) for part in np.split(np.stack([column, row], 1), jumps)]
    return curves


def _doubts(result: Stitched) -> list[str]:
    panorama, lines = result.panorama, []
    if panorama.left_out:
        lines.append(
            "left out, as they are not linked to the largest group of shots: "
            f"{_names(result, panorama.left_out)}; say where they look with --turns"
        )
    if panorama.by_hint:
        lines.append(
            f"placed by --turns alone, as they match no other shot: "
            f"{_names(result, panorama.by_hint)}"
        )
    if panorama.probe.unseen_share > _UNSEEN:
        lines.append(
            f"{100 * panorama.probe.unseen_share:.2g} % of the sphere is in no shot and was "
            "filled from what is beside it"
        )
    if panorama.bundle.rms_px > _GOOD_PX:
        lines.append(
            f"matches are off by {result.rms_px:.1f} px: the camera moved as it turned, or things "
            "are near; turn it about its lens"
        )
    if any(each.seconds is not None and len(each.files) == 1 for each in result.brackets):
        lines.append(
            "one exposure only: whatever is white in it was brighter by an unknown factor; take "
            "several, the shortest of which shows the sun"
        )
    return lines


def _names(result: Stitched, numbers: Sequence[int]) -> str:
    names = [Path(result.shots[number].name).name for number in numbers[:_NAMED_MOST]]
    more = f" and {len(numbers) - _NAMED_MOST} more" if len(numbers) > _NAMED_MOST else ""
    return ", ".join(names) + more
