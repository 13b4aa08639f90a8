import json
import math
from pathlib import Path

import pytest
import torch

from skylight.csc._code import SparseCode
from skylight.errors import InputError
from skylight.sphere._frame import direction_from_angles

F64 = torch.float64


def some_code(count: int = 7, seed: int = 0) -> SparseCode:
    """Numbers of full length, twists of any angle."""
    generator = torch.Generator().manual_seed(seed)
    azimuth, zenith, twist = math.pi * torch.rand(3, count, generator=generator, dtype=F64)
    return SparseCode(
        dictionary="ani",
        fingerprint="0123456789ab",
        height=64,
        banded=True,
        filters=torch.randint(200, (count,), generator=generator),
        directions=direction_from_angles(2 * azimuth, zenith),
        twists_rad=2 * math.pi * torch.round(twist * 10) / 32,
        weights=torch.randn(count, 3, generator=generator, dtype=F64),
        relative_error=0.1 + 0.2,
    )


@pytest.mark.parametrize("count", [0, 1, 40])
def test_saved_and_loaded_to_the_bit(tmp_path: Path, count: int) -> None:
    code = some_code(count)
    code.save(tmp_path / "code.json")
    again = SparseCode.load(tmp_path / "code.json")
    for name in ("filters", "directions", "weights"):
        assert torch.equal(getattr(again, name), getattr(code, name)), name
        assert getattr(again, name).dtype == getattr(code, name).dtype
    # degrees in the file: one rounding there, one back
    torch.testing.assert_close(again.twists_rad, code.twists_rad, rtol=4e-16, atol=0)
    for name in ("dictionary", "fingerprint", "height", "banded", "relative_error", "floats"):
        assert getattr(again, name) == getattr(code, name), name


def test_angles_are_those_of_the_directions() -> None:
    """About the zenith: longitude from +Z towards +X, which is pi minus the azimuth."""
    code = some_code()
    alpha, beta, gamma = code.rotations.unbind(1)
    back = direction_from_angles(math.pi - alpha, beta)
    torch.testing.assert_close(back, code.directions, atol=1e-14, rtol=0)
    assert torch.equal(gamma, code.twists_rad)


def test_four_words_an_activation() -> None:
    code = some_code(5)
    assert (len(code), code.floats) == (5, 20)


# what is no code


def written(tmp_path: Path, **changes: object) -> Path:
    """A code file with some of its entries, or of its first activation's, changed."""
    path = tmp_path / "code.json"
    some_code(3).save(path)
    content = json.loads(path.read_text())
    for name, value in changes.items():
        part = content if name in content else content["activations"][0]
        assert name in part
        part[name] = value
    path.write_text(json.dumps(content))
    return path


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.json .*No such file"):
        SparseCode.load(tmp_path / "gone.json")


@pytest.mark.parametrize("content", [b"", b'{"format": "skyl', b"\xff\xfe\x00", b"P6 2 2 255"])
def test_no_json(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(InputError, match=r"x\.json .*JSON"):
        SparseCode.load(tmp_path / "x.json")


@pytest.mark.parametrize("content", ["[]", "3", "{}", '{"format": "skylight estimate"}', "null"])
def test_foreign_json(tmp_path: Path, content: str) -> None:
    (tmp_path / "x.json").write_text(content)
    with pytest.raises(InputError, match=r"x\.json .*no sparse code"):
        SparseCode.load(tmp_path / "x.json")


@pytest.mark.parametrize("version", [2, 0, "1", None])
def test_newer_format(tmp_path: Path, version: object) -> None:
    path = written(tmp_path, version=version)
    with pytest.raises(InputError, match=f"version {version} "):
        SparseCode.load(path)


DAMAGES: list[dict[str, object]] = [
    {"activations": None},
    {"activations": {"filter": 1}},
    {"height": "tall"},
    {"relative_error": None},
    {"filter": "wide"},
    {"filter": 10**30},
    {"direction": [1.0, 0.0]},
    {"direction": [2.0, 0.0, 0.0]},
    {"twist_deg": "left"},
    {"rgb": [1.0, None, 0.0]},
    {"rgb": "grey"},
]
# each of a type that reads without complaint
SUBTLE_DAMAGES: list[dict[str, object]] = [
    {"filter": 1.5},
    {"filter": -3},
    {"relative_error": -1.0},
    {"relative_error": "inf"},
    {"height": -5},
    {"dictionary": 3},
]


@pytest.mark.parametrize("changes", DAMAGES + SUBTLE_DAMAGES, ids=str)
def test_damaged_files(tmp_path: Path, changes: dict[str, object]) -> None:
    with pytest.raises(InputError, match=r"code\.json .*damaged"):
        SparseCode.load(written(tmp_path, **changes))


@pytest.mark.parametrize(
    "changes", [{"direction": [math.nan, 0.0, 1.0]}, {"rgb": [1.0, math.inf, 0.0]}], ids=str
)
def test_numbers_that_are_not_finite(tmp_path: Path, changes: dict[str, object]) -> None:
    with pytest.raises(InputError, match=r"code\.json is no JSON file: (NaN|Infinity) "):
        SparseCode.load(written(tmp_path, **changes))


@pytest.mark.parametrize("name", ["height", "dictionary", "activations", "fingerprint", "rgb"])
def test_files_with_parts_missing(tmp_path: Path, name: str) -> None:
    path = written(tmp_path)
    content = json.loads(path.read_text())
    part = content if name in content else content["activations"][0]
    del part[name]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"code\.json .*'{name}'"):
        SparseCode.load(path)
