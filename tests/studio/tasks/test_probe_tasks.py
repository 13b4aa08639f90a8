"""Probes in a light whose answer is known: radiance 1 from the upper half, nothing from below.

With small pictures in the print files; a browser's test asks the server for whole ones.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from skylight.io._files import write_environment_map
from skylight.probes.voxel._model import star_probe
from skylight.sphere._envmap import EnvironmentMap
from skylight.studio.tasks import _probes as partition_task, _probes as voxel_task
from skylight.studio.tasks._light import Light

PANEL_PX = 60


@pytest.fixture
def from_above(tmp_path: Path) -> Light:
    radiance = torch.zeros(16, 32, 3)
    radiance[:8] = 1.0
    write_environment_map(tmp_path / "up.exr", EnvironmentMap(radiance=radiance))
    return Light(path=str(tmp_path / "up.exr"), name="up.exr")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def test_a_voxel_probe(out: Path, from_above: Light, monkeypatch: pytest.MonkeyPatch) -> None:
    small = partial(voxel_task.write_printed_probe, panel_px=PANEL_PX)
    monkeypatch.setattr(voxel_task, "write_printed_probe", small)
    result = voxel_task.make_voxel_probe(str(out), 1, 20.0, 1.6, from_above, tell=lambda *_: None)
    names = {file.name for file in out.iterdir()}
    assert {"parts.stl", "parts.3mf", "assembly.json", "preview.glb", "lightmap.png"} <= names
    assert result["voxels"] == [[[True]]]
    assert result["captured"] == 6
    free = {
        slot["orientation"]: slot["radiance"][0]
        for slot in result["lightmap"]
        if not slot["configuration"]
    }
    # E / pi = (1 + cos) / 2 of a face under half a sphere of radiance 1, times the albedo
    assert free["+y"] == pytest.approx(0.8, abs=0.02)
    assert free["+x"] == pytest.approx(0.4, abs=0.02)
    assert free["-y"] == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(("level", "error"), [(0.0, 0.0), (1.0, 0.5), (1e30, 0.5)])
def test_an_error_is_relative_to_what_was_not_captured(level: float, error: float) -> None:
    environment = EnvironmentMap(radiance=torch.full((16, 32, 3), level))
    true = voxel_task.lit_slots(environment)
    captured = voxel_task.captured_by(star_probe(1), true)
    half = replace(true, radiance=true.radiance / 2)
    assert voxel_task.reconstruction_error(half, true, captured) == pytest.approx(error)


def test_a_partitions_probe(out: Path, from_above: Light, monkeypatch: pytest.MonkeyPatch) -> None:
    small = partial(partition_task.write_printed_partitions, panel_px=PANEL_PX)
    monkeypatch.setattr(partition_task, "write_printed_partitions", small)
    result = partition_task.make_partition_probe(
        str(out), "6d", None, from_above, tell=lambda *_: None
    )
    names = {file.name for file in out.iterdir()}
    assert {"parts.stl", "cells.png", "preview.glb", "lightmap.png", "report.json"} <= names
    cells = result["cells"]
    assert sum(cell["solid_angle_sr"] for cell in cells) == pytest.approx(4 * np.pi)
    for cell in cells:
        # the mean radiance of its cell, weighted by the cosine to its face
        expected = {1: 1.0, 0: 0.5, -1: 0.0}[round(cell["direction"][1])]
        assert cell["radiance"] == pytest.approx([expected] * 3, abs=0.01)
    scene = trimesh.load_scene(out / "preview.glb")
    assert set(scene.geometry) == {"shell_lower", "kernel", "shell_upper"}
    assert np.ptp(scene.bounds, axis=0).max() == pytest.approx(0.08, abs=0.02)
