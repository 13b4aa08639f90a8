"""What evaluations over maps and meshes write down, where the answers are given here."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from skylight.errors import InputError
from skylight.evaluation import (
    _lit_object as lit_object,
    _sky_models as sky_models,
    _sky_representations as sky_representations,
    _sparse_inverse as sparse_inverse,
    _voxel_probe as voxel_probe,
)
from skylight.evaluation._run import Check, Item
from skylight.evaluation._sparse_inverse import ObservedScene, SparseInverse
from skylight.evaluation._voxel_probe import TRANSFER, VoxelProbe
from skylight.io._files import read_environment_map, write_environment_map
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid
from skylight.transport._matrix import TransportMatrix


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten maps, three of them of rooms, and a ball."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "hdr").mkdir()
    (folder / "meshes").mkdir()
    rows = torch.linspace(0.5, 1.5, 64)[:, None, None]
    for number in range(10):
        light = rows.expand(64, 128, 3) + number
        write_environment_map(folder / "hdr" / f"{number}.exr", EnvironmentMap(radiance=light))
    kinds = [f"{n}.exr,{'indoor' if n < 3 else 'night'}" for n in range(10)]
    (folder / "hdr" / "index.csv").write_text("\n".join(["file,category", *kinds]))
    trimesh.creation.icosphere(subdivisions=2).export(folder / "meshes" / "ball.ply")
    return folder


# light from shading


@pytest.fixture
def recovered(data: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    """Codes are off by 1 / count, and by a tenth more for the last of the dictionaries."""
    fine, coarse = (DirectionGrid.latlong(rows) for rows in (64, 32))
    grids = (fine, coarse)
    generator = torch.Generator().manual_seed(0)
    normals = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator), dim=1)
    matrices = [
        TransportMatrix(
            matrix=(normals @ g.directions.T.float()).clamp(min=0) * g.solid_angles.float(), grid=g
        )
        for g in grids
    ]
    scene = ObservedScene.of(torch.zeros(40, 2, dtype=torch.long), *matrices)
    seen: dict[str, object] = {"scene": scene}
    truth = seen.setdefault("true", {})

    def by_code(scene, shading, dictionary, weights, counts):
        seen["shading"] = shading
        off = {("iso", "nonnegative"): 0.1, ("vmf", "nonnegative"): -3.0}
        factor = off.get((dictionary, weights), 0.0)
        return {count: truth["light"] * (1 + 1 / count + factor) for count in counts}

    def by_harmonics(scene, shading, ridge, counts):
        return {count: truth["light"] * (1 + ridge + 1 / count) for count in counts}

    monkeypatch.setattr(sparse_inverse, "observed_scene", lambda _: scene)
    monkeypatch.setattr(sparse_inverse, "recovered_by_code", by_code)
    monkeypatch.setattr(sparse_inverse, "recovered_by_harmonics", by_harmonics)
    monkeypatch.setattr(
        sparse_inverse, "recovered_by_lamps", lambda scene, shading: (truth["light"] * 1.25, 33)
    )
    monkeypatch.setattr(sparse_inverse, "_picture", lambda *_: np.zeros((4, 4, 3), np.uint8))
    return seen


@pytest.mark.parametrize(("name", "end"), [("2", ""), ("9", "_outdoor")])
def test_light_found_in_shading_is_scored_by_method_and_count(
    data: Path, recovered: dict, name: str, end: str, tmp_path: Path
) -> None:
    light = read_environment_map(data / "hdr" / f"{name}.exr")
    true = light.resize(32).flat.double()
    recovered["true"]["light"] = true
    evaluation = SparseInverse(data=data, every=1, counts=(4, 16))
    assert evaluation.items() == ["0", "1", "2", "3", "9"]
    item = evaluation.measure(name, tmp_path / "a.png")
    expected = {
        "ani_nnls": (1 / 4, 1 / 16),
        "ani_l1": (1 / 4, 1 / 16),
        "iso_nnls": (1 / 4 + 0.1, 1 / 16 + 0.1),
        "vmf_nnls": (3 - 1 / 4, 3 - 1 / 16),
        "sh": (1 / 4 + 1e-3, 1 / 16 + 1e-3),
    }
    assert set(item.metrics) == {f"{method}{end}" for method in (*expected, "lamps")}
    for method, (few, many) in expected.items():
        row = item.metrics[method + end]
        assert (row["l2_4"], row["l2_16"]) == pytest.approx((few, many))
        # light is not negative: what is below is cut off
        clamped = (1.0, 1.0) if method == "vmf_nnls" else (few, many)
        assert (row["l2_clamped_4"], row["l2_clamped_16"]) == pytest.approx(clamped)
        assert ("cpu_seconds" in row) == (method != "sh")
        assert 0 <= row.get("cpu_seconds", 0) < 5
    lamps = item.metrics["lamps" + end]
    assert (lamps["l2"], lamps["numbers"]) == (pytest.approx(0.25), 33)
    assert 0 <= lamps["cpu_seconds"] < 5
    by_ridge = {name: row["l2_4"] for name, row in item.facts["sh_by_ridge"].items()}
    assert by_ridge == pytest.approx({f"{r:g}": 0.25 + r for r in (1e-2, 1e-3, 1e-4, 1e-5)})
    assert item.facts["category"] == ("outdoor" if end else "indoor")
    scene, shading = recovered["scene"], recovered["shading"]
    explained = (scene.coarse @ true - shading).norm() / shading.norm()
    assert item.facts["model_error"] == pytest.approx(float(explained))
    assert 1e-4 < float(explained) < 5e-3  # noise of a thousandth, and another grid
    clean = scene.fine @ light.flat.double()
    assert float((shading - clean).std() / clean.mean()) == pytest.approx(1e-3, rel=0.3)


def test_codes_are_compared_with_harmonics_of_the_best_ridge(data: Path) -> None:
    def item(name: str, kind: str, values: tuple[float, ...]) -> Item:
        ridges = ("0.01", "0.001", "0.0001", "1e-05")
        table = {r: {"l2_4": 0.0, "l2_16": v} for r, v in zip(ridges, values, strict=True)}
        return Item(name=name, metrics={}, facts={"category": kind, "sh_by_ridge": table})

    items = [
        item("0", "indoor", (0.9, 0.5, 0.6, 0.7)),
        item("1", "indoor", (0.9, 0.7, 0.4, 0.9)),
        item("9", "outdoor", (0.0, 0.0, 0.0, 0.0)),
    ]
    rows = {
        "ani_nnls": {"l2_4": {"mean": 9.0}, "l2_16": {"mean": 0.49}},
        "lamps": {"l2": {"mean": 0.48}},
    }
    evaluation = SparseInverse(data=data, counts=(4, 16))
    assert evaluation.checks(rows, items) == {
        "ani_nnls, 16": Check.below(0.49, 0.5, "sh, best ridge"),
        "lamps": Check.below(0.48, 0.49, "ani_nnls, 16"),
    }
    rows["lamps"]["l2"]["mean"] = rows["ani_nnls"]["l2_16"]["mean"] = 0.51
    assert not any(check.ok for check in evaluation.checks(rows, items).values())
    assert list(evaluation.checks({"ani_nnls": rows["ani_nnls"]}, items)) == ["ani_nnls, 16"]
    assert evaluation.checks(rows, items[2:]) == {}
    assert evaluation.checks({"lamps": rows["lamps"]}, items) == {}


# skies


def test_every_representation_is_fitted_and_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    def fit(sky: torch.Tensor) -> torch.Tensor:
        given.append(sky)
        return sky.clone()

    def worse(sky: torch.Tensor) -> torch.Tensor:
        return sky.flip(1)

    fits = {"sh_27": (27, fit), "sunsky_10": (10, worse)}
    monkeypatch.setattr(sky_representations, "representations", lambda light: fits)
    evaluation = sky_representations.SkyRepresentations(count=2)
    name = evaluation.items()[1]
    item = evaluation.measure(name, tmp_path / "a.png")
    assert item.name == name
    assert list(item.metrics) == ["sh_27", "sunsky_10"]
    best, other = item.metrics.values()
    assert set(best) == {"psnr", "tone_mapped_ssim", "floats", "seconds"}
    assert (best["psnr"], best["floats"], other["floats"]) == (100, 27, 10)
    assert other["psnr"] < 60
    assert 0 <= best["seconds"] < 5
    known = evaluation.skies.sky(1)
    assert torch.equal(given[0], known.radiance)
    assert item.facts == known.facts


def test_gaussians_and_harmonics_have_the_floats_that_their_names_say() -> None:
    light = sky_representations.trained_light(None)
    found = {
        name: floats for name, (floats, _) in sky_representations.representations(light).items()
    }
    assert found == {
        **{f"sh_{n}": n for n in (27, 48, 75, 108, 147, 300)},
        **{f"gaussians_{n}": n for n in (27, 45, 75, 105, 147, 297)},
        "sunsky_10": 10,
        "autoencoder_65": 65,
    }


def test_every_sky_stands_over_one_of_nine_grounds_and_is_fitted_by_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grounds = []

    def fit(sky: torch.Tensor, ground: torch.Tensor) -> EnvironmentMap:
        grounds.append(tuple(ground.tolist()))
        return sky_models.over_ground(sky, ground)

    def off(found: EnvironmentMap, truth: EnvironmentMap, *, sun_visible: bool) -> dict[str, float]:
        assert not sun_visible
        return {"off": float((found.radiance - truth.radiance).abs().max())}

    even = sky_models.KnownSky(radiance=torch.ones(32, 128, 3), sun_visible=False, facts={"day": 3})
    monkeypatch.setattr(sky_models.KnownSkies, "sky", lambda self, number: even)
    monkeypatch.setattr(sky_models, "score", off)
    monkeypatch.setattr(sky_models, "fits", lambda light: {"sh9": fit, "autoencoder": fit})
    monkeypatch.setattr(sky_models, "panorama_rows", lambda *_: np.zeros((4, 4, 3), np.uint8))
    evaluation = sky_models.SkyModels(count=12)
    for name in evaluation.items()[:6]:
        item = evaluation.measure(name, tmp_path / "a.png")
        assert item.name == name
        assert list(item.metrics) == ["sh9", "autoencoder"]
        assert item.facts == {"day": 3}
        assert item.metrics["sh9"]["off"] == 0
        assert set(item.metrics["sh9"]) == {"off", "seconds", "cpu_seconds"}
    known = {tuple(torch.tensor(g).tolist()) for g in sky_models.GROUND_ALBEDOS}
    assert set(grounds) <= known
    assert len(set(grounds)) > 2
    assert grounds[::2] == grounds[1::2]


def test_simulated_skies_have_seeds_and_facts_of_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seeds = []
    simulated = sky_models.simulated_skies

    def noted(count: int, *, first_seed: int):
        seeds.append((count, first_seed))
        return simulated(count, first_seed=first_seed)

    monkeypatch.setattr(sky_models, "simulated_skies", noted)
    skies = sky_models.KnownSkies(count=3, seed=30_000_000)
    assert skies.names() == ["sky0000", "sky0001", "sky0002"]
    assert not skies.collected
    assert skies.fingerprint() is None
    facts = [skies.sky(number).facts for number in (0, 1)]
    assert seeds == [(1, 30_000_000), (1, 30_001_000)]
    for fact in facts:
        assert set(fact) == {"day", "seed", "regime", "sun_zenith_deg", "sun_visible"}
        assert 0 < fact["sun_zenith_deg"] < 90


# meshes


def test_a_mesh_fills_the_picture_before_the_camera() -> None:
    generator = torch.Generator().manual_seed(0)
    vertices = torch.rand(200, 3, generator=generator).double() * torch.tensor([2.0, 5.0, 3.0])
    placed = lit_object._placed(vertices, half_height=0.5, half_width=0.6)
    size = placed.amax(0) - placed.amin(0)
    own = vertices.amax(0) - vertices.amin(0)
    torch.testing.assert_close(size, own / own[2])
    torch.testing.assert_close((placed.amax(0) + placed.amin(0))[:2] / 2, torch.zeros(2).double())
    near = -float(placed[:, 2].max())
    # its height, not its width, is what limits it: 92 % of what is seen at its front
    assert float(size[1]) / 2 / near == pytest.approx(0.92 * 0.5)
    wide = lit_object._placed(vertices[:, [1, 0, 2]], half_height=0.5, half_width=0.6)
    assert float(size[1]) / 2 / -float(wide[:, 2].max()) == pytest.approx(0.92 * 0.6)


def test_points_of_an_object_are_spread_over_what_is_seen(data: Path) -> None:
    ball = lit_object.lit_object(data, pixels=50, height=24)
    count = len(ball.buffer)
    assert (len(ball.chosen), int(ball.chosen[0]), int(ball.chosen[-1])) == (50, 0, count - 1)
    gaps = ball.chosen.diff()
    assert int(gaps.max() - gaps.min()) <= 1
    grid = DirectionGrid.latlong(8)
    some, every = ball.transport(grid).matrix, ball.full_transport(grid).matrix
    assert every.shape == (count, 128)
    torch.testing.assert_close(some, every[ball.chosen])
    # a ball has no shadows: under even light of 1 every point shows 1 / pi of its irradiance
    torch.testing.assert_close(every.sum(1), torch.ones(count), rtol=0.1, atol=0)
    assert ball.buffer.image(torch.ones(count, 1)).shape == (24, 32, 1)
    # a ball of radius 0.5 whose front, 0.5 / 0.55 / 0.92 away, takes 92 % of the picture's height
    distance = 0.5 / 0.55 / 0.92 + 0.5
    diameter = 2 * 0.5 / (distance**2 - 0.25) ** 0.5 * 24 / (2 * 0.55)
    rows = ball.buffer.pixels[:, 0]
    assert int(rows.max() - rows.min()) + 1 == pytest.approx(diameter, abs=1)
    with pytest.raises(InputError, match="fewer than the 5000"):
        lit_object.lit_object(data, pixels=5000, height=24)
    assert lit_object.lit_object(data, pixels=50, height=24) is ball


# the voxel probe


def test_maps_of_the_voxel_probe_are_from_all_over_the_index(data: Path) -> None:
    probe = VoxelProbe(data=data, maps=3)
    assert probe.items() == ["0.exr", "3.exr", "6.exr", TRANSFER]
    assert len(VoxelProbe(data=data, maps=99).items()) == 11
    assert list(probe.meshes) == ["ball"]
    assert probe.config()["meshes"] == ["ball"]
    for wrong in ({"maps": 0}, {"best": 0}, {"best": voxel_probe.LIT}):
        with pytest.raises(InputError, match="one map or more and sets of 1 to"):
            replace(probe, **wrong)
    replace(probe, maps=1, best=1)


def test_goals_of_the_voxel_probe_are_the_thesis_orderings(data: Path) -> None:
    transfer = {"probe3_direct": 0.0115, "probe3_global": 0.0113}
    transfer |= {"probe5_direct": 0.0112, "probe5_global": 0.0094}
    rows = {
        name: {
            "transfer_l1": {"mean": value},
            "mae": {"mean": 7 * value},
            "ssim": {"mean": 0.96},
        }
        for name, value in transfer.items()
    }
    facts = {"probe3_set": 0.88, "sets_of_five": 1.0}
    item = Item(name=TRANSFER, metrics={}, facts=facts)
    probe = VoxelProbe(data=data)
    checks = probe.checks(rows, [Item(name="0.exr", metrics={}), item])
    assert len(checks) == 2 + 4 + 2 * 4 + 2 * 4
    assert all(check.ok for check in checks.values())
    assert checks["transfer_l1 probe5_direct, off the thesis' 0.0113"].value == pytest.approx(
        1 - 0.0112 / 0.0113
    )
    for ratio, missed in ((0.85, "below"), (0.91, "above")):
        facts["probe3_set"] = ratio
        checks = probe.checks(rows, [item])
        assert [name for name, check in checks.items() if not check.ok] == [
            f"3-probe / mean of sets of five, from {missed}"
        ]
    facts["probe3_set"] = 0.88
    rows["probe5_global"]["transfer_l1"]["mean"] = 0.0125
    rows["probe3_direct"]["mae"]["mean"] = 0.1
    rows["probe3_global"]["ssim"]["mean"] = 0.94
    missed = {name for name, check in probe.checks(rows, [item]).items() if not check.ok}
    assert missed == {
        "transfer_l1 probe5_global, off the thesis' 0.0094",
        "transfer_l1: probe5_global <= probe5_direct",
        "transfer_l1: probe5_global <= probe3_global",
        "mae probe3_direct",
        "ssim probe3_global",
    }
    plain = {name: {"mae": {"mean": 0.05}, "ssim": {"mean": 1.0}} for name in rows}
    assert len(probe.checks(plain, [])) == 4 + 8


def test_the_best_sets_and_all_sets_of_five_are_told(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Residuals that count their lit slots: 26 others of each set of five."""
    monkeypatch.setattr(voxel_probe, "transfer_error", lambda found, albedo: SimpleNamespace(
        mean=found, std=found / 10))  # fmt: skip
    monkeypatch.setattr(
        voxel_probe, "reconstruction", lambda size, kind: size + 1.0 * (kind == "direct")
    )
    monkeypatch.setattr(voxel_probe, "residuals_by_occluders", lambda albedo: {
        1: torch.tensor([2.0, 4.0])})  # fmt: skip
    asked = []

    def best_sets(most, *, albedo, exhaustive):
        asked.append((most, albedo, exhaustive))
        return [SimpleNamespace(configurations=(1, 2), residual=0.5)]

    def residuals(sets, *, albedo):
        asked.append((len(sets), albedo, 0))
        return torch.ones(len(sets), voxel_probe.LIT + 3) * len(sets[0])

    monkeypatch.setattr(voxel_probe, "best_sets", best_sets)
    monkeypatch.setattr(voxel_probe, "residuals", residuals)
    plotted = []
    monkeypatch.setattr(voxel_probe, "plot_residuals", lambda *given: plotted.append(given))
    item = VoxelProbe(data=data, best=9, every_set=9)._transfer(tmp_path / "a.png")
    assert item.metrics == {
        "probe3_direct": {"transfer_l1": 4, "transfer_l1_std": 0.4},
        "probe3_global": {"transfer_l1": 3, "transfer_l1_std": 0.3},
        "probe5_direct": {"transfer_l1": 6, "transfer_l1_std": 0.6},
        "probe5_global": {"transfer_l1": 5, "transfer_l1_std": 0.5},
    }
    assert asked[0] == (9, 0.8, 7)
    every = math.ceil(math.comb(voxel_probe.LIT, 5) / 9)
    assert sum(count for count, _, _ in asked[1:-1]) == every
    assert asked[-1] == (1, 0.8, 0)
    of_each = 5 * voxel_probe.LIT / (voxel_probe.LIT - 5)
    assert item.facts == {
        "by_occluders": {"1": 3.0},
        "best_sets": [{"configurations": [1, 2], "residual": 0.5}],
        "sets_of_five": pytest.approx(of_each),
        "probe3_set": pytest.approx(of_each),
    }
    assert plotted == [(tmp_path / "a.png", {1: 3.0}, [0.5])]


def test_views_are_from_where_they_say(data: Path) -> None:
    """Azimuth from +Z to +X, elevation up, the model's middle in the middle of the picture."""
    model = voxel_probe.voxelise(data / "meshes" / "ball.ply", 6)
    scene = voxel_probe.VoxelScene.of(model, views_deg=((0.0, 0.0), (90.0, 0.0), (30.0, 40.0)))
    middle = torch.tensor(model.occupied.shape).double() / 2
    for pose, (azimuth, elevation) in zip(scene.poses, ((0, 0), (90, 0), (30, 40)), strict=True):
        eye = pose.inverse().translation - middle
        a, e = math.radians(azimuth), math.radians(elevation)
        towards = [math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)]
        distance = 2 * float(torch.tensor(model.occupied.shape).double().norm())
        torch.testing.assert_close(eye, distance * torch.tensor(towards).double())
        torch.testing.assert_close(
            pose.points(middle[None])[0, :2], torch.zeros(2).double(), atol=1e-9, rtol=0
        )
    assert scene.camera.center_px == (80, 80)
    assert scene.camera.focal_px == pytest.approx(0.95 * 160 * 2)
