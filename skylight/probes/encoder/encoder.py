"""A known object as an encoder of light: the dual of its own basis (thesis, 4.4.4 and 7.1.1)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.errors import InputError
from skylight.probes.encoder.basis import SurfaceTransfer
from skylight.probes.encoder.points import DEPENDENT
from skylight.probes.partitions.relight.transfer import TransferCoefficients
from skylight.sphere.envmap import EnvironmentMap


class ObjectEncoder(nn.Module):
    """Shading of k points as coefficients of the light in the dual of the points' basis.

    ``encoder(radiance)`` is the shading, :meth:`decode` the light that it tells of. The functions
    b_i of an object's points are not orthogonal. Their dual is ``b* = (G + r)^-1 b`` with the Gram
    matrix ``G_ij = int b_i b_j dw``. Without ridge r it is bi-orthogonal,
    ``int b_i b*_j dw = delta_ij`` (Eq. 4.21), and ``L = sum_i s_i b*_i`` is, of all lights that
    show the shading s, the one of least ``int L^2 dw``. A probe whose functions do not overlap has
    a diagonal G and Eq. 4.22 for its dual.

    The ridge follows from the noise: ``r = noise^2 mean_i G_ii`` makes L the best linear estimate
    for lights that are white noise on the sphere, where errors of the shading are independent
    with a standard deviation of ``noise`` times its root mean square (Wiener filter; Tarantola
    2005, 3.2).

    ``basis`` (3,k,d) is an ``nn.Parameter``, which photographs under known light can calibrate;
    the dual is solved for whenever it is asked for.
    """

    basis: nn.Parameter
    solid_angles: Tensor

    def __init__(self, points: SurfaceTransfer, *, noise: float = 0.0) -> None:
        super().__init__()
        if not noise >= 0:
            raise InputError(f"the noise must be 0 or more, got {noise:g}")
        self.grid, self.noise = points.grid, noise
        rows = points.weighted()
        values = torch.linalg.svdvals(rows)
        if values.shape[1] < len(points) or bool((values[:, 0] == 0).any()):
            raise InputError(
                f"{len(points)} points on a grid of {len(self.grid)} directions, or points that no "
                "light reaches: choose others or a finer grid"
            )
        if noise == 0 and bool((values[:, -1] < DEPENDENT * values[:, 0]).any()):
            raise InputError(
                "some points show the same as others together: choose fewer or give the noise"
            )
        self.basis = nn.Parameter(rows / self.grid.solid_angles.sqrt())
        self.register_buffer("solid_angles", self.grid.solid_angles, persistent=False)

    @property
    def gram(self) -> Float[Tensor, "3 k k"]:
        """G_ij = int b_i b_j dw for each colour."""
        return (self.basis * self.solid_angles) @ self.basis.mT

    @property
    def ridge(self) -> Float[Tensor, "3"]:
        """r for each colour."""
        return self.noise**2 * self._rows.square().sum(-1).mean(-1)

    @property
    def dual(self) -> Float[Tensor, "3 k d"]:
        """b*_i for each colour.

        ``R^-1 Q_1^T`` with ``[B^T; sqrt(r) I] = [Q_1; Q_2] R`` of the rows B, ``sqrt(dw) b``: the
        Gram matrix, whose condition is that of B squared, is never formed.
        """
        rows = self._rows
        ridge = self.ridge.sqrt()[:, None, None] * torch.eye(rows.shape[1]).to(rows)
        orthogonal, triangle = torch.linalg.qr(torch.cat([rows.mT, ridge], dim=1))
        mine = orthogonal[:, : rows.shape[2]].mT
        return torch.linalg.solve_triangular(triangle, mine, upper=True) / self.solid_angles.sqrt()

    @property
    def _rows(self) -> Float[Tensor, "3 k d"]:
        return self.basis * self.solid_angles.sqrt()

    def forward(self, radiance: Float[Tensor, "*b d 3"]) -> Float[Tensor, "*b k 3"]:
        """What the points show under lights on the encoder's grid; linear, differentiable."""
        power = radiance.to(self.basis.dtype) * self.solid_angles[:, None]
        return torch.einsum("ckd,...dc->...kc", self.basis, power).to(radiance.dtype)

    def encode_map(self, environment: EnvironmentMap) -> Float[Tensor, "k 3"]:
        """What the points show under a map, which is averaged to the encoder's grid."""
        if self.grid.layout is None or environment.is_sky:
            raise InputError("a map needs an encoder on a lat-long grid, and the whole sphere")
        return self(environment.resize(self.grid.layout[0]).flat.to(self.solid_angles.device))

    def decode(self, shading: Float[Tensor, "*b k 3"]) -> Float[Tensor, "*b d 3"]:
        """The light ``sum_i s_i b*_i`` on the grid; it may be negative in places."""
        light = torch.einsum("...kc,ckd->...dc", shading.to(self.basis.dtype), self.dual)
        return light.to(shading.dtype)

    @torch.no_grad()
    def transfer(self, receivers: SurfaceTransfer) -> TransferCoefficients:
        """``t_i(x) = int T_x(w) b*_i(w) dw``: points x then show ``sum_i s_i t_i(x)``.

        With :class:`skylight.probes.partitions.relight.relit.Relighting` the captured shading
        lights them, as that of a partition probe does. All bounces count as one order, under a
        light of 1.
        """
        if not torch.equal(receivers.grid.directions, self.grid.directions):
            raise InputError("the encoder and what it lights need one and the same grid")
        weighted = self.dual * self.solid_angles
        values = torch.einsum("mdc,ckd->mkc", receivers.functions.to(weighted), weighted)
        white = self(torch.ones(1, len(self.grid), 3).to(self.basis))
        return TransferCoefficients(
            values=values.float(), orders=(values * white).sum(1).mean()[None].float()
        )
