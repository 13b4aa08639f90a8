"""Blurred levels of a cube map."""

import math

import pytest
import torch

from skylight.relight._gltf import prefiltered_levels
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._projections import cube_faces, face_directions
from tests.axis_colours import AXES, axis_map


def test_levels_halve_down_to_sixteen_and_the_first_is_the_map() -> None:
    light = axis_map(32)
    levels = prefiltered_levels(light, 64)
    assert [level.shape for level in levels] == [(6, 64, 64, 3), (6, 32, 32, 3), (6, 16, 16, 3)]
    assert torch.equal(levels[0], cube_faces(light, 64))


def test_constant_light_stays_constant() -> None:
    for level in prefiltered_levels(EnvironmentMap(radiance=torch.full((16, 32, 3), 2.5)), 32):
        torch.testing.assert_close(level, torch.full_like(level, 2.5))


def test_every_axis_keeps_its_colour_at_every_level() -> None:
    for level in prefiltered_levels(axis_map(), 64)[:2]:
        middle = level.shape[1] // 2
        for number, (_, colour) in enumerate(AXES.values()):
            seen = level[number, middle, middle]
            torch.testing.assert_close(seen, torch.tensor(colour), atol=0.12, rtol=0)


@pytest.mark.parametrize("angle_deg", [0.0, 25.0, 70.0])
def test_a_point_of_light_shows_the_lobe(angle_deg: float) -> None:
    height = 64
    sun = torch.zeros(height, 2 * height, 3)
    sun[32, 64] = 1.0
    light = EnvironmentMap(radiance=sun)
    level = prefiltered_levels(light, 32)[-1].double()  # 16 pixels, alpha 1
    towards = light.grid.directions.reshape(height, 2 * height, 3)[32, 64]
    cosines = face_directions(16) @ towards
    place = (cosines - math.cos(math.radians(angle_deg))).abs().argmin()
    cosine = float(cosines.flatten()[place])
    # alpha 1: D = 1 / pi whatever h, and the weights' sum is that of the cosine, pi
    solid = float(light.grid.solid_angles.reshape(height, -1)[32, 64])
    expected = max(cosine, 0.0) * solid / math.pi
    assert float(level.reshape(-1, 3)[place, 0]) == pytest.approx(expected, rel=1e-2, abs=1e-9)
