"""What a voxel probe shows under a sky, and what follows from it for faces that it does not have.

    python examples/complete_voxel_lightmap.py

The star of 7 voxels shows 30 of the 192 kinds of faces that voxel models have. Those alone light
any other model; here they are compared with what the star of 25 voxels shows besides.
"""

import torch

import skylight
from skylight.models import LambertianGround
from skylight.probes.voxel import DirectReconstruction, star_probe

SKY, GROUND = skylight.SunSky(32), LambertianGround(32)
GRID = skylight.DirectionGrid.latlong(64)
ALBEDO = torch.tensor([[0.1, 0.1, 0.08]])  # of the ground
# sky colour, sun colour, azimuth and zenith angle of the sun, turbidity, sharpness of the sun
LIGHT = torch.tensor([[0.3, 0.4, 0.6, 3.0, 2.7, 2.4, 0.7, 0.9, 3.0, 60.0]])


def complete() -> tuple[int, int, float]:
    """(kinds of faces shown, kinds compared, their relative error as completed)."""
    radiance = GROUND.append(SKY(LIGHT), ALBEDO)[0]
    small, large = (skylight.VoxelProbe(star_probe(n), 0.5).requires_grad_(False) for n in (3, 5))
    lightmap = small(radiance, GRID)  # (6, 32, n, n, 3): sides, occluded neighbours, texels
    completed = DirectReconstruction(small.known)(lightmap)
    others = large.known & ~small.known
    true = large(radiance, GRID)[others]
    error = (completed[others] - true).norm() / true.norm()
    return int(small.known.sum()), int(others.sum()), float(error)


if __name__ == "__main__":
    shown, others, error = complete()
    print(f"{others} kinds of faces from the {shown} that are seen, off by {error:.0%}")
