"""Furnaces, a corner by finite elements, reciprocity with the transport matrix, symmetry."""

import math

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import diffuse_transport
from skylight.transport._path_tracer import DiffuseScene, Sampling, radiosity_transfer, shade
from tests.oracles.radiosity import corner_radiance
from tests.transport.shapes import icosphere

UP = torch.tensor([0.0, 1.0, 0.0])
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def square_with_wall(albedo: float) -> DiffuseScene:
    """The floor [0, 1]^2 in x and z, the wall above its edge x = 0."""
    floor = torch.tensor([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]]).double()
    wall = torch.tensor([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]]).double()
    return DiffuseScene.uniform(torch.cat([floor, wall]), torch.cat([FACES, FACES + 4]), albedo)


def on_floor(centres: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    x, z = torch.from_numpy(centres).unbind(1)
    positions = torch.stack([x, torch.zeros_like(x), z], 1)
    return positions, UP.expand(len(positions), 3)


def white(height: int = 8) -> EnvironmentMap:
    return EnvironmentMap(radiance=torch.ones(height, 2 * height, 3))


def test_furnace_a_convex_body_under_white_light_has_the_radiance_of_its_albedo() -> None:
    vertices, faces = icosphere(2)
    scene = DiffuseScene.uniform(vertices, faces, 0.6)
    centres, normals = scene.corners.mean(1), scene.normals
    options = {"albedo": 0.6, "sampling": Sampling(samples=64, bounces=4)}
    traced = radiosity_transfer(centres, normals, scene, degree=0, generator=generator(), **options)
    constant = math.sqrt(4 * math.pi)  # of the coefficient of radiance 1
    torch.testing.assert_close(
        traced.mean * constant, torch.full_like(traced.mean, 0.6), atol=1e-6, rtol=0
    )
    lit = shade(centres, normals, scene, white(), generator=generator(), **options)
    assert ((lit.mean - 0.6).abs() <= 6 * lit.standard_error + 1e-6).float().mean() > 0.95
    assert float((lit.mean - 0.6).mean().abs()) < 4e-3


def test_no_light_comes_into_a_closed_body() -> None:
    vertices, faces = icosphere(2)
    scene = DiffuseScene.uniform(vertices, faces, 1.0)
    sampling = Sampling(samples=64, bounces=8)
    inside = scene.corners.mean(1), -scene.normals
    traced = radiosity_transfer(
        *inside, scene, degree=2, albedo=1.0, sampling=sampling, generator=generator()
    )
    assert not traced.mean.any()


@pytest.mark.parametrize("albedo", [0.3, 1.0])
def test_a_corner_shines_as_finite_elements_say(albedo: float) -> None:
    centres, expected = corner_radiance(albedo, patches=12)
    scene = square_with_wall(albedo)
    traced = shade(
        *on_floor(centres),
        scene,
        white(),
        albedo=albedo,
        sampling=Sampling(samples=512, bounces=12),
        generator=generator(1),
    )
    difference = traced.mean[:, 0] - torch.from_numpy(expected)
    noise = float(traced.standard_error[:, 0].square().mean().sqrt())
    assert noise < 0.02
    # patches at the seam are the oracle's weak place
    away = torch.from_numpy(centres[:, 0] > 0.1)
    assert float(difference[away].square().mean().sqrt()) < 2 * noise + 2e-3
    assert abs(float(difference[away].mean())) < 4e-3


def test_every_bounce_brings_one_more_albedo() -> None:
    """With one bounce, T(a) = a t_0 + a^2 t_1: T(a) / a is linear, on the same paths."""
    positions, normals = on_floor(np.array([[0.1, 0.5], [0.7, 0.2]]))
    options = {"degree": 2, "sampling": Sampling(samples=256, bounces=1)}
    low, middle, high = (
        radiosity_transfer(
            positions, normals, square_with_wall(a), albedo=a, generator=generator(), **options
        ).mean
        / a
        for a in (0.25, 0.5, 0.75)
    )
    torch.testing.assert_close(high - middle, middle - low, atol=1e-6, rtol=0)
    assert (high > middle)[:, 0].all()


def test_without_bounces_it_is_the_direct_transport_matrix() -> None:
    scene = square_with_wall(0.8)
    positions, normals = on_floor(np.random.default_rng(0).uniform(0.1, 0.9, (12, 2)))
    grid = DirectionGrid.latlong(64)
    matrix = diffuse_transport(positions, normals, normals, scene.raycaster, grid)
    expected = 0.8 * matrix.project(harmonics.evaluate(grid.directions, 4)).double()
    traced = radiosity_transfer(
        positions,
        normals,
        scene,
        degree=4,
        albedo=0.8,
        sampling=Sampling(samples=4096, bounces=0, batches=8),
        generator=generator(),
    )
    noise = float(traced.standard_error.square().mean().sqrt())
    assert noise < 4e-3
    # the grid's cells of 2.8 degrees along the wall's edge
    assert float((traced.mean - expected).square().mean().sqrt()) < 1.5 * noise + 3e-3


def test_a_map_and_its_harmonics_light_alike_and_a_mirrored_light_mirrors_the_picture() -> None:
    scene = square_with_wall(0.7)
    centres = np.array([[0.15, 0.3], [0.15, 0.7], [0.6, 0.3], [0.6, 0.7]])
    grid = DirectionGrid.latlong(64)
    coefficients = torch.randn(25, 3, generator=generator(5), dtype=torch.float64)
    basis = harmonics.evaluate(grid.directions, 4)
    light = EnvironmentMap(radiance=(basis @ coefficients).reshape(64, 128, 3))
    sampling = Sampling(samples=8192, bounces=8, batches=8)
    options = {"albedo": 0.7, "sampling": sampling}
    by_map = shade(*on_floor(centres), scene, light, generator=generator(1), **options)
    transfer = radiosity_transfer(
        *on_floor(centres), scene, degree=4, generator=generator(2), **options
    )
    noise = by_map.standard_error.square()
    noise = (noise + transfer.standard_error.square() @ coefficients.square()).sqrt()
    assert float(noise.max()) < 0.06
    difference = (by_map.mean - transfer.mean @ coefficients).abs()
    assert (difference < 5 * noise + 2e-3).all()
    # z to 1 - z exchanges the points and the sign of what is odd in z
    up = torch.tensor([[0.3, 0.5, 0.8]]).double()
    odd = torch.sign(
        harmonics.evaluate(up, 4) * harmonics.evaluate(up * torch.tensor([1, 1, -1]), 4)
    )
    left, right = transfer.mean[[0, 2]], transfer.mean[[1, 3]] * odd
    error = transfer.standard_error[[0, 2]].square() + transfer.standard_error[[1, 3]].square()
    assert ((left - right).abs() < 6 * error.sqrt() + 1e-3).all()


def test_a_small_sun_is_not_noisy() -> None:
    """One pixel of 1e5, straight on: E = L cos dw, shadowed behind the wall."""
    radiance = torch.zeros(64, 128, 3)
    radiance[16, 96] = 1e5  # 45 degrees up towards +X
    light = EnvironmentMap(radiance=radiance)
    positions, normals = on_floor(np.array([[0.5, 0.5]]))
    traced = shade(
        positions,
        normals,
        square_with_wall(0.0),
        light,
        albedo=0.5,
        sampling=Sampling(samples=64, bounces=2),
        generator=generator(),
    )
    expected = 0.5 / math.pi * light.irradiance(UP)
    torch.testing.assert_close(traced.mean[0].float(), expected, rtol=5e-3, atol=0)
    behind = EnvironmentMap(radiance=radiance.flip(1))
    dark = shade(
        positions,
        normals,
        square_with_wall(0.0),
        behind,
        albedo=0.5,
        sampling=Sampling(samples=64, bounces=0),
        generator=generator(),
    )
    assert not dark.mean.any()


def test_the_same_seed_gives_the_same_bytes() -> None:
    positions, normals = on_floor(np.array([[0.2, 0.2], [0.4, 0.9]]))
    runs = [
        radiosity_transfer(
            positions,
            normals,
            square_with_wall(1.0),
            degree=1,
            albedo=1.0,
            sampling=Sampling(samples=64, bounces=2),
            generator=generator(9),
        )
        for _ in range(2)
    ]
    assert torch.equal(runs[0].mean, runs[1].mean)
    assert torch.equal(runs[0].standard_error, runs[1].standard_error)


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="multiple"):
        Sampling(samples=10, batches=4)
    with pytest.raises(InputError, match="albedo lies in"):
        square_with_wall(1.5)
    with pytest.raises(InputError, match="with_ground"):
        shade(
            *on_floor(np.array([[0.5, 0.5]])),
            square_with_wall(0.5),
            EnvironmentMap(radiance=torch.ones(4, 16, 3)),
            albedo=0.5,
            sampling=Sampling(samples=4),
            generator=generator(),
        )
