"""What is measured of one map, which maps are measured, and what is asked of the rows."""

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

from skylight.csc._dictionary import FilterBank, builtin
from skylight.csc._greedy import PursuitOptions
from skylight.errors import InputError
from skylight.evaluation import _sparse_coding as sparse_coding
from skylight.evaluation._run import Item
from skylight.evaluation._sparse_coding import (
    CODERS,
    Lobes,
    SparseCoding,
    fit_gaussians,
    relative_error,
)
from skylight.imaging._metrics import ssim
from skylight.io._files import read_environment_map, write_environment_map
from skylight.sphere import _harmonics as harmonics
from skylight.sphere._envmap import EnvironmentMap, luminance
from skylight.sphere._frame import DirectionGrid
from skylight.sphere._latlong_transform import LatLongTransform
from skylight.sphere._wavelets import approximate, cube_from_latlong, latlong_from_cube

HEIGHT = 64
SIGNS = ("nnls", "l1")
CODED = [
    f"{dictionary}_{sign}"
    for dictionary in ("iso_k40", "ani_k40", "kmeans_k40", "vmf_k40", "iso", "ani", "kmeans", "box")
    for sign in SIGNS
]


def indexed(folder: Path, categories: dict[str, str]) -> Path:
    lines = ["file,category", *(f"{name},{kind}" for name, kind in categories.items())]
    (folder / "index.csv").write_text("\n".join(lines))
    return folder


# which maps


def test_indoor_maps_come_first_and_each_kind_has_its_limit(tmp_path: Path) -> None:
    data = indexed(
        tmp_path,
        {"d": "indoor", "a": "night", "c": "indoor-studio", "e": "outdoor-sun", "b": "indoor"},
    )
    assert SparseCoding(data=data).items() == ["b", "c", "d", "a", "e"]
    assert SparseCoding(data=data, indoor=2).items() == ["b", "c", "a", "e"]
    assert SparseCoding(data=data, indoor=1, outdoor=1).items() == ["b", "a"]
    assert SparseCoding(data=data, outdoor=0).items() == ["b", "c", "d"]


def test_a_collection_without_rooms_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no map of the category indoor"):
        SparseCoding(data=indexed(tmp_path, {"a": "night", "b": "outdoor-sun"}))


# what is asked of the rows


def as_in_the_thesis() -> dict[str, dict[str, dict[str, float]]]:
    """Means of made-up rows that have every ordering asked for, at 4, 16 and 64 activations."""
    errors = {"ani": 0.3, "iso": 0.4, "kmeans": 0.35, "vmf": 0.6, "box": 0.2}
    rows = {"haar": {"l2_16": 0.6, "l2_64": 0.5}, "sh": {"l2_16": 0.7, "l2_64": 0.6}}
    for name in CODED:
        error = errors[name.split("_")[0]] + 0.2 * name.endswith("nnls")
        # from 16 to 64 activations weights of either sign gain more
        rows[name] = {"l2_64": error, "l2_16": error + (0.1 if name.endswith("nnls") else 0.4)}
    for name, row in rows.items():
        for metric in ("ssim_64", "ssim_mean_64", "ssim_unit_64"):
            row[metric] = 0.8 if name.endswith("nnls") else 0.7
    return {name: {metric: {"mean": v} for metric, v in row.items()} for name, row in rows.items()}


@pytest.mark.parametrize(
    ("row", "metric", "value", "missed"),
    [
        ("box_l1", "l2_64", 0.2, set()),
        ("box_l1", "l2_64", 0.35, {"l2_64: box_l1 < ani_l1"}),
        ("ani_l1", "l2_64", 0.43, {"l2_64: ani_l1 < kmeans_l1", "l2_64: ani_l1 / sh"}),
        (
            "ani_k40_l1",
            "l2_64",
            0.45,
            {"l2_64: ani_k40_l1 < kmeans_k40_l1", "l2_64: ani_k40_l1 / sh"},
        ),
        ("kmeans_l1", "l2_64", 0.45, {"l2_64: kmeans_l1 < iso_l1"}),
        ("haar", "l2_64", 0.61, {"l2_64: haar < sh"}),
        (
            "vmf_k40_nnls",
            "l2_64",
            0.59,
            {
                "l2_64: vmf_k40_nnls is the worst, of 40 bands",
                "l2_64: vmf_k40_nnls is the worst, of sharper filters",
            },
        ),
        (
            "kmeans_nnls",
            "l2_64",
            0.85,
            {"l2_64: vmf_k40_nnls is the worst, of sharper filters"},
        ),
        (
            "kmeans_nnls",
            "ssim_mean_64",
            0.6,
            {"ssim_mean_64: kmeans_nnls > kmeans_l1", "ssim_mean_64: kmeans_nnls > sh"},
        ),
        ("iso_k40_l1", "ssim_unit_64", 0.9, {"ssim_unit_64: iso_k40_nnls > iso_k40_l1"}),
        ("iso_nnls", "l2_16", 1.01, {"fall of iso_nnls < of iso_l1, 16 to 64"}),
    ],
)
def test_checks_name_the_orderings_that_are_missed(
    tmp_path: Path, row: str, metric: str, value: float, missed: set[str]
) -> None:
    coding = SparseCoding(data=indexed(tmp_path, {"a": "indoor"}), counts=(4, 16, 64))
    rows = as_in_the_thesis()
    rows[row][metric]["mean"] = value
    checks = coding.checks(rows, [])
    # l2 of two coders with haar and sh in common, three SSIMs and falls of seven, the boxes
    assert len(checks) == 1 + 2 * 5 + 3 * 7 * 2 + 7 + 1
    assert {name for name, check in checks.items() if not check.ok} == missed


