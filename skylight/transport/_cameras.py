"""Cameras: a pinhole at the world's origin, and that of a photograph of a known object."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._bounded import json_content
from skylight.sphere._rotation import RigidTransform


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Looks along -Z from the origin; +X is the picture's right, +Y its up.

    ``focal_px`` and ``center_px`` (x, y) are in pixels, x to the right and y down; the centre of
    the pixel in row r and column c is (c + 0.5, r + 0.5). Pixels are square.
    """

    focal_px: float
    width: int
    height: int
    center_px: tuple[float, float]

    def __post_init__(self) -> None:
        if self.focal_px <= 0 or self.width < 1 or self.height < 1:
            raise ValueError(
                f"focal_px, width and height must be positive, got {self.focal_px}, "
                f"{self.width}, {self.height}"
            )

    def resized(self, width: int, height: int) -> "Camera":
        """The camera of the same picture in so many pixels, square or nearly so."""
        across, down = width / self.width, height / self.height
        return Camera(
            focal_px=self.focal_px * (across + down) / 2,
            width=width,
            height=height,
            center_px=(self.center_px[0] * across, self.center_px[1] * down),
        )

    def rays(self) -> Float[Tensor, "hw 3"]:
        """Unit direction through each pixel's centre, row by row, float64."""
        y, x = torch.meshgrid(
            torch.arange(self.height, dtype=torch.float64) + 0.5,
            torch.arange(self.width, dtype=torch.float64) + 0.5,
            indexing="ij",
        )
        cx, cy = self.center_px
        rays = torch.stack([x - cx, cy - y, torch.full_like(x, -self.focal_px)], dim=-1)
        return torch.nn.functional.normalize(rays.reshape(-1, 3), dim=1)

    def project(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 2"]:
        """Image position (x, y) in px: c + f (X, -Y) / (-Z); points must have Z < 0."""
        x, y, z = points.unbind(1)
        cx, cy = self.center_px
        return torch.stack([cx - self.focal_px * x / z, cy + self.focal_px * y / z], dim=1)


_LENS, _POSE = ("fov_deg", "focal_px"), ("position", "look_at", "up")
_KEYS = (*_LENS, "center_px", *_POSE, "world_from_camera")
_RIGID = 1e-3  # files carry rotations with few digits
_EXAMPLE = '{"fov_deg": 40, "position": [0, 1, 4], "look_at": [0, 0.5, 0]}'


@dataclass(frozen=True, kw_only=True)
class PlacedCamera:
    """A pinhole camera, which looks along its own -Z with +Y up, and its place in the world.

    ``world_from_camera`` is in float64 and in the mesh's world and units.
    """

    camera: Camera
    world_from_camera: RigidTransform

    def shrunk(self, factor: int) -> "PlacedCamera":
        """The camera of the picture whose pixels are means of ``factor`` x ``factor`` pixels.

        Rows and columns that fill no block are cut off at the bottom and the right.
        """
        whole = self.camera
        camera = Camera(
            focal_px=whole.focal_px / factor,
            width=whole.width // factor,
            height=whole.height // factor,
            center_px=(whole.center_px[0] / factor, whole.center_px[1] / factor),
        )
        return replace(self, camera=camera)


def read_object_camera(path: str | Path, *, height: int, width: int) -> PlacedCamera:
    """The camera that a JSON file describes, for a picture of ``height`` x ``width`` pixels.

    See :func:`object_camera` for the keys.

    Raises
    ------
    InputError
        The file is missing or no JSON, or a key is missing, unknown or impossible.
    """
    path = Path(path)
    try:
        content = json_content(path)
    except OSError as error:
        raise InputError(
            f"cannot read the camera {path}: {error.strerror}; give a JSON file such as {_EXAMPLE}"
        ) from error
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: no JSON ({reason}); write the camera such as {_EXAMPLE}"
        ) from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: a camera is a JSON object such as {_EXAMPLE}")
    try:
        return object_camera(content, height=height, width=width)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def object_camera(content: Mapping[str, object], *, height: int, width: int) -> PlacedCamera:
    """The camera that these values describe, for a picture of ``height`` x ``width`` pixels.

    Lens
        ``fov_deg``, the vertical field of view, or ``focal_px``, the focal length in pixels of the
        picture; and, where the picture was cropped, ``center_px`` [x, y], where the optical axis
        meets it (default: its middle).
    Place
        ``position`` and ``look_at`` in the mesh's world, and ``up`` (default [0, 1, 0]); or
        ``world_from_camera``, four rows of four numbers, of a camera that looks along its own -Z
        with +Y up (OpenGL's and Blender's).
    """
    unknown = [key for key in content if key not in _KEYS]
    if unknown:
        raise InputError(f"unknown camera key {unknown[0]!r}: use some of {', '.join(_KEYS)}")
    if ("fov_deg" in content) == ("focal_px" in content):
        raise InputError('the camera needs either "fov_deg" or "focal_px", and not both')
    if "fov_deg" in content:
        fov = _numbers(content, "fov_deg", 0)[0]
        if not 0.1 <= fov <= 170:
            raise InputError(f'"fov_deg" must be from 0.1 to 170 degrees, got {fov:g}')
        focal_px = 0.5 * height / math.tan(math.radians(fov) / 2)
    else:
        focal_px = _numbers(content, "focal_px", 0)[0]
        if focal_px <= 0:
            raise InputError(f'"focal_px" must be above 0, got {focal_px:g}')
    center = (width / 2, height / 2)
    if "center_px" in content:
        x, y = _numbers(content, "center_px", 2)
        center = (x, y)
    pose = _matrix(content) if "world_from_camera" in content else _aimed(content)
    return PlacedCamera(
        camera=Camera(focal_px=focal_px, width=width, height=height, center_px=center),
        world_from_camera=pose,
    )


