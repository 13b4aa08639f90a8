"""The coordinate frame, and grids of directions: axes, azimuth, pixels of lat-long maps.

World frame: right-handed, +Y up. A photograph's camera looks along -Z with +X to the picture's
right, so the camera's frame is the world frame. ``azimuth`` is measured from -Z towards +X,
``zenith`` from +Y::

    w(azimuth, zenith) = (sin z sin a, cos z, -sin z cos a)

A lat-long image has the zenith in row 0; its centre looks along -Z and +X lies a quarter turn to
the right (the convention of skylibs and of the Laval data). A *sky* image (w = 4 h) is the upper
half of such an image. A :class:`DirectionGrid` has the directions of its pixels and their solid
angles, for sums over the sphere.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, get_args

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils._pytree import GetAttrKey, register_pytree_node

from skylight._modes import constant
from skylight._names import Convention
from skylight.errors import InputError

# Azimuth (ours, in turns) seen by the *centre* of a lat-long image written in each convention.
# openexr  ImfEnvmap.h: longitude 0 (centre) is +Z, longitude pi/2 (left of it) is +X.
# mitsuba  envmap.cpp: u = atan2(x, -z) / 2 pi, wrapped to [0, 1): the centre is +Z.
# threejs  common.glsl equirectUv: u = atan(z, x) / 2 pi + 1/2: the centre is +X, +Z right of it.
# blender  Cycles: u = 1/2 - atan2(y, x) / 2 pi with Z up; under the usual axis change
#          (x, y, z) -> (x, -z, y) its centre is our +X and its right our +Z.
# unity    Skybox/Panoramic: u = 1/2 - atan2(z, x) / 2 pi, left-handed; under the usual change of
#          hands (x, y, z) -> (x, y, -z) its centre is our +X and its right our +Z.
_CENTRE_AZIMUTH_TURNS: dict[str, float] = {
    "skylight": 0.0,
    "openexr": 0.5,
    "mitsuba": 0.5,
    "threejs": 0.25,
    "blender": 0.25,
    "unity": 0.25,
}


def direction_from_angles(
    azimuth_rad: Float[Tensor, "*s"], zenith_rad: Float[Tensor, "*s"]
) -> Float[Tensor, "*s 3"]:
    """Unit vector(s) of the given azimuth and zenith angle(s)."""
    sin_z = torch.sin(zenith_rad)
    return torch.stack(
        [sin_z * torch.sin(azimuth_rad), torch.cos(zenith_rad), -sin_z * torch.cos(azimuth_rad)],
        dim=-1,
    )


def angles_from_direction(
    direction: Float[Tensor, "*s 3"],
) -> tuple[Float[Tensor, "*s"], Float[Tensor, "*s"]]:
    """(azimuth in (-pi, pi], zenith in [0, pi]); the azimuth of a pole is 0.

    The zenith angle comes from ``atan2`` so that it is accurate near the poles too.
    """
    x, y, z = direction.unbind(-1)
    # + 0.0 turns -0.0 into 0.0: atan2 would answer pi at the poles
    return torch.atan2(x, -z + 0.0), torch.atan2(torch.hypot(x, z), y)


def angle_between(a: Float[Tensor, "*s 3"], b: Float[Tensor, "*#s 3"]) -> Float[Tensor, "*s"]:
    """Angle in radians between vectors, accurate at 0 and pi: ``2 atan2(|a-b|, |a+b|)``."""
    a = a / a.norm(dim=-1, keepdim=True)
    b = b / b.norm(dim=-1, keepdim=True)
    return 2 * torch.atan2((a - b).norm(dim=-1), (a + b).norm(dim=-1))


def rotation_about(axis: Float[Tensor, "3"], angle_rad: float) -> Float[Tensor, "3 3"]:
    """Rodrigues' rotation matrix, right-handed about ``axis``.

    About +Y a positive angle *decreases* the azimuth, which grows from -Z towards +X.
    """
    a = axis / axis.norm()
    zero = torch.zeros((), dtype=a.dtype)
    k = torch.stack(
        [
            torch.stack([zero, -a[2], a[1]]),
            torch.stack([a[2], zero, -a[0]]),
            torch.stack([-a[1], a[0], zero]),
        ]
    )
    eye = torch.eye(3, dtype=a.dtype)
    return eye + math.sin(angle_rad) * k + (1 - math.cos(angle_rad)) * (k @ k)


def pixel_from_direction(
    direction: Float[Tensor, "*s 3"], height: int, width: int
) -> tuple[Float[Tensor, "*s"], Float[Tensor, "*s"]]:
    """Continuous (row, column); pixel centres sit at integers.

    ``width == 2 * height`` is a full lat-long image, ``width == 4 * height`` a sky image.
    """
    azimuth, zenith = angles_from_direction(direction)
    column = (azimuth / (2 * math.pi) + 0.5) * width - 0.5
    return zenith / zenith_span(height, width) * height - 0.5, column


def zenith_span(height: int, width: int) -> float:
    """Zenith angle covered by the rows: pi for a full lat-long image, pi/2 for a sky image."""
    if width == 2 * height:
        return math.pi
    if width == 4 * height:
        return math.pi / 2
    raise InputError(
        f"a lat-long map is twice as wide as high, an upper-hemisphere sky map four times; "
        f"got {width}x{height} (width x height): crop or resize it"
    )


def centre_azimuth_rad(convention: Convention) -> float:
    """Azimuth, in skylight's frame, that the centre of such a lat-long image shows."""
    if convention not in _CENTRE_AZIMUTH_TURNS:
        raise InputError(
            f"unknown convention {convention!r}: choose one of {', '.join(get_args(Convention))}"
        )
    return 2 * math.pi * _CENTRE_AZIMUTH_TURNS[convention]


