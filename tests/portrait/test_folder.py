"""Estimates and folders of them relit: nothing is estimated again, and runs go on."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from skylight.cli import main
from skylight.estimation._kept import KEPT, write_face
from skylight.estimation._manifest import MANIFEST, Entry, list_photos, write_manifest
from skylight.estimation._photos import Pictures
from skylight.io._files import write_png
from skylight.portrait import _asked as asked, _folder as folder_module
from skylight.portrait._folder import relight_one
from skylight.portrait._gain import resized
from skylight.portrait._relit import Portrait, light_in_photo, portrait_of
from tests.sunny_face import known_face


@pytest.fixture(autouse=True)
def no_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is relit here was estimated before."""

    def again(_: Pictures) -> None:
        raise AssertionError("estimated again")

    monkeypatch.setattr(Pictures, "estimate", again)


@pytest.fixture
def one_portrait(monkeypatch: pytest.MonkeyPatch) -> list[Portrait]:
    """All photographs are one, so it is taken apart once; counted where it is asked for."""
    counted: list[Portrait] = []

    def counting(*_: Any, **__: Any) -> Portrait:
        counted.append(small())
        return small()

    monkeypatch.setattr(asked, "taken_apart", counting)
    return counted


@lru_cache(maxsize=1)
def small() -> Portrait:
    """The portrait at a size at which it is lit at once."""
    face = known_face()
    return portrait_of(face.photo, face.fit, face.reflection, light_in_photo(face), face_px=24)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces of work are done by this process."""

    def share(work: Callable[..., Entry], each: list[tuple[Any]], **_: Any) -> Iterator[Entry]:
        return (work(*one) for one in each)

    monkeypatch.setattr(folder_module, "share_work", share)


def kept(photo: Path, folder: Path) -> None:
    """The estimate of a photograph as ``skylight estimate`` leaves it, as far as it counts here."""
    write_png(photo, known_face().photo.encoded)
    folder.mkdir(parents=True)
    (folder / "estimate.json").write_text("{}")
    write_face(folder, replace(known_face(), name=photo.name, file=photo))


def halves(path: Path) -> tuple[float, float]:
    """Mean codes of skin left and right of the middle of the face."""
    codes = np.array(Image.open(path).convert("RGB")).astype(float).mean(2)
    rows, columns = np.nonzero(resized(small().on.bare, small().scene.shape[:2]) > 0.5)
    is_left = columns < columns.mean()
    return codes[rows, columns][is_left].mean(), codes[rows, columns][~is_left].mean()


def test_an_estimate_is_relit_in_several_lights_at_once(
    tmp_path: Path, one_portrait: list[Portrait], capsys: pytest.CaptureFixture[str]
) -> None:
    kept(tmp_path / "me.png", tmp_path / "me_light")
    out = tmp_path / "lit"
    command = ["relight-portrait", str(tmp_path / "me_light"), "--out", str(out)]
    assert main([*command, "--key", "left", "--key", "right", "--angle", "-10,20", "--hard"]) == 0
    names = ["me_left.png", "me_right.png", "me_-10_20.png"]
    assert {path.name for path in out.iterdir()} == set(names)
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("verdict")
    assert said[1:] == [str(out / name) for name in names]
    left, right = (halves(out / name) for name in names[:2])
    assert left[0] > right[0]
    assert left[1] < right[1]
    assert len(one_portrait) == 1


def test_of_an_estimate_the_picture_has_the_photographs_name(
    tmp_path: Path, one_portrait: list[Portrait], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept(tmp_path / "me.png", tmp_path / "me_light")
    monkeypatch.chdir(tmp_path)
    assert main(["relight-portrait", "me_light", "--key", "rim"]) == 0
    assert main(["relight-portrait", "me_light", "--turn", "30"]) == 0
    assert main(["relight-portrait", "me_light", "--key", "top", "--out", "top.exr"]) == 0
    made = {path.name for path in tmp_path.iterdir()} - {"me.png", "me_light"}
    assert made == {"me_rim.png", "me_relit.png", "top.exr"}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--key", "left", "--light", "sh9"], "--light"),
        (["--key", "left", "--place", "indoors"], "--place"),
        (["--key", "left", "--face", "2"], "--face"),
        (["--key", "left", "--linear"], "--gamma or --linear"),
        (["--key", "left", "--workers", "2"], "--workers"),
        (["--key", "left", "--retry-failed"], "--retry-failed"),
        (["--key", "all", "--out", "x.png"], "5 lights"),
        (["--key", "left", "--out", "me.png"], "the photograph itself"),
        (["--key", "left", "--out", "a_file"], "is a file"),
    ],
)
def test_what_an_estimate_does_not_take_is_one_line(
    options: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    kept(tmp_path / "me.png", tmp_path / "me_light")
    (tmp_path / "a_file").touch()
    monkeypatch.chdir(tmp_path)
    assert main(["relight-portrait", str(tmp_path / "me_light"), *options]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line


def test_a_folder_of_estimates_goes_on_and_passes_over_what_fails(
    tmp_path: Path,
    one_portrait: list[Portrait],
    here: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    estimates, out = tmp_path / "light", tmp_path / "lit"
    for name in ("a/me", "you", "gone"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        kept(tmp_path / f"{name}.png", estimates / f"{name}_png")
    (tmp_path / "gone.png").unlink()
    command = ["relight-portrait", str(estimates), "--out", str(out), "--key", "left"]
    assert main(command) == 0
    said = capsys.readouterr()
    assert "is gone from" in said.err
    assert "2 of 3 portraits" in said.out
    pictures = [out / "a" / "me_png_left.png", out / "you_png_left.png"]
    assert sorted(out.rglob("*.png")) == pictures
    lines = [json.loads(line) for line in (out / MANIFEST).read_text().splitlines()]
    told = {line["source"]: line["status"] for line in lines}
    assert told == {"a/me_png": "done", "gone_png": "failed", "you_png": "done"}
    assert len(one_portrait) == 2

    assert main(command) == 0  # what is done stays
    assert len(one_portrait) == 2
    pictures[1].unlink()
    write_png(tmp_path / "gone.png", known_face().photo.encoded)
    assert main(command) == 0  # a picture that is gone, and a photograph that is back
    assert len(one_portrait) == 4
    assert len(list(out.rglob("*.png"))) == 3
    assert main([*command, "--soft"]) == 0  # another light
    assert len(one_portrait) == 7

    assert main(["relight-portrait", str(estimates), "--out", str(estimates), "--key", "top"]) == 2
    assert "another folder" in capsys.readouterr().err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert main(["relight-portrait", str(empty), "--key", "left"]) == 2
    assert "neither pictures nor estimates" in capsys.readouterr().err
    (estimates / "you_png" / KEPT).unlink()
    (tmp_path / "a" / "me.png").unlink()
    (tmp_path / "gone.png").unlink()
    assert main([*command, "--ev", "1"]) == 2
    assert "none of 3" in capsys.readouterr().err


def test_of_a_folder_of_photographs_each_is_estimated_once(
    tmp_path: Path,
    one_portrait: list[Portrait],
    here: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    photos, out = tmp_path / "photos", tmp_path / "photos" / "lit"
    photos.mkdir()
    write_png(photos / "me.png", known_face().photo.encoded)
    asked_for: list[tuple[Path, Path]] = []

    def estimates(photos: Path, out: Path, *_: Any, **__: Any) -> list[Entry]:
        asked_for.append((photos, out))
        if not (out / "me_png").exists():
            kept(photos / "me.png", out / "me_png")
        done = Entry(source="me.png", sha256="", settings="", status="done")
        bad = Entry(source="no.png", sha256="", settings="", status="failed", error="no face")
        write_manifest(out / MANIFEST, [done, bad])
        return [done, bad]

    monkeypatch.setattr("skylight.estimation._folder.estimate_folder", estimates)
    command = ["relight-portrait", str(photos), "--out", str(out), "--key", "left"]
    for _ in range(2):
        assert main(command) == 0
        said = capsys.readouterr()
        assert "no face" in said.err
        assert "1 of 2 portraits" in said.out
    assert asked_for == [(photos, out / "estimates")] * 2
    assert len(one_portrait) == 1
    assert list_photos(photos, tmp_path / "other") == ["me.png"]  # no picture of ours is one
    # what it made takes the place of the photographs
    again = ["relight-portrait", str(out), "--out", str(tmp_path / "more"), "--key", "top"]
    assert main(again) == 0
    assert len(asked_for) == 2
    assert (tmp_path / "more" / "me_png_top.png").is_file()


def test_a_piece_is_named_by_its_light(tmp_path: Path, one_portrait: list[Portrait]) -> None:
    kept(tmp_path / "me.png", tmp_path / "light" / "me_png")
    (light,) = asked.asked_keys([], [(12.5, -3.0)])
    piece = folder_module.RelitPiece(
        folder=tmp_path / "light",
        source="me_png",
        out=tmp_path / "lit",
        lights=(light,),
        exposure=1.0,
        settings_hash="x",
    )
    entry = relight_one(piece)
    assert (entry.status, entry.error) == ("done", "")
    assert piece.is_finished(entry)
    assert (tmp_path / "lit" / "me_png_12.5_-3.png").is_file()