def _aimed(content: Mapping[str, object]) -> RigidTransform:
    """Of a camera at ``position`` that looks at ``look_at``."""
    missing = [key for key in ("position", "look_at") if key not in content]
    if missing:
        raise InputError(
            f'the camera lacks "{missing[0]}": give "position" and "look_at", or '
            '"world_from_camera"'
        )
    position, target = (_vector(content, key) for key in ("position", "look_at"))
    up = _vector(content, "up") if "up" in content else torch.tensor([0.0, 1.0, 0.0]).double()
    backward = position - target
    if not backward.norm() > 0:
        raise InputError('"look_at" is where the camera stands: give a point before it')
    backward = backward / backward.norm()
    right = torch.linalg.cross(up, backward)
    if not right.norm() > 1e-6 * up.norm():
        raise InputError('"up" must not be zero or along the view: give another, such as [0, 0, 1]')
    right = right / right.norm()
    rotation = torch.stack([right, torch.linalg.cross(backward, right), backward], dim=1)
    return RigidTransform(rotation=rotation, translation=position)


def _matrix(content: Mapping[str, object]) -> RigidTransform:
    """Of a 4 x 4 matrix."""
    both = [key for key in _POSE if key in content]
    if both:
        raise InputError(f'the camera has "world_from_camera" and "{both[0]}": keep one of them')
    rows = content["world_from_camera"]
    if not isinstance(rows, list) or len(rows) != 4:
        raise InputError('"world_from_camera" must be four rows of four numbers')
    matrix = torch.tensor(
        [_listed(row, '"world_from_camera"', 4) for row in rows], dtype=torch.float64
    )
    rotation = matrix[:3, :3]
    off = (rotation.T @ rotation - torch.eye(3, dtype=torch.float64)).abs().max()
    last = (matrix[3] - torch.tensor([0.0, 0.0, 0.0, 1.0]).double()).abs().max()
    if not (off < _RIGID and last < _RIGID and torch.linalg.det(rotation) > 0):
        raise InputError(
            '"world_from_camera" must be a rotation and a translation, without scale or mirror, '
            "with the last row 0 0 0 1"
        )
    u, _, v = torch.linalg.svd(rotation)  # the nearest rotation: files round
    return RigidTransform(rotation=u @ v, translation=matrix[:3, 3].clone())


def _vector(content: Mapping[str, object], key: str) -> Float[Tensor, "3"]:
    return torch.tensor(_numbers(content, key, 3), dtype=torch.float64)


def _numbers(content: Mapping[str, object], key: str, count: int) -> list[float]:
    """``count`` finite numbers of that key; 0 for a single one outside a list."""
    value = content[key]
    return _listed(value if count else [value], f'"{key}"', count or 1)


def _listed(value: object, name: str, count: int) -> list[float]:
    wanted = "a number" if count == 1 else f"{count} numbers"
    if not isinstance(value, list) or len(value) != count:
        raise InputError(f"{name} must be {wanted}, got {value!r}")
    for each in value:
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            raise InputError(f"{name} must be {wanted}, got {each!r}")
    return [float(each) for each in value]
