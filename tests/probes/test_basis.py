import math

import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.probes._encoder import SurfaceTransfer, surface_points, surface_transfer
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import TransferSampling, transfer_coefficients
from skylight.sphere._frame import DirectionGrid
from tests.probes.objects import GRID, lights, ring_and_ball, solid, transfer_of


def test_a_ball_shows_clamped_cosines():
    ball = solid(trimesh.creation.icosphere(3))
    receivers = surface_points(ball, 40, torch.Generator().manual_seed(0))
    functions = surface_transfer(ball, receivers, GRID).functions
    cosine = (receivers.normals @ GRID.directions.T).float()
    expected = receivers.albedo[:, None].float() * cosine.clamp(min=0)[..., None] / math.pi
    free = cosine.abs() > 0.2  # at grazing angles the ball's facets are in the way
    torch.testing.assert_close(functions[free], expected[free], atol=1e-5, rtol=1e-4)


def test_shading_is_the_integral_of_light():
    transfer = transfer_of(ring_and_ball(), 10)
    light = lights(2)
    total = torch.zeros(2, 10, 3, dtype=torch.float64)
    for d, angle in enumerate(GRID.solid_angles):
        total += transfer.functions[:, d].double() * light[:, d, None] * angle
    torch.testing.assert_close(transfer.shading(light), total)
    torch.testing.assert_close(transfer.at(torch.tensor([7])).shading(light), total[:, [7]])


def test_a_white_room_under_white_light_ends_up_white():
    """Albedo 1 under a light of 1 through the open ceiling: with all bounces, 1 everywhere."""
    box = trimesh.creation.box((2, 2, 2)).subdivide().subdivide()
    box.invert()
    box.update_faces(~(box.triangles_center[:, 1] > 0.999))
    room = solid(box, (1.0, 1.0, 1.0))
    floor = surface_points(room, 30, torch.Generator().manual_seed(1))
    white = torch.ones(1, len(GRID), 3)
    shown = [
        float(surface_transfer(room, floor, GRID, bounces=n, rays=48).shading(white).mean())
        for n in (0, 2, 30)
    ]
    assert shown[0] < 0.6
    assert shown == sorted(shown)
    assert shown[-1] == pytest.approx(1, abs=0.02)


def test_bounces_agree_with_the_transfer_of_a_partition_probe():
    """Light that is constant in each of a probe's cells, by two ways of casting rays."""
    scene = ring_and_ball()
    receivers = surface_points(scene, 40, torch.Generator().manual_seed(2))
    cells = Cells.of(named_design("6d"))
    fine = DirectionGrid.latlong(32)
    functions = surface_transfer(scene, receivers, fine, bounces=2).functions
    weighted = functions * fine.solid_angles.float()[:, None]
    ours = torch.zeros(40, 6, 3).index_add(1, cells.cell_of(fine.directions), weighted)
    theirs = transfer_coefficients(
        scene, cells, receivers, sampling=TransferSampling(rays=512, bounces=2)
    ).values
    assert float((ours - theirs).square().mean().sqrt()) < 0.05 * float(theirs.mean())
    assert float(ours.mean()) == pytest.approx(float(theirs.mean()), rel=0.01)


def test_bounces_keep_colours_apart():
    red = Scene.joined([solid(trimesh.creation.icosphere(2), (0.9, 0.0, 0.5))])
    box = trimesh.creation.box((4, 0.2, 4))
    box.apply_translation([0, -1.1, 0])
    scene = Scene.joined([red, solid(box, (0.5, 0.5, 0.5))])
    below = Receivers(
        positions=torch.tensor([[1.2, -1.0, 0.0]]).double(),
        normals=torch.tensor([[0.0, 1, 0]]).double(),
        geometric_normals=torch.tensor([[0.0, 1, 0]]).double(),
        albedo=torch.full((1, 3), 0.5).double(),
    )
    direct = surface_transfer(scene, below, GRID).functions
    once = surface_transfer(scene, below, GRID, bounces=1).functions
    gain = ((once - direct) * GRID.solid_angles.float()[:, None]).sum((0, 1))
    assert float(gain[1]) == pytest.approx(0, abs=1e-6)
    assert float(gain[0] / gain[2]) == pytest.approx(0.9 / 0.5, rel=1e-4)


def test_refusals():
    scene = solid(trimesh.creation.icosphere(1))
    receivers = surface_points(scene, 2, torch.Generator().manual_seed(0))
    with pytest.raises(InputError, match="bounces"):
        surface_transfer(scene, receivers, GRID, bounces=-1)
    with pytest.raises(ValueError, match="512 directions"):
        SurfaceTransfer(functions=torch.ones(2, 5, 3), grid=GRID)
    with pytest.raises(InputError, match="NaN"):
        SurfaceTransfer(functions=torch.full((2, 512, 3), torch.nan), grid=GRID)
