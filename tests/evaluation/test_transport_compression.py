"""Rows of a transport matrix by few numbers: what is kept, what it costs, which lights judge it."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from skylight.csc._compressed_transport import transform_for
from skylight.csc._dictionary import builtin
from skylight.csc._positions import Positions
from skylight.csc._sub_dictionaries import SubDictionary
from skylight.evaluation import _transport_compression as compression
from skylight.evaluation._run import Item
from skylight.evaluation._transport_compression import (
    COUNTS,
    HEIGHT,
    RELIGHTING,
    TransportCompression,
)
from skylight.io._files import write_environment_map
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix

GRID = DirectionGrid.latlong(HEIGHT)
ROWS = 9


def transport() -> TransportMatrix:
    """Clamped cosines about as many normals on a circle, the last row in the dark."""
    angle = torch.linspace(0, math.pi, ROWS, dtype=torch.float64)
    normals = torch.stack([angle.sin(), angle.cos(), torch.zeros_like(angle)], 1)
    rows = (normals @ GRID.directions.T).clamp(min=0) / math.pi * GRID.solid_angles
    rows[-1] = 0
    return TransportMatrix(matrix=rows.float(), grid=GRID)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine maps, each of one value: lights are the first, third, fifth and seventh, scaled to 1."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "hdr").mkdir()
    (folder / "meshes").mkdir()
    for number in range(9):
        light = EnvironmentMap(radiance=torch.full((32, 64, 3), 1.0 + number))
        write_environment_map(folder / "hdr" / f"{number}.exr", light)
    lines = ["file,category", *(f"{number}.exr,indoor" for number in range(9))]
    (folder / "hdr" / "index.csv").write_text("\n".join(lines))
    trimesh.creation.icosphere(subdivisions=2).export(folder / "meshes" / "ball.ply")
    return folder


@pytest.fixture
def small(data: Path, monkeypatch: pytest.MonkeyPatch) -> TransportCompression:
    """Without the dragon, and with boxes of a row's own values for the codes."""
    monkeypatch.setattr(compression, "dragon_transport", lambda _: transport())
    monkeypatch.setattr(compression, "_coding", lambda name: ((name,), name))

    def row_codes(signal, parts, transform, counts, options):
        assert (parts, transform) == ((parts[0],), parts[0])
        return [(signal, options.weights, count) for count in counts]

    def decoded(code, part, transform):
        signal, weights, count = code
        return signal * (1 - 1 / (count + {"iso": 1, "vmf": 2, "ani": 3}[part] + (weights == "l1")))

    monkeypatch.setattr(compression, "row_codes", row_codes)
    monkeypatch.setattr(compression, "_decoded", decoded)
    return TransportCompression(data=data, rows=ROWS, chunk=4, nonnegative_every=2)


@pytest.fixture
def first(small: TransportCompression, tmp_path: Path) -> Item:
    return small.measure("rows_000", tmp_path / "a.png")


def test_items_are_chunks_of_rows_and_the_relighting(small: TransportCompression) -> None:
    assert small.items() == ["rows_000", "rows_001", "rows_002", RELIGHTING]


def test_rows_are_spread_evenly_and_dark_ones_left_out(
    small: TransportCompression, tmp_path: Path
) -> None:
    rows = [
        small.measure(name, tmp_path / f"{name}.png").facts["rows"] for name in small.items()[:3]
    ]
    assert rows == [[0, 1, 2, 3], [4, 5, 6, 7], [8]]
    assert small.measure("rows_002", tmp_path / "dark.png").metrics == {}
    assert not (tmp_path / "dark.png").exists()
    few = TransportCompression(data=small.data, rows=3, chunk=2)
    assert few.measure("rows_000", tmp_path / "b.png").facts["rows"] == [0, 3]
    assert few.measure("rows_001", tmp_path / "c.png").facts["rows"] == [6]


def test_every_method_has_its_row_and_codes_the_errors_of_their_counts(first: Item) -> None:
    assert first.name == "rows_000"
    assert set(first.metrics) == {
        *("sh", "sh_windowed", "haar", "iso_l1", "vmf_l1", "ani_l1", "ani_nnls")
    }
    for row in first.metrics.values():
        assert set(row) == {f"{m}_{n}" for m in ("l2", "shading") for n in (1, 9, 25, 49)}
    for name, more in (("iso_l1", 2), ("vmf_l1", 3), ("ani_l1", 4), ("ani_nnls", 3)):
        for count in COUNTS:
            expected = pytest.approx(1 / (count + more), rel=1e-6)
            assert first.metrics[name][f"l2_{count}"] == expected
            assert first.metrics[name][f"shading_{count}"] == expected


