"""The evaluation of partition probes, on small meshes under made-up lights."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import trimesh

from skylight.errors import DependencyError, InputError
from skylight.evaluation import _partition_probe as partition_probe, _partition_scene as scene
from skylight.evaluation._partition_probe import (
    THESIS_MEAN,
    PartitionProbeTable,
    scored,
    with_sun_in_the_east,
)
from skylight.evaluation._partition_scene import (
    ALBEDO,
    MODELS,
    PartitionScene,
    partition_scene,
)
from skylight.evaluation._run import Item
from skylight.io._files import write_environment_map
from skylight.probes.partitions._cells import Cells
from skylight.probes.partitions._optimise import named_design
from skylight.probes.partitions._probe import PartitionProbe
from skylight.probes.partitions._seeds import ProbeDesign
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import angle_between


def uniform() -> EnvironmentMap:
    return EnvironmentMap(radiance=torch.tensor([1.0, 0.8, 0.6]).expand(16, 32, 3).clone())


def sunny(column: int = 5) -> EnvironmentMap:
    radiance = uniform().radiance.clone()
    radiance[4, column] = 400.0
    return EnvironmentMap(radiance=radiance)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    (folder / "hdr").mkdir()
    (folder / "meshes").mkdir()
    write_environment_map(folder / "hdr" / "room.exr", uniform())
    write_environment_map(folder / "hdr" / "day.exr", sunny())
    lines = ["file,category", "room.exr,indoor", "day.exr,outdoor-sun"]
    (folder / "hdr" / "index.csv").write_text("\n".join(lines) + "\n")
    for name in MODELS:
        trimesh.creation.icosphere(subdivisions=2).export(folder / "meshes" / name)
    return folder


def small(data: Path) -> PartitionProbeTable:
    """Of probes as they stand, not turned."""
    return PartitionProbeTable(
        data=data, samples=64, rays=64, even=(6,), width=32, searches=0, turns=1
    )


@pytest.fixture(scope="module")
def by_day(data: Path) -> Item:
    return small(data).measure("day.exr", data / "day.png")


def test_uniform_light_is_drawn_right_by_all_that_know_shadows(data: Path, tmp_path: Path) -> None:
    item = small(data).measure("room.exr", tmp_path / "a.png")
    noise = float(item.facts["noise"])  # type: ignore[arg-type]
    for row in ("6d", "6d_np_corr", "14d_indoor", "sh9", "sh25"):
        assert item.metrics[row]["mae"] < 0.02 + 2 * noise, row
    # without walls, faces show pi over what their cells send
    excess = math.pi / named_facing("6d") - 1
    assert item.metrics["6d_np"]["mae"] == pytest.approx(excess, rel=0.05)
    assert item.metrics["unshadowed"]["mae"] > 0.03
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def named_facing(name: str) -> float:
    facing = Cells.of(named_design(name)).facing
    assert float(facing.max() - facing.min()) < 1e-9
    return float(facing[0])


def test_a_sun_on_the_path_casts_shadows_that_even_cells_miss(data: Path, by_day: Item) -> None:
    assert small(data).items() == ["room.exr", "day.exr"]
    found = by_day.metrics
    assert found["14d_outdoor"]["rmse_sunny"] < 0.8 * found["6d"]["rmse_sunny"]
    assert all(set(scores) == {f"{s.removesuffix('_sunny')}_sunny" for s in scores}
               for scores in found.values())  # fmt: skip


def test_errors_are_means_over_azimuths_of_the_probe(
    data: Path, by_day: Item, tmp_path: Path
) -> None:
    once = small(data)
    twice = replace(once, turns=2).measure("day.exr", tmp_path / "c.png")
    first, mean = (item.metrics["6d"]["mae_sunny"] for item in (by_day, twice))
    made = partition_scene(once.meshes, once.width)
    light = with_sun_in_the_east(sunny().resize(128))
    angle = math.radians(180 + 45)
    around = torch.tensor(
        [
            [math.cos(angle), 0, math.sin(angle)],
            [0, 1, 0],
            [-math.sin(angle), 0, math.cos(angle)],
        ],
        dtype=torch.float64,
    )
    design = ProbeDesign.of("turned", named_design("6d").seeds @ around.T)
    probe = PartitionProbe(Cells.of(design))
    lit = made.relighting(design, once.rays, 0)(probe.light(probe.encode_map(light)))
    truth, _ = made.traced(light, once.samples, once.seed)
    second = scored(made, lit.detach(), truth)["mae"]
    assert abs(second / first - 1) > 0.05
    assert mean == pytest.approx((first + second) / 2, rel=1e-4)


@pytest.mark.slow
def test_a_searched_design_is_scored_on_maps_that_the_search_did_not_see(
    data: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "hdr"
    folder.mkdir()
    for name, column in (("a.exr", 5), ("b.exr", 20)):
        write_environment_map(folder / name, sunny(column))
    lines = ["file,category", "a.exr,indoor", "b.exr,indoor"]
    (folder / "index.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "meshes").symlink_to(data / "meshes")
    evaluation = replace(small(data), data=tmp_path, searches=1, steps=20, even=(6, 14))
    items = [evaluation.measure(name, tmp_path / f"{name}.png") for name in ("a.exr", "b.exr")]
    held = ["14d_optimised" in item.metrics for item in items]
    assert sorted(held) == [False, True]
    found = items[held.index(True)].metrics
    assert set(found["14d_optimised"]) == {f"{name}_held_out" for name in found["6d"]}
    assert found["14d"]["mae_held_out"] == found["14d"]["mae"]
    assert found["14d_optimised"]["mae_held_out"] != found["14d"]["mae"]


def test_checks_tell_good_from_bad() -> None:
    """Rows as in the thesis' table 4.1, where only the goals that are ours can be missed."""
    mae = {"110d": 0.114, "sh25": 0.138, "38d": 0.21, "sh9": 0.242, "14d": 0.442, "6d": 0.546}
    mae |= {"unshadowed": 0.646, "6d_np": 1.991, "14d_np": 7.668, "38d_np": 24.7, "110d_np": 75.7}
    mae |= {"6d_np_corr": 0.694, "14d_np_corr": 0.702, "38d_np_corr": 0.673, "110d_np_corr": 0.663}
    rows = {
        row: {name: {"mean": v} for name in ("mae", "rmse", "mae_thesis")} for row, v in mae.items()
    }
    rows["14d"] |= {"mae_held_out": {"mean": 0.4}, "rmse_sunny": {"mean": 0.5}}
    rows["14d_optimised"] = {"mae_held_out": {"mean": 0.33}}
    rows["14d_outdoor"] = {"rmse_sunny": {"mean": 0.2}}
    evaluation = PartitionProbeTable.__new__(PartitionProbeTable)
    object.__setattr__(evaluation, "even", (6, 14, 38, 110))
    checks = evaluation.checks(rows, [])
    assert len(checks) == 24
    missed = [name for name, check in checks.items() if not check.ok]
    assert missed == ["mae_held_out: 14d_optimised / 14d"]
    rows["sh25"]["mae"]["mean"] = 0.1
    missed = {name for name, check in evaluation.checks(rows, []).items() if not check.ok}
    assert {"mae: 110d is the best", "mae: 110d before sh25"} <= missed


