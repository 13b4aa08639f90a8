"""Folders of captured skies, and when each was captured."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from skylight.errors import InputError
from skylight.io._hdr import write_exr, write_radiance
from skylight.io._light import read_linear
from skylight.skies._captures import Capture, index_captures, index_folder, parse_date, read_days
from skylight.skies._index import folder_hash, load_skies, read_index
from skylight.skies._layouts import read_pixels
from skylight.skies._sun import find_sun, plateau_size, why_no_sky
from skylight.sphere._envmap import EnvironmentMap
from skylight.sphere._frame import DirectionGrid, angle_between, direction_from_angles

SUN = (0.8, 0.9)  # azimuth, zenith


def painted(*, height: int = 48, full: bool = False, sun: float = 2e4) -> Float[Tensor, "h w 3"]:
    """A bright half sky whose sun, if any, is a little wider than a pixel."""
    grid = DirectionGrid.latlong(2 * height) if full else DirectionGrid.sky(height)
    light = light_from(grid.directions, sun)
    return light.float().reshape(-1, 4 * height, 1).expand(-1, -1, 3).contiguous()


def light_from(directions: Float[Tensor, "*n 3"], sun: float) -> Float[Tensor, "*n"]:
    place = direction_from_angles(torch.tensor(SUN[0]), torch.tensor(SUN[1])).double()
    angle = angle_between(directions, place.expand_as(directions))
    return 1 + directions[..., 1] * 0.5 + sun * torch.exp(-((angle / 0.03) ** 2))


def write(path: Path, radiance: Float[Tensor, "h w 3"], **header: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = radiance.numpy().astype(np.float32)
    if path.suffix == ".hdr":
        write_radiance(path, pixels)
    else:
        write_exr(path, pixels, half=False, header=header)
    return path


def test_what_is_found_and_what_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "sunny_20160515_0930.exr", painted())
    write(tmp_path / "20160515" / "101500" / "envmap.exr", painted(full=True))
    write(tmp_path / "grey.hdr", painted(sun=0.0))
    write(tmp_path / "clipped.exr", painted().clamp(max=100.0))
    write(tmp_path / "black.exr", torch.zeros(48, 192, 3))
    write(tmp_path / "small.exr", painted(height=16))
    write(tmp_path / "shape.exr", torch.ones(48, 100, 3))
    write(tmp_path / ".hidden" / "a.exr", painted())
    wrong = {"nan": math.nan, "infinite": math.inf, "negative": -1.0}
    for name, value in wrong.items():
        pixels = painted()
        pixels[2, 3] = value
        write(tmp_path / f"{name}.exr", pixels)
    (tmp_path / "damaged.exr").write_bytes(b"no picture")
    records, refusals = index_captures(tmp_path)
    found = {r.file: r for r in records}
    assert set(found) == {
        "sunny_20160515_0930.exr",
        "20160515/101500/envmap.exr",
        "grey.hdr",
    }
    for file, layout in (
        ("sunny_20160515_0930.exr", "skylatlong"),
        ("20160515/101500/envmap.exr", "latlong"),
    ):
        r = found[file]
        assert (r.day, r.layout, r.sun_transmittance, r.regime) == ("20160515", layout, 1, "clear")
        assert r.map_azimuth_deg == pytest.approx(math.degrees(SUN[0]), abs=0.3)
        assert r.sun_zenith_deg == pytest.approx(math.degrees(SUN[1]), abs=0.3)
        assert r.seed is None
        assert r.split is None
    assert found["20160515/101500/envmap.exr"].time == "2016-05-15T10:15:00"
    assert (found["grey.hdr"].day, found["grey.hdr"].sun_transmittance) == ("grey", 0)
    reasons = {r.file: r.reason for r in refusals}
    assert "pixels at its brightest place are equally bright" in reasons.pop("clipped.exr")
    assert "all black" in reasons.pop("black.exr")
    assert "too small: 16 rows" in reasons.pop("small.exr")
    assert "no shape of a sky" in reasons.pop("shape.exr")
    assert "no OpenEXR file" in reasons.pop("damaged.exr")
    for name in wrong:
        assert "finite and >= 0" in reasons.pop(f"{name}.exr")
    assert not reasons
    assert not (tmp_path / "index.csv").exists()


def test_squares_load_like_the_lat_long_map_of_the_same_sky(tmp_path: Path) -> None:
    size = 256
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) * 2 / size - 1
    right, down = torch.meshgrid(centre, centre, indexing="xy")
    zenith = torch.hypot(right, down) * math.pi / 2
    light = light_from(direction_from_angles(torch.atan2(right, down), zenith), 2e4)  # angular
    square = torch.where(zenith < math.pi / 2, light, math.nan)[..., None].expand(-1, -1, 3)
    write(tmp_path / "a_square.exr", square.float().contiguous())
    write(tmp_path / "b_map.exr", painted(height=180))
    index_folder(tmp_path)
    records = read_index(tmp_path)
    assert [r.layout for r in records] == ["angular", "skylatlong"]
    assert records[0].field_deg == 180
    skies = load_skies(tmp_path, records)
    torch.testing.assert_close(skies[0].sum(), skies[1].sum(), rtol=0.01, atol=0)
    near = slice(54, 76)
    torch.testing.assert_close(
        skies[0, :, near].sum((0, 1)), skies[1, :, near].sum((0, 1)), rtol=0.01, atol=0
    )
    torch.testing.assert_close(
        skies[0, :, :50].mean((1, 2)), skies[1, :, :50].mean((1, 2)), rtol=0.02, atol=0
    )


def test_days_of_a_list_come_first(tmp_path: Path) -> None:
    maps = tmp_path / "maps"
    write(maps / "20160515_1.exr", painted())
    write(maps / "b.exr", painted(), capDate="2017:01:02 03:04:05")
    write(maps / "c.hdr", painted())
    head, light = (maps / "c.hdr").read_bytes().split(b"\n\n", 1)
    (maps / "c.hdr").write_bytes(head + b"\nCAPDATE= 2018:02:03 04:05:06\n\n" + light)
    write(maps / "d.exr", painted(), capDate="no date")
    days = tmp_path / "days.csv"
    days.write_text("file,day,time\n20160515_1.exr,first,noon\n")
    records, _ = index_captures(maps, days=days)
    assert [(r.day, r.time) for r in records] == [
        ("first", "noon"),
        ("20170102", "2017-01-02T03:04:05"),
        ("20180203", "2018-02-03T04:05:06"),
        ("d", ""),
    ]
    days.write_text("file,day\nabsent.exr,1\n")
    with pytest.raises(InputError, match=r"absent\.exr"):
        index_captures(maps, days=days)


def test_an_index_elsewhere_and_one_again(tmp_path: Path) -> None:
    maps, out = tmp_path / "maps", tmp_path / "out.csv"
    for i in range(4):
        write(maps / f"2016051{i}.exr", painted(sun=2e4 * (i % 2)))
    index_folder(maps, out=out)
    assert not (maps / "index.csv").exists()
    records = read_index(out)
    assert {r.split for r in records} == {"train", "validation", "test"}
    assert load_skies(out, records).shape == (4, 32, 128, 3)
    assert len(folder_hash(out, records)) == 64
    before = out.read_bytes()
    index_folder(maps, out=out)
    assert out.read_bytes() == before


def test_other_peoples_indices_are_not_overwritten(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", painted())
    index = tmp_path / "index.csv"
    index.write_text("file,category\na.exr,outdoor-sun\n")
    with pytest.raises(InputError, match="--out"):
        index_folder(tmp_path)
    assert index.read_text() == "file,category\na.exr,outdoor-sun\n"
    index.unlink()
    index_folder(tmp_path)
    index.write_text(index.read_text().replace(",,,,skylatlong", ",1.0,2.0,7,skylatlong"))
    with pytest.raises(InputError, match="indexes simulated skies"):
        index_folder(tmp_path)


def test_folders_without_usable_maps(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no \.exr or \.hdr maps"):
        index_folder(tmp_path)
    write(tmp_path / "a.exr", torch.zeros(48, 192, 3))
    with pytest.raises(InputError, match=r"a\.exr: .* black"):
        index_folder(tmp_path)
    assert not (tmp_path / "index.csv").exists()


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_the_top_of_a_smooth_sky_is_not_clipped(tmp_path: Path, suffix: str) -> None:
    """RGBE rounds it to a plateau of hundreds of equal pixels."""
    path = write(tmp_path / f"smooth{suffix}", painted(height=128, sun=0.0))
    assert plateau_size(read_pixels(path)[1], wraps=True) == 0
    records, refusals = index_captures(tmp_path)
    assert (len(records), refusals) == (1, [])


def test_plateaus() -> None:
    level = torch.ones(40, 160, 3)
    level[10:12, 158:] = 50.0
    level[10:12, 0] = 50.0  # over the border of a lat-long map
    assert plateau_size(level, wraps=True) == 6
    assert plateau_size(level, wraps=False) in (2, 4)
    assert plateau_size(painted(), wraps=True) <= 2
    coloured = painted() * torch.tensor([1.0, 0.8, 0.5])
    assert plateau_size(coloured.clamp(max=60.0), wraps=True) > 5


def test_published_maps(shared_data: Path) -> None:
    """Maps whose suns their collectors described: where they stand, and which are clipped."""
    folder = shared_data / "hdr"
    if not (folder / "index.csv").is_file():
        pytest.skip("no described maps among the collected data")
    with (folder / "index.csv").open(newline="") as stream:
        described = {row["file"]: row for row in csv.DictReader(stream)}
    records, refusals = index_captures(folder, all_maps=True)
    assert len(records) + len(refusals) == len(described)
    outdoor = [r for r in records if described[r.file]["category"].startswith("outdoor")]
    # none is a plateau as it lies there: the one that was clamped was averaged down since
    assert refusals == []
    assert len(outdoor) >= 40
    for r in outdoor:
        row = described[r.file]
        assert r.sun_transmittance == (row["category"] == "outdoor-sun"), r.file
        if r.sun_transmittance:
            assert 90 - r.sun_zenith_deg == pytest.approx(float(row["peak_elevation_deg"]), abs=1)
            turn = (r.map_azimuth_deg - float(row["peak_column_deg"]) + 180) % 360 - 180
            assert abs(turn) * math.sin(math.radians(r.sun_zenith_deg)) < 1.5


def room(*, ceiling: float = 1.0, blue: float = 0.8) -> Float[Tensor, "96 192 3"]:
    """Grey below the horizon; above it of luminance ``ceiling``, its blue ``blue`` of its red."""
    light = torch.ones(96, 192, 3)
    light[:48] = ceiling * torch.tensor([1.0, 1.0, blue])
    return light


def test_rooms_are_left_out(tmp_path: Path) -> None:
    write(tmp_path / "sky.exr", room(blue=1.5))
    write(tmp_path / "sunny.exr", painted(full=True) * torch.tensor([1.0, 0.9, 0.6]))
    write(tmp_path / "half.exr", room()[:48])
    write(tmp_path / "lamps.exr", room())
    write(tmp_path / "ceiling.exr", room(ceiling=0.3, blue=1.0))
    lantern = room(blue=1.0)
    lantern[70:80, 50:60] = 100.0
    write(tmp_path / "lantern.exr", lantern)
    records, refusals = index_captures(tmp_path)
    assert {r.file for r in records} == {"sky.exr", "sunny.exr", "half.exr"}
    assert not any(r.is_sky for r in refusals)
    reasons = {r.file: r.reason for r in refusals}
    assert "redder" in reasons["lamps.exr"]
    assert "darker" in reasons["ceiling.exr"]
    assert "below the horizon" in reasons["lantern.exr"]
    assert len(index_captures(tmp_path, all_maps=True)[0]) == 6


def test_white_balance_and_exposure_of_a_sky_do_not_matter(tmp_path: Path) -> None:
    """Gains of each channel that leave the zenith no redder, and any level."""
    for level in (1e-3, 1.0, 1e3):
        write(tmp_path / f"{level}.exr", room(blue=1.0) * level)
    assert len(index_captures(tmp_path)[0]) == 3


def test_categories_of_another_index_count(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write(tmp_path / f"{name}.exr", painted())
    text = "file,category\na.exr,indoor-lamps\nb.exr,night\nc.exr,outdoor-sun\n"
    (tmp_path / "index.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        index_folder(tmp_path)
    out = tmp_path / "skies.csv"
    assert f"skylight skies index {tmp_path} --out {out}" in str(caught.value)
    with pytest.raises(InputError, match="an index of another kind") as caught:
        read_index(tmp_path)
    assert f"skylight skies index {tmp_path} --out {out}" in str(caught.value)
    _, records, refusals = index_folder(tmp_path, out=out)
    assert [Path(r.file).name for r in records] == ["c.exr"]
    assert ["indoor" in refusals[0].reason, "night" in refusals[1].reason] == [True, True]


@pytest.mark.parametrize(
    "content", [b"", bytes(4096), b"file,category\n\xff\xfe,night\n", b"file,category\na.exr\n"]
)
def test_a_damaged_index_is_told(tmp_path: Path, content: bytes) -> None:
    write(tmp_path / "a.exr", painted())
    (tmp_path / "index.csv").write_bytes(content)
    with pytest.raises(InputError) as caught:
        index_captures(tmp_path)
    assert str(tmp_path / "index.csv") in str(caught.value)
    assert "move it away" in str(caught.value)
    assert len(index_captures(tmp_path, all_maps=True)[0]) == 1


def test_an_index_without_categories_says_nothing_of_the_maps(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", painted())
    (tmp_path / "index.csv").write_text("name,photographer\na.exr,somebody\n")
    assert len(index_captures(tmp_path)[0]) == 1


def test_collected_probes_by_the_maps_alone(shared_data: Path) -> None:
    """Of a published collection: most rooms are told, and no open sky is left out."""
    folder = shared_data / "hdr"
    with (folder / "index.csv").open(newline="") as stream:
        category = {row["file"]: row["category"] for row in csv.DictReader(stream)}
    left_out = set()
    for file in category:
        whole = torch.from_numpy(read_linear(folder / file))
        visible = find_sun(EnvironmentMap(radiance=whole[: len(whole) // 2])).visible
        if why_no_sky(whole, sun_is_visible=visible):
            left_out.add(file)
    rooms = {file for file, name in category.items() if name == "indoor"}
    assert len(rooms & left_out) >= 16
    wrong = {file for file in left_out if category[file].startswith("outdoor")}
    assert wrong <= {"cave_wall.exr"}  # the inside of a cave


@pytest.mark.parametrize(
    ("text", "day", "time"),
    [
        ("IMG_20160515_1.exr", "20160515", ""),
        ("20160515_093015.exr", "20160515", "2016-05-15T09:30:15"),
        ("sky-2016-05-15 09.30.15.hdr", "20160515", "2016-05-15T09:30:15"),
        ("20160515T0930.exr", "20160515", "2016-05-15T09:30:00"),
        ("20160515093015.exr", "20160515", "2016-05-15T09:30:15"),
        ("20160515/093015/envmap.exr", "20160515", "2016-05-15T09:30:15"),
        ("20160515/20160516_093015.exr", "20160516", "2016-05-16T09:30:15"),
        ("2016:05:15 09:30:15", "20160515", "2016-05-15T09:30:15"),
        ("20160515_997799.exr", "20160515", ""),
        ("20240229.exr", "20240229", ""),
    ],
)
def test_dates(text: str, day: str, time: str) -> None:
    assert parse_date(text) == Capture(day=day, time=time)


@pytest.mark.parametrize(
    "text", ["", "20161301.exr", "20230229.exr", "kloofendal_43d", "120160515.exr", "2016051.exr"]
)
def test_what_is_no_date(text: str) -> None:
    assert parse_date(text) is None


def test_a_list_of_days(tmp_path: Path) -> None:
    path = tmp_path / "days.csv"
    path.write_text("\ufefffile,day,time\na.exr, one ,12:00\nb/c.exr,two,\n", encoding="utf-8")
    assert read_days(path) == {
        "a.exr": Capture(day="one", time="12:00"),
        "b/c.exr": Capture(day="two"),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "cannot be read"),
        ("name,day\na.exr,1\n", "row 2 has no file or no day"),
        ("file,day\na.exr,1\nb.exr\n", "row 3 has no file or no day"),
        ("file,day\na.exr,1\na.exr,2\n", "row 3 lists a.exr a second time"),
    ],
)
def test_unusable_lists(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "days.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_days(path)
