"""Photographs solved together: the same files and lines as one by one, whatever fails."""

import json
import math
import pickle
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from skimage.data import astronaut

from skylight._names import LightName
from skylight.cli import main
from skylight.estimation import _folder as batch
from skylight.estimation._folder import estimate_folder
from skylight.estimation._manifest import MANIFEST, Entry, read_manifest
from skylight.estimation._photos import Pictures
from skylight.estimation._settings import EstimateSettings
from skylight.estimation._summary import describe
from skylight.inverse._descent import Stage
from skylight.inverse._faces import Level
from skylight.inverse._sky import SOLVERS, SolverOptions
from skylight.io._files import read_environment_map
from skylight.sphere._frame import angle_between, direction_from_angles
from skylight.work._cluster import Cluster
from skylight.work._resumable import Workers
from tests.estimated import RESULTS
from tests.sunny_face import sunny_face

SUNSKY = EstimateSettings(light="sunsky", device="cpu")
OPTIONS = ["--light", "sunsky", "--device", "cpu", "--workers", "2"]
# So few iterations that roundings stay small: of all of them, a light that is found together is up
# to 1.3 degrees and 36 % of the radiance from the one found alone.
FEW = SolverOptions(
    scan_candidates=3,
    stages=(
        Stage(level=Level(2, light=1), starts=3, iterations=3),
        Stage(level=Level(0), starts=1, iterations=2),
    ),
)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two that go well, of different numbers of pixels, and two that do not."""
    folder = tmp_path_factory.mktemp("photos")
    (folder / "more").mkdir()
    Image.fromarray(sunny_face(40.0, 50.0).encoded).save(folder / "a.png")
    small = Image.fromarray(astronaut()[:256, 110:366]).resize((140, 140))
    small.save(folder / "more" / "c.png")
    Image.new("RGB", (64, 64), (200, 120, 40)).save(folder / "no_face.png")
    (folder / "bad.png").write_bytes(b"nothing")
    return folder


@pytest.fixture(scope="module")
def three(photos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With one more that goes well."""
    folder = Path(shutil.copytree(photos, tmp_path_factory.mktemp("three") / "photos"))
    Image.fromarray(astronaut()[:240, 100:356]).save(folder / "b.jpg", quality=95)
    return folder