def convert_latlong(
    image: Float[Tensor, "*b h w c"], source: Convention, target: Convention
) -> Float[Tensor, "*b h w c"]:
    """The same panorama laid out for another program: a roll of the columns, exact.

    Raises :class:`InputError` where the roll is no whole number of columns (width not a
    multiple of 4).
    """
    width = image.shape[-2]
    turns = (centre_azimuth_rad(source) - centre_azimuth_rad(target)) / (2 * math.pi)
    shift = turns * width
    if shift != round(shift):
        height = 2 * max(1, width // 4)
        raise InputError(
            f"a map {width} columns wide cannot be turned by a quarter exactly: make it a multiple "
            f"of 4 wide, as by skylight convert IN OUT --height {height}"
        )
    return torch.roll(image, round(shift), dims=-2)


def cosines(one: Float[Tensor, "*s 3"], other: Float[Tensor, "n 3"]) -> Float[Tensor, "*s n"]:
    """``<a, b>`` of all pairs, for what is cut or sharpened afterwards.

    As sums: a matrix product may have eight bits (autocast) or eleven (TF32).
    """
    x, y, z = one[..., None].unbind(-2)
    a, b, c = other.T.contiguous()
    return torch.addcmul(torch.addcmul(x * a, y, b), z, c)


def squared_chords(
    one: Float[Tensor, "*s 3"], other: Float[Tensor, "n 3"]
) -> Float[Tensor, "*s n"]:
    """``|a - b|^2`` of all pairs: of unit vectors ``2 - 2 cos``, to every digit where it is small.

    A lobe is ``exp(-kappa |a - b|^2 / 2)``. Its ``kappa (cos - 1)`` from a matrix product is off
    by kappa times the product's rounding, 2^-8 under autocast, 2^-11 with TF32.
    """
    along = zip(one[..., None].unbind(-2), other.T.contiguous(), strict=True)
    return torch.stack([(a - b).square() for a, b in along]).sum(0)


@dataclass(frozen=True, kw_only=True)
class DirectionGrid:
    """Directions (n,3), float64, unit; solid angles (n,) in sr; lat-long ``layout`` or None.

    Row ``i`` of a lat-long layout has the exact solid angle
    ``dphi (cos t_i - cos t_{i+1})`` per pixel, so every row, and not only the sum, is right.

    A pytree of its tensors: an argument of :func:`torch.func.vmap`, :func:`torch.compile` and
    :func:`torch.export.export`.
    """

    directions: Float[Tensor, "n 3"]
    solid_angles: Float[Tensor, " n"]
    layout: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.directions.shape != (self.solid_angles.shape[0], 3):
            raise ValueError(
                f"directions {tuple(self.directions.shape)} and solid_angles "
                f"{tuple(self.solid_angles.shape)} do not match: expected (n, 3) and (n,)"
            )
        if self.layout is not None and math.prod(self.layout) != len(self):
            raise ValueError(f"layout {self.layout} does not hold {len(self)} directions")

    def __len__(self) -> int:
        return self.solid_angles.shape[0]

    @property
    def is_sphere(self) -> bool:
        """Whether the layout is that of the whole sphere, not of the upper hemisphere."""
        return self.layout is not None and self.layout[1] == 2 * self.layout[0]

    @staticmethod
    def latlong(height: int, width: int | None = None) -> "DirectionGrid":
        """Pixel centres of a lat-long image: (h, 2h) the sphere (default), (h, 4h) the sky."""
        return _latlong(height, 2 * height if width is None else width)

    @staticmethod
    def sky(height: int) -> "DirectionGrid":
        """The upper hemisphere, ``height`` rows by ``4 * height`` columns."""
        return _latlong(height, 4 * height)

    @staticmethod
    def hammersley(count: int) -> "DirectionGrid":
        """``count`` low-discrepancy directions of equal solid angle 4 pi / count.

        Point i: cos(zenith) = 1 - (2 i + 1) / n, azimuth = 2 pi phi_2(i), the base-2 radical
        inverse (Wong, Luk, Heng 1997).
        """
        index = torch.arange(count, dtype=torch.float64)
        radical, scale, rest = torch.zeros_like(index), 0.5, index.clone()
        for _ in range(max(1, count.bit_length())):
            radical += scale * (rest % 2)
            rest, scale = torch.floor(rest / 2), scale / 2
        zenith = torch.acos(1 - (2 * index + 1) / count)
        return DirectionGrid(
            directions=direction_from_angles(2 * math.pi * radical, zenith),
            solid_angles=torch.full((count,), 4 * math.pi / count, dtype=torch.float64),
        )


def _rebuilt(values: Iterable[Any], layout: tuple[int, int] | None) -> DirectionGrid:
    """Not checked: transforms put other things in the place of tensors."""
    grid = object.__new__(DirectionGrid)
    directions, solid_angles = values
    grid.__dict__.update(directions=directions, solid_angles=solid_angles, layout=layout)
    return grid


def _named(grid: DirectionGrid) -> tuple[list[tuple[Any, Any]], Any]:
    names = "directions", "solid_angles"
    return [(GetAttrKey(name), getattr(grid, name)) for name in names], grid.layout


register_pytree_node(
    DirectionGrid,
    lambda grid: ([grid.directions, grid.solid_angles], grid.layout),
    _rebuilt,
    serialized_type_name="skylight.sphere.DirectionGrid",
    to_dumpable_context=lambda layout: layout and list(layout),
    from_dumpable_context=lambda layout: layout and tuple(layout),
    flatten_with_keys_fn=_named,
)


def row_edges_cos(height: int, width: int) -> Float[Tensor, " edges"]:
    """cos(zenith) at the height + 1 row borders of a lat-long layout, float64, descending."""
    span = zenith_span(height, width)
    return torch.cos(torch.linspace(0, span, height + 1, dtype=torch.float64))


@constant()
def _latlong(height: int, width: int) -> DirectionGrid:
    span = zenith_span(height, width)
    zenith = (torch.arange(height, dtype=torch.float64) + 0.5) * span / height
    azimuth = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * 2 * math.pi
    zenith, azimuth = torch.meshgrid(zenith, azimuth, indexing="ij")
    row = -torch.diff(row_edges_cos(height, width)) * 2 * math.pi / width
    return DirectionGrid(
        directions=direction_from_angles(azimuth, zenith).reshape(-1, 3),
        solid_angles=row.repeat_interleave(width),
        layout=(height, width),
    )