# what is measured


def room(seed: int) -> EnvironmentMap:
    """Dim noise, and forty windows of 6 x 6 pixels."""
    generator = torch.Generator().manual_seed(seed)
    radiance = torch.rand(HEIGHT, 2 * HEIGHT, 3, generator=generator)
    rows = torch.randint(HEIGHT - 6, (40,), generator=generator).tolist()
    columns = torch.randint(2 * HEIGHT - 6, (40,), generator=generator).tolist()
    for row, column in zip(rows, columns, strict=True):
        radiance[row : row + 6, column : column + 6] += 5 * torch.rand(3, generator=generator)
    return EnvironmentMap(radiance=radiance)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[torch.Tensor, Item, Path]:
    """The map, what was measured of it, and the picture; k-means learns from the other map."""
    data = indexed(tmp_path_factory.mktemp("maps"), {"a.exr": "indoor", "b.exr": "night"})
    write_environment_map(data / "a.exr", room(0))
    write_environment_map(data / "b.exr", room(1))
    coding = SparseCoding(data=data, height=HEIGHT, counts=(4, 64), learned=4, learned_from=1)
    item = coding.measure("a.exr", data / "picture.png")
    return read_environment_map(data / "a.exr").radiance.double(), item, data / "picture.png"


@pytest.mark.slow
def test_every_method_has_its_row_of_errors(
    measured: tuple[torch.Tensor, Item, Path],
) -> None:
    """Boxes have the coder of sharper filters alone, the single lobe that of 40 bands."""
    truth, item, picture = measured
    assert picture.stat().st_size > 0
    assert (item.name, item.facts, item.problem) == ("a.exr", {"category": "indoor"}, "")
    rows = dict(item.metrics)
    limits = rows.pop("band_limit")
    assert set(rows) == {"sh", "sh_windowed", "haar", "sg", *CODED}
    for row in rows.values():
        assert set(row) == {
            "floats_per_activation",
            *(f"{metric}_{count}" for metric in ("l2", "ssim") for count in (4, 64)),
            "ssim_mean_64",
            "ssim_unit_64",
        }
        assert 0 < row["l2_64"] < row["l2_4"] < 1
    floats = {name: row["floats_per_activation"] for name, row in rows.items()}
    assert floats == dict.fromkeys(rows, 4) | {"sh": 3, "sh_windowed": 3, "sg": 6}

    # Gaussians start from a code, whose places they refine; windows are what boxes are for
    assert rows["sg"]["l2_64"] < rows["iso_l1"]["l2_64"]
    assert rows["box_l1"]["l2_64"] < 0.8 * rows["ani_l1"]["l2_64"]
    assert list(limits) == ["l2_degree40", "l2_degree60", "l2_degree63"]
    assert list(limits.values()) == sorted(limits.values(), reverse=True)
    # Bessel: what harmonics up to degree 1 do not hold, by sums over pixels
    grid = DirectionGrid.latlong(HEIGHT)
    weighted = grid.solid_angles[:, None] * truth.flatten(0, 1)
    held = (harmonics.evaluate_about_zenith(grid.directions, 1).T @ weighted).square().sum()
    energy = (weighted * truth.flatten(0, 1)).sum()
    assert rows["sh"]["l2_4"] == pytest.approx(math.sqrt(1 - held / energy), rel=1e-3)


@pytest.mark.slow
def test_the_whites_are_the_mean_luminance_and_the_norm(
    measured: tuple[torch.Tensor, Item, Path],
) -> None:
    """A map of unit length has the luminance 1 where this one has its norm over the sphere."""
    truth, item, _ = measured
    (wavelets,) = approximate(cube_from_latlong(truth, 64), [64], "weighted")
    fit = latlong_from_cube(wavelets, HEIGHT)
    solid_angles = DirectionGrid.latlong(HEIGHT).solid_angles
    norm = float((solid_angles @ truth.flatten(0, 1).square()).sum().sqrt())
    found = item.metrics["haar"]
    assert found["ssim_64"] == pytest.approx(ssim(fit, truth))
    for metric, white in (("ssim_mean", float(luminance(truth).mean())), ("ssim_unit", norm)):
        assert found[f"{metric}_64"] == pytest.approx(ssim(fit, truth, white=white))
        assert found[f"{metric}_64"] != pytest.approx(ssim(fit, truth, white=1.1 * white), rel=1e-3)


