"""``skylight live`` from a film to its lines, and what it says where that cannot be."""

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from skimage.data import astronaut

from skylight.cli import main
from skylight.errors import InputError
from skylight.imaging._film import FilmFrame
from skylight.live import _play
from skylight.live._command import _Told
from skylight.live._play import MOST_SIDE, played, source_of
from tests.films import write_film
from tests.live.test_live import some_light


def person(x: int) -> np.ndarray:
    picture = np.full((240, 320, 3), 120, np.uint8)
    picture[20:220, x : x + 200] = astronaut()[0:200, 125:325]
    return picture


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    frames = [person(40 + 3 * k) for k in range(8)]
    return write_film(tmp_path_factory.mktemp("film") / "me.mp4", frames)


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_a_film_becomes_a_line_a_frame(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "light.jsonl"
    assert main(["live", str(film), "--no-page", "--out", str(out), "--benchmark"]) == 0
    found = lines(out)
    assert [line["frame"] for line in found] == list(range(8))
    np.testing.assert_allclose([line["time_s"] for line in found], 0.1 * np.arange(8), atol=1e-3)
    assert all(line["seen"] for line in found)
    for line in found:
        assert np.linalg.norm(line["direction"]) == pytest.approx(1, abs=1e-4)
        assert len(line["sh27"]) == 27
        assert 0 < line["radius_90_deg"] <= 180
        assert line["mean_luminance"] > 0
    told = capsys.readouterr().out
    assert "8 of 8 frames with a face" in told
    assert "frames a second" in told
    assert [p.name for p in tmp_path.iterdir()] == ["light.jsonl"]


def test_one_of_so_many_frames(film: Path, tmp_path: Path) -> None:
    out = tmp_path / "light.jsonl"
    assert main(["live", str(film), "--no-page", "--every", "3", "--out", str(out)]) == 0
    assert [line["frame"] for line in lines(out)] == [0, 3, 6]


def test_a_film_without_a_face(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = write_film(tmp_path / "nobody.mp4", [np.full((96, 128, 3), 90, np.uint8)] * 3)
    out = tmp_path / "light.jsonl"
    assert main(["live", str(empty), "--no-page", "--out", str(out)]) == 0
    assert [line["seen"] for line in lines(out)] == [False] * 3
    assert "no face was seen" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["97"], "cannot open webcam 97: see that it is plugged in"),
        (["99999999999"], "webcams are numbered from 0 to 99"),
        (["nothing.mp4"], "there is no such file"),
        (["{text}"], "give a video such as .mp4"),
        (["{text}", "--every", "0"], "--every must be 1 or more"),
        (["97", "--out", "{folder}/none/light.jsonl"], "no such folder"),
    ],
)
def test_what_cannot_be_played_is_one_line(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no film")
    given = [each.format(text=text, folder=tmp_path) for each in arguments]
    assert main(["live", *given, "--no-browser"]) in (1, 2)
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_what_is_a_webcam_and_what_a_film() -> None:
    assert source_of("0") == 0
    assert source_of("12.mp4") == Path("12.mp4")


def test_a_film_in_time_takes_as_long_as_it_is(film: Path) -> None:
    begun = time.monotonic()
    with played(film, in_time=True) as frames:
        numbers = [frame.number for frame in frames]
    assert time.monotonic() - begun > 0.65
    assert numbers[0] == 0
    assert numbers == sorted(numbers)


class Camera:
    """Gives so many frames, each when it is asked for after ``pause_s``; then it may fail."""

    def __init__(self, count: int, pause_s: float, failure: Exception | None = None) -> None:
        self.count, self.pause_s, self.failure, self.taken = count, pause_s, failure, 0

    def read(self) -> tuple[bool, np.ndarray | None]:
        if self.taken == self.count:
            if self.failure is not None:
                raise self.failure
            return False, None
        time.sleep(self.pause_s)
        self.taken += 1
        return True, np.full((960, 1280, 3), self.taken, np.uint8)


def test_of_a_webcam_the_newest_frame_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """What came while others were looked at is left out, and the last one is not."""
    before = threading.active_count()
    camera = Camera(30, 0.01)
    with _play._Newest(camera, 0) as newest:
        seen = []
        for frame in newest.frames():
            assert max(frame.codes.shape) == MOST_SIDE
            seen.append(frame.number)
            time.sleep(0.05)
    assert seen == sorted(set(seen))
    assert seen[-1] == 29
    assert len(seen) < 20
    assert threading.active_count() == before


def test_a_webcam_that_gives_nothing_is_told() -> None:
    with (
        _play._Newest(Camera(0, 0.0), 3) as newest,
        pytest.raises(InputError, match="webcam 3 gives no picture"),
    ):
        list(newest.frames())


@pytest.mark.parametrize(
    ("failure", "said"),
    [(None, "it gives no more pictures"), (cv2.error("the driver\nis gone"), "the driver is gone")],
    ids=["unplugged", "driver"],
)
def test_why_a_webcam_ended_is_told_at_once(
    failure: Exception | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = time.monotonic()
    with _play._Newest(Camera(2, 0.01, failure), 3) as newest:
        assert list(newest.frames())
    assert time.monotonic() - begun < 5
    told = capsys.readouterr()
    assert told.out == f"webcam 3 ended: {said}\n"
    assert told.err == ""


def test_an_error_of_the_reading_thread_is_raised_where_frames_are_asked_for() -> None:
    with (
        _play._Newest(Camera(2, 0.01, ValueError("a bug")), 3) as newest,
        pytest.raises(ValueError, match="a bug"),
    ):
        list(newest.frames())


def in_time(
    monkeypatch: pytest.MonkeyPatch, *, decoding_s: float, looking_s: float
) -> list[tuple[int, float]]:
    """(frame, time) of 100 frames, ten a second, as they are shown by a clock of this test."""
    now = [0.0]

    def passed(seconds: float) -> None:
        now[0] += seconds

    def frames() -> Iterator[FilmFrame]:
        for k in range(100):
            passed(decoding_s)
            yield FilmFrame(number=k, time_s=k / 10, codes=np.zeros((1, 1, 3), np.uint8))

    monkeypatch.setattr(_play, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=passed))
    shown = []
    for frame in _play._shown(frames()):
        shown.append((frame.number, now[0]))
        passed(looking_s)
    return shown


def test_a_film_that_decodes_slowly_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """At half its rate, something is shown every 0.7 s, to the end."""
    shown = in_time(monkeypatch, decoding_s=0.2, looking_s=0.0)
    assert np.diff([at for _, at in shown]).max() < 0.75
    assert shown[-1][0] > 95


def test_who_looks_slowly_stays_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """By leaving out frames: two of three, when each is looked at for 0.3 s."""
    shown = in_time(monkeypatch, decoding_s=0.001, looking_s=0.3)
    assert max(abs(at - number / 10) for number, at in shown) < 0.11
    assert 30 <= len(shown) <= 36


def test_what_was_seen_before_a_film_began_again_is_not_forgotten() -> None:
    told = _Told()
    for light in (None, some_light(np.array([0.0, 0.0, 1.0]), 0.0), None, None):
        told.count(light)
    assert told.summary(None).startswith("1 of 4 frames with a face; last: direction sure")