@pytest.fixture(scope="module")
def apart(three: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("apart") / "out"
    assert main(["estimate", str(three), "--out", str(out), *OPTIONS]) == 0
    return out


def sent(what: Any) -> Any:
    """As it comes out of another process."""
    return pickle.loads(bytes(ForkingPickler.dumps(what)))


def test_a_batch_leaves_the_files_and_lines_of_photos_one_by_one(
    photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against one photo by itself. Steps are taken here, but all that workers get and give is sent
    (:func:`test_what_workers_send_loses_nothing` has real ones)."""

    def share(work: Callable[..., Any], queue: deque[tuple], **_: object) -> Iterator[Any]:
        while queue:
            yield sent(work(*sent(queue.popleft())))

    monkeypatch.setattr(batch, "share_work", share)
    monkeypatch.setitem(SOLVERS, "scan", FEW)
    out = tmp_path / "out"
    assert main(["estimate", str(photos), "--out", str(out), *OPTIONS, "--batch", "2"]) == 0
    lines = read_manifest(out / MANIFEST)
    assert {source: line.status for source, line in lines.items()} == {
        "a.png": "done",
        "bad.png": "failed",
        "more/c.png": "done",
        "no_face.png": "failed",
    }
    assert lines["bad.png"].error.startswith("bad.png: no picture known here")
    for line in lines.values():
        if line.status == "done":
            assert line.results is not None
            assert {path.name for path in (out / line.results).iterdir()} == RESULTS
            told = json.loads((out / line.results / "estimate.json").read_text())
            assert line.seconds is not None
            assert line.seconds > sum(told["seconds"].values())
    line, told = lines["a.png"], json.loads((out / "a_png" / "estimate.json").read_text())
    alone = Pictures.of([photos / "a.png"], SUNSKY, names=["a.png"], workers=1).estimate()
    expected = json.loads(json.dumps(describe(alone, keep_place=False)))
    assert told.keys() == expected.keys()
    for name in ("sources", "light", "advice", "versions"):
        assert told[name] == expected[name]
    assert line.verdict == alone.estimate.verdict.summary
    off = float(angle_between(sun(line), alone.estimate.sun_direction))
    assert math.degrees(off) < 0.1
    found, light = (
        read_environment_map(out / "a_png" / "probe.exr").radiance,
        alone.estimate.environment.radiance,
    )
    assert float((found - light).abs().mean()) < 0.01 * float(light.mean())


def sun(line: Entry) -> torch.Tensor:
    assert line.sun is not None
    return direction_from_angles(
        *(torch.tensor(math.radians(line.sun[name])) for name in ("azimuth_deg", "zenith_deg"))
    )


@pytest.mark.slow
def test_what_workers_send_loses_nothing(
    three: Path,
    apart: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Batches of one, solved as if by a worker: the same bytes; and of batches that cannot be
    solved, as memory is short for two, each photo is solved by itself."""
    solve = batch._solve

    def short(observed: list, model: object) -> list:
        if len(observed) > 1:
            raise RuntimeError("out of memory")
        return solve(observed, model)

    monkeypatch.setattr(batch, "_solve", short)
    estimate_folder(three, tmp_path, SUNSKY, workers=2, batch=2)
    (line,) = {record.getMessage() for record in caplog.records}
    assert "2 photos could not be solved together (RuntimeError: out of memory)" in line
    for path in apart.rglob("*"):
        other = tmp_path / path.relative_to(apart)
        if path.suffix in (".exr", ".hdr", ".obj"):
            assert other.read_bytes() == path.read_bytes()
        elif path.name == "estimate.json":
            found, expected = (json.loads(each.read_text()) for each in (other, path))
            assert found.pop("seconds").keys() == expected.pop("seconds").keys()
            assert found == expected


@pytest.mark.slow
def test_a_photo_without_a_light_fails_alone(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solve = batch._solve

    def broken(observed: list, model: object) -> list:
        if any(one.source == "b.jpg" for one in observed):
            raise ValueError("no\nsecond line")
        return solve(observed, model)

    monkeypatch.setattr(batch, "_solve", broken)
    entries = estimate_folder(three, tmp_path, SUNSKY, workers=1, batch=3)
    assert {entry.source: entry.status for entry in entries} == {
        "a.png": "done",
        "b.jpg": "failed",
        "bad.png": "failed",
        "more/c.png": "done",
        "no_face.png": "failed",
    }
    assert entries[1].error == "b.jpg: internal error (ValueError: no)"
    assert not (tmp_path / "b_jpg").exists()


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_being_written(
    three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the second batch: of the first, what was begun to be written is noted."""
    solved: list[str] = []
    lights = batch._lights

    def interrupted(observed: list, model: object) -> list:
        solved.extend(one.source for one in observed)
        if len(solved) == 3:
            raise KeyboardInterrupt
        return lights(observed, model)

    monkeypatch.setattr(batch, "_lights", interrupted)
    with pytest.raises(KeyboardInterrupt):
        estimate_folder(three, tmp_path, SUNSKY, workers=2, batch=2)
    noted = read_manifest(tmp_path / MANIFEST).values()
    done = {line.source for line in noted if line.status == "done"}
    assert done
    assert done <= set(solved[:2])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("probe.exr")}
    assert len(before) == len(done)
    assert not list(tmp_path.rglob(".partial-*"))
    monkeypatch.setattr(batch, "_lights", lights)
    entries = estimate_folder(three, tmp_path, SUNSKY, workers=2, batch=2)
    assert sum(entry.status == "done" for entry in entries) == 3
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())


def test_a_gpu_solves_many_together_unless_it_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    def choice(light: LightName, workers: Workers = 4) -> int:
        return batch._batch(EstimateSettings(light=light), workers, None)

    assert [choice("sunsky"), choice("autoencoder")] == [1, 1] or torch.cuda.is_available()
    monkeypatch.setattr(batch, "choose_device", lambda _: torch.device("cuda"))
    assert {choice(light) for light in batch.SKY_LIGHTS} == {batch.GPU_BATCH}
    assert {choice(light) for light in ("sh9", "sh25", "lamps")} == {1}
    assert choice("sunsky", Cluster(address="tcp://there:1", folder=Path())) == 1