class Coder:
    """Draws the truth with an error that is told by its dictionary, sign and count."""

    def __init__(self, dictionary: str, height: int, banded: bool) -> None:
        self.number = 1 + 2 * [*CODERS, "box"].index(dictionary) + banded
        self.height, self.options = height, PursuitOptions()

    def path(self, truth: torch.Tensor, counts: list[int]) -> list[tuple[torch.Tensor, int, str]]:
        return [(truth, count, self.options.weights) for count in counts]

    def decode(self, code: tuple[torch.Tensor, int, str]) -> torch.Tensor:
        truth, count, weights = code
        return truth * (1 - error_of(self.number, count, weights))


def error_of(number: int, count: int, weights: str) -> float:
    return (number / 100 + (weights == "l1") / 30) / math.sqrt(count)


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SparseCoding:
    """An indoor map and one by night; the coders know the answer but for their error."""
    data = indexed(tmp_path, {"a.exr": "indoor-studio", "b.exr": "night"})
    for number, name in enumerate(("a.exr", "b.exr")):
        radiance = room(number).resize(16).radiance
        write_environment_map(data / name, EnvironmentMap(radiance=radiance))
    coders = cache(Coder)

    def coder(self: SparseCoding, dictionary: str, item: str, *, banded: bool) -> Coder:
        return coders(dictionary, self.height, banded)

    monkeypatch.setattr(SparseCoding, "_coder", coder)
    monkeypatch.setattr(sparse_coding, "lobes_of", lambda code, coder: code)
    monkeypatch.setattr(sparse_coding, "fit_gaussians", lambda truth, code: truth / (2 + code[1]))
    return SparseCoding(data=data, height=16, counts=(4, 16, 64))


@pytest.mark.parametrize(("name", "end"), [("a.exr", ""), ("b.exr", "_outdoor")])
def test_rows_are_named_by_coder_sign_and_kind_of_map(
    drawn: SparseCoding, name: str, end: str
) -> None:
    truth = read_environment_map(drawn.data / name).radiance.double()
    item = drawn.measure(name, drawn.data / "picture.png")
    rows = dict(item.metrics)
    assert item.name == name
    assert item.facts == {"category": "outdoor" if end else "indoor"}
    limits = rows.pop("band_limit" + end)
    assert set(limits) == {"l2_degree40", "l2_degree60", "l2_degree15"}
    assert 0.01 < limits["l2_degree15"] < 0.5
    methods = {"sh", "sh_windowed", "haar", *CODED, *([] if end else ["sg"])}
    assert set(rows) == {method + end for method in methods}
    whites = {"ssim": None, "ssim_mean": float(luminance(truth).mean())}
    scale = DirectionGrid.latlong(16).solid_angles
    whites["ssim_unit"] = math.sqrt(float(scale @ truth.flatten(0, 1).square().sum(1)))
    for dictionary, banded in itertools.product(CODERS, (True, False)):
        number = Coder(dictionary, 16, banded).number
        for sign, weights in (("nnls", "nonnegative"), ("l1", "l1")):
            row = rows.get(f"{dictionary}{'_k40' if banded else ''}_{sign}{end}")
            if row is None:
                assert (dictionary, banded) in (("vmf", False), ("box", True))
                continue
            assert row["floats_per_activation"] == 4
            for count in (4, 16, 64):
                error = error_of(number, count, weights)
                assert row[f"l2_{count}"] == pytest.approx(error, rel=1e-4)
                assert row[f"ssim_{count}"] == pytest.approx(ssim((1 - error) * truth, truth))
            for tones in ("ssim_mean", "ssim_unit"):
                expected = ssim((1 - error) * truth, truth, white=whites[tones])
                assert row[f"{tones}_64"] == pytest.approx(expected)
            assert len(row) == 1 + 2 * 3 + 2
    if not end:
        assert rows["sg"]["l2_16"] == pytest.approx(1 - 1 / 18)
        assert rows["sg"]["floats_per_activation"] == 6
    for name in ("sh", "sh_windowed"):
        assert rows[name + end]["floats_per_activation"] == 3
    for count in (4, 16, 64):  # a window costs error: what is cut is the best of its degree
        cut, windowed = (rows[name + end][f"l2_{count}"] for name in ("sh", "sh_windowed"))
        assert cut < windowed < 1
    errors = [rows["haar" + end][f"l2_{count}"] for count in (4, 16, 64)]
    assert errors == sorted(errors, reverse=True)


