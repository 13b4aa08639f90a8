"""An object of known shape and colour as a light probe: what its points show tells of the light.

    python examples/light_from_known_object.py

Of 300 points on a ring round a ball, the 40 are chosen that tell other objects' shading best. What
they show under a sky, with noise, relights a cube that was not there.
"""

import torch
import trimesh

import skylight
from skylight.models import LambertianGround
from skylight.probes import (
    ObjectEncoder,
    SurfaceTransfer,
    choose_points,
    surface_points,
    surface_transfer,
)
from skylight.probes.partitions.relight import Relighting, Scene

SKY, GROUND = skylight.SunSky(8), LambertianGround(8)
GRID = skylight.DirectionGrid.latlong(16)
ALBEDO = torch.tensor([[0.1, 0.1, 0.08]])  # of the ground
# sky colour, sun colour, azimuth and zenith angle of the sun, turbidity, sharpness of the sun
LIGHT = torch.tensor([[0.3, 0.4, 0.6, 3.0, 2.7, 2.4, 0.7, 0.9, 3.0, 5.0]])
NOISE = 0.01  # of what the points show


def points_of(*meshes: trimesh.Trimesh, count: int) -> SurfaceTransfer:
    """How points of grey meshes gather the light of the grid, shadows of one another included."""
    scene = Scene.joined(
        [
            Scene.of(torch.tensor(m.vertices), torch.tensor(m.faces), torch.full((3,), 0.5))
            for m in meshes
        ]
    )
    points = surface_points(scene, count, torch.Generator().manual_seed(0))
    return surface_transfer(scene, points, GRID)


def relight() -> float:
    """Error of the cube's shading, relative to its own."""
    ring, ball = trimesh.creation.torus(1.0, 0.3), trimesh.creation.icosphere(2, 0.5)
    candidates = points_of(ring, ball, count=300)
    chosen = candidates.at(choose_points(candidates, 40, noise=NOISE, lit=candidates))
    encoder = ObjectEncoder(chosen, noise=NOISE).requires_grad_(False)
    radiance = GROUND.append(SKY(LIGHT), ALBEDO)[0]
    shading = encoder(radiance)
    noise = torch.randn(shading.shape, generator=torch.Generator().manual_seed(1))
    shading = shading + NOISE * shading.square().mean().sqrt() * noise
    cube = points_of(trimesh.creation.box(), count=200)
    relit = Relighting(encoder.transfer(cube))(shading)
    true = cube.shading(radiance[None])[0]
    return float((relit - true).norm() / true.norm())


if __name__ == "__main__":
    print(f"the cube's shading is off by {relight():.1%}")
