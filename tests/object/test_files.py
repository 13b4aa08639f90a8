"""The command `skylight estimate-object`: files in, files out, one line where it fails."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from skylight.cli import main
from skylight.imaging._colour import linear_to_srgb
from skylight.io._files import read_environment_map
from skylight.io._hdr import write_exr
from skylight.object._files import read_mask
from skylight.object._view import observe_object
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._cameras import object_camera
from tests.cli.test_cli import one_line
from tests.imaging.picture_files import camera_exif

CAMERA = {"fov_deg": 36, "position": [3, 1.2, -2.6], "look_at": [0, 0, 0]}
RESULTS = {"probe.exr", "probe.hdr", "probe.png", "estimate.json", "comparison.png"}
SIZE = 40
LAMP = (0.8, 0.6, 0.0)  # 53 degrees from +Y towards +X


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mesh, its camera, and its picture in light from +X above, linear and as PNG.

    In lamp.exr a lamp lights it too.
    """
    folder = tmp_path_factory.mktemp("object")
    mesh = trimesh.util.concatenate(
        [
            trimesh.creation.icosphere(subdivisions=3, radius=0.8),
            trimesh.creation.torus(1.0, 0.12, major_sections=64, minor_sections=16),
        ]
    )
    mesh.export(folder / "mesh.ply")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    grid = DirectionGrid.latlong(64)
    c = torch.zeros(9, 3, dtype=torch.float64)
    c[0], c[1], c[3] = torch.tensor([0.9, 0.8, 0.7]), 0.2, torch.tensor([0.4, 0.3, 0.2])
    light = EnvironmentMap(
        radiance=(harmonics.evaluate(grid.directions, 2) @ c).reshape(64, 128, 3).float()
    )
    view = observe_object(
        torch.from_numpy(np.array(mesh.vertices)),
        torch.from_numpy(np.array(mesh.faces)),
        object_camera(CAMERA, height=SIZE, width=SIZE),
        torch.ones(SIZE, SIZE, 3),
    )
    background = torch.tensor([0.1, 0.2, 0.4]).expand(SIZE, SIZE, 3)
    every = torch.arange(len(view.surface))
    pixels = view.surface.image(view.shade(light, every), background)
    write_exr(folder / "photo.exr", pixels.numpy(), half=False, header={})
    lobe = 30 * torch.exp(50 * (grid.directions @ torch.tensor(LAMP).double() - 1)).reshape(64, 128)
    lit = EnvironmentMap(radiance=light.radiance + lobe[..., None].float())
    by_lamp = view.surface.image(view.shade(lit, every), background)
    write_exr(folder / "lamp.exr", by_lamp.numpy(), half=False, header={})
    codes = (255 * linear_to_srgb(pixels.clamp(0, 1))).round().to(torch.uint8).numpy()
    Image.fromarray(codes).save(folder / "photo.png")
    Image.fromarray(np.full((SIZE, SIZE), 255, np.uint8)).save(folder / "mask.png")
    return folder


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_mask_is_what_is_brighter_than_half_of_its_range(
    tmp_path: Path, suffix: str, depth: int
) -> None:
    """Upright, as the photograph is: held upside down here."""
    codes = np.full((30, 40), 0.3)  # grey is no object
    codes[:10, :15] = 0.7
    codes[0, :3] = 127 / 255, 128 / 255, 1
    stored = np.rint(codes * (2**depth - 1)).astype(np.uint8 if depth == 8 else np.uint16)
    path = tmp_path / f"mask{suffix}"
    exif = camera_exif(orientation=3)
    Image.fromarray(stored).save(path, exif=exif)
    np.testing.assert_array_equal(read_mask(path), (codes > 0.5)[::-1, ::-1])


def arguments(folder: Path, out: Path, *more: str, photo: str = "photo.exr") -> list[str]:
    files = [str(folder / "mesh.ply"), str(folder / photo)]
    return [
        "estimate-object", *files, "--camera", str(folder / "camera.json"), "--out", str(out), *more
    ]  # fmt: skip


