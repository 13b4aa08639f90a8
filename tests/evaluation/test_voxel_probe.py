"""The evaluation of voxel probes, on a small mesh under a made-up sky."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from skylight.evaluation import _voxel_probe as voxel_probe
from skylight.evaluation._voxel_probe import (
    ALBEDO,
    TRANSFER,
    VoxelProbe,
    VoxelScene,
    baked,
    reconstruction,
)
from skylight.io._files import write_environment_map
from skylight.probes.voxel._model import star_probe
from skylight.sphere._envmap import EnvironmentMap
from skylight.transport._path_tracer import Sampling


def sky() -> EnvironmentMap:
    """Bright above, dim and reddish below."""
    rows = torch.linspace(1, 0, 16)[:, None, None].expand(16, 32, 3)
    return EnvironmentMap(radiance=(0.2 + rows) * torch.tensor([1.0, 0.9, 0.8]))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    (folder / "hdr").mkdir()
    (folder / "meshes").mkdir()
    write_environment_map(folder / "hdr" / "sky.exr", sky())
    (folder / "hdr" / "index.csv").write_text("file,category\nsky.exr,indoor\n")
    shape = trimesh.creation.box((2.0, 1.0, 1.0))
    shape.export(folder / "meshes" / "stanford_bunny.ply")
    return folder


def small(data: Path) -> VoxelProbe:
    return VoxelProbe(data=data, maps=1, models=1, samples=16, best=2, every_set=5000)


def test_items_have_scores_and_a_picture(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(voxel_probe, "PIXELS", 80)
    monkeypatch.setattr(voxel_probe, "RESOLUTION", 12)
    evaluation = small(data)
    assert evaluation.items() == ["sky.exr", TRANSFER]
    item = evaluation.measure("sky.exr", tmp_path / "a.png")
    assert set(item.metrics) == {f"probe{n}_{k}" for n in (3, 5) for k in ("direct", "global")}
    for scores in item.metrics.values():
        # a box has no neighbours to be shadowed by: only noise differs
        assert 0 < scores["mae"] < 0.1
        # the background is equal, and so the whole picture is more alike than the model alone
        assert 0.8 < scores["ssim"] < 1
        assert scores["ssim_model"] < scores["ssim"]
        assert scores["mae"] == pytest.approx(scores["mae_bunny"])
    assert (tmp_path / "a.png").stat().st_size > 5000


def test_transfer_has_the_thesis_numbers(data: Path, tmp_path: Path) -> None:
    item = small(data).measure(TRANSFER, tmp_path / "b.png")
    assert (tmp_path / "b.png").read_bytes()[:4] == b"\x89PNG"
    assert item.metrics["probe5_global"]["transfer_l1"] == pytest.approx(0.0094, rel=0.25)
    assert item.facts["probe3_set"] == pytest.approx(2.71, abs=0.01)
    rows = {
        name: {metric: {"mean": value} for metric, value in of.items()}
        for name, of in item.metrics.items()
    }
    checks = small(data).checks(rows, [item])
    assert checks["transfer_l1 probe3_direct, off the thesis' 0.0115"].ok
    assert checks["transfer_l1: probe5_global <= probe5_direct"].ok


def test_drawing_a_probe_with_its_own_light_is_what_path_tracing_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No slot is missing and no light comes from afar: what differs is noise and interpolation."""
    monkeypatch.setattr(voxel_probe, "PIXELS", 64)
    scene, light = VoxelScene.of(star_probe(3), views_deg=((35.0, 25.0),)), sky()
    captured = baked(3, light, Sampling(samples=256), 0)
    completed = reconstruction(3, "direct").complete(captured)
    truths, masks, noise = scene.traced(light, Sampling(samples=256), 1)
    for drawing, truth, mask in zip(scene.drawn(completed), truths, masks, strict=True):
        assert (drawing[~mask] == 0).all()
        error = (drawing - truth)[mask].abs().mean() / truth[mask].mean()
        assert float(error) < 0.02
    assert noise < 0.02


def test_a_face_in_a_white_world_has_its_albedo() -> None:
    white = EnvironmentMap(radiance=torch.ones(8, 16, 3))
    captured = baked(1, white, Sampling(samples=64), 0)
    each = captured.radiance[:, 0].mean((1, 2, 3))
    np.testing.assert_allclose(each.numpy(), ALBEDO, rtol=0.02)
    assert captured.known.sum() == 6
