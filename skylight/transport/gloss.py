"""The surface reflection of skin as a second transport matrix."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.transport.matrix import TransportMatrix
from skylight.transport.render import Specular, ggx


def glossy_transport(
    transport: TransportMatrix,
    normals: Float[Tensor, "m 3"],
    views: Float[Tensor, "m 3"],
    specular: Specular,
    *,
    block: int = 512,
) -> TransportMatrix:
    """G[p, w] = f_s(n_p, w, v_p) V(p, w) <n_p, w>+ dw = pi f_s T[p, w].

    ``normals`` and ``views`` (towards the camera) are unit vectors; visibility and cosine come
    from ``transport``, so that no ray is cast. Memory: 4 m n bytes of result and about ten times
    4 ``block`` n of scratch.
    """
    light = transport.grid.directions.float()
    out = torch.empty_like(transport.matrix)
    for start in range(0, len(normals), block):
        rows = slice(start, start + block)
        n, v = normals[rows].float(), views[rows].float()
        lobe = ggx(
            (light @ n.T).clamp(min=0), (n * v).sum(1).clamp(min=1e-2), light @ v.T, specular
        )
        out[rows] = math.pi * lobe.T * transport.matrix[rows]
    return TransportMatrix(matrix=out, grid=transport.grid)
