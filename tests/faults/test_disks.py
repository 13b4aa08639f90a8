"""Full and read-only disks, and workers that die: one clear line, and what was there stays whole.

Small and read-only disks in memory need root; their tests skip without.
"""

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from skylight.errors import OutputError
from skylight.io._bounded import write_json
from skylight.io._files import write_environment_map, write_png
from skylight.io._tensors import write_tensors
from skylight.probes.voxel._lightmap import Lightmap
from skylight.probes.voxel._model import VoxelModel, write_voxels
from skylight.skies._index import SkyRecord, write_rows
from skylight.sphere._envmap import EnvironmentMap
from skylight.work._resumable import results_folder

DISK = 1_000_000  # bytes
_NOISE = np.random.default_rng(0)
_CODES = _NOISE.integers(0, 256, (1200, 1200, 3), dtype=np.uint8)
_LIGHT = EnvironmentMap(radiance=torch.from_numpy(_NOISE.random((512, 1024, 3), dtype=np.float32)))
_RECORD = SkyRecord(
    file="a" * 1000, day="d", time="", regime="clear", sun_zenith_deg=1.0, map_azimuth_deg=0.0,
    sun_transmittance=1.0,
)  # fmt: skip
_SLOTS = Lightmap(
    radiance=torch.from_numpy(_NOISE.random((6, 32, 32, 32, 3), dtype=np.float32)),
    coverage=torch.ones(6, 32),
    confidence=torch.ones(6, 32),
)

# each writes more than fits
WRITERS: dict[str, Callable[[Path], object]] = {
    "light.exr": lambda path: write_environment_map(path, _LIGHT),
    "light.hdr": lambda path: write_environment_map(path, _LIGHT),
    "shown.png": lambda path: write_png(path, _CODES),
    "numbers.json": lambda path: write_json(path, list(range(300_000))),
    "weights.safetensors": lambda path: write_tensors(path, {"w": torch.zeros(10**6)}),
    "index.csv": lambda path: write_rows(path, [_RECORD] * 2000),
    "lightmap.npz": lambda path: _SLOTS.save(path),
    "model.npy": lambda path: write_voxels(
        path, VoxelModel(occupied=np.ones((128, 128, 128), bool))
    ),
}


def _mounted(place: Path, options: str) -> Iterator[Path]:
    place.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True
    )
    if made.returncode:
        pytest.skip("no disk of its own can be made here (needs root)")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    yield from _mounted(tmp_path / "small", f"size={DISK}")


@pytest.fixture
def read_only_disk(tmp_path: Path) -> Iterator[Path]:
    yield from _mounted(tmp_path / "fixed", "ro")


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file_whole(tmp_path: Path, name: str) -> None:
    """A real failing write without a disk: no file of this process may be longer than 1 KiB."""
    resource = pytest.importorskip("resource")
    path = tmp_path / name
    path.write_bytes(b"the old one")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"File too large|requested and") as caught:
            WRITERS[name](path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    line = str(caught.value)
    assert "\n" not in line
    assert str(path) in line
    assert path.read_bytes() == b"the old one"
    assert os.listdir(tmp_path) == [name]


def test_a_full_disk_leaves_old_results_whole(small_disk: Path) -> None:
    out = small_disk / "out"
    out.mkdir()
    (out / "probe.exr").write_bytes(b"the old one")

    def work() -> None:
        with results_folder(out) as partial:
            write_json(partial / "estimate.json", {})
            write_environment_map(partial / "probe.exr", _LIGHT)

    with pytest.raises(OutputError, match=r"probe\.exr"):
        work()
    assert os.listdir(out) == ["probe.exr"]
    assert (out / "probe.exr").read_bytes() == b"the old one"


@pytest.mark.parametrize("name", WRITERS)
def test_a_read_only_disk_is_one_line(read_only_disk: Path, name: str) -> None:
    with pytest.raises(OutputError, match="choose a folder that you may write to") as caught:
        WRITERS[name](read_only_disk / name)
    assert "\n" not in str(caught.value)


def test_results_on_a_read_only_disk(read_only_disk: Path) -> None:
    with pytest.raises(OutputError, match="choose another folder"), results_folder(read_only_disk):
        pass
