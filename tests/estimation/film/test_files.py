"""``skylight estimate --video``: a light for each keyframe, and what is wrong with films."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from skimage.data import astronaut

from skylight.cli import main
from skylight.errors import InputError
from skylight.estimation.film import _estimate as film_module
from skylight.estimation.film._estimate import FOLLOWING
from skylight.estimation.film._follow import FOLLOWED, Shot, read_followed
from skylight.estimation.film._kept import read_film
from skylight.imaging._camera_turns import Link, world_from_cameras
from skylight.io._files import read_environment_map
from skylight.io._tensors import read_tensors, write_tensors
from tests.films import box, with_in_description, write_film


def frames(count: int) -> list[np.ndarray]:
    """The astronaut before a camera that pans by a few pixels a frame."""
    whole = astronaut()[:300, 60:400]
    return [np.ascontiguousarray(whole[:, 3 * k : 3 * k + 256]) for k in range(count)]


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line that says why."""
    assert main(["estimate", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a film of three frames gave, its light at two of them."""
    folder = tmp_path_factory.mktemp("film")
    film = write_film(folder / "film.mp4", frames(3))
    out = folder / "light"
    assert main(["estimate", str(film), "--video", "--out", str(out), "--keyframes", "2"]) == 0
    return out


@pytest.mark.slow  # a whole estimate, twice
class TestALightOfAFilm:
    def test_a_probe_of_each_keyframe_and_one_of_the_film(self, out: Path) -> None:
        told = json.loads((out / "film.json").read_text())
        assert [one["frame"] for one in told["keyframes"]] == [0, 2]
        assert [one["time_s"] for one in told["keyframes"]] == pytest.approx([0, 0.2])
        for one in told["keyframes"]:
            assert read_environment_map(out / one["probe"]).layout == (256, 512)
            assert one["residual"] < 0.25
        assert read_environment_map(out / "probe.exr").layout == (256, 512)
        assert not told["posterior"]["is_seen"]  # of a sun that nobody saw nothing is told
        assert {one["kind"] for one in told["lights"]} <= {"lamp"}
        assert {"posterior.exr", "probe.hdr", "mesh.obj", "report.png"} <= {
            path.name for path in out.iterdir()
        }

    def test_what_films_are_relit_by_is_to_their_end_and_of_medians(self, out: Path) -> None:
        told, film = json.loads((out / "film.json").read_text()), read_film(out)
        assert film.shot == (0.0, math.inf)
        whites = [one["white_balance"] for one in told["keyframes"]]
        np.testing.assert_allclose(film.white_balance, np.median(whites, axis=0), rtol=1e-6)
        assert len(film.points) == len(film.frames) == 2

    def test_the_same_command_goes_on_without_following_again(
        self, out: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def never(*_: object, **__: object) -> None:
            raise AssertionError

        before = json.loads((out / "film.json").read_text())
        monkeypatch.setattr(film_module, "follow", never)
        film = out.parent / "film.mp4"
        assert main(["estimate", str(film), "--video", "--out", str(out), "--keyframes", "2"]) == 0
        after = json.loads((out / "film.json").read_text())
        assert after["sun"] == pytest.approx(before["sun"])

    @pytest.mark.parametrize(
        "facts", ["{}", "[]", '{"shot": [0, 0, 1, 1], "gaps": 3}', "[" * 10**5]
    )
    def test_what_was_followed_and_cannot_be_is_one_line(
        self, out: Path, tmp_path: Path, facts: str
    ) -> None:
        tensors, _ = read_tensors(out / FOLLOWING / FOLLOWED)
        write_tensors(tmp_path / FOLLOWED, tensors, {"facts": facts})
        with pytest.raises(InputError, match="the film is followed again") as caught:
            read_followed(tmp_path)
        assert "\n" not in str(caught.value)

    def test_other_settings_want_another_folder(
        self, out: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        film = str(out.parent / "film.mp4")
        line = refused(capsys, film, "--video", "--out", str(out), "--keyframes", "5")
        assert "made with other settings" in line


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


class TestWhatIsWrong:
    def test_a_film_without_the_word(
        self, in_folder: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        write_film(in_folder / "film.mp4", frames(1))
        assert "film.mp4 is a film: add --video" in refused(capsys, "film.mp4")

    def test_high_dynamic_range(self, in_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        film = write_film(in_folder / "film.mp4", frames(1))
        colour = b"nclx" + bytes([0, 9, 0, 18, 0, 9, 0])
        with_in_description(film, box(b"colr", colour))
        line = refused(capsys, "film.mp4", "--video")
        assert "HLG" in line
        assert "export it as SDR" in line

    def test_too_long(self, in_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        """The header tells, so nothing is decoded."""
        write_film(in_folder / "film.mp4", [np.zeros((32, 32, 3), np.uint8)] * 700, rate=1.0)
        line = refused(capsys, "film.mp4", "--video")
        assert "12 minutes long, and at most 10 are followed" in line

    def test_nobody_in_it(self, in_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        write_film(in_folder / "film.mp4", [np.full((64, 64, 3), 90, np.uint8)] * 2)
        assert "no face found in 2 frames" in refused(capsys, "film.mp4", "--video")
        assert not (in_folder / "film_light" / "film.json").exists()

    def test_no_film(self, in_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        (in_folder / "film.mp4").write_bytes(b"nothing" * 99)
        assert "cannot open film.mp4" in refused(capsys, "film.mp4", "--video")
        assert "cannot read none.mp4" in refused(capsys, "none.mp4", "--video")
        (in_folder / "empty").mkdir()
        assert "no pictures" in refused(capsys, "empty", "--video")

    @pytest.mark.parametrize(
        ("options", "word"),
        [
            (["--light", "lamps"], "not lamps"),
            (["--keyframes", "0"], "--keyframes must be 1 or more"),
            (["--rate", "0"], "--rate"),
            (["--faces", "all"], "--faces all"),
            (["--workers", "2"], "--workers"),
            (["--solver", "thesis"], "--solver"),
            (["--place", "1,2"], "--time, --place and --heading"),
        ],
    )
    def test_what_does_not_go_with_films(
        self,
        in_folder: Path,
        capsys: pytest.CaptureFixture[str],
        options: list[str],
        word: str,
    ) -> None:
        write_film(in_folder / "film.mp4", frames(1))
        assert word in refused(capsys, "film.mp4", "--video", *options)


def test_a_film_cut_short_is_told(in_folder: Path) -> None:
    """An AVI whose header tells of more frames than its bytes hold."""
    path = in_folder / "film.avi"
    code = cv2.VideoWriter.fourcc(*"MJPG")
    made = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 10.0, (256, 300))
    for frame in frames(20):
        made.write(frame[..., ::-1])
    made.release()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    settings = film_module.FilmSettings(keyframes=2)
    followed = film_module.followed_film(path, in_folder / "out", settings)
    assert followed.notes[-1].startswith("cut short: pictures end at")


def test_frames_of_a_folder_at_their_rate(in_folder: Path) -> None:
    folder = in_folder / "frames"
    folder.mkdir()
    for number, frame in enumerate(frames(6)):
        Image.fromarray(frame).save(folder / f"{number:03d}.png")
    settings = film_module.FilmSettings(keyframes=3, rate=20.0)
    followed = film_module.followed_film(folder, in_folder / "out", settings)
    assert [one.number for one in followed.shot.keyframes] == [0, 2, 4]
    assert [one.time_s for one in followed.shot.keyframes] == pytest.approx([0, 0.1, 0.2])
    assert followed.shot.keyframes[1].picture == folder / "002.png"


def test_a_wall_that_tells_no_turn_is_said_once() -> None:
    none = np.zeros((0, 2))
    links = [Link(start=0, end=k, before=none, after=none) for k in (3, 6)]
    shot = Shot(first=0, begin_s=0.0, end_s=0.6, links=links)
    _, untold = world_from_cameras(links, 900.0, (640, 480))
    (note,) = film_module.turn_notes(shot, untold)
    assert note.startswith("the camera's turn cannot be told (too little of the background")
    assert note.endswith("it is taken to stand still")
    assert film_module.turn_notes(shot, []) == []
