"""Sparse codes of files: what is written, told and refused, and outlines of the lobes."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from skylight.cli import main
from skylight.csc._code import SparseCode
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, builtin, isotropic
from skylight.csc._positions import centres_of
from skylight.csc._sub_dictionaries import BOX_SIZES
from skylight.errors import InputError
from skylight.io._files import read_environment_map, write_environment_map
from skylight.io._hdr import write_exr
from skylight.maps._sparse_codes import (
    _unrolled,
    check_code_name,
    code_map,
    decode_file,
    outlines,
    summarise_code,
)
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import (
    DirectionGrid,
    angle_between,
    direction_from_angles,
    pixel_from_direction,
)
from tests.cli.test_cli import one_line


def make_map(height: int) -> EnvironmentMap:
    """Grey, with a warm lobe in the right half and a blue one in the left."""
    directions = DirectionGrid.latlong(height).directions
    centres = direction_from_angles(
        torch.tensor([1.5, -1.2]).double(), torch.tensor([1.0, 0.7]).double()
    )
    colours = torch.tensor([[3.0, 2.0, 1.0], [0.5, 1.0, 2.0]]).double()
    angle = angle_between(
        directions[:, None].expand(-1, 2, -1), centres.expand(len(directions), -1, -1)
    )
    light = 0.3 + torch.exp(-0.5 * (angle / 0.25) ** 2) @ colours
    return EnvironmentMap(radiance=light.reshape(height, 2 * height, 3).float())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, and the code of it that one good run made."""
    folder = tmp_path_factory.mktemp("codes")
    write_environment_map(folder / "map.exr", make_map(48))
    arguments = ["--dictionary", "iso", "--height", "32", "--activations", "12"]
    assert main(["code", str(folder / "map.exr"), *arguments, "--out", str(folder / "a.json")]) == 0
    return folder


