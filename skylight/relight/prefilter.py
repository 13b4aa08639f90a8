"""Cube maps prefiltered for rough metals, one level per roughness."""

import torch
from jaxtyping import Float
from torch import Tensor

from skylight.sphere.cube_faces import cube_faces, face_directions
from skylight.sphere.envmap import EnvironmentMap
from skylight.transport.render import reflection_weights

LAST_SIZE = 16  # pixels of the roughest level
BLURRED_ROWS = 64  # of the map that rough levels are made from: cells of 2.8 degrees
_BLOCK = 1024  # directions at a time: 64 MB of scratch


def prefiltered_levels(environment: EnvironmentMap, size: int) -> list[Float[Tensor, "6 s s 3"]]:
    """Faces of ``size``, half of it, and so on down to 16 pixels a side.

    Level m of n stands for the perceptual roughness m / (n - 1) and alpha, its square. Level 0 is
    the map itself; the others are

        L'(r) = sum_w L(w) D(h) <r,w>+ dw / sum_w D(h) <r,w>+ dw,

    with D the GGX density (:func:`skylight.transport.render.reflection_weights`).
    """
    levels = [cube_faces(environment, size)]
    coarse = environment
    if environment.layout[0] > BLURRED_ROWS:
        coarse = environment.resize(BLURRED_ROWS)
    grid, light = coarse.grid, coarse.flat.float()
    sizes = []
    while size // 2 >= LAST_SIZE:
        size //= 2
        sizes.append(size)
    for number, smaller in enumerate(sizes, start=1):
        alpha = (number / len(sizes)) ** 2
        towards = face_directions(smaller).reshape(-1, 3)
        blurred = [reflection_weights(r, grid, alpha) @ light for r in towards.split(_BLOCK)]
        levels.append(torch.cat(blurred).reshape(6, smaller, smaller, 3).to(levels[0]))
    return levels
