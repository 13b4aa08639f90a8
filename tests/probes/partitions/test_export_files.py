"""Scenes exported with their light at the texels of an atlas, by the command line."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals

from skylight.cli import main
from tests.probes.partitions import test_scene_commands as test_partition_scene
from tests.probes.partitions.test_scene_commands import CELLS, LIGHT, command

folder = test_partition_scene.folder


def test_export_of_texels_has_the_light_of_the_faces(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("xatlas")
    arguments = command(folder, "export", "t.glb", "--atlas-px", "48", names=("probe", "capture"))
    arguments[arguments.index("--cache") + 1] = str(folder / "texels.npz")
    assert main(arguments) == 0
    assert "no texture coordinates" in capsys.readouterr().out
    with np.load(folder / "t.atlas.npz") as content:
        transfer, facts = content["transfer"].astype(float), json.loads(str(content["extras"]))
    radiance = np.einsum("nhwc,nc->hwc", transfer, facts["light"])
    read: Any = trimesh.load(folder / "t.glb", force="mesh", process=False)
    np.testing.assert_allclose(read.bounds, [[-0.015, 0, -0.015], [0.015, 0.03, 0.015]], atol=1e-7)
    share = CELLS.clamped_cosine(torch.tensor([[0.0, 1, 0]]).double()) / np.pi
    expected = 0.7 * (share @ LIGHT).numpy()
    uv = read.visual.uv[read.faces].mean(1)
    column, row = (uv[:, 0] * 48).astype(int), ((1 - uv[:, 1]) * 48).astype(int)
    top = np.isclose(read.vertices[read.faces][:, :, 1], 0.03).all(1)
    assert top.sum() >= 2
    found = radiance[row[top], column[top]]
    # nothing hides what the upper face sees
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=2e-3)
    written = (folder / "texels.npz").stat().st_mtime_ns
    assert main(arguments) == 0
    assert (folder / "texels.npz").stat().st_mtime_ns == written


def test_layouts_that_cannot_be_used_are_made_anew_or_said(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sheet with one picture on both of its faces."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    twice = np.concatenate([square, square + np.array([0, 0, 0.2])])
    visual = TextureVisuals(
        uv=np.concatenate([square[:, :2]] * 2), image=Image.new("RGB", (4, 4), (200, 100, 50))
    )
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    trimesh.Trimesh(twice, faces, visual=visual, process=False).export(folder / "sheet.glb")
    arguments = command(folder, "export", "s.glb", "--atlas-px", "32", names=("probe", "capture"))
    arguments[arguments.index("--scene") + 1] = str(folder / "sheet.glb")
    arguments[arguments.index("--cache") + 1] = str(folder / "sheet.npz")
    monkeypatch.setitem(sys.modules, "xatlas", None)
    assert main(arguments) == 1
    told = capsys.readouterr()
    assert "coordinates overlap: 992 texels of 32 x 32" in told.out  # not on the diagonal
    assert "pip install 'skylight-lighting[atlas]'" in told.err.strip().splitlines()[-1]
    assert not (folder / "s.glb").exists()
    arguments[arguments.index("--atlas-px") + 1] = "2"
    assert main(arguments) == 2
    assert "4 texels" in capsys.readouterr().err.strip().splitlines()[-1]
    monkeypatch.undo()
    pytest.importorskip("xatlas")
    arguments[arguments.index("--atlas-px") + 1] = "32"
    assert main(arguments) == 0
    assert (folder / "s.atlas.npz").exists()
