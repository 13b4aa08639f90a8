"""Pictures of the sphere: where they look, and that light survives the journey."""

import math
from typing import get_args

import pytest
import torch

from skylight.errors import InputError
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._projections import Projection, from_latlong, looks, places, shape, to_latlong

AXES = torch.eye(3, dtype=torch.float64)
X, Y, Z = AXES
HEIGHTS: dict[Projection, int] = {"latlong": 64, "cube": 96, "octahedral": 64, "angular": 96,
                                  "mirrorball": 96}  # fmt: skip


@pytest.mark.parametrize(
    ("projection", "u", "v", "direction"),
    [
        ("latlong", 0.5, 0.5, -Z),
        ("latlong", 0.75, 0.5, X),
        ("latlong", 0.3, 0.0, Y),
        ("cube", 3 / 8, 1 / 2, -Z),
        ("cube", 5 / 8, 1 / 2, X),
        ("cube", 1 / 8, 1 / 2, -X),
        ("cube", 7 / 8, 1 / 2, Z),
        ("cube", 3 / 8, 1 / 6, Y),
        ("cube", 3 / 8, 5 / 6, -Y),
        ("octahedral", 0.5, 0.5, Y),
        ("octahedral", 1.0, 0.5, X),
        ("octahedral", 0.5, 0.0, -Z),
        ("octahedral", 0.0, 0.0, -Y),
        ("angular", 0.5, 0.5, -Z),
        ("angular", 0.75, 0.5, X),
        ("angular", 0.5, 0.25, Y),
        ("mirrorball", 0.5, 0.5, Z),
        ("mirrorball", 0.5 + math.sqrt(0.125), 0.5, X),
        ("mirrorball", 0.5, 0.5 - math.sqrt(0.125), Y),
    ],
)
def test_axes_are_where_the_definition_says(projection, u, v, direction):
    seen = looks(projection, *torch.tensor([u, v], dtype=torch.float64).split(1))
    torch.testing.assert_close(seen.directions[0], direction, atol=1e-12, rtol=0)


@pytest.mark.parametrize("projection", get_args(Projection))
def test_every_direction_is_seen_once(projection):
    directions = torch.nn.functional.normalize(
        torch.randn(5000, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64), dim=1
    )
    seen = looks(projection, *places(projection, directions))
    torch.testing.assert_close(seen.directions, directions, atol=1e-7, rtol=0)
    assert seen.inside.all()


@pytest.mark.parametrize("projection", get_args(Projection))
def test_solid_angles_make_a_sphere(projection):
    rows, columns = shape(projection, 600)
    v, u = torch.meshgrid(
        (torch.arange(rows).double() + 0.5) / rows,
        (torch.arange(columns).double() + 0.5) / columns,
        indexing="ij",
    )
    seen = looks(projection, u.flatten(), v.flatten())
    total = (seen.density * seen.inside).sum() / rows**2
    assert float(total) == pytest.approx(4 * math.pi, rel=2e-3)
    # and each density is the ratio of solid angle to area: finite differences
    step = 1e-6
    middle = seen.inside.nonzero()[5000:-5000:997, 0]
    at = [u.flatten()[middle], v.flatten()[middle]]
    here = looks(projection, *at).directions
    right = looks(projection, at[0] + step * rows / columns, at[1]).directions - here
    down = looks(projection, at[0], at[1] + step).directions - here
    solid = torch.linalg.cross(right, down).norm(dim=1) / step**2
    smooth = (right.norm(dim=1) < 1e-4) & (down.norm(dim=1) < 1e-4)  # not across a border
    assert smooth.double().mean() > 0.9
    torch.testing.assert_close(solid[smooth], seen.density[middle][smooth], rtol=1e-3, atol=1e-3)


def smooth_map(height: int = 64) -> EnvironmentMap:
    blank = EnvironmentMap(radiance=torch.zeros(height, 2 * height, 3))
    x, y, z = blank.grid.directions.float().unbind(1)
    radiance = torch.stack([1 + x, 1 + y * z, 1 + 0.5 * z + x * y], 1)
    return EnvironmentMap(radiance=radiance.reshape(height, 2 * height, 3))


@pytest.mark.parametrize("projection", get_args(Projection))
def test_smooth_light_survives_the_journey(projection):
    light = smooth_map()
    picture = from_latlong(light, projection, HEIGHTS[projection])
    again = to_latlong(picture, projection, 64)
    # pixels are constant: a border of 2 to 4 degrees
    assert float((again.radiance - light.radiance).abs().mean()) < 0.03
    torch.testing.assert_close(again.integrate(), light.integrate(), rtol=0.01, atol=0)


@pytest.mark.parametrize("projection", get_args(Projection))
def test_a_sun_keeps_its_place_and_its_energy(projection):
    sun = torch.zeros(64, 128, 3)
    sun[20, 75] = 1e4
    light = EnvironmentMap(radiance=sun + 0.1)
    height = 4 * HEIGHTS[projection]
    again = to_latlong(from_latlong(light, projection, height), projection, 64)
    away = float(again.brightest_direction().double() @ light.brightest_direction().double())
    assert math.degrees(math.acos(min(away, 1))) < 1.5
    torch.testing.assert_close(again.integrate(), light.integrate(), rtol=0.1, atol=0)


def test_corners_of_round_pictures_are_black():
    for projection in ("angular", "mirrorball"):
        picture = from_latlong(smooth_map(), projection, 48)
        assert picture[0, 0].abs().max() == 0
        assert picture[24, 24].min() > 0


def test_wrong_shapes_are_named():
    with pytest.raises(InputError, match="64 rows"):
        from_latlong(smooth_map(), "cube", 64)
    with pytest.raises(InputError, match="128 columns"):
        to_latlong(torch.zeros(96, 96, 3), "cube", 64)
    with pytest.raises(InputError, match="lower half"):
        from_latlong(smooth_map().upper(), "angular", 64)
