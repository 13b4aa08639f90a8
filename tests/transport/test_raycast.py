import numpy as np
import pytest
import torch

from skylight.transport._rays import Raycaster
from tests.oracles.raycasting import occluded


def triangle_soup(scale=1.0):
    generator = torch.Generator().manual_seed(1)
    centre = torch.rand(120, 1, 3, generator=generator, dtype=torch.float64)
    corners = centre + 0.2 * torch.randn(120, 3, 3, generator=generator, dtype=torch.float64)
    return scale * corners.reshape(-1, 3), torch.arange(360).reshape(-1, 3)


def random_rays(count, scale=1.0):
    generator = torch.Generator().manual_seed(2)
    origins = 2 * torch.rand(count, 3, generator=generator, dtype=torch.float64) - 0.5
    directions = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    # what embree sees
    return (scale * origins).float().double(), directions.float().double()


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_occlusion_agrees_with_trying_every_triangle(scale):
    vertices, faces = triangle_soup(scale)
    origins, directions = random_rays(1500, scale)
    ours = Raycaster(vertices, faces).occluded(origins, directions).numpy()
    hit, doubtful = occluded(vertices.numpy(), faces.numpy(), origins.numpy(), directions.numpy())
    assert 0.2 < hit.mean() < 0.98
    assert np.mean((ours != hit) & ~doubtful) < 1e-3
    assert doubtful.mean() < 1e-2


def test_a_hit_lies_on_its_triangle_and_on_its_ray():
    vertices, faces = triangle_soup()
    origins, directions = random_rays(2000)
    hits = Raycaster(vertices, faces).intersect(origins, directions)
    found = hits.face >= 0
    corners = vertices[faces[hits.face[found]]]
    on_triangle = (hits.barycentric[found][:, :, None] * corners).sum(1)
    on_ray = origins[found] + hits.distance[found, None] * directions[found]
    # an edge hit that float32 found may lie float32's rounding outside
    torch.testing.assert_close(on_triangle, on_ray, atol=1e-5, rtol=0)
    assert (on_triangle - on_ray).norm(dim=1).median() < 1e-12
    assert (hits.barycentric >= 0).all()
    assert torch.isinf(hits.distance[~found]).all()


def test_the_nearest_of_two_walls_is_hit():
    wall = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]], dtype=torch.float64)
    depth = torch.tensor([0, 0, 1.0])
    vertices = torch.cat([wall - 5 * depth, wall - 2 * depth])
    caster = Raycaster(vertices, torch.arange(6).reshape(2, 3))
    hits = caster.intersect(torch.zeros(1, 3), torch.tensor([[0.0, 0, -1]]))
    assert hits.face.tolist() == [1]
    assert hits.distance.item() == pytest.approx(2, abs=1e-12)


def test_faces_must_index_vertices():
    with pytest.raises(ValueError, match="3 vertices"):
        Raycaster(torch.zeros(3, 3), torch.tensor([[0, 1, 3]]))


def test_between_two_points_ends_before_what_they_lie_on() -> None:
    """A square at z = 0: it lies between its sides, and not before a point on it or short of it."""
    vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    caster = Raycaster(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]))
    start = torch.tensor([[0.3, 0.1, 2.0]]).expand(4, 3)
    targets = torch.tensor([[0.3, 0.1, -2.0], [0.2, 0.1, 0.0], [0.3, 0.1, 0.5], [5.0, 0.1, -2.0]])
    assert caster.between(start, targets).tolist() == [True, False, False, False]
    assert caster.between(targets[1:2], start[:1]).tolist() == [False]
