"""Occlusion by PyTorch against embree, analytic shapes and every triangle in float64."""

import numpy as np
import pytest
import torch
from torch import Tensor

from skylight.faces._model import HeadModel
from skylight.sphere._frame import DirectionGrid
from skylight.transport._rays import Raycaster, TorchRaycaster, _enters
from skylight.transport._render import vertex_normals
from skylight.transport._visibility import adaptive_visibility
from tests.oracles.raycasting import occluded
from tests.transport.shapes import icosphere

CPU = torch.device("cpu")


def random_rays(count: int, spread: float = 2.0) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(count)
    origins = spread * (2 * torch.rand(count, 3, generator=generator) - 1)
    return origins, torch.randn(count, 3, generator=generator)


@pytest.fixture(scope="module")
def head() -> tuple[Tensor, Tensor, Tensor]:
    """(vertices, faces, normals) of the mean head."""
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(model.mean.copy()), torch.from_numpy(model.faces.copy())
    return vertices, faces, vertex_normals(vertices, faces)


def test_a_head_hides_what_embree_says(
    head: tuple[Tensor, Tensor, Tensor], device: torch.device
) -> None:
    """From 50 vertices to 512 directions each, half of them within the head."""
    vertices, faces, normals = head
    embree, caster = Raycaster(vertices, faces), TorchRaycaster(vertices, faces, device)
    starts = (vertices + embree.epsilon * normals)[::152].float()
    directions = DirectionGrid.latlong(16).directions.float()
    origins = starts.repeat_interleave(len(directions), 0)
    rays = directions.repeat(len(starts), 1)
    assert len(rays) >= 25_000
    found, expected = caster.occluded(origins, rays), embree.occluded(origins, rays)
    assert 0.6 < float(expected.float().mean()) < 0.8
    # a GPU may round products and sums together: rays that graze an edge may differ there
    assert int((found != expected).sum()) <= (0 if device.type == "cpu" else 20)


def test_a_sphere_hides_what_passes_it_nearer_than_its_radius(device: torch.device) -> None:
    vertices, faces = icosphere(4)
    caster = TorchRaycaster(vertices, faces, device)
    origins, directions = random_rays(30_000)
    outside = origins.norm(dim=1) > 1.001
    origins, directions = origins[outside], directions[outside]
    along = torch.nn.functional.normalize(directions.double(), dim=1)
    ahead = -(origins * along).sum(1)
    past = (origins + ahead[:, None] * along).norm(dim=1)
    hit = (past < 1) & (ahead > 0)
    # 2,562 vertices on the sphere; the triangles' centres lie up to 0.0017 within
    sure = (past - 0.999).abs() > 0.0012
    assert float(sure.float().mean()) > 0.99
    found = caster.occluded(origins, directions)
    assert torch.equal(found[sure], hit[sure])
    assert 0.05 < float(hit.float().mean()) < 0.5


@pytest.mark.parametrize("start", [(0.1, -0.2, 0.05), (0.5, 0.3, -0.4), (0.0, 0.0, 0.85)])
def test_nothing_leaves_a_closed_mesh(start: tuple[float, ...], device: torch.device) -> None:
    """No ray slips between triangles, towards its vertices and edges least of all."""
    vertices, faces = icosphere(4)
    inside = torch.tensor(start)
    corners = vertices[faces]
    middles = torch.cat([(corners + corners.roll(1, 1)).flatten(0, 1) / 2, vertices])
    towards = torch.cat([middles.float() - inside, random_rays(5000)[1]])
    caster = TorchRaycaster(vertices, faces, device)
    assert bool(caster.occluded(inside.expand(len(towards), 3), towards).all())


def test_a_plane_hides_what_goes_down_to_it(device: torch.device) -> None:
    """A square of side 2 at z = 0, whatever the direction's sign or a zero in it."""
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    caster = TorchRaycaster(square, torch.tensor([[0, 1, 2], [0, 2, 3]]), device)
    origins, directions = random_rays(30_000, 1.5)
    directions[::3, 0] = 0
    directions[::5, 1] = 0
    time = -origins[:, 2] / directions[:, 2]
    place = (origins + time[:, None] * directions)[:, :2].abs().amax(1)
    sure = (place - 1).abs() > 1e-5
    assert torch.equal(caster.occluded(origins, directions)[sure], ((time > 0) & (place < 1))[sure])


