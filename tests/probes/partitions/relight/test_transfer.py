"""Furnaces, finite elements, the path tracer, shrinking bounces; coefficients that are kept."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError, OutputError
from skylight.probes.partitions.relight import _gather, _transfer as transfer_file
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._scene import Scene
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    TransferSampling,
    Turn,
    kept_transfer,
    load_transfer,
    save_transfer,
    transfer_coefficients,
    transfer_key,
)
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._path_tracer import DiffuseScene, Sampling, shade
from tests.oracles.radiosity import corner_radiance
from tests.probes.partitions.shapes import AXES, corner, quad, six_cells, solid

MUCH = TransferSampling(rays=1024, bounces=12)


def on_floor(centres: np.ndarray, albedo=(0.5, 0.5, 0.5)) -> Receivers:
    x, z = torch.from_numpy(centres).unbind(1)
    positions = torch.stack([x, torch.zeros_like(x), z], 1)
    up = torch.tensor([0.0, 1, 0]).double().expand(len(x), 3)
    colours = torch.tensor(albedo).double().expand(len(x), 3)
    return Receivers(positions=positions, normals=up, geometric_normals=up, albedo=colours)


def test_furnace_a_convex_body_in_white_light_has_the_radiance_of_its_albedo():
    ball = solid(trimesh.creation.icosphere(subdivisions=2), albedo=(0.9, 0.5, 0.1))
    found = transfer_coefficients(ball, six_cells(), sampling=TransferSampling(rays=16))
    expected = torch.tensor([0.9, 0.5, 0.1]).expand(len(found), 3)
    torch.testing.assert_close(found.values.sum(1), expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(found.orders, torch.tensor([0.5, 0, 0, 0]).double())


def test_furnace_a_white_scene_in_white_light_is_white():
    scene = corner((1.0, 1, 1), (1.0, 1, 1), 0.2)
    found = transfer_coefficients(
        scene, six_cells(), sampling=TransferSampling(rays=64, bounces=30)
    )
    torch.testing.assert_close(found.values.sum(1), torch.ones(len(found), 3), atol=1e-4, rtol=0)


@pytest.mark.parametrize("albedo", [pytest.param(0.3, marks=pytest.mark.slow), 0.9])
def test_a_corner_shines_as_finite_elements_say(albedo):
    centres, expected = corner_radiance(albedo, patches=12)
    scene = corner((albedo,) * 3, (albedo,) * 3, 0.09)
    receivers = on_floor(centres, (albedo,) * 3)
    found = transfer_coefficients(scene, six_cells(), receivers, sampling=MUCH)
    error = found.values.sum(1)[:, 0].numpy() - expected
    away = centres[:, 0] > 0.1  # patches at the seam are the oracle's weak place
    assert np.sqrt(np.square(error[away]).mean()) < 3e-3 * albedo
    assert abs(error[away].mean()) < 1.5e-3


def test_light_of_every_cell_bounces_as_in_path_tracing():
    cells = six_cells()
    grid = DirectionGrid.latlong(64)
    light = torch.rand(6, 3, generator=torch.Generator().manual_seed(2)) * 3
    environment = EnvironmentMap(radiance=light[cells.cell_of(grid.directions)].reshape(64, 128, 3))
    ring = trimesh.creation.torus(0.3, 0.12, major_sections=24, minor_sections=12)
    ring.apply_translation([0.6, 0.3, 0.5])
    scene = Scene.joined([corner((0.7,) * 3, (0.7,) * 3, 0.09), solid(ring, (0.7, 0.7, 0.7))])
    centres = np.random.default_rng(0).uniform(0.05, 0.95, (40, 2))
    receivers = on_floor(centres, (0.7,) * 3)
    found = transfer_coefficients(
        scene, cells, receivers, sampling=TransferSampling(rays=1024, bounces=6)
    )
    radiance = torch.einsum("mic,ic->mc", found.values, light)
    traced = shade(
        receivers.positions,
        receivers.normals,
        DiffuseScene.uniform(scene.vertices, scene.faces, 0.7),
        environment,
        albedo=0.7,
        sampling=Sampling(samples=2048, bounces=6),
        generator=torch.Generator().manual_seed(0),
    )
    noise = float(traced.standard_error.square().mean().sqrt())
    error = radiance - traced.mean
    assert noise < 0.02
    assert float(error.square().mean().sqrt()) < 2 * noise + 5e-3
    assert abs(float(error.mean())) < 3e-3


def test_a_red_wall_reddens_a_white_floor_and_nothing_else_does():
    scene = corner((0.8, 0.8, 0.8), (0.8, 0.1, 0.1), 0.1)
    floor = scene.normals[:, 1] > 0.5
    direct, once = (
        transfer_coefficients(
            scene, six_cells(), sampling=TransferSampling(rays=256, bounces=bounces)
        ).values.sum(1)[floor]
        for bounces in (0, 1)
    )
    torch.testing.assert_close(direct[:, 0], direct[:, 1])
    red, green, _ = (once - direct).T
    near = scene.vertices[floor][:, 0] < 0.4
    assert (red[near] > 0).all()
    torch.testing.assert_close(green, red / 8, atol=1e-6, rtol=1e-4)


def test_bounces_shrink_by_the_albedo_at_least_and_their_sums_are_those_of_the_values():
    scene = corner((0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.15)
    sampling = TransferSampling(rays=128, bounces=6)
    at_vertices = transfer_coefficients(scene, six_cells(), sampling=sampling)
    elsewhere = transfer_coefficients(
        scene, six_cells(), Receivers.at_vertices(scene), sampling=sampling
    )
    for found in (at_vertices, elsewhere):
        assert len(found.orders) == 7
        assert (found.orders[1:] <= 0.5 * found.orders[:-1]).all()
        assert float(found.values.sum(1).mean()) == pytest.approx(float(found.orders.sum()))
    torch.testing.assert_close(at_vertices.orders, elsewhere.orders, rtol=0.03, atol=1e-4)


def test_a_thin_screen_throws_shadow_and_light_from_both_sides():
    """What lies behind the screen's triangles gets the light of its own side only."""
    albedo = (0.5, 0.5, 0.5)
    floor = quad([-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1], albedo=albedo)
    wall = quad([0, 0, -1], [0, 1, -1], [0, 1, 1], [0, 0, 1], albedo=albedo)
    mirrored = Scene.of(wall.vertices, wall.faces.flip(1), torch.tensor(albedo))
    centres = np.random.default_rng(1).uniform(-0.9, 0.9, (200, 2))
    cells = six_cells()
    first, second = (
        transfer_coefficients(
            Scene.joined([floor, w]), cells, on_floor(centres), sampling=TransferSampling(rays=1024)
        ).values
        for w in (wall, mirrored)
    )
    # which way the wall is wound makes no difference
    assert float((first - second).square().mean().sqrt()) < 1e-3


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_processes(monkeypatch):
    scene = corner((0.5, 0.5, 0.5), (0.8, 0.2, 0.2), 0.3)
    points = Receivers.at_vertices(scene)
    sampling = TransferSampling(rays=1500, bounces=2, seed=5)
    monkeypatch.setattr(_gather, "_RAYS_AT_ONCE", len(points) // 6 * sampling.rays)  # 6 blocks
    seen: list[float] = []
    one = transfer_coefficients(scene, six_cells(), points, sampling=sampling, progress=seen.append)
    three = transfer_coefficients(scene, six_cells(), points, sampling=sampling, workers=3)
    assert one.values.equal(three.values)
    assert one.orders.equal(three.orders)
    assert len(set(seen)) >= 6
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1)


