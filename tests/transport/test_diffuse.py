from collections.abc import Callable

import pytest
import torch
from torch import nn
from torch.nn.functional import normalize

from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix, diffuse_transport, visibility
from skylight.transport._rays import Raycaster
from skylight.transport._reflection import (
    DiffuseTransport,
    SkyTransport,
    SpecularTransport,
    shade_scenes,
    specular_transport,
)
from skylight.transport._render import Specular
from tests.transport.shapes import icosphere, seen_sphere

F64 = torch.float64
GRID = DirectionGrid.latlong(4)
POINTS = 5


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def diffuse(seed: int = 0) -> DiffuseTransport:
    return DiffuseTransport(
        random(POINTS, len(GRID), seed=seed) > 0.3, random(POINTS, 3, seed=seed + 1) - 0.5, GRID
    )


def specular(seed: int = 0) -> SpecularTransport:
    """Views near the normals, where the lobe is smooth."""
    normals = normalize(random(POINTS, 3, seed=seed + 1) - 0.5)
    views = normalize(normals + 0.5 * random(POINTS, 3, seed=seed + 2))
    visible = random(POINTS, len(GRID), seed=seed) > 0.3
    return SpecularTransport(visible, normals, GRID, views=views, specular=Specular())


@pytest.fixture(params=[diffuse, specular])
def make(request: pytest.FixtureRequest) -> Callable[[int], DiffuseTransport]:
    return request.param


def test_the_matrices_are_those_of_ray_casting():
    """Two spheres, one in the other's shadow."""
    gbuffer, _ = seen_sphere(subdivisions=3, height=24)
    parts = [icosphere(3, (0.0, 0.0, -4.0)), icosphere(3, (0.0, 1.5, -3.0))]
    vertices = torch.cat([part[0] for part in parts])
    caster = Raycaster(vertices, torch.cat([parts[0][1], parts[1][1] + len(parts[0][0])]))
    grid = DirectionGrid.latlong(16)
    normals, flat = gbuffer.normals, gbuffer.geometric_normals
    traced = diffuse_transport(gbuffer.origins, normals, flat, caster, grid)
    visible = visibility(gbuffer.origins, flat, caster, grid)
    assert (~visible & (normals @ grid.directions.T > 0.1)).any()
    module = DiffuseTransport(visible, normals, grid)
    torch.testing.assert_close(module.transport_matrix().matrix, traced.matrix, atol=1e-6, rtol=0)

    views, lobe = normalize(-gbuffer.positions), Specular(roughness=0.5)
    expected = specular_transport(traced, normals, views, lobe)
    shiny = SpecularTransport(visible, normals, grid, views=views, specular=lobe)
    torch.testing.assert_close(
        shiny.transport_matrix().matrix, expected.matrix, atol=1e-5, rtol=1e-3
    )


def test_shading_and_its_slope_under_linear_light():
    """Unoccluded under L = c + <a, w>: rho (c + 2/3 <a, n>) (Ramamoorthi & Hanrahan 2001)."""
    grid = DirectionGrid.latlong(64)
    constant, slope = torch.tensor(2.0), torch.tensor([0.4, -0.3, 0.8], dtype=F64)
    light = (constant + grid.directions @ slope)[:, None].expand(-1, 3)
    normals = normalize(random(POINTS, 3) - 0.5).requires_grad_()
    transport = DiffuseTransport(torch.ones(POINTS, len(grid), dtype=torch.bool), normals, grid)
    shading = transport(light, 0.5)[:, 0]
    expected = 0.5 * (constant + 2 / 3 * (normals @ slope))
    torch.testing.assert_close(shading, expected, atol=1e-3, rtol=0)
    (found,) = torch.autograd.grad(shading.sum(), transport.normals)
    tangent = slope - (normals @ slope)[:, None] * normals
    torch.testing.assert_close(found, 0.5 * 2 / 3 * tangent, atol=5e-3, rtol=0)


@pytest.mark.parametrize("albedo", [(), (3,), (POINTS, 3), (2, 1, 3), (2, POINTS, 3), (POINTS, 1)])
def test_gradients_are_the_differences(make, albedo: tuple[int, ...]) -> None:
    transport = make(0)

    def shading(normals, *inputs):
        return torch.func.functional_call(transport, {"normals": normals}, inputs)

    inputs = (
        transport.normals.detach().clone().requires_grad_(),
        random(2, len(GRID), 3, seed=5).requires_grad_(),
        random(*albedo, seed=6).requires_grad_(),
    )
    assert torch.autograd.gradcheck(shading, inputs, fast_mode=True)


@pytest.mark.parametrize("albedo", [(POINTS,), (2, 3), (4, 3), (2, POINTS, 3), (1, 1, 3)])
def test_an_albedo_of_another_shape_is_refused(make, albedo: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="albedo of shape"):
        make(0)(random(len(GRID), 3), random(*albedo))


def test_visibility_on_another_grid_is_refused() -> None:
    visible, normals = torch.ones(POINTS, len(GRID) - 1, dtype=torch.bool), random(POINTS, 3)
    with pytest.raises(ValueError, match="must be"):
        DiffuseTransport(visible, normals, GRID)


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_any_batch_of_lights(make, dtype: torch.dtype, device: torch.device) -> None:
    transport = make(0).to(device, dtype)
    lights = random(2, 3, len(GRID), 3).to(device, dtype)
    albedo = random(3).to(device, dtype)
    shading = transport(lights, albedo)
    assert (shading.dtype, shading.device.type) == (dtype, device.type)
    for i in range(2):
        torch.testing.assert_close(shading[i, 1], transport(lights[i, 1], albedo))
    expected = albedo * torch.einsum("mn,...nc->...mc", transport.matrix, lights)
    torch.testing.assert_close(shading, expected)
    assert transport(lights[:0]).shape == (0, 3, POINTS, 3)


