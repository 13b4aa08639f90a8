"""The table of captures: read strictly, and only azimuths are ever written into it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from skylight.errors import InputError
from skylight.faces._captures import (
    CAPTURES_NAME,
    FaceCapture,
    capture_hash,
    read_captures,
    read_probe,
    true_light,
    write_azimuths,
)
from skylight.io._files import write_environment_map
from skylight.io._hdr import write_exr
from skylight.sphere._envmap import EnvironmentMap

HEAD = "photo,probe,azimuth_deg,visible_sun,person\n"
CAPTURE = FaceCapture(
    photo="a.jpg", probe="noon.exr", azimuth_deg=90.0, visible_sun=True, person="Ada"
)


@pytest.fixture
def folder(tmp_path):
    radiance = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    write_environment_map(tmp_path / "noon.exr", EnvironmentMap(radiance=radiance))
    for name in ("a.jpg", "b.jpg"):
        (tmp_path / name).write_bytes(name.encode())
    table(tmp_path, HEAD + "a.jpg,noon.exr,90,1,Ada\nb.jpg,noon.exr,,0,Bob\n")
    return tmp_path


def table(folder, text):
    (folder / CAPTURES_NAME).write_text(text, encoding="utf-8")


def test_rows_are_read_in_order(folder):
    second = FaceCapture(
        photo="b.jpg", probe="noon.exr", azimuth_deg=None, visible_sun=False, person="Bob"
    )
    assert read_captures(folder) == [CAPTURE, second]


def test_columns_may_stand_in_any_order_after_a_byte_order_mark(folder):
    table(folder, "\ufeffperson,visible_sun,azimuth_deg,probe,photo\nAda,1,90,noon.exr,a.jpg\n")
    assert read_captures(folder) == [CAPTURE]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column photo"),
        ("photo;probe;azimuth_deg;visible_sun;person\n", "with commas"),
        (HEAD.replace("person", "person,person"), "stands twice"),
        (HEAD, "no rows"),
        (HEAD + "a.jpg,noon.exr,90,1\n", "line 2: not as many values"),
        (HEAD + "a.jpg,noon.exr,90,1,Ada,x\n", "line 2: not as many values"),
        (HEAD + "a.jpg,noon.exr,nan,1,Ada\n", "line 2: azimuth_deg is 'nan'"),
        (HEAD + "a.jpg,noon.exr,east,1,Ada\n", "azimuth_deg is 'east'"),
        (HEAD + "a.jpg,noon.exr,400,1,Ada\n", "azimuth_deg is '400'"),
        (HEAD + "a.jpg,noon.exr,90,,Ada\n", "visible_sun is ''"),
        (HEAD + "a.jpg,noon.exr,90,1,\n", "person is empty"),
        (HEAD + "c.jpg,noon.exr,90,1,Ada\n", "line 2: photo 'c.jpg' is not there"),
        (HEAD + '"c\n.jpg",noon.exr,90,1,Ada\n', "line 3: photo"),
        (HEAD + "c" * 5000 + ".jpg,noon.exr,90,1,Ada\n", "is not there"),
        (HEAD + "a.jpg,dusk.exr,90,1,Ada\n", "probe 'dusk.exr' is not there"),
        (HEAD + "../a.jpg,noon.exr,90,1,Ada\n", "must be a file within"),
        (HEAD + "a.jpg,/noon.exr,90,1,Ada\n", "must be a file within"),
        (HEAD + 2 * "a.jpg,noon.exr,90,1,Ada\n", "line 3: a.jpg stands in line 2"),
    ],
)
def test_what_cannot_be_understood_is_named_in_one_line(folder, text, said):
    table(folder, text)
    with pytest.raises(InputError) as caught:
        read_captures(folder)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_table_is_told_what_to_write(tmp_path):
    with pytest.raises(InputError, match="photo, probe"):
        read_captures(tmp_path)


def test_only_azimuths_change(folder):
    before = 'note,photo,probe,azimuth_deg,visible_sun,person\n"x, y",a.jpg,noon.exr,90,1,Ada\n'
    table(folder, before + "é,b.jpg,noon.exr,,0,Bob\n")
    write_azimuths(folder, {"b.jpg": -177.1875})
    after = (folder / CAPTURES_NAME).read_text(encoding="utf-8")
    assert after == before + "é,b.jpg,noon.exr,-177.1875,0,Bob\n"


def test_an_unknown_photograph_changes_nothing(folder):
    before = (folder / CAPTURES_NAME).read_bytes()
    with pytest.raises(InputError, match=r"no photograph c\.jpg"):
        write_azimuths(folder, {"b.jpg": 1.0, "c.jpg": 2.0})
    assert (folder / CAPTURES_NAME).read_bytes() == before


def test_light_moves_to_the_right_by_the_azimuth(folder):
    probe, light = read_probe(folder, CAPTURE), true_light(folder, CAPTURE, height=8)
    # a quarter of 16 columns
    torch.testing.assert_close(light.radiance, probe.radiance.roll(4, dims=1))


def test_light_of_an_unknown_azimuth_is_refused(folder):
    with pytest.raises(InputError, match="calibrate-azimuth"):
        true_light(folder, replace(CAPTURE, azimuth_deg=None))


@pytest.mark.parametrize(
    ("radiance", "said"),
    [
        (torch.ones(4, 16, 3), "upper half alone"),
        (torch.zeros(8, 16, 3), "black"),
        (torch.rand(8, 16, 3).mul(2).clamp(max=1), "cut off"),
    ],
)
def test_probes_that_are_none(folder, radiance, said):
    write_environment_map(folder / "noon.exr", EnvironmentMap(radiance=radiance))
    with pytest.raises(InputError, match=said):
        read_probe(folder, CAPTURE)


def test_a_picture_is_no_probe(folder):
    with pytest.raises(InputError, match=r"use \.exr or \.hdr"):
        read_probe(folder, replace(CAPTURE, probe="a.jpg"))


def test_a_probe_with_nan_is_refused(folder):
    pixels = np.full((8, 16, 3), math.nan, np.float32)
    write_exr(folder / "noon.exr", pixels, half=False, header={})
    with pytest.raises(InputError, match="NaN"):
        read_probe(folder, CAPTURE)


def test_the_hash_tells_photograph_and_probe(folder):
    seen = {capture_hash(folder, CAPTURE), capture_hash(folder, replace(CAPTURE, photo="b.jpg"))}
    (folder / "noon.exr").write_bytes(b"other")
    seen.add(capture_hash(folder, CAPTURE))
    assert len(seen) == 3
