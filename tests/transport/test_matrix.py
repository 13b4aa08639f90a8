import math

import pytest
import torch

from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix, diffuse_transport, visibility
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals
from tests.transport.shapes import icosphere, seen_sphere


def quad(*corners):
    return torch.tensor(corners, dtype=torch.float64), torch.tensor([[0, 1, 2], [0, 2, 3]])


def test_furnace_a_convex_surface_of_albedo_1_reflects_all_of_a_constant_light():
    vertices, faces = icosphere(3)
    normals = vertex_normals(vertices, faces)
    transport = diffuse_transport(
        vertices, normals, normals, Raycaster(vertices, faces), DirectionGrid.latlong(32)
    )
    torch.testing.assert_close(
        transport.matrix.sum(1), torch.ones(len(vertices)), atol=2e-3, rtol=0
    )


def test_a_wall_takes_half_of_the_light_of_a_floor_at_its_foot():
    # The cosine is symmetric about the wall's plane. The wall reaches 1000 times further.
    vertices, faces = quad([-10, -10, 0], [10, -10, 0], [10, 10, 0], [-10, 10, 0])
    point, up = torch.tensor([[0.0, 0, 0.01]]), torch.tensor([[0.0, 1, 0]])
    grid = DirectionGrid.latlong(32)
    transport = diffuse_transport(point, up, up, Raycaster(vertices, faces), grid)
    assert transport.matrix.sum().item() == pytest.approx(0.5, abs=2e-3)


@pytest.mark.parametrize(("along", "wall"), [(1.0, 1.0), (0.5, 2.0), (1.5, 0.5)])
def test_a_right_angled_groove_keeps_the_share_of_its_form_factor(along, wall):
    # A floor along x and a wall along y meet in the z axis. Seen from the floor at x = along,
    # light is free from the horizon up to the wall's edge, at tan(angle) = along / wall from the
    # normal: the share is (1 + sin angle) / 2 for walls endless in z.
    floor, faces = quad([0, 0, -20], [0, 0, 20], [2, 0, 20], [2, 0, -20])
    side, _ = quad([0, 0, -20], [0, wall, -20], [0, wall, 20], [0, 0, 20])
    caster = Raycaster(torch.cat([floor, side]), torch.cat([faces, faces + 4]))
    point, up = torch.tensor([[along, 0.0, 0.0]]), torch.tensor([[0.0, 1, 0]])
    transport = diffuse_transport(point, up, up, caster, DirectionGrid.latlong(64))
    expected = (1 + math.sin(math.atan2(along, wall))) / 2
    assert transport.matrix.sum().item() == pytest.approx(expected, abs=8e-3)


def test_a_coarse_sphere_has_no_speckles():
    gbuffer, caster = seen_sphere(subdivisions=2)
    grid = DirectionGrid.latlong(16)
    start = (gbuffer.normals, gbuffer.geometric_normals, caster, grid)
    transport = diffuse_transport(gbuffer.origins, *start)
    cosine = gbuffer.normals @ grid.directions.T
    assert (transport.matrix[cosine > 1e-3] > 0).all()
    # the test can fail: starts on the flat triangles are shadowed by the next facet
    flat = diffuse_transport(gbuffer.positions, *start)
    assert (flat.matrix[cosine > 1e-3] == 0).any()


def test_entries_are_cosine_times_solid_angle_over_pi():
    gbuffer, caster = seen_sphere(subdivisions=4, height=16)
    grid = DirectionGrid.latlong(16)
    transport = diffuse_transport(
        gbuffer.origins, gbuffer.normals, gbuffer.geometric_normals, caster, grid
    )
    cosine = (gbuffer.normals @ grid.directions.T).clamp(min=0)
    expected = (cosine * grid.solid_angles / math.pi).float()
    torch.testing.assert_close(transport.matrix, expected, atol=1e-7, rtol=1e-4)


def test_every_number_of_processes_gives_the_same_bytes():
    gbuffer, caster = seen_sphere(subdivisions=2, height=24)
    surface = (gbuffer.origins, gbuffer.normals, gbuffer.geometric_normals)
    grid, seen = DirectionGrid.latlong(16), []
    one = diffuse_transport(*surface, caster, grid, progress=seen.append)
    three = diffuse_transport(*surface, caster, grid, workers=3)
    assert torch.equal(one.matrix, three.matrix)
    visible = [visibility(surface[0], surface[2], caster, grid, workers=n) for n in (1, 3)]
    assert torch.equal(visible[0], visible[1])
    assert seen == sorted(seen)
    assert seen[-1] == 1


def test_visibility_is_what_the_matrix_does_not_see_shaded():
    """Also below the horizon of a normal, where the matrix has no entries."""
    gbuffer, caster = seen_sphere(subdivisions=3, height=24)
    grid = DirectionGrid.latlong(16)
    seen = visibility(gbuffer.origins, gbuffer.geometric_normals, caster, grid)
    tilted = gbuffer.normals.flip(1)
    for normals in (gbuffer.normals, tilted):
        transport = diffuse_transport(
            gbuffer.origins, normals, gbuffer.geometric_normals, caster, grid
        )
        cosine = (normals.float() @ grid.directions.T.float()) > 0
        assert torch.equal(seen & cosine, transport.matrix > 0)
    # a convex body hides what is behind the tangent plane and nothing else
    height = gbuffer.geometric_normals @ grid.directions.T
    assert seen[height > 0.1].all()
    assert not seen[height < -0.3].any()  # origins are clear of the facets


@pytest.fixture
def random_transport():
    grid = DirectionGrid.latlong(4)
    matrix = torch.rand(5, len(grid), generator=torch.Generator().manual_seed(0))
    return TransportMatrix(matrix=matrix, grid=grid)


def test_folding_the_ground_equals_a_uniform_lower_half(random_transport):
    light = torch.cat([torch.linspace(0, 1, 16), torch.full((16,), 0.3)])
    folded = random_transport.fold_ground() @ torch.cat([light[:16], light[-1:]])
    torch.testing.assert_close(folded, random_transport.matrix @ light)


def test_a_sky_grid_has_no_ground_to_fold():
    grid = DirectionGrid.sky(4)
    with pytest.raises(ValueError, match="full lat-long"):
        TransportMatrix(matrix=torch.zeros(1, len(grid)), grid=grid).fold_ground()


def test_projection_commutes_with_expanding_the_basis(random_transport):
    basis, coefficients = torch.randn(32, 4), torch.randn(4)
    torch.testing.assert_close(
        random_transport.project(basis) @ coefficients,
        random_transport.matrix @ (basis @ coefficients),
    )
