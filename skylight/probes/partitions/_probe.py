"""The partition probe as a linear encoder of light: radiance to shading, and back."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from skylight._modes import Derived, on_cpu
from skylight._module import Module
from skylight.errors import InputError, check_shape
from skylight.probes.partitions._cells import Cells
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid

_FINE_ROWS = 512  # into which maps are divided at least, to share pixels between cells
_WORST_CONDITION = 1e4


class PartitionProbe(Module):
    """A kernel of n Lambertian faces, each of which sees its own cell (thesis, 4.4).

    ``probe(radiance, grid)`` is the shading, radiance of the faces,
    ``s_i = rho_i / pi int_cell_i L(w) <n_i, w>+ dw`` (Eq. 4.3), linear Rec.709; constant radiance
    L_j of the cells gives ``s = rho / pi * (A @ L)``.

    On a grid each direction belongs to one cell, and each cell's directions weigh as much as
    the cell, so that uniform light comes out exactly and decoded shading encodes to itself. Basis
    functions are off by how finely the grid covers the cells: with 128 rows by at most 0.5 % for
    14 even cells and 5 % for 110, with 64 rows by 2 % and 21 %.

    Parameters
    ----------
    albedo
        rho, an ``nn.Parameter`` (n,3): a number or what broadcasts to that, (3,) for colours,
        (n,1) for faces.
    response
        A (n,n) as measured on a printed probe, whose walls have thickness and are not quite
        black: a buffer. Without it A is ``diag(cells.facing)``, which follows from the cells and
        is not in the ``state_dict``. The cells are never in it; they are those of the design's
        file.
    """

    albedo: nn.Parameter
    facing: Tensor
    response: Tensor

    @on_cpu
    def __init__(
        self,
        cells: Cells,
        albedo: float | Float[Tensor, "*_"] = 0.8,
        *,
        response: Float[Tensor, "n n"] | None = None,
    ) -> None:
        super().__init__()
        self.cells = cells
        measured = response is not None
        response = response.double() if measured else torch.diag(cells.facing)
        _check_response(response, cells.count)
        self.albedo = nn.Parameter(_albedo(albedo, cells.count))
        self.register_buffer("facing", cells.facing, persistent=False)
        self.register_buffer("response", response, persistent=measured)
        self._cell: Derived[Tensor] = Derived()
        self._share: Derived[Tensor] = Derived()

    @property
    def inverse(self) -> Float[Tensor, "n n"]:
        """A^-1, float64."""
        # there is one, as was found when the response was given
        return torch.linalg.inv_ex(self.response.double()).inverse

    @property
    def weights(self) -> Float[Tensor, "n 3"]:
        """w_i = (rho / pi int_cell <n_i, w>+ dw)^-1 of the ideal probe (Eq. 4.5)."""
        return math.pi / (self.albedo * self.facing[:, None])

    @property
    def correction(self) -> Float[Tensor, " n"]:
        """d_i: what of a face's hemisphere, cosine-weighted, its cell is (Eq. 4.24)."""
        return self.facing / math.pi

    def forward(
        self, radiance: Float[Tensor, "*b d 3"], grid: DirectionGrid
    ) -> Float[Tensor, "*b n 3"]:
        """``rho / pi A L``: shading ``(..., n, 3)`` of the n faces, L_j the light of cell j.

        That is the mean of radiance ``(..., d, 3)`` on a grid of the whole sphere over the cell, as
        its face weighs it; in the radiance's units, linear, differentiable.
        Light from other cells that ``response`` lets in counts as their own faces average it.
        """
        check_shape("PartitionProbe's radiance", radiance.shape, len(grid), 3)
        cell, share = self._shares(grid)
        # float64 sums: a sun is 1e5 times brighter than the pixels it is added to
        shape = *radiance.shape[:-2], len(self.facing), 3
        mean = radiance.new_zeros(shape, dtype=torch.float64)
        mean = mean.index_add(-2, cell, radiance.double() * share[:, None])
        return (self.albedo / math.pi * (self.response.double() @ mean)).to(radiance)

    def encode_map(self, environment: EnvironmentMap) -> Float[Tensor, "n 3"]:
        """Shading under a full map; pixels on borders are shared between their cells."""
        if environment.is_sky:
            raise InputError("a probe sees the whole sphere: give the sky map a ground first")
        height, width = environment.layout
        samples = math.ceil(_FINE_ROWS / height)
        fine = environment.radiance.repeat_interleave(samples, 0).repeat_interleave(samples, 1)
        grid = DirectionGrid.latlong(height * samples, width * samples)
        return self(fine.flatten(0, 1).to(self.response.device), grid)

    def light(self, shading: Float[Tensor, "*b n 3"]) -> Float[Tensor, "*b n 3"]:
        """Each cell's constant radiance, ``A^-1 (pi s / rho)``: s_i w_i if ideal (Eq. 4.6)."""
        check_shape("PartitionProbe's shading", shading.shape, len(self.facing), 3)
        return (self.inverse @ (math.pi * shading.double() / self.albedo)).to(shading)

    def decode(
        self, shading: Float[Tensor, "*b n 3"], grid: DirectionGrid
    ) -> Float[Tensor, "*b d 3"]:
        """Radiance reconstructed from shading, constant within each cell."""
        return self.light(shading)[..., self._cell_of(grid), :]

    def basis(self, grid: DirectionGrid) -> Float[Tensor, "n d 3"]:
        """b_i = rho / pi V_i <n_i, w>+ for each colour, of the ideal probe (Eq. 4.18)."""
        cell, share = self._shares(grid)
        values = share.new_zeros(len(self.facing), len(cell))
        every = torch.arange(len(cell), device=cell.device)
        values[cell, every] = share / grid.solid_angles.to(share)
        gathered = (self.albedo * self.facing[:, None] / math.pi).to(values)
        return values[..., None] * gathered[:, None]

    def dual_basis(self, grid: DirectionGrid) -> Float[Tensor, "n d 3"]:
        """b*_i = b_i / int b_i^2 dw (Eq. 4.22), with int b_i b*_j dw = delta_ij (Eq. 4.21)."""
        basis = self.basis(grid)
        return basis / (basis**2 * grid.solid_angles.to(basis)[:, None]).sum(1, keepdim=True)

    def unpartitioned(
        self, radiance: Float[Tensor, "*b d 3"], grid: DirectionGrid
    ) -> Float[Tensor, "*b n 3"]:
        """s'_i: shading of the faces without any walls, as of points on a ball (Eq. 4.23).

        Times :attr:`correction` it is s''_i (Eq. 4.25).
        """
        check_shape("PartitionProbe's radiance", radiance.shape, len(grid), 3)
        _check_whole(grid)
        cosine = (self.cells.normals @ grid.directions.T).clamp(min=0) * grid.solid_angles
        share = (cosine / cosine.sum(1, keepdim=True)).to(radiance.device)
        return (self.albedo * (share @ radiance.double())).to(radiance)

    def _shares(self, grid: DirectionGrid) -> tuple[Int[Tensor, " d"], Float[Tensor, " d"]]:
        """Each direction's cell, and its part of what that cell's face gathers; sums are 1.

        Kept on the probe's device: many maps of one size come after each other.
        """
        sources = [grid.directions, grid.solid_angles, self.facing]
        share = self._share.of(sources, lambda: self._find_shares(grid))
        return self._cell_of(grid), share

    def _cell_of(self, grid: DirectionGrid) -> Int[Tensor, " d"]:
        device = self.facing.device
        return self._cell.of(
            [grid.directions, self.facing],
            lambda: self.cells.cell_of(grid.directions).to(device),
        )

    def _find_shares(self, grid: DirectionGrid) -> Float[Tensor, " d"]:
        _check_whole(grid)
        cell = self.cells.cell_of(grid.directions)
        # within 0.6 degrees of the horizon are no cells, so that this is above 0
        weight = (self.cells.normals[cell] * grid.directions).sum(1) * grid.solid_angles
        total = weight.new_zeros(len(self.facing)).index_add(0, cell, weight)
        if not torch.compiler.is_compiling() and bool((total == 0).any()):
            raise InputError(
                f"no direction of the grid is in cell {int(total.argmin())}: use a finer grid"
            )
        return (weight / total[cell]).to(self.facing.device)


