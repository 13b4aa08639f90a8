import hashlib
import json
import math
import runpy
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch

from skylight.csc._code import CodeTensors
from skylight.csc._coder import SphericalSparseCoder
from skylight.csc._dictionary import FilterBank, anisotropic, builtin
from skylight.csc._learning import CapFilterBank, cap_lobes, cap_nodes
from skylight.csc._positions import Positions
from skylight.csc._wigner import RotationCorrelation
from skylight.errors import InputError
from skylight.io._files import write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.training._config import DictionaryConfig
from skylight.training._dictionary import (
    RATE,
    _probes,
    filter_sheet,
    learn_dictionary,
    learning_epoch,
    mean_squared_error,
)
from skylight.training._run import main
from tests.training.test_callbacks import Recorder

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


@pytest.fixture
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the optimiser in an epoch, whose number changes nothing else."""
    monkeypatch.setattr("skylight.training._dictionary.STEPS", 6)


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
        method="kmeans",
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


@pytest.mark.slow
def test_one_configuration_gives_one_dictionary(config: DictionaryConfig, tmp_path: Path) -> None:
    one, other = (
        FilterBank.load(learn_dictionary(replace(config, out=tmp_path / name), str))
        for name in ("one", "other")
    )
    assert torch.equal(one.coefficients, other.coefficients)


def test_what_was_learned_from_is_known_by_names_and_bytes(
    config: DictionaryConfig, probes: Path
) -> None:
    maps = replace(config, maps=("a.exr", "b.hdr"))
    found = _probes(maps, lambda _: None)
    expected = hashlib.sha256()
    for name in found.names:
        expected.update(
            name.encode() + b"\0" + hashlib.sha256((probes / name).read_bytes()).digest()
        )
    assert found.sha256 == expected.hexdigest()


def test_which_maps(config: DictionaryConfig) -> None:
    def used(**changes: object) -> list[str]:
        path = learn_dictionary(replace(config, **changes), str)  # type: ignore[arg-type]
        return json.loads(path.with_suffix(".json").read_text())["maps"]

    assert used(category="indoor") == ["a.exr", "b.hdr"]
    assert used(maps=("d.exr", "a.exr")) == ["a.exr", "d.exr"]
    with pytest.raises(InputError, match=r"no z\.exr there"):
        used(maps=("a.exr", "z.exr"))
    with pytest.raises(InputError, match=r"'night'; .*indoor, outdoor-sun, semi-outdoor"):
        used(category="night")
    with pytest.raises(InputError, match="none of 1 maps"):
        used(maps=("small.exr",))
    with pytest.raises(InputError, match="no such folder"):
        used(data=config.data / "none")


@pytest.mark.usefixtures("few_steps")
def test_gradient_goes_on_where_it_stopped(config: DictionaryConfig) -> None:
    config = replace(config, method="gradient", maps=("a.exr", "c.exr"), activations=2)
    said: list[str] = []
    path = learn_dictionary(replace(config, epochs=1), said.append)
    first = json.loads(path.with_suffix(".json").read_text())
    assert FilterBank.load(path).name == "gradient"
    said.clear()
    recorder, shown = Recorder(), []
    learn_dictionary(
        config, said.append, callbacks=[recorder], progress=lambda *each: shown.append(each)
    )
    assert "goes on after epoch 1" in said
    started, *steps, epoch, closed = recorder.told
    assert (started, closed) == (("start", 6, 12), ("close",))
    assert [step[:2] for step in steps] == [("step", n) for n in range(7, 13)]
    assert epoch[1:3] == (2, 12)
    assert epoch[3]["mean_squared_error"] < steps[0][2] * 1.5
    assert {name.split(" 0 of")[0] for name, share in shown if share == 0} == {
        "reading map",
        "searching the codes, part",
    }
    assert shown[-1][1] == 1
    assert not any("epoch 1:" in line for line in said)
    errors = json.loads(path.with_suffix(".json").read_text())["mean_squared_error_by_epoch"]
    assert errors[0] == first["mean_squared_error_by_epoch"][0]
    assert len(errors) == 2
    assert errors[1] <= errors[0]
    with pytest.raises(InputError, match=r"`filters` was 3 and is 2; .*another `out`"):
        learn_dictionary(replace(config, filters=2), said.append)
    learn_dictionary(replace(config, epochs=1), said.append, callbacks=[recorder])
    assert recorder.told[-1] is closed
    assert "`epochs` is 1: 2 are done already, none is taken back" in said


CAP_RAD = math.radians(50)


def planted(shape: str, degree: int = 12) -> torch.Tensor:
    """A filter that no Gaussian is like: an L, or a ring with a hole."""
    nodes = cap_nodes(CAP_RAD, degree)
    theta = torch.rad2deg(torch.acos(nodes[:, 1].clamp(-1, 1)))
    phi = torch.atan2(nodes[:, 0], nodes[:, 2])
    u, v = theta * torch.cos(phi), theta * torch.sin(phi)
    if shape == "L":
        on = ((u.abs() < 7) & (v > -7) & (v < 45)) | ((v.abs() < 7) & (u > -7) & (u < 32))
    else:
        on = (theta - 33).abs() < 8
    row = on.double() @ cap_lobes(CAP_RAD, degree)
    return row / row.norm()


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["L", "ring"])
def test_a_planted_filter_is_found_and_no_epoch_raises_the_error(shape: str) -> None:
    """In maps of a constant and three coloured copies; what is not learned stays."""
    generator = torch.Generator().manual_seed(0)
    true = FilterBank(torch.stack([torch.eye(1, 169)[0].double(), planted(shape)]), "true")
    angles = torch.tensor([2 * math.pi, math.pi, 2 * math.pi])
    scene = CodeTensors(
        torch.tensor([0, 1, 1, 1]).expand(8, 4),
        torch.rand(8, 4, 3, generator=generator, dtype=torch.float64) * angles,
        torch.rand(8, 4, 3, generator=generator, dtype=torch.float64) + 0.5,
        torch.full((8,), 4),
    )
    maps = SphericalSparseCoder(true, height=16).decode(scene).detach()
    start = FilterBank(anisotropic(12).coefficients[[0, 60, 20]], "start")
    bank = CapFilterBank(start, [1], radius_rad=CAP_RAD)
    coder = SphericalSparseCoder(bank, height=16, activations=4)

    def likeness() -> float:
        """The largest correlation with the planted filter, over all rotations."""
        found = RotationCorrelation(bank.coefficients.detach()[[1]], Positions())
        return float(found(planted(shape)).max())

    assert likeness() < 0.92
    optimiser = torch.optim.Adam(bank.parameters(), lr=RATE)
    codes, errors = None, [1.0]
    for _ in range(4):
        codes = learning_epoch(coder, optimiser, maps, codes)
        errors.append(mean_squared_error(coder, maps, codes))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < min(0.07, 0.8 * errors[1])
    assert likeness() > 0.95
    # a sum of Gaussians that undershoot by 1.8 %
    assert float(bank.undershoot()[1]) < 0.03
    assert torch.equal(bank.coefficients[[0, 2]], start.coefficients[[0, 2]])


@pytest.mark.slow
def test_the_example_beats_its_start() -> None:
    """On maps that it does not learn from, by a third at least."""
    example = Path(__file__).parents[2] / "examples/learn_dictionary.py"
    assert len(example.read_text().splitlines()) <= 40
    errors = runpy.run_path(str(example))["errors"]
    assert errors[-1] < 0.67 * errors[0]


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
    row = anisotropic(20, 4).coefficients[2]
    values = filter_sheet(FilterBank(torch.stack([row, row]), "two"), 1)[..., 0].astype(float)
    assert values[50, 75] > values[25, 50] + 10


@pytest.mark.usefixtures("few_steps")
def test_the_command(
    config: DictionaryConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    yaml = Path(__file__).parents[2] / "configs" / "csc_dictionary.yaml"
    out = str(tmp_path / "out")
    small = "--filters 2 --degree 8 --rows 16 --activations 2"
    main([str(yaml), "--data", str(config.data), "--out", out, *small.split()])
    said = capsys.readouterr().out
    assert "left out: " in said
    assert "epoch 1  mean squared relative error" in said
    assert f"dictionary: {out}" in said
    assert json.loads(Path(out, "dictionary.json").read_text())["method"] == "gradient"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filters": 0}, "`filters`"),
        ({"rows": 64}, "`rows` .* 64"),
        ({"rows": 20, "degree": 40}, "1681, got 20"),
        ({"radius_deg": 91.0}, "`radius_deg`"),
        ({"degree": 2}, "`degree`"),
        ({"seed": -1}, "`seed`"),
    ],
)
def test_unusable_configurations(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        DictionaryConfig(**changes)  # type: ignore[arg-type]
