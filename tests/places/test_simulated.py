"""Simulated places: from their numbers, on disk, and what belongs to each kind."""

import csv
import math
from pathlib import Path

import pytest
import torch

from skylight.cli import main
from skylight.errors import InputError
from skylight.io._files import read_environment_map
from skylight.places import _simulated as simulated
from skylight.places._scene import Material, Outside, Scene, box
from skylight.places._simulated import SHARES, read_places, simulate_place, simulate_places
from skylight.skies._simulated import EVALUATION_SEEDS
from skylight.sphere._envmap import luminance

HEIGHT = 8


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated, "PER_DAY", 1)
        return simulate_places(tmp_path_factory.mktemp("places"), count=3, height=HEIGHT).parent


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.*") if p.is_file()}


def test_shares() -> None:
    assert math.fsum(SHARES.values()) == pytest.approx(1)
    assert set(simulated.FLASH) == set(SHARES)


def test_index_and_lights(folder: Path) -> None:
    records = read_places(folder / "index.csv")
    assert {r.file for r in records} == {p.name for p in folder.glob("*.exr")}
    assert [(r.seed, r.number) for r in records] == [(k, 0) for k in range(3)]
    with (folder / "lights.csv").open() as stream:
        lights = list(csv.DictReader(stream))
    for record in records:
        light = read_environment_map(folder / record.file)
        total = float(luminance(light.flat) @ light.grid.solid_angles.float())
        for each in lights:
            if each["file"] == record.file and each["in_map"] == "0":
                rgb = torch.tensor([float(each[c]) for c in ("red", "green", "blue")])
                total += float(luminance(rgb))
        assert total == pytest.approx(4 * math.pi, rel=2e-3)  # half precision
        assert record.level > 0
        assert record.split == "train"


def test_a_folder_grows_and_resumes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two places, then three, end as three at once; what is there is kept."""
    monkeypatch.setattr(simulated, "PER_DAY", 1)
    simulate_places(tmp_path, count=2, height=HEIGHT)
    before = (tmp_path / "days" / "0.csv").stat().st_mtime_ns
    seen: list[tuple[int, int]] = []
    simulate_places(
        tmp_path, count=3, height=HEIGHT, progress=lambda done, of: seen.append((done, of))
    )
    assert (tmp_path / "days" / "0.csv").stat().st_mtime_ns == before
    assert seen == [(2, 3), (3, 3)]
    assert contents(tmp_path) == contents(folder)


@pytest.mark.slow
def test_processes_make_the_same_files(tmp_path: Path) -> None:
    for workers in (1, 2):
        simulate_places(tmp_path / str(workers), count=17, height=HEIGHT, workers=workers)
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


def test_a_map_is_that_of_its_numbers(folder: Path) -> None:
    record, rendered = simulate_place(1, 0, HEIGHT)
    there = read_environment_map(folder / record.file).radiance
    torch.testing.assert_close(there, rendered.map.radiance, rtol=1e-3, atol=1e-6)
    other = read_environment_map(folder / "00000002_0.exr").radiance
    assert not torch.equal(there, other)


def test_nobody_stands_in_furniture() -> None:
    chair = Material(albedo=(0.5, 0.5, 0.5))
    for low, high, free in (((-1, -1, -1), (1, 1, 1), False), ((0.1, -1, -1), (1, 1, 1), False),
                            ((2, -1, -1), (3, 1, 1), True)):  # fmt: skip
        scene = Scene(rectangles=box(low, high, chair), outside=Outside.uniform((1, 1, 1), 8))
        assert simulated._has_room(scene) is free


def test_splits_go_by_day() -> None:
    splits = [simulated._split(day) for day in range(20)]
    assert splits.count("validation") == splits.count("test") == 2


@pytest.mark.parametrize("kind", SHARES)
def test_kinds(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every kind makes a map of its own sort: lamps where there are no suns, and the reverse."""
    monkeypatch.setattr(simulated, "SHARES", {kind: 1.0})
    monkeypatch.setattr(simulated, "FLASH", {kind: (0.0, 1.0)})
    found = [simulate_place(3, number, HEIGHT) for number in range(2)]
    for record, rendered in found:
        assert record.kind == kind
        assert bool(rendered.map.radiance.isfinite().all())
        assert float(rendered.map.radiance.min()) >= 0
        kinds = {light.kind for light in rendered.lights}
        if kind == "outdoors":
            assert kinds <= {"sun"}
            assert record.ground
        elif kind in ("studio", "street"):
            assert "lamp" in kinds
            assert "window" not in kinds
    levels = {"outdoors": 300, "car": 1}
    assert max(record.level for record, _ in found) > levels.get(kind, 0.1)


@pytest.mark.parametrize("kind", ["studio", "street"])
def test_a_flash_comes_from_the_camera(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera looks along -Z at the viewer, so its flash stands towards +Z."""
    monkeypatch.setattr(simulated, "SHARES", {kind: 1.0})
    monkeypatch.setattr(simulated, "FLASH", {kind: (1.0, 1e6)})
    _, rendered = simulate_place(2, 0, HEIGHT)
    brightest = rendered.lights[0]
    assert float(brightest.direction[2]) > 0.9


def test_seeds_of_evaluations_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="for evaluation"):
        simulate_places(tmp_path, count=9, seed=EVALUATION_SEEDS - 1)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["places", "simulate", "--count", "0", "--out", str(tmp_path / "no")]) == 2
    assert "--count must be above 0" in capsys.readouterr().err
    out = tmp_path / "places"
    assert main(["places", "simulate", "--count", "1", "--out", str(out), "--workers", "1"]) == 0
    assert f"{out}/index.csv: 1 places (" in capsys.readouterr().out
    assert read_environment_map(next(out.glob("*.exr"))).layout == (64, 128)
    (out / "days" / "0.csv").write_text("file,day\n1,2\n")
    assert main(["places", "simulate", "--count", "1", "--out", str(out), "--workers", "1"]) == 2
    assert "not an index of places" in capsys.readouterr().err
