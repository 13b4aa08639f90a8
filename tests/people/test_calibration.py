"""Calibrating a folder of captures: what is proposed, chosen, remembered and refused."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skylight.cli import main
from skylight.errors import InputError
from skylight.faces._captures import CAPTURES_NAME, read_captures
from skylight.io._files import write_png
from skylight.people._azimuth import choose, parse_choices, picture_path, propose
from tests.face_captures import MIRRORED, PHOTO, TURNS_DEG

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def first_run(face_captures, tmp_path_factory):
    """A copy of the captures after the first step: (folder, proposals); some rows are bad."""
    folder = tmp_path_factory.mktemp("calibrated") / "faces"
    shutil.copytree(face_captures.folder, folder)
    noise = np.random.default_rng(1).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    write_png(folder / "noise.png", noise)
    write_png(folder / "grey.png", noise[..., :1].repeat(3, -1))
    with (folder / CAPTURES_NAME).open("a") as stream:
        stream.write("Eve,noise.png,day/ada.exr,,1,\n")
        stream.write("Gus,grey.png,day/ada.exr,,1,\n")
        stream.write(f"Dan,day/ada.exr,{PHOTO},,1,\n")  # a picture where light is wanted
        stream.write("Fay,day/bob.exr,day/bob.exr,30,1,\n")  # has its azimuth
    proposals, problems = propose(folder)
    return folder, proposals, problems


@pytest.fixture
def proposed(first_run, tmp_path) -> Path:
    shutil.copytree(first_run[0], tmp_path / "faces")
    return tmp_path / "faces"


def test_the_best_minimum_is_near_the_truth(first_run):
    _, proposals, _ = first_run
    for photo, truth in TURNS_DEG.items():
        off = (proposals[photo].azimuths_deg[0] - truth + 180) % 360 - 180
        assert abs(off) < 15, photo  # the head is fitted to landmarks
        assert list(proposals[photo].errors) == sorted(proposals[photo].errors)


def test_captures_that_cannot_be_used_do_not_stop_the_others(first_run):
    _, proposals, problems = first_run
    assert set(proposals) == {PHOTO, MIRRORED}
    assert "no face found" in problems["noise.png"]
    assert "give a colour photo" in problems["grey.png"]
    assert "use .exr or .hdr" in problems["day/ada.exr"]


def test_each_proposal_has_its_picture(first_run):
    folder, proposals, _ = first_run
    for photo in proposals:
        with Image.open(picture_path(folder, photo)) as picture:
            assert picture.width > 900
            assert np.ptp(np.asarray(picture)) > 200


def test_what_is_done_is_not_done_again_unless_a_file_changed(proposed, monkeypatch):
    asked = []

    def never(data, capture):
        asked.append(capture.photo)
        raise InputError("asked again")

    monkeypatch.setattr("skylight.people._azimuth._proposal", never)
    proposals, _ = propose(proposed)
    assert set(proposals) == {PHOTO, MIRRORED}
    shutil.copy(proposed / "day/bob.exr", proposed / "day/ada.exr")
    proposals, _ = propose(proposed)
    assert PHOTO in asked
    assert set(proposals) == {MIRRORED}


def test_a_choice_is_written_and_nothing_else(proposed, first_run):
    before = list(csv.DictReader((proposed / CAPTURES_NAME).open()))
    wanted = len(first_run[1][PHOTO].azimuths_deg)  # the worst of them
    assert main(["faces", "calibrate-azimuth", str(proposed), "--choose", f"{PHOTO}={wanted}"]) == 0
    after = list(csv.DictReader((proposed / CAPTURES_NAME).open()))
    assert float(after[0].pop("azimuth_deg")) == first_run[1][PHOTO].azimuths_deg[wanted - 1]
    before[0].pop("azimuth_deg")
    assert after == before


def test_auto_takes_the_best_and_keeps_what_was_known(proposed, first_run, capsys):
    folder = str(proposed)
    assert main(["faces", "calibrate-azimuth", folder, "--auto"]) == 2  # three cannot be used
    assert "3 of 5 photographs got no azimuth" in capsys.readouterr().err
    azimuths = {c.photo: c.azimuth_deg for c in read_captures(proposed)}
    best = {photo: first_run[1][photo].azimuths_deg[0] for photo in TURNS_DEG}
    unusable = {"noise.png": None, "grey.png": None, "day/ada.exr": None}
    assert azimuths == best | unusable | {"day/bob.exr": 30.0}


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        ("day/cy.png=1", "no photograph day/cy.png"),
        (f"{PHOTO}=9", "there is no minimum 9; choose 1 to"),
        (f"{PHOTO}=0", "there is no minimum 0"),
        ("noise.png=1", "nothing to choose from yet"),
        (PHOTO, "takes PHOTO=N"),
        (f"{PHOTO}=-1", "takes PHOTO=N"),
        ("=1", "takes PHOTO=N"),
    ],
)
def test_choices_that_cannot_be_made(proposed, choice, said):
    before = (proposed / CAPTURES_NAME).read_bytes()
    with pytest.raises(InputError) as caught:
        choose(proposed, parse_choices([f"{MIRRORED}=1", choice]))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert (proposed / CAPTURES_NAME).read_bytes() == before


def test_a_photograph_chosen_twice(proposed):
    with pytest.raises(InputError, match="twice"):
        parse_choices([f"{PHOTO}=1", f"{PHOTO}=2"])


def test_a_changed_probe_must_be_looked_at_again(proposed):
    shutil.copy(proposed / "day/bob.exr", proposed / "day/ada.exr")
    with pytest.raises(InputError, match="changed since"):
        choose(proposed, {PHOTO: 1})


def test_a_damaged_record_is_named(proposed):
    record = picture_path(proposed, PHOTO).with_suffix(".json")
    whole = record.read_text()
    changed = json.dumps(json.loads(whole) | {"azimuths_deg": ["north"]})
    for damaged in ("{", changed):
        record.write_text(damaged)
        with pytest.raises(InputError, match="delete"):
            choose(proposed, {PHOTO: 1})