def test_some_rows_alone_are_coded_without_negative_weights(
    small: TransportCompression, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second of a chunk, from its first."""
    asked: list[bool] = []
    every = compression._approximations

    def noted(signal, *, nonnegative):
        asked.append(nonnegative)
        return every(signal, nonnegative=nonnegative)

    monkeypatch.setattr(compression, "_approximations", noted)
    small.measure("rows_001", tmp_path / "a.png")
    assert asked == [True, False, True, False]


def test_harmonics_of_a_clamped_cosine_are_ramamoorthis(first: Item) -> None:
    """Energy of <n,w>+ / pi: 2 / (3 pi); its bands 0 to 2 hold 1/4 + 1/3 + 5/64 of 2/3 (2001)."""
    left = {1: 1 - 3 / 8, 9: 1 - 1.5 * (1 / 4 + 1 / 3 + 5 / 64)}
    for count, part in left.items():
        assert first.metrics["sh"][f"l2_{count}"] == pytest.approx(math.sqrt(part), rel=5e-3)
    for count in (9, 25, 49):  # Hann's factor in each band, which the cut does not have
        assert first.metrics["sh_windowed"][f"l2_{count}"] > first.metrics["sh"][f"l2_{count}"]
    hann = [(1 + math.cos(math.pi * band / 3)) / 2 for band in range(3)]
    kept = sum(e * (1 - (1 - w) ** 2) for e, w in zip((1 / 4, 1 / 3, 5 / 64), hann, strict=True))
    expected = pytest.approx(math.sqrt(1 - 1.5 * kept), rel=5e-3)
    assert first.metrics["sh_windowed"]["l2_9"] == expected
    # even light asks for the mean alone, which the first coefficient is
    assert first.metrics["sh"]["shading_1"] == pytest.approx(0, abs=1e-6)


def test_wavelets_are_the_best_of_their_count(first: Item) -> None:
    errors = [first.metrics["haar"][f"l2_{count}"] for count in COUNTS]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.25 < errors[0] < 1


def test_errors_are_weighted_by_solid_angle() -> None:
    signal = torch.ones(HEIGHT, 2 * HEIGHT, dtype=torch.float64)
    off = signal.clone()
    off[[0, -1]] = 0  # beside the poles: 1 - cos(pi / rows) of the sphere
    share = 1 - math.cos(math.pi / HEIGHT)
    assert compression._error(off, signal) == pytest.approx(math.sqrt(share), rel=1e-3)
    lights = torch.tensor([[1.0, 2.0, 5.0]]).double().expand(len(GRID), 3)
    assert compression._relit(off, signal, lights) == pytest.approx(share, rel=1e-3)
    assert compression._relit(1.25 * signal, signal, lights) == pytest.approx(0.25)


def test_lights_are_from_all_over_the_index_each_of_mean_one(data: Path) -> None:
    lights = compression._lights(data / "hdr")
    torch.testing.assert_close(lights, torch.ones(len(GRID), 12).double(), rtol=1e-3, atol=0)


def test_of_few_maps_all_are_lights(data: Path, tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_text("file,category\n1.exr,indoor\n7.exr,indoor\n8.exr,night")
    for number in (1, 7, 8):
        (tmp_path / f"{number}.exr").symlink_to(data / "hdr" / f"{number}.exr")
    assert compression._lights(tmp_path).shape == (len(GRID), 9)


def test_relighting_costs_what_it_keeps(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of as many rows as the thesis has, repeated from few."""
    part = SubDictionary(builtin("iso", 8), Positions(rows=8, twists=1))
    transform = transform_for((part,), HEIGHT)
    monkeypatch.setattr(compression, "_coding", lambda name: ((part,), transform))
    monkeypatch.setattr(compression, "PIXELS", 60)  # 1477 in the thesis
    small = TransportCompression(data=data, timed_rows=2)
    item = small._timed(TransportMatrix(matrix=transport().matrix[: ROWS - 1], grid=GRID))
    facts = {name: fact for name, fact in item.facts.items() if isinstance(fact, dict)}
    assert (item.name, item.metrics, item.facts["pixels"]) == (RELIGHTING, {}, 60)
    assert {name: of["floats"] for name, of in facts.items() if "l1" not in name} == {
        "dense": 60 * 2048,
        "sh_25": 60 * 25,
        "sh_49": 60 * 49,
        "haar_25": 2 * 60 * 25,
        "haar_49": 2 * 60 * 49,
    }
    codes = {f"{name}_l1_{count}" for name in ("iso", "ani") for count in (25, 49)}
    assert codes == {name for name in facts if "l1" in name}
    for name, of in facts.items():
        assert 0 < of["seconds"] < 5
        if name != "dense":
            assert of["shading_error"] < 0.1
    assert facts["sh_49"]["shading_error"] < 1e-3  # under even light the mean is all


def test_ani_is_to_be_closer_than_harmonics(small: TransportCompression) -> None:
    def rows(ani: float) -> dict[str, dict[str, dict[str, float]]]:
        return {
            name: {f"l2_{count}": {"mean": value} for count in COUNTS}
            for name, value in (("ani_l1", ani), ("sh", 0.5))
        }

    for ani, met in ((0.4, True), (0.5, False), (0.6, False)):
        checks = small.checks(rows(ani), [])
        assert list(checks) == [f"ani_l1, {count}" for count in (1, 9, 25, 49)]
        assert {check.ok for check in checks.values()} == {met}
        assert {check.goal for check in checks.values()} == {"< 0.5 (sh)"}
    assert small.checks({"sh": rows(0.4)["sh"]}, []) == {}


def test_codes_are_of_the_sizes_that_are_told() -> None:
    assert compression.CODES == {
        "iso_l1": ("iso", "l1"),
        "vmf_l1": ("vmf", "l1"),
        "ani_l1": ("ani", "l1"),
        "ani_nnls": ("ani", "nonnegative"),
    }
    (part,), _ = compression._coding("ani")
    assert (part.bank.degree, part.positions) == (24, compression.POSITIONS)
    assert len(part.bank.coefficients) == 137
    (part,), transform = compression._coding("iso")
    assert (part.positions.rows, part.positions.twists) == (16, 1)
    assert transform.solid_angles.numel() in (HEIGHT, HEIGHT * 2 * HEIGHT)
    basis = compression._sh_basis(9)
    assert torch.equal(basis, harmonics.evaluate_about_zenith(GRID.directions, 2))
    assert np.shape(basis) == (len(GRID), 9)
