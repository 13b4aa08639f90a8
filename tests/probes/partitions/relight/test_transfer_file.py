from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.errors import InputError, OutputError
from skylight.probes.partitions.relight import _transfer as transfer_file
from skylight.probes.partitions.relight._atlas import Receivers
from skylight.probes.partitions.relight._transfer import (
    TransferCoefficients,
    TransferSampling,
    Turn,
    TurningCoefficients,
    kept_transfer,
    kept_turning_transfer,
    load_transfer,
    load_turning_transfer,
    save_transfer,
    transfer_coefficients,
    transfer_key,
)
from tests.probes.partitions.shapes import AXES, corner, six_cells

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
    save_transfer(tmp_path / "t.npz", TurningCoefficients(values=values, orders=ORDERS), "key")
    back = load_turning_transfer(tmp_path / "t.npz", "key")
    torch.testing.assert_close(back.values, values, rtol=5e-4, atol=3e-8)
    assert back.orders.equal(ORDERS)
    with pytest.raises(InputError, match="shape"):
        load_transfer(tmp_path / "t.npz", "key")
    still = TransferCoefficients(values=values[0], orders=ORDERS)
    save_transfer(tmp_path / "t.npz", still, "key")
    with pytest.raises(InputError, match="shape"):
        load_turning_transfer(tmp_path / "t.npz", "key")


def test_a_kept_turn_is_used_and_begins_with_what_stands_still(tmp_path, scene, monkeypatch):
    path, cells = tmp_path / "t.npz", six_cells()
    still = kept_transfer(path, scene, cells, sampling=SAMPLING)
    turn = Turn(angles=4)
    first = kept_turning_transfer(path, scene, cells, turn, sampling=SAMPLING)
    assert first.values[0].equal(still.values)
    assert not first.values[1].equal(still.values)
    with monkeypatch.context() as patch:
        patch.setattr(transfer_file, "turning_coefficients", None)  # not to be called
        again = kept_turning_transfer(path, scene, cells, turn, sampling=SAMPLING)
    assert again.values.equal(first.values)