class TestCode:
    def test_code_and_picture(self, folder: Path) -> None:
        assert {path.name for path in folder.iterdir()} >= {"a.json", "a.png"}
        code = SparseCode.load(folder / "a.json")
        assert (code.dictionary, code.height) == ("iso", 32)
        assert 1 <= len(code) <= 12
        assert code.relative_error < 0.05
        with Image.open(folder / "a.png") as picture:
            assert picture.size == (1800, 1008)

    def test_numbers_told(self, folder: Path) -> None:
        coded = code_map(folder / "map.exr", dictionary="vmf", activations=3, weights="nonnegative")
        assert coded.code.height == 48  # the map's own
        assert (coded.code.weights >= 0).all()
        told = summarise_code(coded)
        assert "activations    3\n" in told
        assert f"relative error {100 * coded.code.relative_error:.1f} %" in told
        assert "floats         12 for 13824 (0.087 %)" in told

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"probe": "half.exr"}, "upper half"),
            ({"probe": "black.exr"}, "black"),
            ({"probe": "tiny.exr"}, "finer map"),
            ({"dictionary": "abc"}, "no dictionary 'abc'"),
            ({"dictionary": "/"}, "cannot be read as a dictionary"),
            ({"activations": 99999}, "99999 activations"),
            ({"height": 64}, "fewer than --height 64"),
        ],
    )
    def test_what_cannot_be_coded(
        self, change: dict[str, Any], message: str, folder: Path, tmp_path: Path
    ) -> None:
        for name, *shape in (("half", 16, 64), ("black", 32, 64), ("tiny", 8, 16)):
            pixels = np.full((*shape, 3), name != "black", np.float32)
            write_exr(tmp_path / f"{name}.exr", pixels, half=False, header={})
        probe = tmp_path / change.pop("probe", folder / "map.exr")
        with pytest.raises(InputError, match=message):
            code_map(probe, **{"dictionary": "vmf", **change})

    def test_a_code_is_json(self) -> None:
        with pytest.raises(InputError, match=r"must end in \.json"):
            check_code_name(Path("a.png"))

    def test_earlier_code_survives_a_failure(
        self, folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        before = {path: path.read_bytes() for path in folder.iterdir()}
        given = [str(folder / "map.exr"), "--dictionary", "vmf", "--out", str(folder / "a.json")]
        assert main(["code", *given, "--activations", "0"]) == 2
        assert "0 activations" in one_line(capsys)
        assert {path: path.read_bytes() for path in folder.iterdir()} == before


class TestDecode:
    def test_map_is_the_code_decoded(
        self, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = tmp_path / "map.exr"
        assert main(["decode", str(folder / "a.json"), "--out", str(out)]) == 0
        assert "% of the energy cut off" in capsys.readouterr().out
        code, decoded = SparseCode.load(folder / "a.json"), read_environment_map(out)
        true = read_environment_map(folder / "map.exr").resize(32)
        share = true.grid.solid_angles[:, None]
        error = (share * (decoded.flat - true.flat).square()).sum()
        found = float((error / (share * true.flat.square()).sum()).sqrt())
        assert found == pytest.approx(code.relative_error, rel=0.02)

    def test_any_height(self, folder: Path, tmp_path: Path) -> None:
        decode_file(folder / "a.json", tmp_path / "map.hdr", height=80)
        fine, true = read_environment_map(tmp_path / "map.hdr"), make_map(80)
        assert fine.layout == (80, 160)
        assert float((fine.radiance - true.radiance).abs().mean() / true.radiance.mean()) < 0.05

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_share_cut_off(self, tmp_path: Path, sign: float) -> None:
        """Of a constant all or nothing, by its sign."""
        code = SparseCode(
            dictionary="vmf",
            fingerprint=builtin("vmf").fingerprint,
            height=32,
            banded=False,
            filters=torch.tensor([0]),
            directions=torch.tensor([[0.0, 1.0, 0.0]]).double(),
            twists_rad=torch.zeros(1).double(),
            weights=torch.tensor([[sign, sign, sign]]).double(),
            relative_error=0.0,
        )
        code.save(tmp_path / "c.json")
        share = decode_file(tmp_path / "c.json", tmp_path / "c.exr")
        assert share == pytest.approx(0 if sign > 0 else 1)
        radiance = read_environment_map(tmp_path / "c.exr").radiance
        level = max(sign, 0.0) / math.sqrt(4 * math.pi)
        torch.testing.assert_close(radiance, torch.full_like(radiance, level))

    def test_own_dictionary(self, folder: Path, tmp_path: Path) -> None:
        bank = isotropic(40, 6)
        bank.name = "mine"
        mine, other = tmp_path / "mine.safetensors", tmp_path / "other.safetensors"
        bank.save(mine)
        isotropic(40, 7).save(other)
        code, out = tmp_path / "c.json", tmp_path / "c.exr"
        coded = code_map(folder / "map.exr", dictionary=str(mine), height=32, activations=4)
        coded.code.save(code)
        decode_file(code, out, dictionary=mine)
        out.unlink()
        with pytest.raises(InputError, match="'mine'"):
            decode_file(code, out)
        with pytest.raises(InputError, match="make a coder that matches"):
            decode_file(code, out, dictionary=other)
        assert not out.exists()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"height": 1_000_000}, "damaged"),
            ({"dictionary": "abc"}, "--dictionary"),
            ({"fingerprint": "abc"}, "make a coder that matches"),
            ({"activations": 3}, "damaged"),
            ({"activations": ["a"]}, "damaged"),
            ({"filter": 10**6}, "filters that"),
            ({"direction": [0, 0, 0]}, "damaged"),
            ({"rgb": None}, "damaged"),
            ({"rgb": [0, 1e300, 1]}, "damaged"),
        ],
    )
    def test_damaged_codes(
        self, change: dict[str, object], message: str, folder: Path, tmp_path: Path
    ) -> None:
        """What a file may hold that no code has; of its form, tests/csc/test_code.py."""
        content = json.loads((folder / "a.json").read_text())
        ((key, value),) = change.items()
        target = content if key in content else content["activations"][-1]
        target[key] = value
        (tmp_path / "c.json").write_text(json.dumps(content))
        with pytest.raises(InputError, match=message):
            decode_file(tmp_path / "c.json", tmp_path / "c.exr")
        assert {path.name for path in tmp_path.iterdir()} == {"c.json"}

    @pytest.mark.parametrize(
        ("more", "message"),
        [
            ({"height": 0}, "--height must be"),
            ({"height": 99999}, "--height must be"),
            ({"out": Path("c.png")}, r"use \.exr or \.hdr"),
            ({"dictionary": Path("none")}, "no dictionary"),
        ],
    )
    def test_what_cannot_be_decoded(
        self, more: dict[str, Any], message: str, folder: Path, tmp_path: Path
    ) -> None:
        with pytest.raises(InputError, match=message):
            decode_file(folder / "a.json", **{"out": tmp_path / "c.exr", **more})
        assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def coder() -> SphericalSparseCoder:
    return SphericalSparseCoder("ani", banded=True)