def _check_whole(grid: DirectionGrid) -> None:
    if torch.compiler.is_compiling():
        return  # values cannot be looked at
    if abs(float(grid.solid_angles.sum()) - 4 * math.pi) > 1e-6:
        raise InputError("a probe sees the whole sphere, and the grid is only a part of it")


def _check_response(response: Float[Tensor, "n m"], count: int) -> None:
    if response.shape != (count, count):
        raise InputError(
            f"the response is {tuple(response.shape)}, but the probe has {count} cells: measure it "
            "on this design"
        )
    if not bool(response.isfinite().all()) or float(torch.linalg.cond(response)) > _WORST_CONDITION:
        raise InputError(
            "the response cannot be inverted, some faces do not tell cells apart: check the print"
        )


def _albedo(albedo: float | Float[Tensor, "*_"], count: int) -> Float[Tensor, "n 3"]:
    value = torch.as_tensor(albedo, dtype=torch.float64)
    try:
        value = value.expand(count, 3).clone()
    except RuntimeError as error:
        raise InputError(
            f"an albedo of shape {tuple(value.shape)} does not fit {count} faces: give a number, "
            f"3 colours, or ({count}, 1) or ({count}, 3)"
        ) from error
    if not bool(((value > 0) & (value <= 1)).all()):
        raise InputError("the albedo must be above 0 and at most 1")
    return value