@pytest.mark.parametrize("options", [{"rays": 0}, {"bounces": -1}])
def test_samplings_that_are_refused(options):
    with pytest.raises(InputError, match="must be"):
        TransferSampling(**options)


SAMPLING = TransferSampling(rays=32, bounces=1)
ORDERS = torch.tensor([0.5, 0.1]).double()


@pytest.fixture(scope="module")
def scene():
    return corner((0.5, 0.4, 0.3), (0.8, 0.1, 0.1), 0.4)


@pytest.fixture(scope="module")
def made(scene):
    return transfer_coefficients(scene, six_cells(), sampling=SAMPLING)


def test_there_and_back_in_half_precision(tmp_path, made):
    save_transfer(tmp_path / "t.npz", made, "key")
    back = load_transfer(tmp_path / "t.npz", "key")
    assert back.values.dtype == torch.float32
    torch.testing.assert_close(back.values, made.values, rtol=5e-4, atol=3e-8)
    assert back.orders.equal(made.orders)
    assert (tmp_path / "t.npz").stat().st_size < 2 * made.values.numel() + 3000


def test_the_key_tells_everything_that_changes_the_numbers(scene):
    cells, points = six_cells(), Receivers.at_vertices(scene)
    brighter = replace(points, albedo=points.albedo + 0.01)
    moved = scene.vertices.clone()
    moved[0, 0] += 1e-9
    keys = [
        transfer_key(scene, cells, sampling=SAMPLING),
        transfer_key(replace(scene, vertices=moved), cells, sampling=SAMPLING),
        transfer_key(replace(scene, albedo=scene.albedo * 0.5), cells, sampling=SAMPLING),
        transfer_key(replace(scene, normals=-scene.normals), cells, sampling=SAMPLING),
        transfer_key(scene, six_cells(AXES), sampling=SAMPLING),
        transfer_key(scene, cells, points, sampling=SAMPLING),
        transfer_key(scene, cells, brighter, sampling=SAMPLING),
        transfer_key(scene, cells, sampling=replace(SAMPLING, rays=33)),
        transfer_key(scene, cells, sampling=replace(SAMPLING, bounces=2)),
        transfer_key(scene, cells, sampling=replace(SAMPLING, seed=1)),
        transfer_key(scene, cells, sampling=SAMPLING, turn=Turn()),
        transfer_key(scene, cells, sampling=SAMPLING, turn=Turn(angles=12)),
        transfer_key(scene, cells, sampling=SAMPLING, turn=Turn(axis=(1.0, 0.0, 0.0))),
    ]
    assert len(set(keys)) == len(keys)
    again = corner((0.5, 0.4, 0.3), (0.8, 0.1, 0.1), 0.4)
    assert again.raycaster is not None  # what is worked out is no part of it
    assert transfer_key(again, six_cells(), sampling=SAMPLING) == keys[0]