class TestOutlines:
    def code(self, coder: SphericalSparseCoder, filter_: int, direction: list[float]) -> SparseCode:
        return SparseCode(
            dictionary="ani",
            fingerprint=coder.bank.fingerprint,
            height=32,
            banded=True,
            filters=torch.tensor([filter_]),
            directions=torch.nn.functional.normalize(torch.tensor([direction]).double(), dim=1),
            twists_rad=torch.tensor([0.7]).double(),
            weights=torch.ones(1, 3).double(),
            relative_error=0.0,
        )

    @pytest.mark.parametrize("direction", [[0.3, 0.2, -1], [0.2, 1, 0.1], [-0.1, -0.4, 1]])
    @pytest.mark.parametrize("filter_", [45, 88, 200])
    def test_half_the_height_all_around(
        self, coder: SphericalSparseCoder, filter_: int, direction: list[float]
    ) -> None:
        """Turned as the decoder turns: the filter's values along the outline are alike."""
        code = self.code(coder, filter_, direction)
        (found,) = outlines(coder, code)
        assert found is not None
        coefficients = coder.coefficients(code.tensors()).detach()[:, 0]
        around, middle = (
            harmonics.evaluate_about_zenith(d, coder.degree) @ coefficients
            for d in (found.around, code.directions)
        )
        assert (around / middle > 0.2).all()
        assert (around / middle < 0.75).all()
        assert (found.axis is None) == (filter_ >= 101)
        if found.axis is not None:
            ends = angle_between(found.axis[:1], found.axis[-1:])
            across = angle_between(found.around[24:25], found.around[72:73])
            along = angle_between(found.around[:1], found.around[48:49])
            torch.testing.assert_close(ends, torch.maximum(across, along))

    def test_width_of_a_gaussian(self, coder: SphericalSparseCoder) -> None:
        (found,) = outlines(coder, self.code(coder, 180, [1, 0, 0]))
        assert found is not None
        radius = float(angle_between(found.around, torch.tensor([[1.0, 0, 0]]).double()).mean())
        profile = coder.bank.evaluate(
            direction_from_angles(torch.zeros(400).double(), torch.linspace(0, 2, 400).double())
        )[180]
        half = 2 * int((profile > 0.5 * profile[0]).sum()) / 399
        assert radius == pytest.approx(half, rel=0.1)

    def test_constants_have_none(self, coder: SphericalSparseCoder) -> None:
        assert outlines(coder, self.code(coder, 0, [1, 0, 0])) == [None]

    def test_a_box_has_its_border(self) -> None:
        """2 rows of 3 columns about row 10 and column 0, and round the seam; a pixel has none."""
        coder = SphericalSparseCoder(FilterBank(builtin("iso", 8).coefficients, "box"))
        boxes = coder.parts[-1]
        place = torch.tensor([[10, 0, 0]])
        code = replace(
            self.code(coder, boxes.first + BOX_SIZES.index((2, 3)), [1, 0, 0]),
            directions=centres_of(boxes.positions.rotations(place)),
        )
        (found,) = outlines(coder, code)
        assert found is not None
        assert found.axis is None
        row, column = pixel_from_direction(found.around, 32, 64)
        assert float(row.min()) == pytest.approx(9.5)
        assert float(row.max()) == pytest.approx(11.5)
        column = (column + 10) % 64 - 10
        assert float(column.min()) == pytest.approx(-1.5)
        assert float(column.max()) == pytest.approx(1.5)
        torch.testing.assert_close(found.around[0], found.around[-1])
        pixel = replace(code, filters=torch.tensor([boxes.first]))
        assert outlines(coder, pixel) == [None]

    def test_no_seam(self) -> None:
        """A circle about the middle of the seam: no stroke crosses the map."""
        angle = torch.linspace(0, 2 * math.pi, 97, dtype=torch.float64)
        circle = torch.stack([0.3 * torch.cos(angle), 0.3 * torch.sin(angle), torch.ones(97)], 1)
        columns, rows = _unrolled(torch.nn.functional.normalize(circle.double(), dim=1), (32, 64))
        steps = np.abs(np.diff(columns))
        assert np.nanmax(steps) < 1
        for edge in (0, 63):
            assert np.nanmin(np.abs(columns - edge)) < 1
        assert len(columns) == len(rows)