def test_the_sun_is_turned_to_the_east() -> None:
    for column in (0, 5, 20, 31):
        turned = with_sun_in_the_east(sunny(column))
        direction = turned.brightest_direction()
        level = torch.tensor([float(direction[0]), 0.0, float(direction[2])]).double()
        east = torch.tensor([1.0, 0.0, 0.0]).double()
        assert float(angle_between(level / level.norm(), east)) < math.radians(6)


def test_azimuths_are_spread_over_the_circle_and_over_a_quarter_of_it() -> None:
    """Four turns about +Y: by 0, 90 + 22.5, 180 + 45 and 270 + 67.5 degrees."""
    design = named_design("6d")
    turned = partition_probe._turns(design, 4)
    assert turned[0] is design
    for k, one in enumerate(turned):
        angle = math.radians(90 * k + 22.5 * k)
        c, s = math.cos(angle), math.sin(angle)
        about = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=torch.float64)
        torch.testing.assert_close(one.seeds, design.seeds @ about.T)
    oriented = named_design("14d-outdoor")
    assert partition_probe._turns(oriented, 4) == (oriented,)


def test_models_stand_on_the_ground_beside_each_other(data: Path, tmp_path: Path) -> None:
    box = trimesh.creation.box((2.0, 4.0, 1.0))
    box.apply_translation((5.0, 7.0, -3.0))
    box.export(tmp_path / "box.ply")
    vertices, faces = scene._standing(tmp_path / "box.ply")
    low, high = vertices.amin(0), vertices.amax(0)
    torch.testing.assert_close(low, torch.tensor([-0.25, 0.0, -0.125]).double())
    torch.testing.assert_close(high, torch.tensor([0.25, 1.0, 0.125]).double())
    assert len(faces) == 12
    ground = scene._ground(torch.full((3,), 0.8).double())
    assert (ground.vertices[:, 1] == 0).all()
    corners = ground.vertices[ground.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 1] > 0).all()  # it is seen from above
    assert float(normals[:, 1].sum() / 2) == pytest.approx(12 * 12)
    edges = (corners - corners.roll(1, 1)).norm(dim=2)
    assert float(edges.max()) <= 0.2 + 1e-9
    both = partition_scene((tmp_path / "box.ply", tmp_path / "box.ply"), 48)
    models = both.scene.vertices[len(ground.vertices) :]
    first, second = models.chunk(2)
    shift = torch.tensor([1.0, 0.0, 0.0]).double()
    torch.testing.assert_close(second - first, shift.expand_as(first))
    torch.testing.assert_close(first.mean(0), torch.tensor([-0.5, 0.5, 0.0]).double())
    assert both.picture(torch.ones(len(both.points), 3)).shape == (28, 48, 3)