def test_what_is_kept_is_used_and_what_is_stale_is_made_again(tmp_path, scene, monkeypatch):
    path, cells = tmp_path / "t.npz", six_cells()
    first = kept_transfer(path, scene, cells, sampling=SAMPLING)
    with monkeypatch.context() as patch:
        patch.setattr(transfer_file, "transfer_coefficients", None)  # not to be called
        assert kept_transfer(path, scene, cells, sampling=SAMPLING).values.equal(first.values)
    dark = replace(scene, albedo=scene.albedo * 0)
    assert not kept_transfer(path, dark, cells, sampling=SAMPLING).values.any()
    assert kept_transfer(path, scene, cells, sampling=SAMPLING).values.equal(first.values)


def test_what_is_something_else_is_never_replaced(tmp_path, scene):
    path = tmp_path / "t.npz"
    np.savez(path, radiance=np.ones(3))
    for content in (path.read_bytes(), path.read_bytes()[:50], b"ply\nformat ascii 1.0\n"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="delete"):
            kept_transfer(path, scene, six_cells(), sampling=SAMPLING)
        assert path.read_bytes() == content


def test_numbers_that_half_precision_does_not_hold_are_refused(tmp_path):
    large = TransferCoefficients(values=torch.full((1, 6, 3), 7e4), orders=torch.ones(1))
    with pytest.raises(InputError, match="do not fit"):
        save_transfer(tmp_path / "t.npz", large, "key")
    assert not list(tmp_path.iterdir())


def test_files_that_are_refused(tmp_path, made):
    path = tmp_path / "t.npz"
    with pytest.raises(InputError, match="cannot be read"):
        load_transfer(path)
    save_transfer(path, made, "key")
    with pytest.raises(InputError, match="another scene"):
        load_transfer(path, "other")
    with np.load(path) as content:
        arrays = dict(content)
    np.savez(path, **{**arrays, "version": np.array(9)})
    with pytest.raises(InputError, match="version 9"):
        load_transfer(path)
    np.savez(path, **{**arrays, "values": arrays["values"][0]})
    with pytest.raises(InputError, match="shape"):
        load_transfer(path)
    np.savez(path, **{**arrays, "values": arrays["values"] * np.float16(np.nan)})
    with pytest.raises(InputError, match="NaN"):
        load_transfer(path)
    with pytest.raises(OutputError, match="folder"):
        save_transfer(tmp_path / "none" / "t.npz", made, "key")


def test_coefficients_of_a_turn_there_and_back(tmp_path):
    values = torch.rand(5, 7, 6, 3, generator=torch.Generator().manual_seed(0))
    save_transfer(tmp_path / "t.npz", TransferCoefficients(values=values, orders=ORDERS), "key")
    back = load_transfer(tmp_path / "t.npz", "key")
    torch.testing.assert_close(back.values, values, rtol=5e-4, atol=3e-8)
    assert back.orders.equal(ORDERS)


def test_a_kept_turn_is_used_and_begins_with_what_stands_still(tmp_path, scene, monkeypatch):
    path, cells = tmp_path / "t.npz", six_cells()
    still = kept_transfer(path, scene, cells, sampling=SAMPLING)
    turn = Turn(angles=4)
    first = kept_transfer(path, scene, cells, turn=turn, sampling=SAMPLING)
    assert first.values[0].equal(still.values)
    assert not first.values[1].equal(still.values)
    with monkeypatch.context() as patch:
        patch.setattr(transfer_file, "turning_coefficients", None)  # not to be called
        again = kept_transfer(path, scene, cells, turn=turn, sampling=SAMPLING)
    assert again.values.equal(first.values)
