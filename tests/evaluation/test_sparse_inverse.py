"""Recovering light from shading, on a small scene whose answer is known."""

import math
from pathlib import Path

import pytest
import torch

from skylight.csc._dictionary import DEGREE, builtin
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import SubDictionary
from skylight.evaluation._sparse_inverse import (
    HEIGHT,
    ObservedScene,
    SparseInverse,
    map_error,
    recovered_by_code,
    recovered_by_harmonics,
    recovered_by_lamps,
)
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix
from tests.inverse.test_solve import ball_normals


@pytest.fixture(scope="module")
def scene() -> ObservedScene:
    """Points that see every pixel by itself: what is observed is the light."""
    grid = DirectionGrid.latlong(HEIGHT)
    exact = TransportMatrix(matrix=torch.diag(grid.solid_angles.sqrt()).float(), grid=grid)
    return ObservedScene.of(torch.zeros(len(exact.matrix), 2, dtype=torch.long), exact, exact)


def test_a_light_of_few_lobes_is_recovered(scene: ObservedScene):
    part = SubDictionary(builtin("vmf"), Positions())
    places = torch.tensor([[5, 10, 0], [16, 40, 0], [25, 3, 0]])
    atoms = part.plan().correlation.rotated(torch.zeros(3, dtype=torch.long), places).double()
    colours = torch.tensor([[3.0, 2, 1], [1, 1, 2], [0.5, 1, 0.5]]).double()
    true = scene.basis @ (atoms.T @ colours)
    maps = recovered_by_code(scene, scene.coarse @ true, "vmf", "nonnegative", (4,))
    assert map_error(maps[4], true) < 1e-4


def test_harmonics_are_recovered_from_as_many(scene: ObservedScene):
    coefficients = torch.randn(16, 3, generator=torch.Generator().manual_seed(0)).double()
    true = scene.basis[:, :16] @ coefficients
    maps = recovered_by_harmonics(scene, scene.coarse @ true, 1e-6, (4, 16))
    assert list(maps) == [4, 16]
    assert map_error(maps[4], true) > 0.3
    assert map_error(maps[16], true) < 1e-4


def test_a_lamp_is_recovered_from_few_numbers():
    """On a ball, in ambient light."""
    places, normals = (torch.from_numpy(part[::3].copy()) for part in ball_normals())

    def diffuse(grid: DirectionGrid) -> TransportMatrix:
        cosines = (normals @ grid.directions.T).clamp(min=0)
        return TransportMatrix(matrix=(cosines * grid.solid_angles / math.pi).float(), grid=grid)

    coarse, fine = (DirectionGrid.latlong(rows) for rows in (HEIGHT, 2 * HEIGHT))
    scene = ObservedScene.of(places, diffuse(fine), diffuse(coarse))
    lamp = torch.nn.functional.normalize(torch.tensor([0.5, 0.5, 0.7]).double(), dim=0)
    light = [
        (0.5 + 20 * ((grid.directions @ lamp - 1) / math.radians(12) ** 2).exp())[:, None]
        * torch.tensor([1.0, 0.8, 0.5]).double()
        for grid in (fine, coarse)
    ]
    found, numbers = recovered_by_lamps(scene, scene.fine @ light[0])
    assert numbers == 26
    assert map_error(found, light[1]) < 0.05


def test_noise_is_a_thousandth_of_the_mean(scene: ObservedScene):
    light = torch.ones(len(scene.basis), 3).double()
    clean = scene.coarse @ light
    noise = scene.shade(light, torch.Generator().manual_seed(0)) - clean
    assert float(noise.std() / clean.mean()) == pytest.approx(1e-3, rel=0.05)


def test_error_is_weighted_by_solid_angle():
    """A map off by 1 in its upper half only: sqrt(1 / 2)."""
    true = torch.ones(HEIGHT * 2 * HEIGHT, 3).double()
    found = true.clone()
    found[: len(true) // 2] += 1
    assert map_error(found, true) == pytest.approx(math.sqrt(0.5))
    # the row round each pole holds 1 - cos(pi / rows) of a half: less than a row's share
    found = true.clone()
    found[: 2 * HEIGHT] += 1
    share = (1 - math.cos(math.pi / HEIGHT)) / 2
    assert map_error(found, true) == pytest.approx(math.sqrt(share), rel=1e-3)


def test_the_basis_is_that_of_the_filters(scene: ObservedScene):
    directions = DirectionGrid.latlong(HEIGHT).directions
    assert torch.equal(scene.basis, harmonics.evaluate_about_zenith(directions, DEGREE))


def test_maps_are_told_apart(tmp_path: Path):
    lines = ["file,category"] + [f"{i}.exr,{'indoor' if i < 3 else 'night'}" for i in range(10)]
    (tmp_path / "index.csv").write_text("\n".join(lines))
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "ball.obj").touch()
    assert SparseInverse(data=tmp_path, every=1).items() == ["0", "1", "2", "3", "9"]
    assert SparseInverse(data=tmp_path, every=2).items() == ["0", "2", "3"]
