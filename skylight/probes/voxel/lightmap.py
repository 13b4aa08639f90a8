"""The lightmap: a picture of shading for each of the 192 kinds of voxel faces.

As one image it is 12 rows of 16 slots: two rows for each orientation in the order of
:data:`~skylight.probes.voxel.faces.ORIENTATIONS`, the first for configurations 0 to 15, the second
for those with a ceiling (after Fig. 3.3 of the thesis). A slot's row 0 lies forward, column 0 left.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.imaging.atomic import atomic_path
from skylight.probes.voxel.faces import CONFIGURATIONS, ORIENTATIONS

SLOTS_ACROSS = 16
SLOTS_DOWN = len(ORIENTATIONS) * CONFIGURATIONS // SLOTS_ACROSS
SIZE = 16
_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Lightmap:
    """``radiance`` (6 orientations, 32 configurations, n, n, 3), linear, >= 0.

    ``coverage``: the share of a slot's texels that were seen unsaturated, 0 where nothing was
    captured. ``confidence``: camera pixels for each texel of the view that was kept.
    """

    radiance: Float[Tensor, "6 32 n n 3"]
    coverage: Float[Tensor, "6 32"]
    confidence: Float[Tensor, "6 32"]

    def __post_init__(self) -> None:
        slots = (len(ORIENTATIONS), CONFIGURATIONS)
        shapes = self.radiance.shape, self.coverage.shape, self.confidence.shape
        if (
            self.radiance.ndim != 5
            or self.radiance.shape[:2] != slots
            or self.radiance.shape[2] != self.radiance.shape[3]
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

    def save(self, path: Path) -> None:
        """As .npz, which :func:`load_lightmap` reads."""
        with atomic_path(path) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream,
                version=np.array(_VERSION),
                radiance=self.radiance.numpy().astype(np.float32),
                coverage=self.coverage.numpy().astype(np.float32),
                confidence=self.confidence.numpy().astype(np.float32),
            )


def load_lightmap(path: str | Path) -> Lightmap:
    """A lightmap as :meth:`Lightmap.save` wrote it."""
    try:
        with np.load(path, allow_pickle=False) as content:
            version = int(content["version"])
            arrays = [torch.from_numpy(content[k]) for k in ("radiance", "coverage", "confidence")]
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as a lightmap ({error})") from error
    if version != _VERSION:
        raise InputError(f"{path}: a lightmap of version {version}, this program reads {_VERSION}")
    if not all(bool(a.isfinite().all()) for a in arrays):
        raise InputError(f"{path}: the lightmap has values that are NaN or infinite")
    return Lightmap(radiance=arrays[0], coverage=arrays[1], confidence=arrays[2])


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
