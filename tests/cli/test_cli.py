"""The command line from end to end: what it writes, and how it fails."""

import errno
import inspect
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

import skylight
from skylight._options import who_works
from skylight.cli import main
from skylight.errors import InputError, explain
from skylight.estimation._command import estimate as estimate_command
from skylight.estimation._photos import estimate, estimate_photo
from skylight.estimation._settings import EstimateSettings, SettingKeywords
from skylight.faces._landmarkers import choose_landmarker
from skylight.faces._landmarks import DetectedFace
from skylight.faces._model import HeadModel
from skylight.imaging._photo import photo_from_codes
from skylight.io._files import read_environment_map
from skylight.sphere._frame import angles_from_direction
from skylight.work._progress import ProgressForm, StageProgress
from tests.estimated import RESULTS


@pytest.fixture(scope="module")
def portrait(estimated_portrait: tuple[Path, Path]) -> Path:
    return estimated_portrait[0]


@pytest.fixture(scope="module")
def results(estimated_portrait: tuple[Path, Path]) -> Path:
    """The folder of one good run, by the quickest light model."""
    return estimated_portrait[1]


class Faces:
    """A landmarker that sees these faces in each picture of that many pixels, others in none."""

    def __init__(self, *faces: DetectedFace, pixels: int = 512 * 512) -> None:
        self.faces, self.pixels = list(faces), pixels

    def detect(self, image: np.ndarray) -> list[DetectedFace]:
        return self.faces if image.shape[0] * image.shape[1] == self.pixels else []


def profile() -> DetectedFace:
    """The mean head, turned by 80 degrees."""
    head = HeadModel.load()
    c, s = np.cos(np.radians(80)), np.sin(np.radians(80))
    points = head.landmarks(head.mean) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    pixels = points[:, :2] * [1500, -1500] / (1.5 - points[:, 2:]) + 256
    return DetectedFace(points=pixels, score=1.0)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    assert captured.out == ""
    assert lines[0].startswith("skylight: ")
    return lines[0]


class TestResults:
    def test_all_files_are_there_and_nothing_else(self, results: Path) -> None:
        assert {path.name for path in results.iterdir()} == RESULTS

    def test_numbers_and_map_tell_the_same_sun(self, results: Path) -> None:
        told = json.loads((results / "estimate.json").read_text())
        probe = read_environment_map(results / "probe.exr")
        assert probe.layout == (256, 512)
        azimuth, zenith = angles_from_direction(probe.brightest_direction())
        assert told["sun"]["azimuth_deg"] == pytest.approx(np.degrees(float(azimuth)), abs=0.01)
        assert told["sun"]["zenith_deg"] == pytest.approx(np.degrees(float(zenith)), abs=0.01)
        assert told["objective"]["total"] == pytest.approx(told["objective"]["data"])
        assert len(told["params"]) == 27
        (face,) = told["faces"]
        assert face["source"] == told["sources"][0]
        assert face["landmarker"] == "mediapipe"
        assert face["landmark_score"] > 0
        assert "onnxruntime" in told["versions"]
        assert told["taken"]["latitude_deg"] == pytest.approx(41.89)  # of EXIF data, on request
        assert told["taken"]["time"].startswith("2024-06-01T14:30")
        assert 0 < min(face["albedo"]) < max(face["albedo"]) < 1

    def test_both_maps_hold_the_same_light(self, results: Path) -> None:
        exr, hdr = (read_environment_map(results / f"probe.{kind}") for kind in ("exr", "hdr"))
        peak = exr.radiance.amax(-1, keepdim=True)
        assert ((hdr.radiance - exr.radiance).abs() <= peak / 255).all()

    def test_mesh_stands_before_the_camera(self, results: Path) -> None:
        import trimesh

        mesh = trimesh.load_mesh(results / "mesh.obj", process=False)
        assert len(mesh.faces) == len(HeadModel.load().faces)
        assert (mesh.vertices[:, 2] < -0.2).all()
        assert 0.15 < np.ptp(mesh.vertices[:, 1]) < 0.45

    def test_report_is_a_large_picture(self, results: Path) -> None:
        with Image.open(results / "report.png") as report:
            report.load()
            assert report.width > 1500
            assert report.height > 1000

    def test_codes_are_the_picture_of_their_file(self, portrait: Path) -> None:
        """What is equal before the estimate gives the same light."""
        with Image.open(portrait) as photo:
            codes = photo_from_codes(np.asarray(photo))
        found = skylight.read_photo(portrait)
        np.testing.assert_array_equal(found.encoded, codes.encoded)
        torch.testing.assert_close(found.pixels, codes.pixels)

    def test_default_folder_is_named_after_the_picture(
        self,
        portrait: Path,
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "portrait_light").write_text("taken")
        shutil.copy(portrait, "portrait.jpg")
        assert main(["estimate", "portrait.jpg"]) == 1
        assert "portrait_light" in one_line(capsys)


