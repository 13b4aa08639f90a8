"""Named designs: those of the thesis (Fig. 4.3 and 4.4), read off its figures.

==================  ===========================================================================
6d 14d 38d 110d     the points of Lebedev quadrature of degrees 3, 5, 9 and 17: near-uniform
14d-indoor          14 cells, small above and large below
14d-outdoor         a path of 7 cells through the zenith, with the 6 around it of which one is cut
6d-sun-6, ...       6 or 14 base cells with 6 or 12 along a path from +X through the zenith to -X
6d-tilted-sun-12    the same with a path that leans by 30 degrees towards +Z
==================  ===========================================================================

Where a path runs through a base cell, that one is cut in two. In the world of
:func:`~skylight.probes.partitions.design.sun_path.sun_path`, +X is east and +Z south.
"""

import math
from functools import partial

import torch
from jaxtyping import Float
from scipy.integrate import lebedev_rule
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.partitions.design.sun_path import path_design, path_through
from skylight.probes.partitions.seeds import ProbeDesign
from skylight.sphere.frame import direction_from_angles

_LEBEDEV_DEGREE = {6: 3, 14: 5, 38: 9, 110: 17}
_TILT_RAD = math.radians(30.0)
# zenith angle in degrees, seeds, and azimuth of the first in degrees
_INDOOR_RINGS = ((0.0, 1, 0.0), (40.0, 4, 45.0), (78.0, 6, 0.0), (135.0, 3, 0.0))


def design_names() -> list[str]:
    """What :func:`named_design` knows."""
    return list(_DESIGNS)


def named_design(name: str) -> ProbeDesign:
    """The design of that name."""
    if name not in _DESIGNS:
        raise InputError(f"no design is called {name!r}: choose one of {', '.join(_DESIGNS)}")
    return _DESIGNS[name](name)


def _even(name: str, *, cells: int) -> ProbeDesign:
    points, _ = lebedev_rule(_LEBEDEV_DEGREE[cells])
    return ProbeDesign.of(name, torch.from_numpy(points.T.copy()))


def _indoor(name: str) -> ProbeDesign:
    rings = [_ring(*ring) for ring in _INDOOR_RINGS]
    return ProbeDesign.of(name, torch.cat(rings))


def _ring(zenith_deg: float, count: int, first_deg: float) -> Float[Tensor, "k 3"]:
    azimuth = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    zenith = torch.full_like(azimuth, math.radians(zenith_deg))
    return direction_from_angles(azimuth + math.radians(first_deg), zenith)


def _sun(name: str, *, base: int, cells: int, tilt_rad: float = 0.0) -> ProbeDesign:
    east = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    noon = torch.tensor([0.0, math.cos(tilt_rad), math.sin(tilt_rad)], dtype=torch.float64)
    return path_design(name, _even(name, cells=base), cells, path_through(east, noon, -east))


_DESIGNS = {
    **{f"{n}d": partial(_even, cells=n) for n in _LEBEDEV_DEGREE},
    "14d-indoor": _indoor,
    "14d-outdoor": partial(_sun, base=6, cells=7),
    "6d-sun-6": partial(_sun, base=6, cells=6),
    "6d-sun-12": partial(_sun, base=6, cells=12),
    "6d-tilted-sun-12": partial(_sun, base=6, cells=12, tilt_rad=_TILT_RAD),
    "14d-sun-6": partial(_sun, base=14, cells=6),
    "14d-sun-12": partial(_sun, base=14, cells=12),
    "14d-tilted-sun-12": partial(_sun, base=14, cells=12, tilt_rad=_TILT_RAD),
}
