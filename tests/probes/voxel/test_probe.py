"""The voxel probe as a module: furnace, free faces, radiosity by brute force, batches, state."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from skylight.errors import InputError
from skylight.probes.voxel._model import NORMALS, VoxelModel, star_probe
from skylight.probes.voxel._probe import VoxelProbe
from skylight.probes.voxel._reconstruct import DirectReconstruction
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from tests.oracles.radiosity import corner_radiance

GRID = DirectionGrid.latlong(32)
RGB = torch.tensor([0.9, 0.6, 0.3], dtype=torch.float64)


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_a_free_face_shows_albedo_times_irradiance_over_pi() -> None:
    """Of light of degree 2, E = A_l c_lm Y_lm(n): Ramamoorthi and Hanrahan 2001."""
    probe = VoxelProbe(star_probe(3), RGB, size=4)
    coefficients = random(9, 3)
    grid = DirectionGrid.latlong(96)
    light = harmonics.evaluate(grid.directions, 2) @ coefficients
    shown = probe(light, grid)[:, 0]
    lobe = harmonics.cosine_coefficients(2)[harmonics.bands(2), None]
    normals = torch.from_numpy(NORMALS).double()
    expected = RGB / math.pi * (harmonics.evaluate(normals, 2) @ (lobe * coefficients))
    torch.testing.assert_close(shown, expected[:, None, None].expand_as(shown), rtol=0, atol=1e-3)


def test_a_corner_shows_what_radiosity_gives() -> None:
    albedo = 0.7
    corner = VoxelModel(occupied=np.array([[[True], [True]], [[True], [False]]]))
    probe = VoxelProbe(corner, albedo, size=8)
    centres, radiance = corner_radiance(albedo, 24)
    along = centres[:: len(np.unique(centres[:, 1])), 0]
    by_wall = radiance.reshape(len(along), -1).mean(1)  # the wall is at x = 0
    shown = probe(torch.ones(len(GRID), 3).double(), GRID)[2, 1, ..., 0].mean(0)  # +Y, wall left
    texels = (np.arange(8) + 0.5) / 8
    expected = torch.from_numpy(np.interp(texels, along, by_wall))
    torch.testing.assert_close(shown.detach(), expected, rtol=5e-3, atol=0)


def test_only_slots_of_the_model_are_shown_and_the_others_follow() -> None:
    probe = VoxelProbe(star_probe(3), size=2).requires_grad_(False)
    light = random(len(GRID), 3)
    slots = probe(light, GRID)
    assert int(probe.known.sum()) == 30
    assert not slots[~probe.known].any()
    completed = DirectReconstruction(probe.known)(slots)
    larger = VoxelProbe(star_probe(7), size=2).requires_grad_(False)
    assert int((larger.known & ~probe.known).sum()) > 0
    missing = larger.known & ~probe.known
    off = (completed - larger(light, GRID))[missing].abs().mean()
    # bounces between walls are what the sums of direct light leave out
    assert float(off) < 0.2 * float(larger(light, GRID)[missing].mean())


def test_lights_of_any_leading_shape_are_each_by_itself() -> None:
    probe = VoxelProbe(star_probe(3), size=2).requires_grad_(False)
    light = random(2, 3, len(GRID), 3)
    slots = probe(light, GRID)
    assert slots.shape == (2, 3, 6, 32, 2, 2, 3)
    torch.testing.assert_close(slots[1, 2], probe(light[1, 2], GRID))


def test_light_and_albedo_have_gradients() -> None:
    """Along a direction of both, against the central difference: its error is of order h^2."""
    grid = DirectionGrid.latlong(3)
    probe = VoxelProbe(star_probe(1), size=1, degree=1)
    weight = random(6, 3, seed=1)
    places = [random(len(grid), 3).requires_grad_(), probe.albedo]
    directions = [random(*each.shape, seed=2 + i) - 0.5 for i, each in enumerate(places)]

    def shown(light: Tensor, albedo: Tensor) -> Tensor:
        slots = torch.func.functional_call(probe, {"albedo": albedo}, (light, grid))
        return (weight * slots[:, 0].sum((1, 2))).sum()

    slopes = torch.autograd.grad(shown(*places), places)
    expected = sum(float((s * d).sum()) for s, d in zip(slopes, directions, strict=True))
    step = 1e-4
    with torch.no_grad():
        above, below = (
            float(shown(*[p + h * d for p, d in zip(places, directions, strict=True)]))
            for h in (step, -step)
        )
    assert (above - below) / (2 * step) == pytest.approx(expected, rel=1e-6)


def test_what_follows_from_the_albedo_follows_its_changes() -> None:
    probe, light = VoxelProbe(star_probe(3), size=2), random(len(GRID), 3)
    optimiser = torch.optim.Adam(probe.parameters(), lr=0.05)
    probe(light, GRID).sum().backward()
    optimiser.step()
    fresh = VoxelProbe(star_probe(3), probe.albedo.detach(), size=2)
    loaded = VoxelProbe(star_probe(3), 0.3, size=2)
    loaded.load_state_dict(probe.state_dict())
    assert set(probe.state_dict()) == {"albedo"}
    with torch.no_grad():
        expected = fresh(light, GRID)
        before = VoxelProbe(star_probe(3), size=2)(light, GRID)
        assert not torch.allclose(expected, before)
        for same in (probe, loaded):
            torch.testing.assert_close(same(light, GRID), expected)


def test_precision_and_device_are_those_of_the_light(device: torch.device) -> None:
    light = random(len(GRID), 3).to(device)
    probe = VoxelProbe(star_probe(3), RGB, size=2).to(device).requires_grad_(False)
    slots = probe(light, GRID)
    assert slots.dtype == torch.float64
    assert slots.device.type == device.type
    assert probe(light.float(), GRID).dtype == torch.float32
    torch.testing.assert_close(probe(light.float(), GRID), slots.float())
    torch.testing.assert_close(probe.float()(light, GRID), slots, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("albedo", [torch.full((30,), 0.5), torch.full((6, 3), 0.5), 1.2])
def test_impossible_materials_are_refused(albedo: Tensor | float) -> None:
    with pytest.raises(InputError, match="albedo"):
        VoxelProbe(star_probe(3), albedo)


def test_radiance_of_another_grid_is_refused() -> None:
    with pytest.raises(InputError, match=r"\.\.\., 2048, 3"):
        VoxelProbe(star_probe(3), size=2)(random(8, 3), GRID)