def test_light_without_shadows_is_a_balls() -> None:
    """Under even light of L every point sends back albedo L; under harmonics too."""
    lit = PartitionScene.lit_sphere
    points = SimpleNamespace(points=SimpleNamespace(normals=torch.eye(3).double().repeat(900, 1)))
    shade = lit(points, EnvironmentMap(radiance=torch.full((32, 64, 3), 2.0)))
    torch.testing.assert_close(shade, torch.full((2700, 3), 2 * ALBEDO).double(), rtol=1e-2, atol=0)
    coefficients = scene.harmonic_light(EnvironmentMap(radiance=torch.ones(32, 64, 3)))
    assert coefficients.shape == (25, 3)
    torch.testing.assert_close(
        coefficients[0], torch.full((3,), math.sqrt(4 * math.pi)).double(), rtol=1e-3, atol=0
    )
    assert float(coefficients[1:].abs().max()) < 1e-2


def test_a_probe_needs_an_azimuth_and_maps(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="1 azimuth or more, got turns=0"):
        replace(small(data), turns=0)
    (tmp_path / "meshes").symlink_to(data / "meshes")
    (tmp_path / "index.csv").write_text("file,category\na.exr,night\n")
    with pytest.raises(InputError, match="no map of the category indoor or outdoor-sun"):
        replace(small(data), data=tmp_path)


def test_the_thesis_measures(data: Path) -> None:
    made = partition_scene(small(data).meshes, 32)
    truth = torch.full((len(made.points), 3), 2.0)
    found = scored(made, truth * torch.tensor([1.1, 1.0, 0.7]), truth)
    assert found["mae"] == pytest.approx(0.4 / 3, rel=1e-5)
    assert found["mae_thesis"] == pytest.approx(0.4 * THESIS_MEAN, rel=1e-5)
    assert found["rmse_thesis"] == pytest.approx(math.hypot(0.1, 0.3) * THESIS_MEAN, rel=1e-5)


def test_a_ball_in_the_sun_is_lit_by_its_cosine(data: Path) -> None:
    made = partition_scene(small(data).meshes, 32)
    light = uniform()
    lit = made.lit_sphere(light)
    expected = ALBEDO * torch.tensor([1.0, 0.8, 0.6]).double()
    assert torch.allclose(lit, expected.expand_as(lit), rtol=0.02)


def test_fine_meshes_without_libigl_name_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=5)  # 20480 triangles
    sphere.export(tmp_path / MODELS[0])
    monkeypatch.setitem(sys.modules, "igl", None)
    with pytest.raises(DependencyError, match=r"skylight-lighting\[decimation\]"):
        partition_scene((tmp_path / MODELS[0],), 24)
