"""Sparse coding of an environment map, with the error over the number of activations."""

import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.csc._coder import SphericalSparseCoder
from skylight.io._files import write_environment_map
from skylight.maps._sparse_codes import MOST_ROWS, CodedMap, Outline, outlines, write_code
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between, angles_from_direction
from skylight.studio.tasks._uploads import Light, read_light
from skylight.work._progress import StageProgress

_SIDES = 24  # of the polygon that stands for a filter's outline
_DIGITS = 5


def code_light(
    light: Light, folder: str, dictionary: str, activations: int, *, tell: StageProgress
) -> dict[str, Any]:
    """The code of at most so many activations, what each is, and the errors of smaller ones.

    ``errors`` are ``|x - decoded| / |x|`` at ``counts`` activations of one pursuit; both end early
    where the map needs no more.
    """
    environment = read_light(light)
    environment = environment.resize(min(environment.layout[0], MOST_ROWS))
    tell("preparing the filters", 0.0)
    coder = SphericalSparseCoder(dictionary, height=environment.layout[0], activations=activations)
    path = coder.path(
        environment.radiance,
        _counts(activations),
        lambda share: tell("choosing activations", share),
    )
    tell("writing the results", 0.0)
    coded = CodedMap(environment=environment, code=path[-1], coder=coder)
    write_code(Path(folder), "code.json", coded, title=light["name"])
    decoded = EnvironmentMap(radiance=coder.decode(coded.code).detach().clamp(min=0).float())
    for name in ("decoded.exr", "decoded.hdr"):
        write_environment_map(Path(folder) / name, decoded)
    sizes = {len(code): code.relative_error for code in path}
    return {
        "counts": list(sizes),
        "errors": list(sizes.values()),
        "rows": environment.layout[0],
        "floats": coded.code.floats,
        "map_floats": coded.map_floats,
        "activations": _described(coded),
    }


def _counts(most: int) -> list[int]:
    """1, 2, 3, 4, 6, 8, 12, 16, 24, ... up to the most."""
    steps = {1, 3} | {2**k for k in range(1, 9)} | {3 * 2**k for k in range(1, 7)}
    return sorted({count for count in steps if count < most} | {most})


def _described(coded: CodedMap) -> list[dict[str, Any]]:
    """Each activation, the strongest first.

    ``width_deg`` and ``length_deg`` are the extents across and along the filter where it has
    half its height; ``outline`` [azimuth, zenith] in degrees runs there. Of a pixel both extents
    are a pixel's, and of a filter that is the same everywhere 360 degrees; neither has an outline.
    """
    code = coded.code
    azimuth, zenith = (angle.rad2deg() for angle in angles_from_direction(code.directions))
    found = outlines(coded.coder, code)
    order = code.weights.abs().sum(1).argsort(descending=True).tolist()
    constant = {filter_ for part in coded.coder.parts for filter_ in part.constant}
    described = []
    for number in order:
        filter_ = int(code.filters[number])
        outline = found[number]
        if outline is not None:
            width, length = _extents(outline)
        else:
            width = length = 360.0 if filter_ in constant else 180.0 / coded.environment.layout[0]
        described.append(
            {
                "azimuth_deg": round(float(azimuth[number]), _DIGITS),
                "zenith_deg": round(float(zenith[number]), _DIGITS),
                "weight": code.weights[number].tolist(),
                "width_deg": round(width, _DIGITS),
                "length_deg": round(length, _DIGITS),
                "twist_deg": round(math.degrees(float(code.twists_rad[number])), _DIGITS),
                "filter": filter_,
                "outline": [] if outline is None else _polygon(outline.around),
            }
        )
    return described


def _extents(outline: Outline) -> tuple[float, float]:
    """(across, along) in degrees: the shortest and longest line between opposite points."""
    half = (len(outline.around) - 1) // 2
    across = angle_between(outline.around[:half], outline.around[half : 2 * half]).rad2deg()
    return float(across.min()), float(across.max())


def _polygon(around: Float[Tensor, "n 3"]) -> list[list[float]]:
    step = max(1, (len(around) - 1) // _SIDES)
    azimuth, zenith = angles_from_direction(around[:-1:step])
    return torch.stack([azimuth, zenith], 1).rad2deg().round(decimals=2).tolist()