def test_the_matrix_follows_its_normals(make) -> None:
    """A step, a loaded state and another precision: each as of a fresh module."""
    light = random(len(GRID), 3)
    transport, other = make(0), make(9)
    first = transport(light)
    assert transport.matrix is transport.matrix  # computed once
    transport.requires_grad_(True)
    optimiser = torch.optim.SGD(transport.parameters(), lr=10.0)
    (transport(light) - 1).square().mean().backward()
    optimiser.step()
    transport.requires_grad_(False)
    assert not torch.allclose(transport(light), first)

    transport.load_state_dict(other.state_dict())
    assert torch.equal(transport(light), other(light))
    single = transport.float()(light.float())
    torch.testing.assert_close(single, other(light).float(), rtol=1e-4, atol=1e-5)


def test_normals_are_learnable_where_they_require_a_gradient() -> None:
    """Photometric stereo: the normals that explain shading under several lights."""
    visible = torch.ones(POINTS, len(GRID), dtype=torch.bool)
    normals = normalize(random(POINTS, 3) - 0.5)
    assert not DiffuseTransport(visible, normals, GRID).normals.requires_grad
    lights = random(6, len(GRID), 3).pow(8)
    target = DiffuseTransport(visible, normals, GRID)(lights)
    start = nn.Parameter(normals + 0.3 * random(POINTS, 3, seed=4))
    found = DiffuseTransport(visible, start, GRID)
    optimiser = torch.optim.Adam(found.parameters(), lr=0.02)
    for _ in range(200):
        optimiser.zero_grad()
        loss = (found(lights) - target).square().mean()
        loss.backward()
        optimiser.step()
    angle = torch.rad2deg((normalize(start.detach()) * normals).sum(1).clamp(max=1).acos())
    assert angle.max() < 0.5


# --- a sky over a ground


@pytest.fixture
def random_transport() -> TransportMatrix:
    grid = DirectionGrid.latlong(4)
    matrix = torch.rand(5, len(grid), generator=torch.Generator().manual_seed(0))
    return TransportMatrix(matrix=matrix, grid=grid)


def test_sky_transport_and_its_gradient(random_transport):
    shading = SkyTransport.of(random_transport).double()
    sky = torch.rand(2, 16, 3, dtype=torch.float64, requires_grad=True)
    ground = torch.rand(2, 3, dtype=torch.float64, requires_grad=True)
    albedo = torch.rand(2, 3, dtype=torch.float64, requires_grad=True)
    out = shading(sky, ground, albedo)
    light = torch.cat([sky[1], ground[1].expand(16, 3)])
    torch.testing.assert_close(out[1], albedo[1] * (random_transport.matrix.double() @ light))

    # the adjoint, written with the transpose
    residual = torch.randn(out.shape, dtype=torch.float64)
    out.backward(residual)
    back = shading.folded[0].T @ (residual * albedo.detach()[:, None])
    assert sky.grad is not None
    assert ground.grad is not None
    torch.testing.assert_close(sky.grad, back[:, :-1])
    torch.testing.assert_close(ground.grad, back[:, -1])
    torch.autograd.gradcheck(shading, (sky, ground, albedo))


@pytest.mark.parametrize("lights", [1, 2, 5])
def test_shading_of_few_lights_is_that_of_many(random_transport, lights):
    # the product pads few lights to a fast size
    generator = torch.Generator().manual_seed(2)
    n = len(random_transport.grid) // 2
    sky = torch.rand(lights, n, 3, generator=generator, dtype=random_transport.matrix.dtype)
    ground, albedo = sky[:, 0], sky[:, 1]
    shading = SkyTransport.of(random_transport)(sky, ground, albedo)
    whole = torch.cat([sky, ground[:, None].expand(-1, n, -1)], 1)
    expected = albedo[:, None] * torch.einsum("mn,bnc->bmc", random_transport.matrix, whole)
    torch.testing.assert_close(shading, expected)


@pytest.mark.parametrize("scene", [[0, 0, 1, 2, 2, 2, 2], [1], [0, 2, 2]])
def test_shading_of_several_scenes_is_each_ones_own(scene):
    """However many lights fall on each, on some of them none; and its adjoint."""
    generator = torch.Generator().manual_seed(3)
    matrices = torch.rand(3, 4, 6, generator=generator, dtype=torch.float64)
    radiance = torch.rand(len(scene), 6, 3, generator=generator, dtype=torch.float64)
    radiance.requires_grad_(True)
    index = torch.tensor(scene)
    shading = shade_scenes(matrices, radiance, index)
    torch.testing.assert_close(shading, torch.einsum("bmn,bnc->bmc", matrices[index], radiance))
    torch.autograd.gradcheck(lambda x: shade_scenes(matrices, x, index), (radiance,))


def test_no_lights_on_several_scenes_are_no_shading():
    none = torch.zeros(0, dtype=torch.int64)
    assert shade_scenes(torch.rand(3, 4, 6), torch.rand(0, 6, 3), none).shape == (0, 4, 3)
