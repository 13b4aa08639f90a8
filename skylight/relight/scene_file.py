"""Precomputed scenes: pixels of one camera and their transport; without torch."""

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, UInt8, UInt16

from skylight.errors import InputError
from skylight.io.atomic import atomic_path
from skylight.io.bounded import load_arrays, require_pixels

SCENE_FORMAT = "skylight scene 1"
PICTURE_PIXELS_MAX = 2**23  # the largest that is exported has 2880 x 2160
DIRECTIONS_MAX = 2**17  # 256 x 512; 64 x 128 are exported
_TYPES = {
    "pixels": np.uint16,
    "normals": np.float32,
    "albedo": np.float32,
    "on_ground": np.bool_,
    "visible": np.uint8,
    "directions": np.float32,
    "solid_angles": np.float32,
}


@dataclass(frozen=True, kw_only=True)
class PrecomputedScene:
    """What one camera sees of a scene, and which directions light each of its m pixels.

    The transport matrix T[p, w] = V(p, w) <n_p, w>+ dw / pi (thesis, Eq. 5.3) in factors:
    one bit for V instead of a float for T is 32 times smaller, and exact.
    :func:`skylight.relight.runtime.relight` puts T together again, a block of pixels at a time.

    ``visible`` holds V as bits, the n directions of a row packed as :func:`numpy.packbits` does.
    ``directions`` are unit vectors of ``grid_layout``, a full lat-long map, ``solid_angles`` in sr.
    ``pixels`` are (row, column) in a picture of ``layout`` (height, width); ``focal_px`` and
    ``center_px`` (x, y) belong to a camera that looks along -Z. ``on_ground`` marks the pixels
    that take the ground's albedo instead of their own.
    """

    layout: tuple[int, int]
    focal_px: float
    center_px: tuple[float, float]
    pixels: UInt16[np.ndarray, "m 2"]
    normals: Float32[np.ndarray, "m 3"]
    albedo: Float32[np.ndarray, "m 3"]
    on_ground: Bool[np.ndarray, " m"]
    visible: UInt8[np.ndarray, "m bytes"]
    grid_layout: tuple[int, int]
    directions: Float32[np.ndarray, "n 3"]
    solid_angles: Float32[np.ndarray, " n"]

    def __post_init__(self) -> None:
        m, n = len(self.pixels), math.prod(self.grid_layout)
        shapes = {
            "pixels": (m, 2),
            "normals": (m, 3),
            "albedo": (m, 3),
            "on_ground": (m,),
            "visible": (m, math.ceil(n / 8)),
            "directions": (n, 3),
            "solid_angles": (n,),
        }
        for name, shape in shapes.items():
            got = getattr(self, name).shape
            if got != shape:
                raise ValueError(f"{name} must have the shape {shape}, got {got}")
        if m and (self.pixels.min() < 0 or (self.pixels.max(0) >= self.layout).any()):
            raise ValueError(f"pixels must lie in a picture of {self.layout}")

    def save(self, path: str | Path) -> None:
        """Write the scene as a compressed .npz."""
        path = Path(path)
        if path.suffix != ".npz":
            raise InputError(f"{path}: scenes are .npz files; choose a name that ends in .npz")
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        with atomic_path(path) as temporary:
            np.savez_compressed(temporary, format=SCENE_FORMAT, **arrays)


def load_scene(path: str | Path) -> PrecomputedScene:
    """A scene that :meth:`PrecomputedScene.save` wrote; :class:`InputError` for anything else."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such scene; write one with: skylight export scene MESH")
    try:
        names = [field.name for field in fields(PrecomputedScene)]
        arrays: dict[str, Any] = dict(load_arrays(path, ["format", *names]))
        if str(form := arrays.pop("format")) != SCENE_FORMAT:
            raise ValueError(f"format {form}")
        plain = {
            "layout": _whole_numbers(arrays.pop("layout")),
            "focal_px": float(arrays.pop("focal_px")),
            "center_px": tuple(arrays.pop("center_px").tolist()),
            "grid_layout": _whole_numbers(arrays.pop("grid_layout")),
        }
        _require_usable(plain, arrays)
        return PrecomputedScene(**plain, **arrays)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: damaged, or no scene of this version of skylight ({error}); write it again "
            "with: skylight export scene MESH"
        ) from error


def _whole_numbers(array: np.ndarray) -> tuple[int, ...]:
    if array.dtype.kind not in "iu":
        raise ValueError(f"a layout of {array.dtype}")
    return tuple(array.tolist())


def _require_usable(plain: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """ValueError for numbers of the wrong type, that are not finite, or of a huge picture."""
    for name, array in arrays.items():
        if array.dtype != _TYPES[name]:
            raise ValueError(f"{name} holds {array.dtype}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    (height, width), (rows, columns) = plain["layout"], plain["grid_layout"]
    require_pixels(width, height, PICTURE_PIXELS_MAX)
    require_pixels(columns, rows, DIRECTIONS_MAX)
    if columns != 2 * rows:
        raise ValueError(f"{columns} x {rows} directions are no lat-long map")
    if not 0 < plain["focal_px"] < math.inf or not np.isfinite(plain["center_px"]).all():
        raise ValueError("its camera is none")