class TestResults:
    def test_of_an_earlier_code_nothing_stays(self, folder: Path, tmp_path: Path) -> None:
        few = ["--light", "vmf", "--activations", "2"]
        assert main(arguments(folder, tmp_path, *few)) == 0
        assert {path.name for path in tmp_path.iterdir()} == {*RESULTS, "code.json"}
        assert main(arguments(folder, tmp_path, "--light", "sh9")) == 0
        assert {path.name for path in tmp_path.iterdir()} == RESULTS

    def test_harmonics(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "out"
        mask = ["--mask", str(folder / "mask.png")]
        assert main(arguments(folder, out, "--light", "sh9", *mask)) == 0
        assert {path.name for path in out.iterdir()} == RESULTS
        assert "re-rendered to within 0." in capsys.readouterr().out
        told = json.loads((out / "estimate.json").read_text())
        assert told["residual"] < 0.01
        # from +X, 90 degrees to the right of -Z, and above
        assert told["brightest"]["azimuth_deg"] == pytest.approx(90, abs=10)
        assert told["brightest"]["zenith_deg"] == pytest.approx(63, abs=10)
        assert np.shape(told["coefficients"]) == (9, 3)
        probe = read_environment_map(out / "probe.exr")
        assert probe.layout == (64, 128)
        row, column = np.unravel_index(int(probe.flat.sum(1).argmax()), probe.layout)
        assert abs(int(column) - 96) < 5
        assert int(row) < 32
        with Image.open(out / "comparison.png") as image:
            assert image.size == (1650, 1100)
        camera = told["camera"]
        again = object_camera(
            {k: camera[k] for k in ("focal_px", "center_px", "world_from_camera")},
            height=camera["height"],
            width=camera["width"],
        )
        torch.testing.assert_close(
            again.world_from_camera.rotation,
            object_camera(CAMERA, height=SIZE, width=SIZE).world_from_camera.rotation,
        )

    def test_code(self, folder: Path, tmp_path: Path) -> None:
        out = tmp_path / "out"
        more = ["--light", "vmf", "--activations", "6", "--albedo", "0.9,0.8,0.7"]
        assert main(arguments(folder, out, *more, "--roughness", "0.5", photo="photo.png")) == 0
        told = json.loads((out / "estimate.json").read_text())
        assert told["dictionary"]["name"] == "vmf"
        assert 1 <= len(told["code"]) <= 6
        assert all(min(each["rgb"]) >= 0 for each in told["code"])
        # the file of the code is what `skylight decode` reads: the light that was found
        assert main(["decode", str(out / "code.json"), "--out", str(tmp_path / "map.exr")]) == 0
        decoded, probe = (
            read_environment_map(path) for path in (tmp_path / "map.exr", out / "probe.exr")
        )
        torch.testing.assert_close(decoded.radiance, probe.radiance, rtol=1e-3, atol=1e-4)
        assert told["material"] == {
            "albedo": [0.9, 0.8, 0.7],
            "roughness": 0.5,
            "reflectance": 0.04,
        }

    def test_lamps(self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """Told as a face's are."""
        out = tmp_path / "out"
        assert main(arguments(folder, out, "--light", "lamps", photo="lamp.exr")) == 0
        assert {path.name for path in out.iterdir()} == RESULTS
        said = capsys.readouterr().out
        assert "lamp        azimuth +90°, zenith 53°\n" in said
        assert "light       one lamp in ambient light" in said
        told = json.loads((out / "estimate.json").read_text())
        assert told["light"] == "lamps"
        assert "coefficients" not in told
        (lamp,) = told["lamps"]
        assert lamp.keys() == {"azimuth_deg", "zenith_deg", "irradiance", "spread_deg"}
        assert lamp["azimuth_deg"] == pytest.approx(90, abs=1)
        assert lamp["zenith_deg"] == pytest.approx(53.1, abs=1)
        assert lamp["spread_deg"] == pytest.approx(math.degrees(50**-0.5), abs=1)
        # of a surface that faces it: 30 int exp(50 (cos - 1)) cos dw
        assert lamp["irradiance"] == pytest.approx([30 * 2 * math.pi * 49 / 50**2] * 3, rel=0.05)


class TestFailures:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"--camera": "none.json"}, "No such file"),
            ({"--mask": "none.png"}, "none.png: No such file"),
            ({"--mask": "text.png"}, "no picture"),
            ({"mesh": "none.ply"}, "no such mesh"),
            ({"photo": "grey.png"}, "give a colour photo"),
            ({"--albedo": "red"}, "--albedo"),
            ({"--reflectance": "0.1"}, "--roughness"),
            ({"--activations": "0"}, "1 or more"),
        ],
    )
    def test_one_line(
        self,
        changes: dict[str, str],
        message: str,
        folder: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        (tmp_path / "text.png").write_text("none")
        Image.fromarray(np.full((SIZE, SIZE), 200, np.uint8)).save(tmp_path / "grey.png")
        given = {
            "mesh": str(folder / "mesh.ply"),
            "photo": str(folder / "photo.exr"),
            "--camera": str(folder / "camera.json"),
        }
        for key, value in changes.items():
            is_file = key in ("mesh", "photo", "--camera", "--mask")
            given[key] = str(tmp_path / value) if is_file else value
        mesh, photo = given.pop("mesh"), given.pop("photo")
        options = [part for pair in given.items() for part in pair]
        out = tmp_path / "out"
        code = main(["estimate-object", mesh, photo, *options, "--light", "vmf", "--out", str(out)])
        assert code == 2
        assert message in one_line(capsys)
        assert not out.exists()