def test_windowed_harmonics_have_hanns_factors_in_each_band(drawn: SparseCoding) -> None:
    """Of light 1 + y: the mean stays, and band 1 is halved at degree 1 = sqrt(4) - 1."""
    y = DirectionGrid.latlong(64).directions[:, 1].reshape(64, 128, 1).expand(-1, -1, 3)
    finer = replace(drawn, height=64)
    cut, windowed = (finer._harmonics(1 + y, windowed=w) for w in (False, True))
    for fit in cut:
        torch.testing.assert_close(fit, 1 + y, rtol=0, atol=1e-2)
    for degree, fit in zip((1, 3, 7), windowed, strict=True):
        factor = (1 + math.cos(math.pi / (degree + 1))) / 2
        torch.testing.assert_close(fit, 1 + factor * y, rtol=0, atol=1e-2)


def test_kmeans_learns_from_the_half_that_is_not_tested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Maps of one value each, which tells them."""
    seen: list[tuple[int, int, list[int]]] = []

    def learn(maps: list[torch.Tensor], *, count: int, seed: int) -> FilterBank:
        assert {tuple(each.shape) for each in maps} == {(128, 256, 3)}
        seen.append((count, seed, [round(float(each.mean())) for each in maps]))
        return builtin("iso", 4)

    data = indexed(tmp_path, {f"{n}.exr": "indoor" for n in range(5)})
    for n in range(5):
        light = torch.full((16, 32, 3), float(n))
        write_environment_map(data / f"{n}.exr", EnvironmentMap(radiance=light))
    monkeypatch.setattr(sparse_coding, "learn_patches", learn)
    coding = SparseCoding(data=data, height=32, learned=7, seed=3)
    tried = [coding._coder("kmeans", f"{n}.exr", banded=True) for n in range(3)]
    assert seen == [(7, 3, [1, 3]), (7, 3, [0, 2, 4])]
    assert tried[0] is tried[2] is not tried[1]
    few = SparseCoding(data=data, height=32, learned_from=1)
    few._coder("kmeans", "1.exr", banded=True)
    assert seen[-1] == (100, 0, [0])
    other = few._coder("iso", "1.exr", banded=True)
    assert other is few._coder("iso", "0.exr", banded=True)
    assert other is not few._coder("iso", "0.exr", banded=False)


def test_gaussians_descend_to_those_that_made_the_map() -> None:
    start = Lobes(
        directions=torch.tensor([[0.1, 1.0, 0.1], [1.0, 0.2, 0.0]]).double(),
        sharpness=torch.tensor([8.0, 20.0]).double(),
        colours=torch.ones(2, 3).double(),
    )
    grid = DirectionGrid.latlong(32)
    axes = torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).double()
    colours = torch.tensor([[3.0, 2.0, 1.0], [0.5, 1.0, 2.0]]).double()
    true = (12 * (grid.directions @ axes.T - 1)).exp() @ colours
    found = fit_gaussians(true.reshape(32, 64, 3), start)
    scale = grid.solid_angles.reshape(32, 64, 1)
    assert relative_error(found, true.reshape(32, 64, 3), scale) < 0.02


def test_two_gaussians_that_are_one_are_still_solved() -> None:
    """The colours' normal equations are singular then but for a ridge."""
    start = Lobes(
        directions=torch.tensor([[0.0, 1.0, 0.0]]).double().repeat(3, 1),
        sharpness=torch.full((3,), 10.0).double(),
        colours=torch.ones(3, 3).double(),
    )
    y = DirectionGrid.latlong(16).directions[:, 1].reshape(16, 32, 1)
    true = (10 * (y - 1)).exp().expand(-1, -1, 3)
    scale = DirectionGrid.latlong(16).solid_angles.reshape(16, 32, 1)
    assert relative_error(fit_gaussians(true, start), true, scale) < 1e-3


def test_errors_are_weighted_by_solid_angle() -> None:
    """Off by a tenth of it on the upper half of the sphere: 0.1 / sqrt(2) of a constant map."""
    truth = torch.ones(HEIGHT, 2 * HEIGHT, 3, dtype=torch.float64)
    fit = truth.clone()
    fit[: HEIGHT // 2] = 0.9
    scale = LatLongTransform(0, HEIGHT).solid_angles[..., None]
    assert relative_error(fit, truth, scale) == pytest.approx(0.1 / math.sqrt(2))
    # the two rows beside the poles have 2 (1 - cos(pi / 64)) of 4 pi each
    fit = truth.clone()
    fit[[0, -1]] = 0
    share = 1 - math.cos(math.pi / HEIGHT)
    assert relative_error(fit, truth, scale) == pytest.approx(math.sqrt(share), rel=1e-3)