def test_rays_along_axes_and_in_planes_of_boxes(device: torch.device) -> None:
    """Zero coordinates, and starts in the plane of a box: 0 times infinity is not asked for."""
    vertices, faces = icosphere(2)
    caster, embree = TorchRaycaster(vertices, faces, device), Raycaster(vertices, faces)
    axes = torch.cat([torch.eye(3), -torch.eye(3)])
    starts = torch.cat([vertices.float() + 3 * axis for axis in axes])
    for axis in axes:
        assert torch.equal(
            caster.occluded(starts + 1e-4, axis[None]), embree.occluded(starts + 1e-4, axis[None])
        )


def test_no_box_is_missed_by_rays_to_its_corners_and_edges(device: torch.device) -> None:
    """Boxes that are flat in one or two coordinates too, whose near and far planes meet."""
    random = np.random.default_rng(2)
    low = random.uniform(-1, 1, size=(20_000, 3))
    size = random.uniform(0, 0.5, size=(20_000, 3)) * (random.random((20_000, 3)) > 0.3)
    boxes = torch.from_numpy(np.stack([low, low + size], 1)).float().to(device)
    start = torch.from_numpy(random.uniform(-3, 3, size=(20_000, 3))).float().to(device)
    share = torch.from_numpy(random.choice([0.0, 1.0, 0.5], size=(20_000, 3))).to(device)
    target = boxes[:, 0].double() + share * (boxes[:, 1] - boxes[:, 0]).double()
    along = (target - start).float()
    planes = (boxes.double() - start.double()[:, None]) / along.double()[:, None]
    near, far = planes.amin(1).amax(1), planes.amax(1).amin(1)
    passes = (near <= far) & (far >= 0)  # all but exactly, of these rays
    assert 0.3 < float(passes.float().mean()) < 0.9
    assert bool(_enters(start, along, boxes[:, None])[passes].all())


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_a_soup_of_triangles_against_each_of_them(scale: float, device: torch.device) -> None:
    random = np.random.default_rng(1)
    corners = random.uniform(size=(120, 1, 3)) + 0.2 * random.normal(size=(120, 3, 3))
    vertices = torch.from_numpy(scale * corners.reshape(-1, 3)).float()
    faces = torch.arange(360).reshape(-1, 3)
    origins, directions = random_rays(1500, 0.5)
    origins = scale * (origins + 0.5)
    found = TorchRaycaster(vertices, faces, device).occluded(origins, directions).numpy()
    hit, doubtful = occluded(
        vertices.double().numpy(),
        faces.numpy(),
        origins.double().numpy(),
        directions.double().numpy(),
    )
    assert 0.2 < hit.mean() < 0.9
    assert doubtful.mean() < 1e-2
    assert not np.any((found != hit) & ~doubtful)


def test_how_many_pairs_are_looked_at_together_changes_nothing(device: torch.device) -> None:
    vertices, faces = icosphere(2)
    rays = random_rays(1000)
    few, many = (TorchRaycaster(vertices, faces, device, pairs=n) for n in (7, 10**6))
    assert torch.equal(few.occluded(*rays), many.occluded(*rays))


def test_answers_come_on_the_device_of_the_rays(device: torch.device) -> None:
    caster = TorchRaycaster(*icosphere(1), device)
    assert caster.device == device
    for where in (CPU, device):
        start = torch.zeros(2, 3, device=where)
        found = caster.occluded(start, torch.ones(1, 3))  # one direction serves both rays
        assert found.device.type == where.type
        assert found.tolist() == [True, True]
    assert len(caster.occluded(torch.zeros(0, 3), torch.ones(1, 3))) == 0


def test_it_asks_for_what_embree_asks_for() -> None:
    with pytest.raises(ValueError, match="faces is empty"):
        TorchRaycaster(torch.zeros(3, 3), torch.zeros(0, 3, dtype=torch.long), CPU)
    with pytest.raises(ValueError, match="3 vertices"):
        TorchRaycaster(torch.zeros(3, 3), torch.tensor([[0, 1, 3]]), CPU)
    vertices, faces = icosphere(1, (5.0, 0, 0))
    assert TorchRaycaster(vertices, faces, CPU).epsilon == Raycaster(vertices, faces).epsilon


def test_visibility_of_a_head_is_embree_s(
    head: tuple[Tensor, Tensor, Tensor], device: torch.device
) -> None:
    """Also with workers, which a GPU is not shared by."""
    vertices, faces, normals = head
    some = slice(0, None, 80)
    points = vertices[some], normals[some], normals[some]
    expected = adaptive_visibility(*points, Raycaster(vertices, faces), 32)
    found = adaptive_visibility(
        *points, TorchRaycaster(vertices, faces, device), 32, workers=1 if device == CPU else 2
    )
    assert int((found.visible != expected.visible).sum()) <= (0 if device == CPU else 10)
