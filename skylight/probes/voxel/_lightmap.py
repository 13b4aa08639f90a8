"""The lightmap: a square of shading, a slot, for each of the 192 kinds of voxel faces.

As one image it is 12 rows of 16 slots: two rows for each orientation in the order of
:data:`~skylight.probes.voxel._model.ORIENTATIONS`, the first for configurations 0 to 15, the second
for those with a ceiling (after Fig. 3.3 of the thesis). A slot's row 0 lies forward, column 0 left.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging._colour import linear_to_srgb
from skylight.io._atomic import atomic_path
from skylight.io._bounded import load_arrays
from skylight.probes.voxel._model import CONFIGURATIONS, ORIENTATIONS

SLOTS_ACROSS = 16
SLOTS_DOWN = len(ORIENTATIONS) * CONFIGURATIONS // SLOTS_ACROSS
SIZE = 16
_VERSION = 1
_MOST_BYTES = 2**29  # slots of 256 x 256 take 151 MB


@dataclass(frozen=True, kw_only=True)
class Lightmap:
    """``radiance`` (6 orientations, 32 configurations, n, n, 3), linear, >= 0.

    ``coverage``: the share of a slot's texels that were seen unsaturated, 0 where nothing was
    captured. ``confidence``: camera pixels for each texel of the view that was kept. ``faces``:
    which face of the probe that was, -1 for none. ``rotation`` takes the probe's axes, which are
    those of the slots, to the board's.
    """

    radiance: Float[Tensor, "6 32 n n 3"]
    coverage: Float[Tensor, "6 32"]
    confidence: Float[Tensor, "6 32"]
    faces: Int[Tensor, "6 32"] = field(default_factory=lambda: torch.full((6, 32), -1))
    rotation: Float[Tensor, "3 3"] = field(
        default_factory=lambda: torch.eye(3, dtype=torch.float64)
    )

    def __post_init__(self) -> None:
        slots = (len(ORIENTATIONS), CONFIGURATIONS)
        shapes = self.radiance.shape, self.coverage.shape, self.confidence.shape
        if (
            self.radiance.ndim != 5
            or self.radiance.shape[:2] != slots
            or self.radiance.shape[2] != self.radiance.shape[3]
            or self.radiance.shape[2] < 2
            or self.radiance.shape[4] != 3
            or shapes[1:] != (slots, slots)
        ):
            raise InputError(f"a lightmap is 6 x 32 square slots of 3 colours, got {shapes}")

    @staticmethod
    def blank(size: int = SIZE) -> "Lightmap":
        slots = len(ORIENTATIONS), CONFIGURATIONS
        return Lightmap(
            radiance=torch.zeros(*slots, size, size, 3),
            coverage=torch.zeros(slots),
            confidence=torch.zeros(slots),
        )

    @property
    def size(self) -> int:
        """Texels along a slot's side."""
        return self.radiance.shape[2]

    @property
    def known(self) -> Bool[Tensor, "6 32"]:
        return self.coverage > 0

    def image(self) -> Float[Tensor, "h w 3"]:
        """All slots side by side."""
        n = self.size
        slots = self.radiance.reshape(SLOTS_DOWN, SLOTS_ACROSS, n, n, 3)
        return slots.transpose(1, 2).reshape(SLOTS_DOWN * n, SLOTS_ACROSS * n, 3)

    def png(self, exposure: float = 1.0) -> UInt8[np.ndarray, "h w 3"]:
        """:meth:`image` as sRGB codes; what exceeds 1 is clipped."""
        encoded = linear_to_srgb((self.image() * exposure).clamp(0, 1))
        return (encoded.numpy() * 255 + 0.5).astype(np.uint8)

    def save(self, path: Path) -> None:
        """As .npz, which :func:`load_lightmap` reads."""
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream,
                version=np.array(_VERSION),
                radiance=self.radiance.numpy().astype(np.float32),
                coverage=self.coverage.numpy().astype(np.float32),
                confidence=self.confidence.numpy().astype(np.float32),
                faces=self.faces.numpy(),
                rotation=self.rotation.numpy().astype(np.float64),
            )


def load_lightmap(path: str | Path) -> Lightmap:
    """A lightmap as :meth:`Lightmap.save` wrote it."""
    names = ("radiance", "coverage", "confidence", "faces", "rotation")
    try:
        arrays = load_arrays(Path(path), ["version", *names], most=_MOST_BYTES)
        version = int(arrays.pop("version"))
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{path}: cannot be read as a lightmap ({error})") from error
    if version != _VERSION:
        raise InputError(f"{path}: a lightmap of version {version}, this program reads {_VERSION}")
    kinds = {"faces": "i", "rotation": "f"}
    for name, array in arrays.items():
        if array.dtype.kind != kinds.get(name, "f") or not np.isfinite(array).all():
            raise InputError(f"{path}: the lightmap's {name} are not finite numbers")
    if arrays["radiance"].ndim != 5 or arrays["radiance"].min(initial=0) < 0:
        raise InputError(f"{path}: the lightmap's radiance is no light of 6 x 32 slots")
    slots = (len(ORIENTATIONS), CONFIGURATIONS)
    if arrays["faces"].shape != slots or arrays["rotation"].shape != (3, 3):
        raise InputError(f"{path}: the lightmap's faces or rotation have a wrong shape")
    off = np.abs(arrays["rotation"] @ arrays["rotation"].T - np.eye(3)).max()
    if off > 1e-6:
        raise InputError(f"{path}: the lightmap's rotation is none")
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    return Lightmap(
        radiance=tensors["radiance"].float(),
        coverage=tensors["coverage"].float(),
        confidence=tensors["confidence"].float(),
        faces=tensors["faces"].long(),
        rotation=tensors["rotation"].double(),
    )


def texture_coordinates(
    orientation: Int[Tensor, " f"], configuration: Int[Tensor, " f"], *, inset: float = 0.0
) -> Float[Tensor, "f 4 2"]:
    """(u, v) of the corners of faces, in the order of ``VoxelFaces.corners``; v runs upwards.

    ``inset`` is the share of a slot's side by which coordinates are drawn in from its edges, so
    that filters of textures do not reach into the next slot; half a texel is 0.5 / n.
    """
    slot = orientation * CONFIGURATIONS + configuration
    row, column = slot // SLOTS_ACROSS, slot % SLOTS_ACROSS
    low, high = inset, 1 - inset
    # left-backward, right-backward, right-forward, left-forward; row 0 of a slot lies forward
    across = torch.tensor([low, high, high, low], dtype=torch.float64)
    down = torch.tensor([high, high, low, low], dtype=torch.float64)
    u = (column[:, None] + across) / SLOTS_ACROSS
    v = 1 - (row[:, None] + down) / SLOTS_DOWN
    return torch.stack([u, v], -1)
