"""Glossy reflection of skin: a transport matrix with a microfacet BRDF."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

from skylight.sphere.grid import DirectionGrid
from skylight.transport.diffuse import DiffuseTransport
from skylight.transport.matrix import TransportMatrix
from skylight.transport.render import Specular, ggx

_BLOCK = 2**17  # entries at a time: 6 MB of intermediate results, which the processor's caches hold


class GlossyTransport(DiffuseTransport):
    """Reflection of distant light at m glossy points: ``sum_w f_s(n_p, w, v_p) V <n_p, w>+ L dw``.

    ``forward(radiance, gloss)`` is :class:`DiffuseTransport`'s with the strength of the lobe in
    the place of the albedo; differentiable in radiance, gloss and normals, the latter where the
    cosine with the view is above 0.01. ``views`` (towards the camera) are unit vectors.

    Memory: about ten times 4 m n bytes while the matrix is computed.
    """

    views: Tensor

    def __init__(
        self,
        visibility: Bool[Tensor, "m n"],
        normals: Float[Tensor, "m 3"],
        grid: DirectionGrid,
        *,
        views: Float[Tensor, "m 3"],
        specular: Specular,
    ) -> None:
        super().__init__(visibility, normals, grid)
        self.specular = specular
        self.register_buffer("views", views)

    def _compute(self) -> Float[Tensor, "m n"]:
        normals = normalize(self.normals, dim=1)
        light, views = self.directions.to(normals), self.views.to(normals)
        return math.pi * specular_lobe(normals, views, light, self.specular) * super()._compute()


def glossy_transport(
    transport: TransportMatrix,
    normals: Float[Tensor, "m 3"],
    views: Float[Tensor, "m 3"],
    specular: Specular,
) -> TransportMatrix:
    """G[p, w] = f_s(n_p, w, v_p) V(p, w) <n_p, w>+ dw = pi f_s T[p, w].

    ``normals`` and ``views`` (towards the camera) are unit vectors; visibility and cosine come
    from ``transport``, so that no ray is cast. Memory: 4 m n bytes of result and a few MB.
    """
    light = transport.grid.directions.float()
    out = torch.empty_like(transport.matrix)
    block = max(1, _BLOCK // len(light))
    for start in range(0, len(normals), block):
        rows = slice(start, start + block)
        lobe = specular_lobe(normals[rows].float(), views[rows].float(), light, specular)
        out[rows] = math.pi * lobe * transport.matrix[rows]
    return TransportMatrix(matrix=out, grid=transport.grid)


def camera_lamp(
    normals: Float[Tensor, "m 3"], views: Float[Tensor, "m 3"], specular: Specular | None
) -> Float[Tensor, "m 2"]:
    """(<n,v>, pi f_s <n,v>): T and G for a lamp at the camera, of irradiance pi and no shadow.

    It is taken to be far away: one at the camera lights a face at 50 cm unevenly by a quarter, at
    1.5 m by a twelfth. Without ``specular`` the second is 0.
    """
    facing = (normals * views).sum(1).clamp(min=0)
    gloss = torch.zeros_like(facing)
    if specular is not None:
        n_v = facing.clamp(min=1e-2)
        gloss = math.pi * ggx(n_v[None], n_v, torch.ones_like(n_v)[None], specular)[0] * facing
    return torch.stack([facing, gloss], 1)


def specular_lobe(
    normals: Float[Tensor, "m 3"],
    views: Float[Tensor, "m 3"],
    light: Float[Tensor, "n 3"],
    specular: Specular,
) -> Float[Tensor, "m n"]:
    """f_s(n_p, w, v_p) in 1/sr; all three are unit vectors, ``views`` towards the camera."""
    n_v = (normals * views).sum(1).clamp(min=1e-2)
    return ggx((light @ normals.T).clamp(min=0), n_v, light @ views.T, specular).T
