"""Light that bounces between the parts of an object: laws, and the path tracer's answer."""

import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.faces._model import HeadModel
from skylight.faces._observe import BOUNCING_ALBEDO
from skylight.faces._skin import SkinPrior
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.transport._interreflection import BouncingMesh
from skylight.transport._matrix import diffuse_transport
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade
from skylight.transport._rays import Raycaster
from skylight.transport._render import vertex_normals


@pytest.fixture(scope="module")
def bowl() -> tuple[torch.Tensor, torch.Tensor, Raycaster]:
    """(vertices, faces, a raycaster) of half a sphere, open upwards; its faces look outwards."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = torch.from_numpy(ball.vertices.copy())
    faces = torch.from_numpy(ball.faces[ball.triangles_center[:, 1] < 0].copy())
    return vertices, faces, Raycaster(vertices, faces)


@pytest.mark.parametrize(("albedo", "bounces"), [(0.3, 1), (0.8, 1), (0.8, 3)])
def test_a_bowl_is_lit_alike_all_over(bowl, albedo: float, bounces: int) -> None:
    """Half of what any point in it sees is the bowl: under light of 1 it shows
    1/2 sum_i (albedo / 2)^i."""
    vertices, faces, caster = bowl
    inside = (vertices[:, 1] < -0.3).nonzero()[:, 0][::60]
    points, normals = 0.99 * vertices[inside], -vertices[inside]
    direct = diffuse_transport(points, normals, normals, caster, DirectionGrid.latlong(32))
    mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=caster, albedo=albedo)
    found = mesh.transport(direct, points, normals, bounces=bounces).matrix.sum(1)
    expected = 0.5 * sum((albedo / 2) ** i for i in range(bounces + 1))
    assert float((found / expected - 1).abs().max()) < 0.06
    assert float(found.mean()) == pytest.approx(expected, rel=0.025)


def test_on_a_head_it_is_what_paths_say() -> None:
    """Light of one bounce and of two."""
    model = HeadModel.load()
    vertices, faces = torch.from_numpy(model.mean.copy()), torch.from_numpy(model.faces.copy())
    scene, caster = DiffuseScene.uniform(vertices, faces, 0.6), Raycaster(vertices, faces)
    normals = vertex_normals(vertices, faces)
    # where the head takes a part of what is seen, but not in its mouth
    coarse = DirectionGrid.latlong(16)
    direct = diffuse_transport(vertices, normals, normals, caster, coarse).matrix.sum(1)
    some = ((direct > 0.5) & (direct < 0.8)).nonzero()[::90, 0]
    light = torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0))
    light[3, 10] = 40.0
    environment = EnvironmentMap(radiance=light)
    grid = DirectionGrid.latlong(64)
    points = vertices[some], normals[some]
    mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=caster, albedo=0.6, rays=512)
    straight = diffuse_transport(*points, points[1], caster, grid)
    fine_light = environment.resize(64).flat

    def paths(count: int):
        sampling = Sampling(samples=4096, bounces=count)
        generator = torch.Generator().manual_seed(1)
        return shade(
            *points, scene, environment, albedo=1.0, sampling=sampling, generator=generator
        )

    unbounced = paths(0).mean
    for bounces in (1, 2):
        bounced = mesh.transport(straight, *points, bounces=bounces)
        added = (bounced.matrix - straight.matrix) @ fine_light
        true = (paths(bounces).mean - unbounced).float()
        assert float(true.mean()) > 0.15 * float((straight.matrix @ fine_light).mean())
        off = (added - true).square().mean().sqrt()  # 4 % of it are the paths' own noise
        assert float(off) < 0.15 * float(true.square().mean().sqrt())
        assert float(added.mean()) == pytest.approx(float(true.mean()), rel=0.05)


def test_without_bounces_or_hollows_nothing_is_added() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = torch.from_numpy(ball.vertices.copy()), torch.from_numpy(ball.faces.copy())
    caster = Raycaster(vertices, faces)
    mesh = BouncingMesh(vertices=vertices, faces=faces, raycaster=caster, albedo=0.9)
    points = vertices[::7], vertices[::7]
    direct = diffuse_transport(*points, points[1], caster, DirectionGrid.latlong(32))
    assert mesh.transport(direct, *points, bounces=0) is direct
    assert torch.equal(mesh.transport(direct, *points, bounces=3).matrix, direct.matrix)


def test_what_cannot_be_is_refused(bowl) -> None:
    vertices, faces, caster = bowl
    given = {"vertices": vertices, "faces": faces, "raycaster": caster}
    with pytest.raises(InputError, match="between 0 and 1"):
        BouncingMesh(**given, albedo=1.2)
    with pytest.raises(InputError, match="one ray"):
        BouncingMesh(**given, albedo=0.2, rays=0)
    direct = diffuse_transport(
        vertices[:2], vertices[:2], vertices[:2], caster, DirectionGrid.latlong(32)
    )
    with pytest.raises(InputError, match="0 or more"):
        BouncingMesh(**given, albedo=0.2).transport(direct, vertices[:2], vertices[:2], bounces=-1)


def test_skin_sends_on_what_its_prior_says() -> None:
    prior = SkinPrior.load()
    mean = float(luminance(prior.means).double() @ prior.log_albedo.weights.double())
    assert mean == pytest.approx(BOUNCING_ALBEDO, abs=0.01)
