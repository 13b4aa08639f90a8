"""Normals that may be wrong: light vectors of known lights, and shading of turned normals."""

import math

import pytest
import torch
from torch.nn.functional import normalize

from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from skylight.transport._normal_modes import NormalModes, SkyNormalModes

GRID = DirectionGrid.latlong(64)
POINTS, MODES, ROWS = 40, 3, 32


def open_transport(normals):
    """That of points that see their whole upper hemisphere."""
    cosine = (normals.double() @ GRID.directions.T).clamp(min=0)
    return TransportMatrix(matrix=(cosine * GRID.solid_angles / math.pi).float(), grid=GRID)


def across(normals, *shape, seed=0):
    """Random vectors perpendicular to the normals."""
    x = torch.randn(len(normals), 3, *shape, generator=torch.Generator().manual_seed(seed))
    unit = normals.reshape(len(normals), 3, *[1] * len(shape))
    return x - unit * (unit * x).sum(1, keepdim=True)


@pytest.fixture
def normals():
    return normalize(torch.randn(POINTS, 3, generator=torch.Generator().manual_seed(1)), dim=1)


def errors_of(normals, spread=0.1, seed=0):
    modes = spread * across(normals, MODES, seed=seed)
    return NormalModes.of(open_transport(normals), normals, modes, ROWS)


def test_the_light_vector_of_an_even_sky_is_the_normal(normals):
    # 1 / pi times the integral of w over a hemisphere
    errors = errors_of(normals)
    vector = errors.visible @ errors.grid.directions.float()
    torch.testing.assert_close(vector, normals, atol=0.01, rtol=0)


def test_fewer_rows_see_the_same_of_light_that_is_coarse(normals):
    """But for the directions of cells, which are their middles."""
    errors = errors_of(normals)
    coarse = errors.on_rows(8)
    assert coarse.grid.layout == (8, 16)
    assert errors.on_rows(64) is errors
    light = torch.rand(8, 16, generator=torch.Generator().manual_seed(2))
    fine = light.repeat_interleave(4, 0).repeat_interleave(4, 1).flatten()
    expected = (errors.visible * fine) @ errors.grid.directions.float()
    found = (coarse.visible * light.flatten()) @ coarse.grid.directions.float()
    torch.testing.assert_close(
        found, expected, atol=0.03 * float(expected.norm(dim=1).mean()), rtol=0.1
    )


def test_what_is_hidden_is_not_seen(normals):
    transport = open_transport(normals)
    hidden = GRID.directions[:, 0] > 0.2
    matrix = transport.matrix * ~hidden
    errors = NormalModes.of(
        TransportMatrix(matrix=matrix, grid=GRID), normals, across(normals, MODES), ROWS
    )
    coarse = errors.grid.directions[:, 0]
    assert float(errors.visible[:, coarse > 0.3].max()) == 0
    whole = errors_of(normals).visible
    torch.testing.assert_close(errors.visible[:, coarse < 0.1], whole[:, coarse < 0.1])


@pytest.mark.parametrize("turned_deg", [2.0, 10.0])
def test_shading_of_turned_normals_is_that_of_the_derivative(normals, turned_deg):
    axis = normalize(across(normals), dim=1)
    lamp = normalize(torch.tensor([0.4, 0.7, 0.6]), dim=0)
    cell = int((GRID.directions.float() @ lamp).argmax())
    lamp = GRID.directions[cell].float()
    errors = NormalModes.of(open_transport(normals), normals, axis[:, :, None], 64)
    radiance = torch.zeros(len(GRID))
    radiance[cell] = math.pi / float(GRID.solid_angles[cell])
    turn = math.tan(math.radians(turned_deg))
    vector = (errors.visible * radiance) @ GRID.directions.float()
    found = (normals @ lamp) + turn * (errors.modes[..., 0] * vector).sum(1)
    right = normalize(normals + turn * axis, dim=1) @ lamp
    lit = (normals @ lamp > 0.02) & (right > 0.02)
    assert int(lit.sum()) > 10
    # exact but for the length of n + u M
    torch.testing.assert_close(
        found[lit], right[lit] / math.cos(math.radians(turned_deg)), atol=1e-4, rtol=1e-4
    )
    assert 1 / math.cos(math.radians(10)) - 1 < 0.0155  # the bound that the module states


def folded(normals, seed):
    return SkyNormalModes.of(errors_of(normals, seed=seed))


def light(count, seed=3):
    generator = torch.Generator().manual_seed(seed)
    sky = torch.rand(count, len(GRID) // 2, 3, generator=generator)
    return sky, torch.rand(count, 3, generator=generator)


def test_a_sky_over_a_ground_is_the_whole_sphere(normals):
    errors = errors_of(normals)
    sky, ground = light(2)
    amounts = torch.tensor([[1.0, -0.5, 2.0], [0.0, 1.0, 0.3]])
    found = SkyNormalModes.of(errors)(sky, ground, amounts)
    assert found.shape == (2, POINTS, 3)
    for b in range(2):
        blocks = sky[b].reshape(ROWS // 2, 2, -1, 2, 3).mean((1, 3)).reshape(-1, 3)
        whole = torch.cat([blocks, ground[b].expand(len(blocks), 3)])
        for colour in range(3):
            vector = (errors.visible * whole[:, colour]) @ errors.grid.directions.float()
            turned = errors.modes @ amounts[b]
            torch.testing.assert_close(found[b, :, colour], (turned * vector).sum(1))
    assert float(SkyNormalModes.of(errors)(sky, ground, 0 * amounts).abs().max()) == 0


def test_scenes_in_one_batch_are_as_each_alone(normals):
    one, other = folded(normals, 5), folded(normals.flip(0), 6)
    both = SkyNormalModes(
        torch.cat([one.modes, other.modes]),
        torch.cat([one.visible, other.visible]),
        torch.cat([one.ground, other.ground]),
        one.rows,
    )
    sky, ground = light(3)
    amounts = torch.randn(3, MODES, generator=torch.Generator().manual_seed(7))
    found = both(sky, ground, amounts, torch.tensor([0, 1, 1]))
    torch.testing.assert_close(found[:1], one(sky[:1], ground[:1], amounts[:1]))
    torch.testing.assert_close(found[1:], other(sky[1:], ground[1:], amounts[1:]))


def test_some_points_alone(normals):
    errors, some = errors_of(normals), torch.arange(POINTS) % 3 == 0
    kept = errors.rows(some)
    assert len(kept) == int(some.sum())
    torch.testing.assert_close(kept.visible, errors.visible[some])
    torch.testing.assert_close(kept.modes, errors.modes[some])
