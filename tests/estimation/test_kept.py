"""What is kept of an estimate's face, exactly, and what is said where it cannot be used."""

import json
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.estimation._kept import KEPT, FaceReflection, KeptFace, read_face, write_face
from skylight.imaging._edits import Edit
from skylight.imaging._photo import read_photo
from skylight.inverse._result import Lamp
from skylight.io._files import write_png
from tests.sunny_face import direction, known_face


@pytest.fixture
def kept(tmp_path: Path) -> tuple[KeptFace, Path]:
    """(A face, the folder that it is kept in), of the photograph beside that."""
    photo, folder = tmp_path / "me.png", tmp_path / "me_light"
    write_png(photo, known_face().photo.encoded)
    folder.mkdir()
    face = replace(
        known_face(),
        reflection=FaceReflection(
            specular_scale=0.7,
            head_error=torch.rand(5),
            edit=Edit(saturation=1.2, contrast=0.9, pivot=0.3),
        ),
        lamps=tuple(
            Lamp(direction=direction(x, 60.0), irradiance=torch.rand(3), spread_rad=x / 99)
            for x in (5.0, 7.0)
        ),
        file=photo,
        decode="linear",
    )
    write_face(folder, face)
    return replace(face, photo=read_photo(photo, decode="linear")), folder


def same(one: Any, other: Any) -> None:
    """To the last bit."""
    if is_dataclass(one):
        for field in fields(one):
            same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple) and one and is_dataclass(one[0]):
        for each in zip(one, other, strict=True):
            same(*each)
    else:
        np.testing.assert_equal(np.asarray(one), np.asarray(other))


def test_a_face_is_read_as_it_was(kept: tuple[KeptFace, Path]) -> None:
    want, folder = kept
    same(read_face(folder), want)
    write_face(folder, replace(want, reflection=known_face().reflection, lamps=()))
    again = read_face(folder, want.photo)
    assert (again.lamps, again.reflection.head_error) == ((), None)
    assert KeptFace.of(again) is again


def test_the_command_keeps_the_face(estimated_portrait: tuple[Path, Path]) -> None:
    photo, folder = estimated_portrait
    face = read_face(folder)
    np.testing.assert_array_equal(face.photo.encoded, read_photo(photo).encoded)
    told = json.loads((folder / "estimate.json").read_text())
    assert face.name == told["sources"][0]
    assert list(face.advice) == told["advice"]
    assert face.verdict == told["verdict"]["summary"]
    assert face.reflection.specular_scale == told["faces"][0]["gloss"]


@pytest.mark.usefixtures("kept")
def test_the_photograph_is_found_where_both_were_moved(tmp_path: Path) -> None:
    away = tmp_path / "away"
    away.mkdir()
    for name in ("me.png", "me_light"):
        shutil.move(tmp_path / name, away / name)
    assert read_face(away / "me_light").photo.encoded.shape == (96, 96, 3)
    assert str(tmp_path).encode() not in (away / "me_light" / KEPT).read_bytes()


def test_what_is_missing_or_wrong_is_one_line(kept: tuple[KeptFace, Path], tmp_path: Path) -> None:
    face, folder = kept
    with pytest.raises(InputError, match="no person"):
        read_face(tmp_path)
    photo, codes = tmp_path / "me.png", known_face().photo.encoded
    write_png(photo, 255 - codes)
    with pytest.raises(InputError, match="another picture"):
        read_face(folder)
    photo.unlink()
    with pytest.raises(InputError, match="is gone from"):
        read_face(folder)
    write_png(tmp_path / "small.png", codes[:60, :60])
    with pytest.raises(InputError, match="not of the size"):
        read_face(folder, read_photo(tmp_path / "small.png"))
    write_face(folder, replace(face, file=None))
    with pytest.raises(InputError, match="made of no file"):
        read_face(folder)
    content = (folder / KEPT).read_bytes()
    for damaged in (content[: len(content) // 2], content[:-1] + bytes([content[-1] ^ 1]), b""):
        (folder / KEPT).write_bytes(damaged)
        with pytest.raises(InputError, match="damaged"):
            read_face(folder)
