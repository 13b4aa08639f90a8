import json
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch

from skylight.csc.dictionary import FilterBank, builtin
from skylight.errors import InputError
from skylight.imaging.files import write_environment_map
from skylight.sphere.envmap import EnvironmentMap
from skylight.training.config import DictionaryConfig
from skylight.training.dictionary import filter_sheet, learn_dictionary
from skylight.training.main import main

DEGREE = 8


def room(seed: int, rows: int = 64) -> EnvironmentMap:
    """Grey, with six blurred lamps of some shape."""
    generator = torch.Generator().manual_seed(seed)
    radiance = torch.full((rows, 2 * rows, 3), 0.2)
    for _ in range(6):
        size = torch.randint(2, 14, (2,), generator=generator).tolist()
        top, left = (
            int(torch.randint(8, n - 16, (1,), generator=generator)) for n in (rows, 2 * rows)
        )
        radiance[top : top + size[0], left : left + size[1]] = 5.0
    return EnvironmentMap(radiance=radiance)


def silent(_: str) -> None:
    pass


@pytest.fixture(scope="module")
def probes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three rooms and a garden, and four files that are none."""
    folder = tmp_path_factory.mktemp("probes")
    for i, name in enumerate(["a.exr", "b.hdr", "c.exr", "d.exr"]):
        write_environment_map(folder / name, room(i))
    write_environment_map(folder / "small.exr", room(0, 32))
    write_environment_map(folder / "sky.exr", EnvironmentMap(radiance=torch.ones(64, 256, 3)))
    write_environment_map(folder / "black.exr", EnvironmentMap(radiance=torch.zeros(64, 128, 3)))
    (folder / "damaged.exr").write_bytes(b"no picture")
    (folder / "notes.txt").write_text("no map")
    kinds = "file,category\nd.exr,outdoor-sun\nb.hdr,indoor\na.exr,indoor\nc.exr,semi-outdoor\n"
    (folder / "index.csv").write_text(kinds)
    return folder


@pytest.fixture
def config(probes: Path, tmp_path: Path) -> DictionaryConfig:
    return DictionaryConfig(
        data=probes,
        out=tmp_path / "out",
        filters=3,
        degree=DEGREE,
        rows=16,
        activations=3,
        epochs=2,
        radius_deg=50.0,
    )


def test_means_of_patches(config: DictionaryConfig) -> None:
    said: list[str] = []
    path = learn_dictionary(config, said.append)
    bank = FilterBank.load(path)
    assert bank.name == "kmeans"
    ani = builtin("ani", DEGREE).coefficients
    assert len(bank) == len(ani) + 3
    assert torch.equal(bank.coefficients[[0, *range(4, len(bank))]], ani)
    left_out = [line for line in said if line.startswith("left out: ")]
    for name in ("black.exr", "damaged.exr", "sky.exr", "small.exr"):
        assert sum(name in line for line in left_out) == 1
    assert len(left_out) == 4
    facts = json.loads(path.with_suffix(".json").read_text())
    assert facts["maps"] == ["a.exr", "b.hdr", "c.exr", "d.exr"]
    assert facts["fingerprint"] == bank.fingerprint
    assert (facts["learned"], facts["filters"], facts["seed"]) == (3, len(bank), 0)
    assert facts["largest_undershoot"] == pytest.approx(float(bank.undershoot()[1:4].max()))
    sheet = cv2.imread(str(path.parent / "filters.png"))
    assert sheet is not None
    assert sheet.shape == (100, 300, 3)


def test_the_same_seed_gives_the_same_filters(config: DictionaryConfig, tmp_path: Path) -> None:
    paths = [learn_dictionary(replace(config, out=tmp_path / n), silent) for n in ("one", "two")]
    first, again = (FilterBank.load(path).coefficients for path in paths)
    assert torch.equal(first, again)


def test_which_maps(config: DictionaryConfig) -> None:
    def used(**changes: object) -> list[str]:
        path = learn_dictionary(replace(config, **changes), silent)  # type: ignore[arg-type]
        return json.loads(path.with_suffix(".json").read_text())["maps"]

    assert used(category="indoor") == ["a.exr", "b.hdr"]
    assert used(maps=("d.exr", "a.exr")) == ["a.exr", "d.exr"]
    with pytest.raises(InputError, match=r"no z\.exr there"):
        used(maps=("a.exr", "z.exr"))
    with pytest.raises(InputError, match=r"'night'; there are indoor, outdoor-sun, semi-outdoor"):
        used(category="night")
    with pytest.raises(InputError, match=r"none of 1 maps can be learned from"):
        used(maps=("small.exr",))
    with pytest.raises(InputError, match="no such folder"):
        used(data=config.data / "none")


def test_gradient_goes_on_where_it_stopped(config: DictionaryConfig) -> None:
    config = replace(config, method="gradient", maps=("a.exr", "c.exr"), activations=2)
    said: list[str] = []
    path = learn_dictionary(replace(config, epochs=1), said.append)
    first = json.loads(path.with_suffix(".json").read_text())
    assert FilterBank.load(path).name == "gradient"
    said.clear()
    learn_dictionary(config, said.append)
    assert "goes on after epoch 1" in said
    assert not any("epoch 1:" in line for line in said)
    errors = json.loads(path.with_suffix(".json").read_text())["mean_squared_error_by_epoch"]
    assert errors[0] == first["mean_squared_error_by_epoch"][0]
    assert len(errors) == 2
    assert errors[1] <= errors[0]
    with pytest.raises(InputError, match="another configuration; choose another `out`"):
        learn_dictionary(replace(config, filters=2), said.append)


def test_sheet_shows_what_looks_up_and_what_is_negative() -> None:
    """A lobe at the zenith is bright in its tile's middle; minus it is blue there."""
    ani = builtin("ani", DEGREE).coefficients
    bank = FilterBank(torch.stack([ani[0], ani[-1], -ani[-1]]), "three")
    sheet = filter_sheet(bank, 2)
    assert sheet.shape == (100, 200, 3)
    assert sheet[50, 50].min() > 240
    assert sheet[50, 150, 2] > 240
    assert sheet[50, 150, 0] < 10
    assert (sheet[3, 3] == 255).all()  # beyond the cap


def test_long_axis_points_to_the_right() -> None:
    """phi = 0, which is +Z at the zenith."""
    row = builtin("ani", 20).coefficients[50]
    values = filter_sheet(FilterBank(torch.stack([row, row]), "two"), 1)[..., 0].astype(float)
    assert values[50, 75] > values[25, 50] + 10


def test_the_command(
    config: DictionaryConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    yaml = Path(__file__).parents[2] / "configs" / "csc_dictionary.yaml"
    out = str(tmp_path / "out")
    main([str(yaml), "--data", str(config.data), "--out", out, "--filters", "2", "--degree", "8"])
    said = capsys.readouterr().out
    assert "left out: " in said
    assert f"dictionary: {out}" in said


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filters": 0}, "`filters` must be at least 1"),
        ({"rows": 64}, "`rows` must be below 64"),
        ({"rows": 20, "degree": 40}, r"at least \(degree \+ 1\)\^2 = 1681, got 20"),
        ({"radius_deg": 91.0}, "`radius_deg` must be above 0"),
        ({"degree": 2}, "`degree` must be at least 3"),
        ({"seed": -1}, "`seed` must be from 0"),
    ],
)
def test_unusable_configurations(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        DictionaryConfig(**changes)  # type: ignore[arg-type]
