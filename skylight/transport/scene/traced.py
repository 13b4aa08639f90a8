"""What of the evaluation scene has to be traced, and the files that come with skylight."""

import io
import lzma
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from skylight.errors import AssetError
from skylight.io.atomic import atomic_path
from skylight.transport.camera import Camera
from skylight.transport.gbuffer import CoveredPixels

DATA = Path(__file__).parent / "data"


@dataclass(frozen=True, kw_only=True)
class TracedScene:
    """What has to be traced for an :class:`EvaluationScene`: its pixels and what they see.

    ``visible`` tells which directions of the grid are free, wherever they are above the normal's
    horizon: bits, eight pixels of a direction a byte (:meth:`seen_by` unpacks some). ``mirrored``
    is where the metal's pixels mirror to.
    """

    height: int
    grid_height: int
    matt: CoveredPixels
    normals: Float[Tensor, "m 3"]
    on_ground: Bool[Tensor, " m"]
    visible: UInt8[np.ndarray, "n bytes"]
    metal: CoveredPixels
    mirrored: Float[Tensor, "k 3"]

    @property
    def path(self) -> Path:
        """Of the file in the package."""
        return shipped_path(self.height, self.grid_height)

    def seen_by(self, first: int, count: int) -> UInt8[Tensor, "n b"]:
        """1 where a direction is free for so many pixels from ``first`` on, a multiple of 8."""
        some = self.visible[:, first // 8 : -(-(first + count) // 8)]
        bits = np.unpackbits(some, axis=1)[:, : min(count, len(self.normals) - first)]
        return torch.from_numpy(bits)

    def save(self, path: Path) -> None:
        """Bits and float32 numbers, packed by LZMA."""
        arrays = {
            "layout": np.array(self.matt.layout),
            "matt": self.matt.pixels.numpy().astype(np.uint16),
            "normals": self.normals.numpy(),
            "on_ground": self.on_ground.numpy(),
            "visible": self.visible,
            "metal": self.metal.pixels.numpy().astype(np.uint16),
            "mirrored": self.mirrored.numpy(),
        }
        packed = io.BytesIO()
        np.savez(packed, **arrays)
        with atomic_path(path) as temporary:
            temporary.write_bytes(lzma.compress(packed.getvalue()))

    @staticmethod
    def load(path: Path) -> "TracedScene":
        """:class:`AssetError` for a file that is damaged."""
        try:
            arrays = np.load(io.BytesIO(lzma.decompress(path.read_bytes())))
            found = {name: torch.from_numpy(arrays[name]) for name in ("normals", "mirrored")}
            layout = tuple(arrays["layout"].tolist())
            return TracedScene(
                height=layout[0],
                grid_height=round((len(arrays["visible"]) / 2) ** 0.5),
                matt=_traced_pixels(layout, arrays["matt"]),
                on_ground=torch.from_numpy(arrays["on_ground"]),
                visible=np.ascontiguousarray(arrays["visible"]),
                metal=_traced_pixels(layout, arrays["metal"]),
                **found,
            )
        except (OSError, ValueError, KeyError, EOFError, lzma.LZMAError) as error:
            raise AssetError(f"{path}: damaged ({error}); reinstall skylight") from error


def _traced_pixels(layout: tuple[int, int], pixels: np.ndarray) -> CoveredPixels:
    return CoveredPixels(layout=layout, pixels=torch.from_numpy(pixels.astype(np.int64)))


def shipped_path(height: int, grid_height: int) -> Path:
    """Where the traced scene of a size is, if it is one of those that come with skylight."""
    return DATA / f"scene_{height}_{grid_height}.npz.xz"


def scene_camera(height: int) -> Camera:
    """It stays level, and looks down on the scene by a principal point near the top edge."""
    width = height * 4 // 3
    return Camera(
        focal_px=1.3 * height, width=width, height=height, center_px=(width / 2, 0.08 * height)
    )
