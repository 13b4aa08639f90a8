"""A known object as an encoder of light: the dual of its own basis (thesis, 4.4.4 and 7.1.1)."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from skylight.errors import InputError
from skylight.probes.encoder.basis import SurfaceTransfer
from skylight.probes.encoder.points import DEPENDENT
from skylight.probes.partitions.transfer import TransferCoefficients
from skylight.sphere.envmap import EnvironmentMap


class ObjectEncoder(nn.Module):
    """Shading of k points as coefficients of the light in the dual of the points' basis.

    The functions b_i of an object's points are not orthogonal. Their dual is
    ``b* = (G + r)^-1 b`` with the Gram matrix ``G_ij = int b_i b_j dw``. Without ridge r it is
    bi-orthogonal, ``int b_i b*_j dw = delta_ij`` (Eq. 4.21), and ``L = sum_i s_i b*_i`` is, of all
    lights that show the shading s, the one of least ``int L^2 dw``. A probe whose functions do not
    overlap has a diagonal G and Eq. 4.22 for its dual.

    The ridge follows from the noise: ``r = noise^2 mean_i G_ii`` makes L the best linear estimate
    for lights that are white noise on the sphere, where errors of the shading are independent
    with a standard deviation of ``noise`` times its root mean square (Wiener filter; Tarantola
    2005, 3.2).

    ``singular_values`` (3,k) are those of ``sqrt(dw) b_i(w)``, descending, for each colour.
    """

    basis: Tensor
    dual: Tensor
    solid_angles: Tensor
    singular_values: Tensor
    ridge: Tensor

    def __init__(self, points: SurfaceTransfer, *, noise: float = 0.0) -> None:
        super().__init__()
        if not noise >= 0:
            raise InputError(f"the noise must be 0 or more, got {noise:g}")
        self.grid = points.grid
        rows = points.weighted()
        left, values, right = torch.linalg.svd(rows, full_matrices=False)
        if values.shape[1] < len(points) or bool((values[:, 0] == 0).any()):
            raise InputError(
                f"{len(points)} points on a grid of {len(self.grid)} directions, or points that no "
                "light reaches: choose others or a finer grid"
            )
        if noise == 0 and bool((values[:, -1] < DEPENDENT * values[:, 0]).any()):
            raise InputError(
                "some points show the same as others together: choose fewer or give the noise"
            )
        root = self.grid.solid_angles.sqrt()
        ridge = noise**2 * values.square().mean(1)
        share = values / (values.square() + ridge[:, None])
        self.register_buffer("basis", rows / root)
        self.register_buffer("dual", (left * share[:, None]) @ right / root)
        self.register_buffer("solid_angles", self.grid.solid_angles)
        self.register_buffer("singular_values", values)
        self.register_buffer("ridge", ridge)

    @property
    def gram(self) -> Float[Tensor, "3 k k"]:
        """G_ij = int b_i b_j dw for each colour."""
        return (self.basis * self.solid_angles) @ self.basis.mT

    @property
    def condition(self) -> float:
        """Largest over smallest singular value of the basis, sqrt(cond G); the worst colour's."""
        return float((self.singular_values[:, 0] / self.singular_values[:, -1]).max())

    @property
    def noise_gain(self) -> float:
        """How errors of the shading grow into light; the worst colour's.

        ``sqrt(mean_i G_ii  mean_i int b*_i^2 dw)``: 1 for orthogonal functions of equal norms, and
        more for all others if there is no ridge.
        """
        dual = (self.dual.square() @ self.solid_angles).mean(1)
        return float((self.singular_values.square().mean(1) * dual).sqrt().max())

    def encode(self, radiance: Float[Tensor, "b d 3"]) -> Float[Tensor, "b k 3"]:
        """What the points show under lights on the encoder's grid; linear, differentiable."""
        power = radiance.to(self.basis) * self.solid_angles[:, None]
        return torch.einsum("ckd,bdc->bkc", self.basis, power).to(radiance)

    def encode_map(self, environment: EnvironmentMap) -> Float[Tensor, "k 3"]:
        """What the points show under a map, which is averaged to the encoder's grid."""
        if self.grid.layout is None or environment.is_sky:
            raise InputError("a map needs an encoder on a lat-long grid, and the whole sphere")
        return self.encode(environment.resize(self.grid.layout[0]).flat[None])[0]

    def decode(self, shading: Float[Tensor, "b k 3"]) -> Float[Tensor, "b d 3"]:
        """The light ``sum_i s_i b*_i`` on the grid; it may be negative in places."""
        return torch.einsum("bkc,ckd->bdc", shading.to(self.dual), self.dual).to(shading)

    def transfer(self, receivers: SurfaceTransfer) -> TransferCoefficients:
        """``t_i(x) = int T_x(w) b*_i(w) dw``: points x then show ``sum_i s_i t_i(x)``.

        With :class:`skylight.probes.partitions.relit.Relighting` the captured shading lights them,
        as that of a partition probe does. All bounces count as one order, under a light of 1.
        """
        if not torch.equal(receivers.grid.directions, self.grid.directions):
            raise InputError("the encoder and what it lights need one and the same grid")
        weighted = self.dual * self.solid_angles
        values = torch.einsum("mdc,ckd->mkc", receivers.functions.to(weighted), weighted)
        white = self.encode(torch.ones(1, len(self.grid), 3, dtype=torch.float64))
        return TransferCoefficients(
            values=values.float(), orders=(values * white).sum(1).mean()[None].float()
        )
