"""Observations: shading at pixels, and its transport."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from skylight.errors import InputError
from skylight.sphere._envmap import luminance
from skylight.transport._background import Background
from skylight.transport._matrix import TransportMatrix
from skylight.transport._normal_modes import NormalModes
from skylight.transport._visibility import PixelBlocks


@dataclass(frozen=True, kw_only=True)
class Observation:
    """``pixels`` (m,3) linear radiance, ``weights`` (m,) >= 0, ``transport`` of the same points.

    ``specular`` is the transport of a surface reflection at those points (see
    :func:`skylight.transport._reflection.specular_transport`), or None for diffuse things.

    ``places`` (m,2) are the pixels' (row, column) in their picture: the image pyramid merges
    neighbours by them.

    ``modes`` (m,k) are smooth fields over the surface by which its albedo may vary (see
    :func:`skylight.faces._skin.pigment_modes`), or None for what is of one albedo.

    ``normal_modes`` are how the points' normals may be wrong, or None where they are known. They
    have a grid of their own.

    ``camera_lamp`` is shading by a lamp at the camera and its reflection (see
    :func:`skylight.transport._reflection.camera_lamp`), or None where it is not asked for.

    ``clipped`` (m,) tells where ``pixels`` are lower bounds, because the picture is over-exposed
    there; None where it is nowhere.

    ``grey``: the picture has no colour, and its three equal channels are luminance.

    ``background`` is what the same photograph shows beside the people, or None where it is not
    known or not to be used.
    """

    pixels: Float[Tensor, "m 3"]
    weights: Float[Tensor, " m"]
    places: Int[Tensor, "m 2"]
    transport: TransportMatrix
    specular: TransportMatrix | None = None
    clipped: Bool[Tensor, " m"] | None = None
    grey: bool = False
    modes: Float[Tensor, "m k"] | None = None
    normal_modes: NormalModes | None = None
    camera_lamp: Float[Tensor, "m 2"] | None = None
    background: Background | None = None

    def __post_init__(self) -> None:
        count = len(self.pixels)
        if count == 0 or not bool((self.weights > 0).any()):
            raise ValueError("an observation needs at least one pixel with a positive weight")
        if len(self.weights) != count or len(self.transport.matrix) != count:
            raise ValueError(
                f"pixels ({count}), weights ({len(self.weights)}) and transport rows "
                f"({len(self.transport.matrix)}) must match"
            )

        if len(self.places) != count:
            raise ValueError(f"places ({len(self.places)}) must match pixels ({count})")
        if self.clipped is not None and len(self.clipped) != count:
            raise ValueError(f"clipped ({len(self.clipped)}) must match pixels ({count})")
        if self.modes is not None and len(self.modes) != count:
            raise ValueError(f"modes ({len(self.modes)}) must match pixels ({count})")
        if self.camera_lamp is not None and len(self.camera_lamp) != count:
            raise ValueError(f"camera_lamp ({len(self.camera_lamp)}) must match pixels ({count})")
        if self.normal_modes is not None and len(self.normal_modes) != count:
            raise ValueError(f"normal_modes ({len(self.normal_modes)}) must match pixels ({count})")
        if self.specular is not None and self.specular.matrix.shape != self.transport.matrix.shape:
            raise ValueError("specular must have the shape of the transport")

    @property
    def mean_luminance(self) -> float:
        """Of all pixels; :class:`InputError` where they are black."""
        mean = float(luminance(self.pixels).mean())
        if not 0 < mean < math.inf:
            raise InputError(
                f"what is observed has a mean luminance of {mean:g}; give a picture that is lit"
            )
        return mean

    def to(self, device: torch.device) -> "Observation":
        """The same on a device; grids of directions stay on the CPU."""

        def moved(transport: TransportMatrix) -> TransportMatrix:
            return replace(transport, matrix=transport.matrix.to(device))

        return replace(
            self,
            pixels=self.pixels.to(device),
            weights=self.weights.to(device),
            places=self.places.to(device),
            transport=moved(self.transport),
            specular=None if self.specular is None else moved(self.specular),
            clipped=None if self.clipped is None else self.clipped.to(device),
            modes=None if self.modes is None else self.modes.to(device),
            normal_modes=None if self.normal_modes is None else self.normal_modes.to(device),
            camera_lamp=None if self.camera_lamp is None else self.camera_lamp.to(device),
            background=None if self.background is None else self.background.to(device),
        )

    def scaled(self, factor: float) -> "Observation":
        """The same with all pixels multiplied."""
        background = None if self.background is None else self.background.scaled(factor)
        return replace(self, pixels=self.pixels * factor, background=background)

    def on_rows(self, rows: int) -> "Observation":
        """The same for light on a lat-long grid of fewer rows.

        See :meth:`TransportMatrix.on_rows`.
        """
        return replace(
            self,
            transport=self.transport.on_rows(rows),
            specular=None if self.specular is None else self.specular.on_rows(rows),
            normal_modes=None if self.normal_modes is None else self.normal_modes.on_rows(rows),
            background=None if self.background is None else self.background.on_rows(rows),
        )

    def coarser(self, level: int) -> "Observation":
        """The observation at 1 / 2^level of the picture's resolution; level 0 is itself.

        Pixels, modes and transport rows are weighted means over blocks, which commutes with
        shading: it is linear in T, and modes are smooth, those of normals too. A block's weight is
        the sum of its pixels' weights. Clipped pixels make blocks of their own.
        """
        if level == 0:
            return self
        blocks = PixelBlocks.of(self.places, self.weights, self.clipped, 2**level)
        means = blocks.means

        def merged(transport: TransportMatrix) -> TransportMatrix:
            return TransportMatrix(matrix=means(transport.matrix), grid=transport.grid)

        normal_modes = self.normal_modes
        if normal_modes is not None:
            bent = means(normal_modes.modes.flatten(1)).unflatten(1, (3, -1))
            normal_modes = replace(normal_modes, modes=bent, visible=means(normal_modes.visible))
        return replace(
            self,
            pixels=means(self.pixels),
            weights=blocks.weights,
            places=blocks.places,
            transport=merged(self.transport),
            specular=None if self.specular is None else merged(self.specular),
            clipped=blocks.clipped,
            modes=None if self.modes is None else means(self.modes),
            normal_modes=normal_modes,
            camera_lamp=None if self.camera_lamp is None else means(self.camera_lamp),
        )
