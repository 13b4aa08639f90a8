"""Results that skylight 0.1 wrote: read, or refused with what to do instead."""

from pathlib import Path
from shutil import copy

import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import write_probe
from skylight.maps._export import export_light
from skylight.relight._decoder import read_latent
from skylight.sphere._envmap import EnvironmentMap

NUMBERS = Path(__file__).parents[1] / "golden" / "estimate_0_1.json"  # as 0.1.0 wrote it


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An estimate's folder; maps of 0.1 had 64 rows."""
    folder = tmp_path / "me_light"
    folder.mkdir()
    copy(NUMBERS, folder / "estimate.json")
    write_probe(folder, EnvironmentMap(radiance=torch.rand(64, 128, 3)))
    return folder


def test_its_light_goes_to_other_programs(folder: Path, tmp_path: Path) -> None:
    exported = export_light(folder, tmp_path / "out", ("gltf", "threejs"))
    assert exported.lamps == 0
    assert (tmp_path / "out" / "light.glb").is_file()


def test_what_needs_more_is_refused_in_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "blender", str(folder), str(tmp_path / "out")]) == 2
    assert "estimate the photograph again" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"skylight 0\.1\.0, .*probe\.exr"):
        read_latent(folder / "estimate.json")


def test_latents_of_this_version_are_read(tmp_path: Path) -> None:
    """The same file with another version in it, since only that tells the decoders apart."""
    path = tmp_path / "estimate.json"
    path.write_text(NUMBERS.read_text().replace('"skylight": "0.1.0"', '"skylight": "0.2.0"'))
    assert read_latent(path).z.shape == (64,)
