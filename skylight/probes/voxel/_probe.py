"""The voxel probe as a linear encoder of light: radiance to its lightmap."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from skylight._modes import Derived, on_cpu
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.probes.voxel._interreflection import (
    DEGREE,
    SIZE,
    face_frame,
    slot_transfer,
    solved_transfer,
)
from skylight.probes.voxel._model import ORIENTATIONS, VoxelModel, exposed_faces
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._rotation import rotate


class VoxelProbe(Module):
    """A voxel model of one Lambertian material as an encoder of light (thesis, 3.4.4).

    ``probe(radiance, grid)`` is the lightmap: of texel x of each slot
    ``s(x) = sum_i c_i t_i(x)`` (Eq. 3.15), with c the light's spherical harmonics up to
    ``degree`` and t the transfer coefficients, all bounces between a face and its neighbours
    included. Slots of which the model has no face are 0;
    :class:`~skylight.probes.voxel._reconstruct.SlotReconstruction` makes them from the others::

        slots = DirectReconstruction(probe.known)(probe(radiance, grid))

    Parameters
    ----------
    albedo
        An ``nn.Parameter`` (3,), a number or one for each colour. While it needs a gradient, the
        transfer is solved for in every call, in a second or so a colour; to optimise the light
        alone, ``probe.requires_grad_(False)``.
    size
        Texels along a slot's side, n.
    """

    albedo: nn.Parameter
    known: Bool[Tensor, "6 32"]
    into_faces: Float[Tensor, "6 k k"]

    @on_cpu
    def __init__(
        self,
        model: VoxelModel,
        albedo: float | Float[Tensor, "*_"] = 0.8,
        *,
        size: int = SIZE,
        degree: int = DEGREE,
    ) -> None:
        super().__init__()
        value = torch.as_tensor(albedo, dtype=torch.float64)
        if value.shape not in ((), (3,)):
            raise InputError(
                f"an albedo of shape {tuple(value.shape)}: a voxel probe is of one material, give "
                "a number or 3 colours"
            )
        if not bool(((value >= 0) & (value <= 1)).all()):
            raise InputError(f"an albedo lies in 0 to 1, got {value.tolist()}")
        self.size, self.degree = size, degree
        self.albedo = nn.Parameter(value.expand(3).clone())
        self.register_buffer("known", exposed_faces(model).counts() > 0, persistent=False)
        # harmonics, as rows, to those in the frame of each orientation's faces
        one = torch.eye((degree + 1) ** 2, dtype=torch.float64)
        frames = [face_frame(o) for o in range(len(ORIENTATIONS))]
        turns = torch.stack([rotate(one, frame.T) for frame in frames])
        self.register_buffer("into_faces", turns, persistent=False)
        self._basis: Derived[Tensor] = Derived()
        self._transfer: Derived[Tensor] = Derived()

    def forward(
        self, radiance: Float[Tensor, "*b d 3"], grid: DirectionGrid
    ) -> Float[Tensor, "*b 6 32 n n 3"]:
        """The lightmap, radiance of each slot's patches, under radiance ``(..., d, 3)`` on a grid.

        ``sum_w t(w) L(w) dw`` with t of :attr:`degree` bands; linear, differentiable, in L's units.
        """
        check_shape("VoxelProbe's radiance", radiance.shape, len(grid), 3)
        # float64 sums: a sun is 1e5 times brighter than the pixels it is added to
        sources = [grid.directions, grid.solid_angles, self.known]
        basis = self._basis.of(sources, lambda: self._integrals(grid))
        light = torch.einsum("dk,...dc->...ck", basis, radiance.double())
        turned = torch.einsum("...ck,okj->...ocj", light, self.into_faces.to(light))
        transfer = self._transfer.of([self.albedo], self._solved)
        slots = torch.einsum("cjxyk,...ock->...ojxyc", transfer, turned)
        return (slots * self.known[..., None, None, None]).to(radiance.dtype)

    def _integrals(self, grid: DirectionGrid) -> Float[Tensor, "d k"]:
        """From radiance to the coefficients c, on the probe's device."""
        basis = harmonics.evaluate(grid.directions, self.degree) * grid.solid_angles[:, None]
        return basis.double().to(self.known.device)

    def _solved(self) -> Float[Tensor, "3 32 n n k"]:
        """t of each colour, for light in the face's frame; solved for on the CPU."""
        if torch.compiler.is_compiling():
            return solved_transfer(self.albedo, self.size, self.degree).double()
        found = [slot_transfer(a, size=self.size, degree=self.degree) for a in self.albedo.cpu()]
        return torch.stack(found).double().to(self.albedo.device)
