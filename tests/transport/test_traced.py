from pathlib import Path

import numpy as np
import pytest
import torch

from skylight._figures import SCENE_GRID, SCENE_HEIGHT
from skylight.errors import AssetError
from skylight.transport._matrix import diffuse_transport
from skylight.transport._scene import (
    TracedScene,
    diffuse_surface,
    evaluation_scene,
    shipped_path,
    trace_scene,
)


@pytest.mark.parametrize(
    ("height", "grid_height"),
    [(72, 64), pytest.param(SCENE_HEIGHT, SCENE_GRID, marks=pytest.mark.slow)],
)
def test_what_ships_is_what_is_traced(height: int, grid_height: int) -> None:
    """Of scores and reports; but for the pixels at edges, where rounding may decide."""
    shipped, traced = TracedScene.load(shipped_path(height, grid_height)), trace_scene(height, 8)
    assert (shipped.height, shipped.grid_height) == (height, grid_height)
    one, other = (scene.diffuse.image(scene.normals) for scene in (shipped, traced))
    alike = (one - other).abs().amax(-1) < 1e-5
    assert alike.float().mean() > 0.999
    one, other = (scene.metal.image(scene.mirrored) for scene in (shipped, traced))
    assert ((one - other).abs().amax(-1) < 1e-4).float().mean() > 0.999
    surface, raycaster, on_ground = diffuse_surface(evaluation_scene(height, grid_height).camera)
    some = torch.arange(0, len(surface), 37)
    assert torch.equal(shipped.on_ground[some], on_ground[some])
    grid = evaluation_scene(height, grid_height).transport.grid
    expected = diffuse_transport(
        surface.origins[some],
        surface.normals[some],
        surface.geometric_normals[some],
        raycaster,
        grid,
    ).matrix
    found = evaluation_scene(height, grid_height).transport.matrix[some]
    assert ((found - expected).abs() < 1e-7).float().mean() > 0.9999


@pytest.fixture(scope="module")
def traced() -> TracedScene:
    return trace_scene(12, 8)


def test_a_traced_scene_comes_back(traced: TracedScene, tmp_path: Path) -> None:
    traced.save(tmp_path / "scene.npz.xz")
    again = TracedScene.load(tmp_path / "scene.npz.xz")
    np.testing.assert_array_equal(again.visible, traced.visible)
    for name in ("normals", "on_ground", "mirrored"):
        assert torch.equal(getattr(again, name), getattr(traced, name)), name
    assert torch.equal(again.diffuse.pixels, traced.diffuse.pixels)
    assert torch.equal(again.metal.pixels, traced.metal.pixels)
    assert (again.diffuse.layout, again.grid_height) == ((12, 16), 8)


def test_a_damaged_scene_is_named(traced: TracedScene, tmp_path: Path) -> None:
    path = tmp_path / "scene.npz.xz"
    traced.save(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(AssetError, match="reinstall"):
        TracedScene.load(path)
