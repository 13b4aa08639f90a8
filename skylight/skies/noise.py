"""Periodic noise in three dimensions, tabulated and interpolated."""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

CELLS = 16  # period of the tile, in cells of the coarser octave
_SIZE = 96  # samples a side: 3 in a cell of the finer octave
_OCTAVES = 2
_TILE_SEED = 20150101


def fractal_noise(points: Float[Tensor, "*s 3"]) -> Float[Tensor, "*s"]:
    """Smooth random values, uniform on [0, 1], at positions in cells (period ``CELLS``).

    Two octaves of Perlin's (2002) gradient noise, summed with amplitudes 1 and 1/2 and brought
    to a uniform distribution by rank. Trilinear between the table's nodes, which draws values
    a little to the middle: P(fractal_noise < q) is within 0.03 of q.
    """
    table = _tile(str(points.device))
    # align_corners puts -1 and 1 on the first node and on its repetition at the end
    grid = torch.remainder(points * (2 / CELLS), 2.0).sub_(1).reshape(1, 1, 1, -1, 3)
    value = torch.nn.functional.grid_sample(table, grid, align_corners=True)
    return value.reshape(points.shape[:-1])


@cache
def _tile(device: str) -> Float[Tensor, "1 1 n n n"]:
    """The table, (z, y, x) as grid_sample wants it, its first nodes repeated at the end."""
    axis = torch.arange(_SIZE, dtype=torch.float64) * (CELLS / _SIZE)
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    total = torch.zeros_like(x)
    generator = torch.Generator().manual_seed(_TILE_SEED)
    for octave in range(_OCTAVES):
        lattice = CELLS * 2**octave
        # the finer octaves keep off the nodes of the table, where gradient noise is zero
        shift = 0.37 * octave
        gradients = torch.randn(lattice, lattice, lattice, 3, generator=generator).double()
        gradients = gradients / gradients.norm(dim=-1, keepdim=True)
        scaled = [c * 2**octave + shift for c in (x, y, z)]
        total += 0.5**octave * _gradient_noise(scaled, gradients)
    rank = total.reshape(-1).argsort().argsort().double()
    uniform = ((rank + 0.5) / rank.numel()).float().reshape(total.shape)
    padded = torch.nn.functional.pad(uniform[None, None], (0, 1, 0, 1, 0, 1), mode="circular")
    return padded.to(device)


def _gradient_noise(
    position: list[Float[Tensor, "n n n"]], gradients: Float[Tensor, "l l l 3"]
) -> Float[Tensor, "n n n"]:
    """Perlin's improved noise with one unit gradient per node of a periodic lattice."""
    size = len(gradients)
    cell = [torch.floor(p) for p in position]
    part = [p - c for p, c in zip(position, cell, strict=True)]
    fade = [p**3 * (p * (p * 6 - 15) + 10) for p in part]
    total = torch.zeros_like(position[0])
    for corner in range(8):
        offset = [(corner >> axis) & 1 for axis in range(3)]
        node = [(c.long() + o) % size for c, o in zip(cell, offset, strict=True)]
        weight = math.prod(f if o else 1 - f for f, o in zip(fade, offset, strict=True))
        slope = gradients[node[2], node[1], node[0]]
        away = torch.stack([p - o for p, o in zip(part, offset, strict=True)], -1)
        total = total + weight * (slope * away).sum(-1)
    return total