def _landscape(path: Path) -> None:
    rng = np.random.default_rng(7)
    coarse = Image.fromarray(rng.integers(0, 255, (8, 12, 3), dtype=np.uint8))
    coarse.resize((96, 64), Image.Resampling.BICUBIC).save(path, format="PNG")


def written_exr(value: float) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        pixels = np.full((64, 128, 3), 0.5, np.float32)
        pixels[3, 5, 1] = value
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": pixels}).write(str(path))

    return write


class TestFailures:
    def test_what_is_no_picture(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """One of the files that tests/imaging/test_photo.py refuses, and a folder without any."""
        out = tmp_path / "out"
        (tmp_path / "folder").mkdir()
        for name, expected in (("a.jpg", "No such file"), ("folder", "no pictures")):
            assert main(["estimate", str(tmp_path / name), "--out", str(out)]) == 2
            line = one_line(capsys)
            assert expected in line
            assert name in line
            assert not out.exists()

    def test_earlier_results_survive_a_failure(
        self, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        out = Path(shutil.copytree(results, tmp_path / "out"))
        before = contents(out)
        _landscape(tmp_path / "hills.png")
        assert main(["estimate", str(tmp_path / "hills.png"), "--out", str(out)]) == 2
        assert "hills.png: no face found" in one_line(capsys)
        assert contents(out) == before

    @pytest.mark.slow
    def test_earlier_results_survive_an_interrupt(
        self,
        portrait: Path,
        results: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        out = Path(shutil.copytree(results, tmp_path / "out"))
        before = contents(out)
        stages: list[str] = []

        @contextmanager
        def interrupted_while_writing(_form: ProgressForm) -> Iterator[StageProgress]:
            def tell(stage: str, share: float) -> None:
                stages.append(stage)
                if stage == "writing the results":
                    raise KeyboardInterrupt

            yield tell

        # a real signal may fall where some library swallows it
        monkeypatch.setattr("skylight.estimation._command.stage_bar", interrupted_while_writing)
        sh9 = ["--light", "sh9"]
        assert main(["estimate", str(portrait), *sh9, "--out", str(out)]) == 1
        assert "interrupted" in one_line(capsys)
        assert contents(out) == before
        assert stages[-1] == "writing the results"

    def test_face_that_is_not_there(
        self, portrait: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for number in ("2", "0"):
            out = str(tmp_path / "out")
            assert main(["estimate", str(portrait), "--face", number, "--out", out]) == 2
            line = one_line(capsys)
            assert f"no face {number}" in line
            assert "choose --face 1 to 1" in line

    @pytest.mark.parametrize(
        ("wrong", "expected"),
        [
            (["b.png"], "add --shared-light"),
            (["--face", "1", "--faces", "all"], "contradict"),
            (["b.png", "--shared-light"], "b.png"),
        ],
    )
    def test_several_faces_that_cannot_be(
        self,
        wrong: list[str],
        expected: str,
        portrait: Path,
        tmp_path: Path,
        capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.chdir(tmp_path)
        assert main(["estimate", str(portrait), *wrong]) == 2
        assert expected in one_line(capsys)
        assert not list(tmp_path.iterdir())

    def test_face_turned_away(self, portrait: Path) -> None:
        with pytest.raises(InputError, match="turned away") as caught:
            estimate_photo(skylight.read_photo(portrait), landmarks=Faces(profile()))
        message, code = explain(caught.value)
        assert code == 2
        assert "use a picture" in message

    def test_what_is_left_out_is_told_and_the_rest_keep_their_numbers(
        self, portrait: Path, tmp_path: Path
    ) -> None:
        """A photograph without a face, and a face that is turned away among others."""
        _landscape(tmp_path / "hills.png")
        hills, photo = (skylight.read_photo(path) for path in (tmp_path / "hills.png", portrait))
        (frontal,) = choose_landmarker().detect(photo.encoded)
        result = estimate_photo(
            hills,
            photo,
            light="sh9",
            face="all",
            names=["hills.png", "group.png"],
            landmarks=Faces(profile(), frontal),
        )
        (seen,), (light,) = result.seen, result.estimate.faces
        assert seen.photo == light.photo == 1
        assert (seen.number, seen.name) == (2, "group.png, face 2")
        lines = [line for line in result.estimate.advice if "left out" in line]
        assert any("hills.png: no face" in line for line in lines)
        assert any("group.png, face 1: the face is turned away" in line for line in lines)

    def test_arrays_are_told_apart(self) -> None:
        hills = np.random.default_rng(7).integers(0, 255, (64, 64, 3), dtype=np.uint8)
        with pytest.raises(InputError, match=r"picture 1: .*; picture 2: "):
            estimate(hills, hills, light="sh9")
        with pytest.raises(InputError, match="the picture: no face"):
            estimate(hills, light="sh9")

    def test_folder_that_cannot_be_written(
        self, portrait: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        (tmp_path / "file").touch()
        out = tmp_path / "file" / "out"
        assert main(["estimate", str(portrait), "--out", str(out)]) == 1
        assert "choose another folder" in one_line(capsys)

    def test_no_cuda(
        self, portrait: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        if torch.cuda.is_available():
            pytest.skip("there is a CUDA device")
        out = tmp_path / "out"
        assert main(["estimate", str(portrait), "--device", "cuda", "--out", str(out)]) == 2
        assert "CUDA" in one_line(capsys)

    @pytest.mark.parametrize(
        "arguments",
        [
            ["estimate"],
            ["estimate", "a.png", "--light", "moon"],
            ["estimate", "a.png", "--gamma", "2.2", "--linear"],
            ["estimate", "a.png", "--face", "first"],
            ["estimate", "a.png", "--faces", "some"],
            ["fly"],
            ["skies"],
            ["export", "scene"],
        ],
    )
    def test_usage(self, arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 2
        assert "Traceback" not in capsys.readouterr().err

    def test_debug_adds_the_traceback(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert main(["estimate", str(tmp_path / "a.png"), "--debug"]) == 2
        captured = capsys.readouterr().err
        assert "Traceback" in captured
        assert captured.splitlines()[-1].startswith("skylight: ")

    @pytest.mark.parametrize(
        ("error", "expected"),
        [
            (MemoryError(), "out of memory"),
            (
                RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"),
                "out of memory",
            ),
            (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a.obj"), "a.obj: No space left"),
            (ZeroDivisionError("division by zero"), "rerun with --debug"),
        ],
    )
    def test_what_is_nobodys_mistake(self, error: Exception, expected: str) -> None:
        message, code = explain(error)
        assert code == 1
        assert expected in message


def test_defaults_are_the_settings() -> None:
    parameters = inspect.signature(estimate_command).parameters
    for name in {*SettingKeywords.__annotations__} - {"face", "decode", "ground", "prior", "place"}:
        assert parameters[name].default == getattr(EstimateSettings(), name)
    assert {*SettingKeywords.__annotations__} == {each.name for each in fields(EstimateSettings)}


def test_without_a_number_each_core_that_this_process_may_use_gets_a_worker(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert who_works(0, None, tmp_path) == 3
    assert who_works(2, None, tmp_path) == 2


def test_public_names_exist() -> None:
    for name in skylight.__all__:
        assert getattr(skylight, name) is not None
        assert name in dir(skylight)
    with pytest.raises(AttributeError, match="moonlight"):
        skylight.moonlight  # noqa: B018
